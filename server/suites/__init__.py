"""Suites: drives of earlier campaigns that are simulated again, with something changed or nothing."""
