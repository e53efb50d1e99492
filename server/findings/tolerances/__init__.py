"""Findings of the kind `tolerances`: how severe the errors of a component may be."""
