"""Measurements of the service, its simulators and its algorithms; each figure stands beside its target."""
