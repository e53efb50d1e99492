"""Benchmarks of the service, its simulators and its algorithms, with a target for each figure."""
