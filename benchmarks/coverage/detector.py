"""How often a detector that violates too often is judged *met* (`brink.search.curves.DriveShares`)."""

from collections.abc import Callable
from functools import cache, partial
from typing import Final

import numpy as np

from benchmarks.coverage.study import Claim, Study
from benchmarks.coverage.tolerance import CONFIDENCE, LIMIT, steps
from brink.search.curves import LEVELS, Counts, Curve, DriveShares, curves_of
from brink.search.space import BoolArray, FloatArray

DRIVES: Final = (5, 10, 20, 50, 100, 200, 500)
SIMULATED: Final = 300
"""Drives of the campaign on which the curve is based."""
_CAMPAIGNS_SEED: Final = 1


def _rare(curve: FloatArray, share: float) -> FloatArray:
    """Return the probability of each level if few drives have the most severe error, and the others none."""
    chances = np.zeros(LEVELS + 1)
    chances[-1] = share / curve[-1]
    chances[0] = 1.0 - chances[-1]
    return chances


def _alike(curve: FloatArray, share: float) -> FloatArray:
    """Return the probability of each level if all drives have nearly the same error."""
    above = max(int(np.searchsorted(curve, share)), 1)
    chances = np.zeros(LEVELS + 1)
    chances[above] = (share - curve[above - 1]) / (curve[above] - curve[above - 1])
    chances[above - 1] = 1.0 - chances[above]
    return chances


def _graded(curve: FloatArray, share: float) -> FloatArray:
    """Return the probability of each level if errors are exponentially distributed."""
    low, high = 0.01, 100.0
    for _ in range(60):
        scale = np.sqrt(low * high)
        chances = np.exp(-np.arange(LEVELS + 1) / scale)
        low, high = (scale, high) if float(chances @ curve) < share * float(chances.sum()) else (low, scale)
    return np.asarray(chances / chances.sum())


_MIXTURES: Final[dict[str, Callable[[FloatArray, float], FloatArray]]] = {
    "few gross errors": _rare,
    "errors of one size": _alike,
    "errors of all sizes": _graded,
}


@cache
def _campaigns(count: int) -> tuple[FloatArray, list[Curve]]:
    """Return true curves, shape ``(count, LEVELS + 1)``, and estimates from a campaign of `SIMULATED` drives of each.

    All studies share them, because they take most of the time.
    """
    rng = np.random.default_rng([_CAMPAIGNS_SEED, count])
    truth = steps(rng, count)
    truth *= np.maximum(2.2 * LIMIT / truth[:, -1:], 1.0)
    counts = rng.multinomial(SIMULATED, np.full(LEVELS, 1.0 / LEVELS), count)
    simulated = Counts(drives=counts, caused=rng.binomial(counts, truth[:, 1:]))
    return truth, curves_of(simulated, [None] * count, [False] * count, limit=LIMIT, confidence=CONFIDENCE)


def _called_met(
    drives: int, times: float, mixture: str, rng: np.random.Generator, repetitions: int
) -> BoolArray:
    """Return in which repetitions a detector whose share of violations is a multiple of the limit is judged *met*."""
    met = []
    for shares, curve in zip(*_campaigns(repetitions), strict=True):
        levels = rng.choice(LEVELS + 1, drives, p=_MIXTURES[mixture](shares, times * LIMIT))
        interval = DriveShares.of([curve], levels / LEVELS).interval(rng, CONFIDENCE)
        met.append(interval.high <= LIMIT)
    return np.array(met)


STUDIES: Final = tuple(
    Study(
        name=f"detector: {drives:>3} drives, {mixture}, {times:g} times the limit, called met",
        claim=Claim.AT_MOST,
        nominal=0.5 * (1.0 - CONFIDENCE),
        simulate=partial(_called_met, drives, times, mixture),
    )
    for times, mixture, sizes in (
        *((1.0, mixture, DRIVES) for mixture in _MIXTURES),
        *((times, mixture, (10, 100, 500)) for times in (1.5, 2.0) for mixture in _MIXTURES),
    )
    for drives in sizes
)
