"""The pairs that an archive holds: two solutions that are almost the same, one safe and one unsafe.

Any archive may hold pairs, whichever search filled it. A solution that was simulated several times, with the same
parameters and other seeds, counts once: it is safe if all its verdicts are, unsafe if all are, otherwise *chancy*.
Chancy solutions are on neither side of a pair. A pair is *checked* if each of its sides was simulated at least twice.

Pairs are *distinct* if their midpoints are at least d_th apart. They are taken greedily: checked pairs first, then by
distance, then by number.

Source: ours; docs/explanation/pairs.md.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.archive import Archive
from brink.search.features import Unit
from brink.search.metric import Metric
from brink.search.pairs import Steps, midpoints
from brink.search.space import FloatArray, IntArray, SearchSpace

_CHUNK_CELLS = 4_000_000
"""Distances computed at a time; bounds the memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One side of a pair.

    Attributes:
        number: Number of the solution; of several simulations of the same parameters, the first.
        evaluated: Simulations of these parameters.
        robustness: Robustness in the first one.
    """

    number: int
    evaluated: int
    robustness: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A safe and an unsafe solution that are almost the same.

    Attributes:
        safe: The safe side: every simulation of it was safe.
        unsafe: The unsafe side: every simulation of it was unsafe.
        distance: Distance between the two.
        units: Columns in which they differ; numbers that a constraint ties together are one unit.
    """

    safe: Side
    unsafe: Side
    distance: float
    units: tuple[Unit, ...]

    @property
    def checked(self) -> bool:
        """Whether both sides kept their verdicts in at least one further simulation."""
        return min(self.safe.evaluated, self.unsafe.evaluated) >= 2


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPairs:
    """The distinct pairs of an archive.

    Attributes:
        pairs: Distinct pairs in the order in which they were taken.
        tight: Number of tight pairs, distinct or not.
        chancy: Number of solutions whose simulations had different verdicts.
        safe: Number of safe solutions, each counted once.
        unsafe: Number of unsafe solutions, each counted once.
    """

    pairs: tuple[Pair, ...]
    tight: int
    chancy: int
    safe: int
    unsafe: int

    @property
    def checked(self) -> int:
        """Number of distinct pairs that are checked."""
        return sum(pair.checked for pair in self.pairs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solutions:
    """Solutions without duplicates: position of the first simulation of each, and how often it was simulated."""

    first: IntArray
    evaluated: IntArray
    unsafe: IntArray


def find_pairs(archive: Archive, space: SearchSpace, *, eps: float, d_th: float) -> FoundPairs:
    """Find the distinct tight pairs of an archive.

    Args:
        archive: Simulated solutions.
        space: Their space.
        eps: Largest distance between the sides of a pair, unless they are one step apart in a single parameter.
        d_th: Smallest distance between the midpoints of two distinct pairs.
    """
    solutions = _without_duplicates(archive)
    is_safe, is_unsafe = solutions.unsafe == 0, solutions.unsafe == solutions.evaluated
    counts = {
        "safe": int(is_safe.sum()),
        "unsafe": int(is_unsafe.sum()),
        "chancy": int((~is_safe & ~is_unsafe).sum()),
    }
    steps = Steps(space)
    candidates = _tight(archive, steps, solutions.first[is_safe], solutions.first[is_unsafe], eps)
    evaluated = dict(zip(solutions.first.tolist(), solutions.evaluated.tolist(), strict=True))
    pairs = [
        Pair(
            safe=_side(archive, safe, evaluated[safe]),
            unsafe=_side(archive, unsafe, evaluated[unsafe]),
            distance=distance,
            units=tuple(steps.differing(archive.vectors[safe], archive.vectors[unsafe])),
        )
        for safe, unsafe, distance in candidates
    ]
    pairs.sort(key=lambda pair: (not pair.checked, pair.distance, pair.safe.number, pair.unsafe.number))
    return FoundPairs(pairs=distinct(pairs, archive, steps, d_th), tight=len(pairs), **counts)


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
    solutions = _without_duplicates(archive)
    safe = solutions.first[solutions.unsafe == 0]
    unsafe = solutions.first[solutions.unsafe == solutions.evaluated]
    if not len(safe) or not len(unsafe):
        return None
    metric, found = Metric.of_space(space), []
    for part in _chunks(safe, len(unsafe)):
        distances = metric.between(archive.vectors[part], archive.vectors[unsafe])
        row, column = np.unravel_index(int(distances.argmin()), distances.shape)
        found.append((float(distances[row, column]), int(part[row]), int(unsafe[column])))
    distance, one, other = min(found)
    return Opposites(
        safe=int(archive.numbers[one]), unsafe=int(archive.numbers[other]), distance=distance
    )  # fmt: skip


def distinct(pairs: Sequence[Pair], archive: Archive, steps: Steps, d_th: float) -> tuple[Pair, ...]:
    """Return the pairs whose midpoints are at least `d_th` from those of all pairs taken before, in their order."""
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}
    taken: list[Pair] = []
    centres: FloatArray = np.empty((0, steps.space.dimension))
    for pair in pairs:
        safe, unsafe = (archive.vectors[[places[side.number]]] for side in (pair.safe, pair.unsafe))
        centre = midpoints(safe, unsafe, steps.space)
        if not taken or (steps.metric.between(centre, centres) >= d_th).all():
            taken.append(pair)
            centres = np.concatenate([centres, centre])
    return tuple(taken)


def _without_duplicates(archive: Archive) -> _Solutions:
    _, first, inverse = np.unique(archive.vectors, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    return _Solutions(
        first=first.astype(np.int64),
        evaluated=np.bincount(inverse, minlength=len(first)),
        unsafe=np.bincount(inverse[archive.unsafe], minlength=len(first)),
    )


def _tight(
    archive: Archive, steps: Steps, safe: IntArray, unsafe: IntArray, eps: float
) -> list[tuple[int, int, float]]:
    """Return the positions of the sides of all tight pairs, and their distances."""
    if not len(safe) or not len(unsafe):
        return []
    rows, limit = archive.vectors, steps.largest_tight(eps) * (1 + 1e-9)
    found = []
    for part in _chunks(safe, len(unsafe)):
        distances = steps.metric.between(rows[part], rows[unsafe])
        for a, b in np.argwhere(distances <= limit).tolist():
            one, other = int(part[a]), int(unsafe[b])
            if steps.is_tight(rows[one], rows[other], eps):
                found.append((one, other, float(distances[a, b])))
    return found


def _chunks(rows: IntArray, columns: int) -> Iterator[IntArray]:
    """Yield parts of `rows` so small that distances to `columns` others fit into memory."""
    size = max(1, _CHUNK_CELLS // columns)
    for begin in range(0, len(rows), size):
        yield rows[begin : begin + size]


def _side(archive: Archive, place: int, evaluated: int) -> Side:
    return Side(
        number=int(archive.numbers[place]), evaluated=evaluated, robustness=float(archive.robustness[place])
    )
