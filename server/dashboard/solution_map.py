"""The map of a campaign as it grows: where its solutions lie in the plane, so that those drawn before stay put.

A map is made for the first so many solutions and takes in the later ones as they come; it is made anew when the
archive has grown by half, and once more when the campaign has ended. Which one is current depends on the archive
alone, so every coordinator draws the same. Above `MOST` solutions not all are drawn.
"""

from collections import OrderedDict
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.dependence import axis_meanings
from brink.search.analysis.similarity import Projection
from brink.search.archive import Archive
from brink.search.space import FloatArray, SearchSpace
from brink.server.campaigns.archives import ReadArchive
from brink.server.single_flight import SingleFlightCache

MOST: Final = 20_000
"""Solutions on a map; while a campaign runs, up to a tenth more."""
NEAREST: Final = 8_000
"""Of those on the map of a larger campaign that has ended, so many are the nearest to the boundary."""
SMALLEST: Final = 64
GROWTH: Final = 1.5
GROWTH_LARGE: Final = 1.1
KEPT: Final = 8

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolutionMap:
    """Where solutions lie.

    Attributes:
        version: Of the map: points of one version do not move.
        projection: How solutions are placed.
        axes: What each axis means in words, or None.
        rows: Positions in the archive of the solutions that are drawn; more are added at the end.
        points: Where they lie, shape ``(len(rows), 2)``.
        evaluated: Solutions in the archive.
    """

    version: str
    projection: Projection
    axes: tuple[str | None, str | None]
    rows: Rows
    points: FloatArray
    evaluated: int


def made_for(count: int) -> int:
    """Return how many of the solutions of a running campaign its map is made for, at most `count`."""
    made = SMALLEST
    while True:
        larger = int(made * (GROWTH if made < MOST else GROWTH_LARGE))
        larger = min(larger, MOST) if made < MOST else larger
        if larger > count:
            return min(made, count)
        made = larger


def evenly(count: int, most: int) -> Rows:
    """Return at most so many of the first `count` positions, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))


def drawn_rows(archive: Archive, made: int, *, ended: bool) -> Rows:
    """Return the positions in the archive of the solutions that are drawn.

    Args:
        archive: All evaluated solutions.
        made: How many of them the map is made for.
        ended: Whether no more will come.
    """
    count = len(archive)
    if count <= MOST:
        return np.arange(count)
    if not ended:  # those of before stay, whatever their fitness has become
        return np.concatenate([evenly(made, MOST), np.arange(made, count)])
    nearest = np.argsort(archive.fitness, kind="stable")[:NEAREST]
    return np.union1d(nearest, evenly(count, MOST - NEAREST))


def mapped(
    space: SearchSpace, archive: Archive, *, ended: bool, before: SolutionMap | None = None
) -> SolutionMap:
    """Return the map of an archive.

    Args:
        space: Where the solutions come from.
        archive: All evaluated solutions.
        ended: Whether no more will come.
        before: The map of an earlier state of the archive, which is gone on with if it still holds.
    """
    made = len(archive) if ended else made_for(len(archive))
    version = f"{made}-{'end' if ended else 'run'}"
    rows = drawn_rows(archive, made, ended=ended)
    if before is not None and before.version == version and len(before.rows) <= len(rows):
        later = before.projection.placed(archive.vectors[rows[len(before.rows) :]])
        return SolutionMap(
            version=version, projection=before.projection, axes=before.axes, rows=rows,
            points=np.concatenate([before.points, later]), evaluated=len(archive),
        )  # fmt: skip
    projection = Projection.fitted(archive.metric, archive.vectors[:made])
    points = projection.placed(archive.vectors[rows])
    return SolutionMap(
        version=version, projection=projection, axes=_axes(space, archive.vectors[rows], points), rows=rows,
        points=points, evaluated=len(archive),
    )  # fmt: skip


def _axes(space: SearchSpace, vectors: FloatArray, points: FloatArray) -> tuple[str | None, str | None]:
    if len(points) < SMALLEST:
        return None, None
    across, up = axis_meanings(space, vectors, points)
    return across.text if across else None, up.text if up else None


@dataclass(slots=True)
class SolutionMaps:
    """The maps that were asked for last.

    Attributes:
        threads: Where they are made.
        most_waiting: How many may be under way.
    """

    threads: InitVar[Executor]
    most_waiting: InitVar[int]
    _latest: SingleFlightCache[SolutionMap] = field(init=False)
    _before: OrderedDict[str, SolutionMap] = field(default_factory=OrderedDict)

    def __post_init__(self, threads: Executor, most_waiting: int) -> None:
        self._latest = SingleFlightCache(KEPT, threads, most_waiting)

    async def get(self, campaign: str, read: ReadArchive, *, ended: bool) -> SolutionMap:
        """Return the map of a campaign's archive."""
        found = await self._latest.get(
            (campaign, ended), read.generation, lambda: self._make(campaign, read, ended=ended)
        )
        kept = self._before.get(campaign)
        if kept is None or kept.evaluated <= found.evaluated:  # whoever asked earlier may come later
            self._before[campaign] = found
            self._before.move_to_end(campaign)
        while len(self._before) > KEPT:
            self._before.popitem(last=False)
        return found

    def _make(self, campaign: str, read: ReadArchive, *, ended: bool) -> SolutionMap:
        space, before = read.plan.problem.space, self._before.get(campaign)
        return mapped(space, read.archive, ended=ended, before=before)
