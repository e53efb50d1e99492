"""The lines that an archive holds: solutions that differ in one unit alone, of which enough had an episode seed each.

Any archive may hold lines, whichever search filled it. Everything but the unit is *held*. How likely a violation is
along a line is estimated from the solutions that had an episode seed of their own. Those that shared the seed of
another one only say where the verdict turned under that seed, which is where the estimate expects the change.

A unit of two numbers, such as the edges of a box, is read by its *leading* number, the one that moves furthest in
units of its range; the other one follows it.

Source: ours; docs/explanation/thresholds.md.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.deadline import check_time
from brink.search.features import Unit, units_of
from brink.search.parameters import Number
from brink.search.sequential import Verdict, verdict_of
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace

FEWEST: Final = 8
"""Solutions with a seed of their own that make a line."""
FEWEST_PLACES: Final = 3
"""Different places on a line that these solutions have."""
_BACK: Final = 4
_STRAIGHT: Final = 0.05
"""How far the numbers of a unit may be off a straight line, where constraints bend it, as a share of its length."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """Solutions that differ in one unit alone.

    Attributes:
        unit: The columns of the unit.
        leading: The column by which places are read.
        places: Positions of the n solutions in the archive, in the order of their values, then of the archive.
        values: The leading number of each, ascending, shape ``(n,)``.
        own: Whether each had an episode seed of its own, shape ``(n,)``.
        unsafe: Their verdicts, shape ``(n,)``.
        rises: Whether a violation is likelier at larger values.
        safe_beyond: Value beyond the unsafe end at which one solution under a shared seed is safe; None without one.
    """

    unit: Unit
    leading: int
    places: IntArray
    values: FloatArray
    own: BoolArray
    unsafe: BoolArray
    rises: bool
    safe_beyond: float | None

    @property
    def ends(self) -> tuple[float, float]:
        """Values at the safe and at the unsafe end."""
        low, high = float(self.values[0]), float(self.values[-1])
        return (low, high) if self.rises else (high, low)

    def bracket(self) -> tuple[float, float]:
        """Return the last safe and the first unsafe value under shared seeds; the ends if these do not say.

        Both are given in the direction from safe to unsafe.
        """
        sign = 1.0 if self.rises else -1.0
        safe = sign * self.values[~self.own & ~self.unsafe]
        unsafe = sign * self.values[~self.own & self.unsafe]
        first, last = (sign * end for end in self.ends)
        low = float(safe.max()) if safe.size else first
        above = unsafe[unsafe > low]
        high = float(above.min()) if above.size else last
        return (sign * low, sign * high) if low < high else self.ends

    def parts(self) -> list["Line"]:
        """Return the part around each change of the verdict, which ends where the verdict changes again.

        Only of use where chance has no part in verdicts.
        """
        changes = np.flatnonzero(self.unsafe[1:] != self.unsafe[:-1]) + 1
        borders = [0, *changes.tolist(), len(self.values)]
        parts = []
        for first, change, last in zip(borders, borders[1:], borders[2:], strict=False):
            rises = bool(self.unsafe[change])
            beyond = last if rises else first - 1
            parts.append(
                replace(
                    self,
                    places=self.places[first:last],
                    values=self.values[first:last],
                    own=self.own[first:last],
                    unsafe=self.unsafe[first:last],
                    rises=rises,
                    safe_beyond=float(self.values[beyond])
                    if 0 <= beyond < len(self.values)
                    else self.safe_beyond,
                )
            )
        return parts

    def turns_back(self) -> float | None:
        """Return the value from which solutions beyond the unsafe ones are safe again; None if there is none.

        Two changes must explain the verdicts of those with a seed of their own better than one, by at least `_BACK`
        verdicts, and it must be refuted that what lies beyond the second one is unsafe (`brink.search.sequential`).
        """
        values, unsafe = self.values[self.own], self.unsafe[self.own]
        if not self.rises:
            values, unsafe = values[::-1], unsafe[::-1]
        signs = np.where(unsafe, 1, -1)
        before = np.concatenate([[0], np.cumsum(signs)])  # at i: unsafe minus safe among the first i
        least = np.minimum.accumulate(before)  # the best start of an unsafe run that ends at i
        gains = before - least
        once = int(gains[-1])
        borders = np.flatnonzero(np.concatenate([[False], values[1:] != values[:-1], [False]]))
        if not borders.size:
            return None
        best = int(borders[np.argmax(gains[borders])])
        beyond = unsafe[best:]
        safe = int((~beyond).sum())
        if gains[best] - once < _BACK or verdict_of(safe, len(beyond)) is not Verdict.REFUTED:
            return None
        return float(values[best])


def find_lines(archive: Archive, space: SearchSpace, own: BoolArray, *, fewest: int = FEWEST) -> list[Line]:
    """Return the lines of an archive, in the order of their first solutions.

    Args:
        archive: Simulated solutions.
        space: Their space.
        own: Whether each had an episode seed of its own, shape ``(n,)``.
        fewest: Solutions with a seed of their own that make a line.
    """
    if not len(archive):
        return []
    hashes = _hashes(archive.vectors)
    whole = hashes.sum(axis=1, dtype=np.uint64)
    lines = []
    for unit in units_of(space):
        check_time()
        columns = list(unit)
        if space.categorical[columns].any():
            continue
        held = whole - hashes[:, columns].sum(axis=1, dtype=np.uint64)
        for places in _groups(held, own, fewest):
            line = _line(archive, space, unit, places, own, fewest)
            if line is not None:
                lines.append(line)
    return sorted(lines, key=lambda line: (int(line.places.min()), line.unit))


def _hashes(rows: FloatArray) -> NDArray[np.uint64]:
    """Return a hash of each number and its column, so that sums are hashes of rows without some of the columns."""
    bits = np.ascontiguousarray(rows + 0.0).view(np.uint64)  # + 0.0: there is one zero
    mixed = bits + (np.arange(rows.shape[1], dtype=np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # splitmix64
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    return np.asarray(mixed ^ (mixed >> np.uint64(31)), np.uint64)


def _groups(held: NDArray[np.uint64], own: BoolArray, fewest: int) -> Iterator[IntArray]:
    """Yield the positions of solutions that agree in what is held, if enough of them had a seed of their own."""
    _, which, counts = np.unique(held, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    enough = np.bincount(which[own], minlength=len(counts)) >= fewest
    for group in np.flatnonzero(enough).tolist():
        yield np.flatnonzero(which == group)


def _line(
    archive: Archive, space: SearchSpace, unit: Unit, places: IntArray, own: BoolArray, fewest: int
) -> Line | None:
    """Return the line of solutions that agree in what is held; None if it has too few places or no direction."""
    columns = list(unit)
    shares = archive.vectors[places][:, columns] / space.ranges[columns]
    leading = int(np.argmax(np.ptp(shares[own[places]], axis=0)))
    places = places[_is_straight(shares, own[places], leading, space, columns)]
    values = archive.vectors[places, columns[leading]]
    order = np.argsort(values, kind="stable")
    places, values = places[order], values[order]
    its_own, unsafe = own[places], archive.unsafe[places]
    of_each = values[its_own & ~unsafe], values[its_own & unsafe]
    if (
        its_own.sum() < fewest
        or len(np.unique(values[its_own])) < FEWEST_PLACES
        or not all(map(len, of_each))
    ):
        return None
    rises = bool(of_each[1].mean() >= of_each[0].mean())
    kept, beyond = _trimmed(values, its_own, unsafe, rises=rises)
    return Line(
        unit=unit,
        leading=columns[leading],
        places=places[kept],
        values=values[kept],
        own=its_own[kept],
        unsafe=unsafe[kept],
        rises=rises,
        safe_beyond=beyond,
    )


def _trimmed(
    values: FloatArray, own: BoolArray, unsafe: BoolArray, *, rises: bool
) -> tuple[slice, float | None]:
    """Return the part between the ends of a line, and where a shared seed is safe again beyond its unsafe end.

    The safe end is safe or had a seed of its own, the unsafe end is unsafe or had one.
    """
    safe_end, unsafe_end = np.flatnonzero(own | ~unsafe), np.flatnonzero(own | unsafe)
    if rises:
        first, last = int(safe_end[0]), int(unsafe_end[-1])
        beyond = float(values[last + 1]) if last + 1 < len(values) else None
    else:
        first, last = int(unsafe_end[0]), int(safe_end[-1])
        beyond = float(values[first - 1]) if first > 0 else None
    return slice(first, last + 1), beyond


def _is_straight(
    shares: FloatArray, own: BoolArray, leading: int, space: SearchSpace, columns: list[int]
) -> BoolArray:
    """Return which solutions lie on the straight line between the outermost ones with a seed of their own.

    Constraints may bend it a little, and values are rounded to steps. Others moved the unit in another direction.
    """
    mine = shares[own]
    first, last = mine[np.argmin(mine[:, leading])], mine[np.argmax(mine[:, leading])]
    length = last[leading] - first[leading]
    if length <= 0.0:
        return np.zeros(len(shares), np.bool_)
    expected = first + ((shares[:, leading] - first[leading]) / length)[:, None] * (last - first)
    spacings = [
        number.spacing for column in columns if isinstance(number := space.parameters[column], Number)
    ]
    steps = np.array(spacings) / space.ranges[columns]
    return np.asarray((np.abs(shares - expected) <= steps + _STRAIGHT * length).all(axis=1))
