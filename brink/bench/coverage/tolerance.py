"""Coverage of the intervals of tolerated severities (`brink.search.curves`)."""

from functools import partial
from typing import Final

import numpy as np

from brink.bench.coverage.study import Claim, Study
from brink.search.curves import LEVELS, Counts, curves_of, severities, severity_at
from brink.search.space import BoolArray, FloatArray, IntArray

LIMIT: Final = 0.05
CONFIDENCE: Final = 0.9
_CELLS_AT_A_TIME: Final = 100


def steps(rng: np.random.Generator, cells: int) -> FloatArray:
    """Return curves that rise from 0 in one step, shape ``(cells, LEVELS + 1)``; half of them to 10% or less."""
    middle = rng.uniform(0.1, 0.9, (cells, 1))
    scale = rng.uniform(0.02, 0.15, (cells, 1))
    height = np.exp(rng.uniform(np.log(0.01), 0.0, (cells, 1)))
    rise = 1.0 / (1.0 + np.exp((middle - severities()) / scale))
    return np.asarray(height * (rise - rise[:, :1]) / (1.0 - rise[:, :1]))


def drawn_counts(shares: FloatArray, drives: int, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Return drives at random levels of severity, and those that violate, shape ``(cells, LEVELS)`` each.

    Args:
        shares: True shares at all severities, shape ``(cells, LEVELS + 1)``.
        drives: Drives of each cell.
        rng: Draws levels and verdicts.
    """
    simulated = rng.multinomial(drives, np.full(LEVELS, 1.0 / LEVELS), len(shares))
    return simulated, rng.binomial(simulated, shares[:, 1:])


def _without_screening(drives: int, rng: np.random.Generator, repetitions: int) -> BoolArray:
    covered: list[bool] = []
    while len(covered) < repetitions:
        cells = min(_CELLS_AT_A_TIME, repetitions - len(covered))
        truth = steps(rng, cells)
        simulated, caused = drawn_counts(truth, drives, rng)
        known = curves_of(
            Counts(drives=simulated, caused=caused), [None] * cells, [False] * cells, limit=LIMIT,
            confidence=CONFIDENCE,
        )  # fmt: skip
        covered += [
            one.tolerated.low <= severity <= one.tolerated.high
            for one, severity in zip(known, severity_at(truth, LIMIT), strict=True)
        ]
    return np.array(covered)


STUDIES: Final = tuple(
    Study(
        name=f"tolerance: {drives:,} drives a cell",
        claim=Claim.AT_LEAST,
        nominal=CONFIDENCE,
        simulate=partial(_without_screening, drives),
    )
    for drives in (100,)
)
