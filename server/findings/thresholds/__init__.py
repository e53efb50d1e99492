"""Findings of the kind `thresholds`: where along one unit drives turn from safe to unsafe."""
