"""Findings of the kind `pairs`: neighbours of which one is safe and one unsafe."""
