"""The map of a campaign's solutions in the plane, which stays stable while the campaign grows.

A layout is fitted to the first solutions, and later ones are placed into it. It is fitted again whenever the archive
has grown by half, and once more when the campaign has ended. The layout depends only on the archive, so every
coordinator draws the same map. Archives of more than `MAX_DRAWN` solutions are thinned out.
"""

from collections import OrderedDict
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.dependence import axis_meanings
from brink.search.analysis.ground import Ground, ground_of
from brink.search.analysis.similarity import Plane, Projection, own_plane
from brink.search.archive import Archive
from brink.search.space import FloatArray, SearchSpace
from brink.server.campaigns.archives import ReadArchive
from brink.server.single_flight import SingleFlightCache

MAX_DRAWN: Final = 20_000
"""Maximum number of solutions on a map; up to a tenth more while a campaign runs."""
NEAREST: Final = 8_000
"""Number of solutions closest to the boundary that the thinned map of an ended campaign always shows."""
MIN_FITTED: Final = 64
GROWTH: Final = 1.5
GROWTH_LARGE: Final = 1.1
CACHED: Final = 8
GROUND_CELLS: Final = 110
"""Number of cells of the ground along its longer side."""
SMOOTHING: Final = 0.028
"""Width of the smoothing kernel of the ground, as a share of its longer side."""
GROUND_MARGIN: Final = 0.06
LEAST_MARGIN: Final = 1e-3
"""How far the ground reaches beyond the outermost solutions: a share of the longer side, and a distance."""

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolutionMap:
    """The positions of solutions on the map.

    Attributes:
        version: Version of the layout; points of one version do not move.
        projection: Projection from solutions to the map: for two numerical parameters, these themselves.
        axes: What each axis is or correlates with, in words, or None.
        rows: Archive indices of the drawn solutions, shape ``(n,)``; later versions append to it.
        points: Coordinates, shape ``(n, 2)``.
        evaluated: Number of solutions in the archive.
        ground: The unsafe share nearby; None while there is no solution.
    """

    version: str
    projection: Projection | Plane
    axes: tuple[str | None, str | None]
    rows: Rows
    points: FloatArray
    evaluated: int
    ground: Ground | None

    @property
    def explained(self) -> float:
        """Share of the squared distances that the map preserves."""
        return 1.0 if isinstance(self.projection, Plane) else self.projection.explained

    @property
    def own_axes(self) -> bool:
        """Whether the axes are the two parameters of the problem."""
        return isinstance(self.projection, Plane)


def fitted_count(count: int) -> int:
    """Return the number of solutions, from the first, to which the layout of a running campaign is fitted."""
    made = MIN_FITTED
    while True:
        larger = int(made * (GROWTH if made < MAX_DRAWN else GROWTH_LARGE))
        larger = min(larger, MAX_DRAWN) if made < MAX_DRAWN else larger
        if larger > count:
            return min(made, count)
        made = larger


def evenly_spaced(count: int, most: int) -> Rows:
    """Return at most `most` evenly spaced indices below `count`, shape ``(min(count, most),)``."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))


def drawn_rows(archive: Archive, made: int, *, ended: bool) -> Rows:
    """Return the archive indices of the solutions to draw, shape ``(n,)``.

    Args:
        archive: All evaluated solutions.
        made: Number of solutions that the layout is fitted to.
        ended: Whether the campaign has ended.
    """
    count = len(archive)
    if count <= MAX_DRAWN:
        return np.arange(count)
    if not ended:  # drawn solutions stay, even if their fitness changes
        return np.concatenate([evenly_spaced(made, MAX_DRAWN), np.arange(made, count)])
    nearest = np.argsort(archive.fitness, kind="stable")[:NEAREST]
    return np.union1d(nearest, evenly_spaced(count, MAX_DRAWN - NEAREST))


def make_map(
    space: SearchSpace,
    archive: Archive,
    *,
    ended: bool,
    before: SolutionMap | None = None,
    asked: FloatArray | None = None,
) -> SolutionMap:
    """Return the map of an archive.

    Args:
        space: Search space of the solutions.
        archive: All evaluated solutions.
        ended: Whether the campaign has ended.
        before: Map of an earlier state of the archive, which is extended if its layout is still current.
        asked: The solutions that are being simulated, to which the layout is fitted while the archive is empty.
    """
    made = len(archive) if ended else fitted_count(len(archive))
    version = f"{made}-{'end' if ended else 'run'}"
    fitted = archive.vectors[:made]
    if asked is not None and not len(archive):
        version, fitted = f"asked-{len(asked)}", asked
    rows = drawn_rows(archive, made, ended=ended)
    if before is not None and before.version == version and len(before.rows) <= len(rows):
        later = before.projection.placed(archive.vectors[rows[len(before.rows) :]])
        points, projection, axes = np.concatenate([before.points, later]), before.projection, before.axes
    else:
        plane = own_plane(space)
        projection = plane or Projection.fitted(archive.metric, fitted)
        points = projection.placed(archive.vectors[rows])
        axes = plane.names if plane is not None else _axes(space, archive.vectors[rows], points)
    return SolutionMap(
        version=version,
        projection=projection,
        axes=axes,
        rows=rows,
        points=points,
        evaluated=len(archive),
        ground=_ground(archive, rows, points, projection) if len(rows) else None,
    )


def _ground(archive: Archive, rows: Rows, points: FloatArray, projection: Projection | Plane) -> Ground:
    if isinstance(projection, Plane):
        low, high = np.zeros(2), np.asarray(projection.extent, np.float64)
    else:
        low, high = points.min(axis=0), points.max(axis=0)
        beyond = max(GROUND_MARGIN * float((high - low).max()), LEAST_MARGIN)
        low, high = low - beyond, high + beyond
    width = SMOOTHING * float((high - low).max())
    return ground_of(archive, rows, points, low=low, high=high, cells=GROUND_CELLS, width=width)


def _axes(space: SearchSpace, vectors: FloatArray, points: FloatArray) -> tuple[str | None, str | None]:
    if len(points) < MIN_FITTED:
        return None, None
    across, up = axis_meanings(space, vectors, points)
    return across.text if across else None, up.text if up else None


@dataclass(slots=True)
class SolutionMaps:
    """A cache of maps.

    Attributes:
        threads: Where maps are computed.
        most_waiting: Maximum number of pending computations.
    """

    threads: InitVar[Executor]
    most_waiting: InitVar[int]
    _latest: SingleFlightCache[SolutionMap] = field(init=False)
    _before: OrderedDict[str, SolutionMap] = field(default_factory=OrderedDict)

    def __post_init__(self, threads: Executor, most_waiting: int) -> None:
        self._latest = SingleFlightCache(CACHED, threads, most_waiting)

    async def get(
        self, campaign: str, read: ReadArchive, *, ended: bool, asked: FloatArray | None = None
    ) -> SolutionMap:
        """Return the map of a campaign's archive.

        Args:
            campaign: Id of the campaign.
            read: Its archive.
            ended: Whether the campaign has ended.
            asked: The solutions that are being simulated, while the archive is empty.
        """
        found = await self._latest.get(
            (campaign, ended, 0 if asked is None else len(asked)),
            read.generation,
            lambda: self._make(campaign, read, asked, ended=ended),
        )
        kept = self._before.get(campaign)
        if kept is None or kept.evaluated <= found.evaluated:  # an earlier request may finish later
            self._before[campaign] = found
            self._before.move_to_end(campaign)
        while len(self._before) > CACHED:
            self._before.popitem(last=False)
        return found

    def _make(
        self, campaign: str, read: ReadArchive, asked: FloatArray | None, *, ended: bool
    ) -> SolutionMap:
        space, before = read.plan.problem.space, self._before.get(campaign)
        return make_map(space, read.archive, ended=ended, before=before, asked=asked)
