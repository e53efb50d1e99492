"""Figures of a campaign, computed in their own thread pool, so that they wait for neither videos nor scores."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np

from brink.search.analysis.boundary import BudgetPoint, dbs_by_budget
from brink.search.analysis.dependence import Dependence, dependences
from brink.server.campaigns.archives import ArchiveActivity, Archives, ReadArchive
from brink.server.dashboard.found import FoundWords
from brink.server.dashboard.overview import Sparklines
from brink.server.dashboard.solution_map import SolutionMaps
from brink.server.read_threads import ReadThreads
from brink.server.single_flight import SingleFlightCache

POINTS: Final = 24
MAX_SOLUTIONS: Final = 10_000
"""Largest archive with a convergence curve: each point recounts the neighbours of all solutions evaluated by then."""
CACHED_CURVES: Final = 64
DIGITS: Final = 3
"""Decimal places to which thresholds are rounded, so that similar requests share one computation."""


@dataclass(slots=True)
class ConvergenceCurves:
    """A cache of convergence curves: distinct boundary solutions against simulations, at chosen thresholds.

    Attributes:
        threads: Where curves are computed.
        most_waiting: Maximum number of pending computations.
    """

    threads: InitVar[Executor]
    most_waiting: InitVar[int]
    _latest: SingleFlightCache[Sequence[BudgetPoint]] = field(init=False)

    def __post_init__(self, threads: Executor, most_waiting: int) -> None:
        self._latest = SingleFlightCache(CACHED_CURVES, threads, most_waiting)

    async def get(self, campaign: str, read: ReadArchive, t_b: float, d_th: float) -> Sequence[BudgetPoint]:
        """Return DBS at fractions of the simulations so far; empty if the archive is empty or too large.

        Args:
            campaign: Id of the campaign.
            read: Its archive.
            t_b: Maximum fitness of a boundary solution.
            d_th: Minimum distance between two boundary solutions.
        """
        if not 0 < len(read.archive) <= MAX_SOLUTIONS:
            return ()
        t_b, d_th = round(t_b, DIGITS), round(d_th, DIGITS)
        return await self._latest.get((campaign, t_b, d_th), read.generation, lambda: _curve(read, t_b, d_th))


def _curve(read: ReadArchive, t_b: float, d_th: float) -> Sequence[BudgetPoint]:
    archive = read.archive
    spent = int(archive.numbers[-1]) + 1
    fractions = (np.arange(1, POINTS + 1) / POINTS).tolist()
    return list(dbs_by_budget(archive, spent, fractions, (t_b,), (d_th,)))


CACHED_DEPENDENCES: Final = 32
LIMIT_S: Final = 60.0
"""Time limit of a figure: nobody but the dashboard waits for it, and it is kept once it is known."""
MAX_PENDING: Final = 64
"""Maximum number of pending computations of each kind; further requests get a 503 response."""


@dataclass(slots=True)
class Figures:
    """Caches of the figures that the dashboard draws.

    Attributes:
        at_once: How many figures are computed at the same time.
        archives: Where campaigns are read.
        maps: Maps of the solutions.
        convergence: Convergence curves.
        sparks: Convergence curves as sparklines.
        found: What campaigns found, in a few words each.
    """

    at_once: InitVar[int]
    archives: InitVar[Archives]
    maps: SolutionMaps = field(init=False)
    convergence: ConvergenceCurves = field(init=False)
    sparks: Sparklines = field(default_factory=Sparklines)
    found: FoundWords = field(init=False)
    _dependences: SingleFlightCache[list[Dependence]] = field(init=False)
    _threads: ReadThreads = field(init=False)

    def __post_init__(self, at_once: int, archives: Archives) -> None:
        self.found = FoundWords(archives)
        self._threads = ReadThreads(at_once, "brink-figures", limit_s=LIMIT_S)
        self.maps = SolutionMaps(threads=self._threads, most_waiting=MAX_PENDING)
        self.convergence = ConvergenceCurves(threads=self._threads, most_waiting=MAX_PENDING)
        self._dependences = SingleFlightCache(CACHED_DEPENDENCES, self._threads, MAX_PENDING)

    async def dependences(
        self, campaign: str, found: ReadArchive, activity: ArchiveActivity
    ) -> list[Dependence]:
        """Return how the verdict depends on each parameter where it is active, strongest dependence first."""
        space, archive = found.plan.problem.space, found.archive
        return await self._dependences.get(
            campaign, found.generation, lambda: dependences(space, archive, activity.active)
        )

    def close(self) -> None:
        """End the running computations and cancel the pending ones."""
        self._threads.close()
        self.found.close()
