"""Measurements of this installation, of its simulators and of its methods."""
