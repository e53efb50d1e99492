"""Measurements of the whole service, each with its target."""
