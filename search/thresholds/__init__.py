"""Thresholds: where along a unit the probability of a violation rises from at most 20% to at least 80%."""

from brink.search.thresholds.estimation import (
    CHANCY_STRETCH,
    CONFIDENCE,
    FEWEST,
    HIGH,
    LOW,
    MOST,
    Estimate,
    Trials,
    estimate,
    next_places,
)
from brink.search.thresholds.prior import CurvePrior

__all__ = [
    "CHANCY_STRETCH",
    "CONFIDENCE",
    "FEWEST",
    "HIGH",
    "LOW",
    "MOST",
    "CurvePrior",
    "Estimate",
    "Trials",
    "estimate",
    "next_places",
]
