"""Coverage of the intervals of a monitor's trees, which state how much an estimate depends on the simulations."""

from functools import partial
from typing import Final

import numpy as np

from benchmarks.coverage.study import Claim, Study
from brink.search.analysis.choices import Model
from brink.search.analysis.monitor import Monitor
from brink.search.space import BoolArray, Component, FloatArray, Real, SearchSpace

SPACE: Final = SearchSpace((Component("plane", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0))),))
SOLUTIONS: Final = 120
QUERIES: Final = 40
_NEAR: Final = 1e-4


def risk(rows: FloatArray) -> FloatArray:
    """Return the true probability of being unsafe, shape ``(n,)``: high in a corner."""
    log_odds: FloatArray = 10.0 * (rows.sum(axis=1) - 1.1)
    return 1.0 / (1.0 + np.exp(-log_odds))


def _of_estimates(copies: int, rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Measure coverage of the mean estimate of all repetitions, to which the interval refers.

    Nearly equal solutions share a verdict: such families say no more than one solution.
    """
    queries = rng.random((QUERIES, 2))
    low, middle, high = (np.empty((repetitions, QUERIES)) for _ in range(3))
    for repetition in range(repetitions):
        rows = np.repeat(rng.random((SOLUTIONS // copies, 2)), copies, axis=0)
        unsafe = np.repeat(rng.random(len(rows) // copies) < risk(rows[::copies]), copies)
        near = np.clip(rows + rng.uniform(-_NEAR, _NEAR, rows.shape), 0.0, 1.0)
        found = Monitor.fitted(SPACE, near, unsafe, threshold=0.5, seed=repetition, model=Model.TREES).score(
            queries
        )
        low[repetition], middle[repetition], high[repetition] = found.low, found.probability, found.high
    asked = np.arange(repetitions) % QUERIES
    mean = middle.mean(axis=0)[asked]
    each = np.arange(repetitions)
    return np.asarray((low[each, asked] <= mean) & (mean <= high[each, asked]))


STUDIES: Final = tuple(
    Study(
        name=f"monitor: {SOLUTIONS} solutions{case}",
        claim=Claim.AT_LEAST,
        nominal=0.95,
        simulate=partial(_of_estimates, copies),
    )
    for copies, case in ((1, ""), (3, " in families of three"))
)
