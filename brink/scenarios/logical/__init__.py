"""Logical scenarios: OpenSCENARIO files with parameters and their distributions, as search spaces and back."""
