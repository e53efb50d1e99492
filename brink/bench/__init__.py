"""Measurements of the service, of its simulators and of its methods, each with its target."""
