"""The kinds of follow-ups, one module each."""
