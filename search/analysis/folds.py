"""Folds of simulations for cross-validation, which keep similar solutions together.

A model that is scored on a simulation must not have learned from one that is nearly the same. Simulations that were
drawn at random are independent; those of a search are not: it simulates both sides of a pair, and one scenario with
many behaviours. A *kind* gives a label to each simulation. Simulations with a label in common, of any kind, are never
on both sides of a division.

Where the simulations that share labels, directly or over others, fall into groups that are small enough, the groups
are divided into folds. Where everything is connected, as in a campaign of MLCSHE, the labels of each kind are divided
into folds of their own. Each combination of folds then has its own model, fitted to the simulations that share no
fold with it.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.deadline import check_time
from brink.search.metric import Metric
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace

NEAR: Final = 0.01
"""Two solutions are nearly the same if they are closer together than all but this share of random draws are to the
nearest solution."""
MAX_DRAWS: Final = 500
"""Maximum number of random draws from which this distance is taken."""
_MAX_LINKS: Final = 1_000_000
"""Links between near solutions that are held at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Division:
    """The simulations of one model.

    Attributes:
        fitted: Mask of the simulations to which it is fitted, shape ``(n,)``.
        scored: Mask of those that it scores, none of which shares a label with the fitted ones, shape ``(n,)``.
    """

    fitted: BoolArray
    scored: BoolArray


def divisions(
    kinds: Sequence[IntArray], unsafe: BoolArray, rng: np.random.Generator, folds: Sequence[int]
) -> list[Division]:
    """Return divisions that together score each simulation once; none if a model would see a single verdict.

    Args:
        kinds: Labels of the simulations, from 0, shape ``(n,)`` each, at least one kind.
        unsafe: Their verdicts, which are spread evenly, shape ``(n,)``.
        rng: Divides them.
        folds: Numbers of folds, descending. The first one is used in whose folds the largest group fits. The last one
            is also that of the folds of each kind, if none fits.
    """
    groups = connected(kinds)
    largest = int(np.bincount(groups).max())
    count = next((one for one in folds if largest * one <= unsafe.size), 0)
    divided = [groups] if count else [kind for kind in kinds if np.unique(kind).size >= folds[-1]]
    count = count or folds[-1]
    fold_of = [_spread(kind, unsafe, rng, count) for kind in divided]
    divisions_found = []
    for which in np.ndindex(*(count,) * len(fold_of)):
        same: BoolArray = np.array([fold == one for fold, one in zip(fold_of, which, strict=True)])
        division = Division(fitted=np.asarray(~same.any(axis=0)), scored=np.asarray(same.all(axis=0)))
        if division.scored.any():
            divisions_found.append(division)
    has_both = [unsafe[one.fitted].any() and not unsafe[one.fitted].all() for one in divisions_found]
    return divisions_found if fold_of and all(has_both) else []


def connected(kinds: Sequence[IntArray]) -> IntArray:
    """Return the groups of simulations that share a label of any kind, directly or through others, shape ``(n,)``.

    Args:
        kinds: Labels, from 0, shape ``(n,)`` each, at least one kind.
    """
    group = np.arange(kinds[0].size)
    while True:
        before = group.copy()
        for kind in kinds:
            least = np.full(int(kind.max()) + 1, kind.size, np.int64)
            np.minimum.at(least, kind, group)
            group = least[kind]
        if (group == before).all():
            return numbered(group.tolist())


def numbered(values: Sequence[Hashable]) -> IntArray:
    """Return consecutive numbers of equal values, from 0, shape ``(n,)``."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(value, len(numbers)) for value in values], np.int64)


def _spread(groups: IntArray, unsafe: BoolArray, rng: np.random.Generator, folds: int) -> IntArray:
    """Return the fold of each simulation, shape ``(n,)``: a group is in one fold, verdicts are spread evenly."""
    share = np.bincount(groups, unsafe) / np.bincount(groups)
    # Sorted by unsafe share, ties at random, each few in a row go to the folds in random order.
    order = np.lexsort((rng.random(share.size), share))
    fold = np.empty(share.size, np.int64)
    for first in range(0, share.size, folds):
        part = order[first : first + folds]
        fold[part] = rng.permutation(folds)[: part.size]
    return fold[groups]


def kinds_of_solutions(space: SearchSpace, vectors: FloatArray, rng: np.random.Generator) -> list[IntArray]:
    """Return labels of similar complete solutions: those that share a component, or are a small distance apart.

    Fresh solutions resemble the simulated ones by chance: scenarios of a few categories recur, and many behaviours
    may report nothing. A component that one of as many random draws has as well therefore makes no solutions alike,
    and random draws also tell what is a small distance. So a model scores solutions that are as unlike its own as
    fresh ones are.

    Args:
        space: Their space.
        vectors: The solutions, shape ``(n, d)``.
        rng: Draws solutions.

    Returns:
        Labels of the solutions, shape ``(n,)`` each. Near solutions have the same label in every kind.

    References:
        Milà et al. 2022 (folds in which distances are those between the training data and what is to be predicted).
    """
    draws = np.array([_drawn(space, rng) for _ in range(len(vectors))])
    near = _near(space, vectors, draws[:MAX_DRAWS])
    kinds = []
    for part in space.slices:
        label = np.unique(np.concatenate([vectors[:, part], draws[:, part]]), axis=0, return_inverse=True)[
            1
        ].ravel()
        shared, drawn = np.split(label, [len(vectors)])
        by_chance = np.flatnonzero(np.isin(shared, drawn))
        shared[by_chance] = label.size + by_chance
        if np.unique(shared).size < len(vectors):
            kinds.append(connected([numbered(shared.tolist()), near]))
    return kinds or [near]


def _drawn(space: SearchSpace, rng: np.random.Generator) -> FloatArray:
    check_time()
    return space.join(space.sample(rng))


def _near(space: SearchSpace, vectors: FloatArray, draws: FloatArray) -> IntArray:
    """Return labels shared by equal or nearly equal solutions, directly or through others, shape ``(n,)``."""
    rows, which = np.unique(vectors, axis=0, return_inverse=True)
    metric = Metric.of_space(space)
    nearest = metric.between(draws, rows).min(axis=1)
    apart = nearest[nearest > 0]
    limit = float(np.quantile(apart, NEAR)) if apart.size else 0.0
    label, points = np.arange(len(rows)), metric.points(rows)
    links: list[IntArray] = []
    for part, columns, block in metric.blocks(points, points):
        above, left = np.nonzero(block < limit)
        links.append(np.stack([label[above + part.start], label[left + columns.start]]))
        if sum(link.shape[1] for link in links) > _MAX_LINKS:
            label, links = _merged(label, links), []
    return _merged(label, links)[which.ravel()]


def _merged(label: IntArray, links: Sequence[IntArray]) -> IntArray:
    """Return labels with linked ones merged, shape ``(n,)``."""
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    above, left = np.concatenate(links, axis=1) if links else np.zeros((2, 0), np.int64)
    graph = csr_array((np.ones(above.size, np.bool_), (above, left)), shape=(label.size, label.size))
    merged: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
    return merged[label]
