"""Findings of the kind `rate`: how often solutions are unsafe in operation."""
