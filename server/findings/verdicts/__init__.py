"""Findings of the kind `verdicts`: how many solutions are unsafe, which every campaign reports."""
