"""Findings of the kind `boundary`: distinct solutions near the hazard boundary."""
