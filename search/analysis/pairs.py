"""The pairs that an archive holds: two neighbouring solutions, one safe and one unsafe.

Any archive may hold pairs, whichever search filled it. A solution that was simulated several times, with the same
parameters and other seeds, counts once: it is safe if all its verdicts are, unsafe if all are, otherwise *chancy*.
Chancy solutions are on neither side of a pair. A pair is *checked* if each of its sides was simulated with at least
two different seeds. It is *categorical* if a category, or one step of a whole number, is changed and nothing else.

Two near solutions with opposite verdicts are not a pair if they differ in no parameter that was active in either of
their episodes, which then differed only by chance.

Pairs are *distinct* if their midpoints are at least d_th apart. They are taken greedily: checked pairs first, then by
distance, then by number.

Source: ours; docs/explanation/pairs.md.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from brink.search.archive import Archive
from brink.search.errors import TooManyPairs
from brink.search.features import Unit
from brink.search.metric import Metric
from brink.search.pairs import Steps, midpoints
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace

_CHUNK_CELLS: Final = 4_000_000
"""Distances computed at a time; bounds the memory."""
_BLOCK: Final = 1_000
"""Midpoints compared at a time."""
HadPart: TypeAlias = Callable[[IntArray], BoolArray]
"""Returns for the solutions at n positions of an archive which parameters were active in the episode of each.

The result has the shape ``(n, d)``.
"""
MOST_TIGHT: Final = 200_000
MOST_DISTINCT: Final = 5_000
"""Maximum numbers of tight and of distinct pairs; they bound time and memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One side of a pair.

    Attributes:
        number: Number of the solution; of several simulations of the same parameters, the first.
        evaluated: Simulations of these parameters.
        seeds: Different episode seeds among them.
        seed: Episode seed of the first one; None if it is not known.
        robustness: Robustness in the first one.
    """

    number: int
    evaluated: int
    seeds: int
    seed: int | None
    robustness: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A safe and an unsafe solution that are neighbours.

    Attributes:
        safe: The safe side: every simulation of it was safe.
        unsafe: The unsafe side: every simulation of it was unsafe.
        distance: Distance between the two.
        units: Columns in which they differ; numbers that a constraint ties together are one unit.
        is_categorical: Whether they differ in one category, or in one number with no valid value in between, and in
            nothing else.
    """

    safe: Side
    unsafe: Side
    distance: float
    units: tuple[Unit, ...]
    is_categorical: bool = False

    @property
    def checked(self) -> bool:
        """Whether both sides kept their verdicts with at least one further seed."""
        return min(self.safe.seeds, self.unsafe.seeds) >= 2

    @property
    def same_seed(self) -> bool:
        """Whether both sides are known to have been simulated with the same episode seed."""
        return self.safe.seed is not None and self.safe.seed == self.unsafe.seed


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPairs:
    """The distinct pairs of an archive.

    Attributes:
        pairs: Distinct pairs in the order in which they were taken.
        tight: Number of tight pairs, distinct or not.
        without_part: Number of near solutions with opposite verdicts that differ in no active parameter.
        chancy: Number of solutions whose simulations had different verdicts.
        safe: Number of safe solutions, each counted once.
        unsafe: Number of unsafe solutions, each counted once.
    """

    pairs: tuple[Pair, ...]
    tight: int
    without_part: int
    chancy: int
    safe: int
    unsafe: int

    @property
    def checked(self) -> int:
        """Number of distinct pairs that are checked."""
        return sum(pair.checked for pair in self.pairs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solutions:
    """Solutions without duplicates: position of the first simulation of each, and counts of its simulations."""

    first: IntArray
    evaluated: IntArray
    unsafe: IntArray
    seeds: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidates:
    """Tight pairs: positions of their sides among the solutions without duplicates, and distances, shape ``(n,)``."""

    safe: IntArray
    unsafe: IntArray
    distance: FloatArray

    def __len__(self) -> int:
        return len(self.safe)

    def at(self, places: IntArray) -> "_Candidates":
        return _Candidates(safe=self.safe[places], unsafe=self.unsafe[places], distance=self.distance[places])


def find_pairs(
    archive: Archive,
    space: SearchSpace,
    *,
    eps: float,
    d_th: float,
    seeds: IntArray | None = None,
    had_part: HadPart | None = None,
) -> FoundPairs:
    """Find the distinct tight pairs of an archive.

    Args:
        archive: Simulated solutions.
        space: Their space.
        eps: Largest distance between the sides of a pair, unless they are one step apart in a single parameter.
        d_th: Smallest distance between the midpoints of two distinct pairs.
        seeds: Episode seed of each solution, shape ``(n,)``; None if each was simulated with a seed of its own.
        had_part: Tells which parameters were active in the episodes; None if all may have been.

    Raises:
        TooManyPairs: There are more than `MOST_TIGHT` tight or `MOST_DISTINCT` distinct pairs.
    """
    solutions = _without_duplicates(archive, seeds)
    is_safe, is_unsafe = solutions.unsafe == 0, solutions.unsafe == solutions.evaluated
    steps = Steps(space)
    rows = archive.vectors[solutions.first]
    tight = _tight(rows, steps, np.flatnonzero(is_safe), np.flatnonzero(is_unsafe), eps)
    differs = _differ_in_a_part(archive, solutions, tight, had_part)
    without_part = len(tight) - int(differs.sum())
    tight = tight.at(np.flatnonzero(differs))
    repeated = np.minimum(solutions.seeds[tight.safe], solutions.seeds[tight.unsafe]) >= 2
    numbers = archive.numbers[solutions.first]
    tight = tight.at(np.lexsort((numbers[tight.unsafe], numbers[tight.safe], tight.distance, ~repeated)))
    taken = tight.at(_distinct(rows, tight, steps, d_th))

    def side(place: int) -> Side:
        first = int(solutions.first[place])
        return Side(
            number=int(archive.numbers[first]),
            evaluated=int(solutions.evaluated[place]),
            seeds=int(solutions.seeds[place]),
            seed=None if seeds is None else int(seeds[first]),
            robustness=float(archive.robustness[first]),
        )

    return FoundPairs(
        pairs=tuple(
            Pair(
                safe=side(safe),
                unsafe=side(unsafe),
                distance=distance,
                units=tuple(steps.differing(rows[safe], rows[unsafe])),
                is_categorical=steps.are_one_step_apart(rows[safe], rows[unsafe]),
            )
            for safe, unsafe, distance in zip(
                taken.safe.tolist(), taken.unsafe.tolist(), taken.distance.tolist(), strict=True
            )
        ),
        tight=len(tight),
        without_part=without_part,
        chancy=int((~is_safe & ~is_unsafe).sum()),
        safe=int(is_safe.sum()),
        unsafe=int(is_unsafe.sum()),
    )


def _differ_in_a_part(
    archive: Archive, solutions: _Solutions, found: _Candidates, had_part: HadPart | None
) -> BoolArray:
    """Return which candidates differ in a parameter that was active in an episode of either, shape ``(n,)``."""
    differs = np.ones(len(found), np.bool_)
    if had_part is None or not len(found):
        return differs
    sides, place = np.unique(np.concatenate([found.safe, found.unsafe]), return_inverse=True)
    part = had_part(solutions.first[sides])
    safe, unsafe = place.reshape(2, -1)
    rows = archive.vectors[solutions.first[sides]]
    for begin in range(0, len(found), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        one, other = safe[block], unsafe[block]
        differs[block] = ((rows[one] != rows[other]) & (part[one] | part[other])).any(axis=1)
    return differs


@dataclass(frozen=True, slots=True, kw_only=True)
class Opposites:
    """A safe and an unsafe solution, however far apart.

    Attributes:
        safe: Number of the safe one.
        unsafe: Number of the unsafe one.
        distance: Distance between the two.
    """

    safe: int
    unsafe: int
    distance: float


def nearest_opposites(archive: Archive, space: SearchSpace) -> Opposites | None:
    """Return the safe and the unsafe solution that are nearest to each other; None without both verdicts.

    Args:
        archive: Simulated solutions; chancy ones are neither safe nor unsafe.
        space: Their space.
    """
    solutions = _without_duplicates(archive, None)
    safe = solutions.first[solutions.unsafe == 0]
    unsafe = solutions.first[solutions.unsafe == solutions.evaluated]
    if not len(safe) or not len(unsafe):
        return None
    metric, nearest = Metric.of_space(space), []
    for part in _chunks(safe, len(unsafe)):
        distances = metric.between(archive.vectors[part], archive.vectors[unsafe])
        row, column = np.unravel_index(int(distances.argmin()), distances.shape)
        nearest.append((float(distances[row, column]), int(part[row]), int(unsafe[column])))
    distance, one, other = min(nearest)
    return Opposites(safe=int(archive.numbers[one]), unsafe=int(archive.numbers[other]), distance=distance)


def _without_duplicates(archive: Archive, seeds: IntArray | None) -> _Solutions:
    _, first, inverse = np.unique(archive.vectors, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    evaluated = np.bincount(inverse, minlength=len(first))
    different = evaluated
    if seeds is not None:
        solution, _ = np.unique(np.column_stack([inverse, seeds]), axis=0).T
        different = np.bincount(solution, minlength=len(first))
    return _Solutions(
        first=first.astype(np.int64),
        evaluated=evaluated,
        unsafe=np.bincount(inverse[archive.unsafe], minlength=len(first)),
        seeds=different,
    )


def _tight(rows: FloatArray, steps: Steps, safe: IntArray, unsafe: IntArray, eps: float) -> _Candidates:
    """Return all tight pairs of rows.

    Raises:
        TooManyPairs: There are too many.
    """
    nothing = np.empty(0, np.int64)
    blocks: list[_Candidates] = [_Candidates(safe=nothing, unsafe=nothing, distance=np.empty(0))]
    limit, total = steps.largest_tight(eps) * (1 + 1e-9), 0
    for part in _chunks(safe, max(1, len(unsafe))):
        distances = steps.metric.between(rows[part], rows[unsafe])
        _check_few(total + int(np.count_nonzero(distances <= eps)), eps)
        a, b = np.nonzero(distances <= limit)
        some = _Candidates(safe=part[a], unsafe=unsafe[b], distance=distances[a, b])
        some = some.at(np.flatnonzero(_are_tight(rows, steps, some, eps)))
        blocks.append(some)
        total += len(some)
        _check_few(total, eps)
    return _Candidates(
        safe=np.concatenate([block.safe for block in blocks]),
        unsafe=np.concatenate([block.unsafe for block in blocks]),
        distance=np.concatenate([block.distance for block in blocks]),
    )


def _check_few(tight: int, eps: float) -> None:
    if tight > MOST_TIGHT:
        raise TooManyPairs(
            f"more than {MOST_TIGHT:,} pairs of solutions are within eps {eps:g}: choose a smaller eps",
            setting="eps",
        )


def _are_tight(rows: FloatArray, steps: Steps, some: _Candidates, eps: float) -> BoolArray:
    """Return which candidates are tight: near, or one step apart in a single unit; shape ``(n,)``."""
    tight: BoolArray = some.distance <= eps
    far = np.flatnonzero(~tight)
    for begin in range(0, len(far), _BLOCK):
        places = far[begin : begin + _BLOCK]
        different = rows[some.safe[places]] != rows[some.unsafe[places]]
        units = np.sum([different[:, list(unit)].any(axis=1) for unit in steps.units], axis=0)
        for place in places[units == 1].tolist():
            tight[place] = steps.is_tight(rows[some.safe[place]], rows[some.unsafe[place]], eps)
    return tight


def _distinct(rows: FloatArray, found: _Candidates, steps: Steps, d_th: float) -> IntArray:
    """Return the positions of the pairs whose midpoints are at least `d_th` from those of all earlier pairs.

    Raises:
        TooManyPairs: There are too many.
    """
    message = (
        f"more than {MOST_DISTINCT:,} distinct pairs at d_th {d_th:g}: choose a larger d_th or a smaller eps"
    )
    if d_th == 0:
        if len(found) > MOST_DISTINCT:
            raise TooManyPairs(message, setting="d_th")
        return np.arange(len(found))
    taken: list[int] = []
    centres: FloatArray = np.empty((0, rows.shape[1]))
    for begin in range(0, len(found), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        middles = midpoints(rows[found.safe[block]], rows[found.unsafe[block]], steps.space)
        left = begin + np.arange(len(middles))
        if taken:
            apart = (steps.metric.between(middles, centres) >= d_th).all(axis=1)
            middles, left = middles[apart], left[apart]
        new = [centres]
        while len(left):
            taken.append(int(left[0]))
            new.append(middles[:1])
            apart = steps.metric.between(middles, middles[:1])[:, 0] >= d_th
            apart[0] = False
            middles, left = middles[apart], left[apart]
        if len(taken) > MOST_DISTINCT:
            raise TooManyPairs(message, setting="d_th")
        centres = np.concatenate(new)
    return np.array(taken, np.int64)


def _chunks(rows: IntArray, columns: int) -> Iterator[IntArray]:
    """Yield parts of `rows` so small that distances to `columns` others fit into memory."""
    size = max(1, _CHUNK_CELLS // columns)
    for begin in range(0, len(rows), size):
        yield rows[begin : begin + size]
