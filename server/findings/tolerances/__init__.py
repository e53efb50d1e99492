"""Findings of the kind `tolerances`: how gross the errors of a component may be."""
