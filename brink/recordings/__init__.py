"""Recordings of a detector beside the truth, in the formats that people have, and how wrong the detector was."""
