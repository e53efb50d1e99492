"""Experiments: methods on problems with seeds, as campaigns that are compared."""
