"""Findings of the kind `violations`: the types of violations that other traffic causes."""
