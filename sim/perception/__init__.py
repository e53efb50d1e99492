"""Detectors: the network that ships with the project, its training and scoring, and users' own networks."""
