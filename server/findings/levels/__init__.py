"""Findings of the kind `levels`: a small rate as a product of shares, by subset simulation."""
