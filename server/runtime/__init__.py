"""Runs the coordinator: in its own process, or on a thread of a command, with worker processes alongside it."""
