"""Campaigns: submission, the generation step, results."""
