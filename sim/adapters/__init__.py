"""Simulators that Brink did not write, each behind the same protocol as its own."""
