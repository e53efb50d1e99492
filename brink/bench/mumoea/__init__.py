"""Compares muMOEA with its ablations and baselines on this installation."""
