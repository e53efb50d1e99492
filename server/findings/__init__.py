"""Findings of campaigns: one folder for each kind, and the code that all kinds share."""
