"""The results of a test and an interval on archives without any effect (`brink.search.analysis.dependence`, `rules`).

Verdicts depend on no parameter by itself: the unit cube is cut into cells, and a coin for each cell decides.
Solutions close together share a verdict, as they do in a simulation, and a search breeds its solutions from unsafe
ones.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from benchmarks.coverage.study import Claim, Study
from brink.search.analysis.rules import DEPTH, LEAST_LEAF, region_rules
from brink.search.archive import Archive, Neighbourhood
from brink.search.fitness import wilson_interval
from brink.search.parameters import Real
from brink.search.space import BoolArray, Component, FloatArray, SearchSpace

PARAMETERS: Final = 8
SOLUTIONS: Final = 600
UNSAFE: Final = 0.3
LEVEL: Final = 0.05
_BINS: Final = 8
_FIRST: Final = 60
"""Solutions of a generation; those of the first one are random."""
_CELL: Final = 0.25
_MUTATED: Final = 0.2
_STEP: Final = 0.1


def _verdicts(rows: FloatArray, salt: int) -> BoolArray:
    """Return a coin flip for the cell of each solution, shape ``(n,)``."""
    cells = np.floor(rows / _CELL).astype(np.uint64)
    mixed = np.full(len(rows), salt, np.uint64)
    for column in cells.T:  # splitmix64
        mixed = mixed + column + np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed = mixed ^ (mixed >> np.uint64(31))
    return np.asarray(mixed < np.uint64(UNSAFE * 2**64))


def searched(rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
    """Return the solutions of a search that breeds from unsafe solutions, and their verdicts."""
    salt = int(rng.integers(2**63))
    rows = rng.random((_FIRST, PARAMETERS))
    unsafe = _verdicts(rows, salt)
    while len(rows) < SOLUTIONS:
        parents = rows[rng.choice(np.flatnonzero(unsafe) if unsafe.any() else len(rows), _FIRST)]
        step = rng.normal(0.0, _STEP, parents.shape) * (rng.random(parents.shape) < _MUTATED)
        children = np.clip(parents + step, 0.0, 1.0 - 1e-9)
        rows, unsafe = np.concatenate([rows, children]), np.concatenate([unsafe, _verdicts(children, salt)])
    return rows, unsafe


def drawn(rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
    """Return random solutions, and their verdicts."""
    rows = rng.random((SOLUTIONS, PARAMETERS))
    return rows, _verdicts(rows, int(rng.integers(2**63)))


Solutions = Callable[[np.random.Generator], tuple[FloatArray, BoolArray]]


def _significant(solutions: Solutions, rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Return where a chi-squared test finds that some parameter has an effect, after Bonferroni."""
    from scipy.stats import chi2  # slow to import

    found = np.zeros(repetitions, np.bool_)
    for repetition in range(repetitions):
        rows, unsafe = solutions(rng)
        share = unsafe.mean()
        bins = np.argsort(np.argsort(rows, axis=0), axis=0) * _BINS // len(rows)
        hits = np.stack([np.bincount(column, unsafe, _BINS) for column in bins.T])
        sizes = np.bincount(bins[:, 0], minlength=_BINS)
        statistics = ((hits - sizes * share) ** 2 / (sizes * share * (1.0 - share))).sum(axis=1)
        found[repetition] = statistics.max() > chi2.isf(LEVEL / PARAMETERS, _BINS - 1)
    return found


SPACE: Final = SearchSpace(
    tuple(
        Component(name, tuple(Real(f"{name}_{number}", 0.0, 1.0) for number in range(PARAMETERS // 2)))
        for name in ("scenario", "behaviour")
    )
)


def _held_out(rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Return where the interval of a leaf covers, counted in scenarios that the tree did not see."""
    covered = np.zeros(repetitions, np.bool_)
    for repetition in range(repetitions):
        rows, unsafe = drawn(rng)
        empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1, z=1.96))
        archive = empty.grown(
            np.arange(len(rows)), rows, unsafe, np.where(unsafe, -1.0, 1.0), keep_rows=False
        )
        rules = region_rules(archive, SPACE, unsafe, "unsafe", seed=int(rng.integers(2**31))).rules
        rule = rules[int(rng.integers(len(rules)))]
        covered[repetition] = _covers(rule.inside, rule.solutions)
    return covered


def _seen(rng: np.random.Generator, repetitions: int) -> BoolArray:
    """Return where the interval of a leaf covers, counted in the solutions that the tree was fitted to."""
    from sklearn.tree import DecisionTreeClassifier  # optional, and slow to import

    covered = np.zeros(repetitions, np.bool_)
    for repetition in range(repetitions):
        rows, unsafe = drawn(rng)
        leaves = (
            DecisionTreeClassifier(max_depth=DEPTH, min_samples_leaf=LEAST_LEAF).fit(rows, unsafe).apply(rows)
        )
        leaf = leaves == rng.choice(np.unique(leaves))
        covered[repetition] = _covers(int(unsafe[leaf].sum()), int(leaf.sum()))
    return covered


def _covers(unsafe: int, solutions: int) -> bool:
    low, high = wilson_interval(unsafe, solutions)
    return bool(low <= UNSAFE <= high)


STUDIES: Final = (
    Study(
        name="dependence: chi-squared test of random solutions",
        claim=Claim.AT_MOST,
        nominal=LEVEL,
        simulate=partial(_significant, drawn),
    ),
    Study(
        name="dependence: chi-squared test of a search (not given)",
        claim=Claim.NONE,
        nominal=LEVEL,
        simulate=partial(_significant, searched),
    ),
    Study(
        name="rules: leaf counted where the tree was fitted (not given)",
        claim=Claim.NONE,
        nominal=0.95,
        simulate=_seen,
    ),
    Study(name="rules: leaf counted elsewhere", claim=Claim.AT_LEAST, nominal=0.95, simulate=_held_out),
)
