"""Formats of recordings: one module each, which defines ``FORMAT``; `brink.recordings.reading` finds them here."""
