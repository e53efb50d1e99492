"""What is drawn of campaigns, computed in threads of its own: it waits neither for films nor for scores."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import InitVar, dataclass, field
from typing import Final

from brink.search.analysis.dependence import Dependence, dependences
from brink.server.campaigns.archives import ReadArchive
from brink.server.dashboard.course import Courses
from brink.server.dashboard.overview import Sparks
from brink.server.dashboard.solution_map import SolutionMaps
from brink.server.single_flight import SingleFlightCache

DEPENDENCES_KEPT: Final = 32
"""Campaigns of which is remembered what their verdicts depend on."""
MOST_WAITING: Final = 64
"""Figures of each kind; whoever asks for one more is told to come back later."""


@dataclass(slots=True)
class Figures:
    """The figures that were asked for last.

    Attributes:
        at_once: How many are computed at a time.
        maps: Where the solutions of a campaign lie.
        courses: How its distinct boundary solutions grew.
        sparks: The same in a few pixels.
    """

    at_once: InitVar[int]
    maps: SolutionMaps = field(init=False)
    courses: Courses = field(init=False)
    sparks: Sparks = field(default_factory=Sparks)
    _dependences: SingleFlightCache[list[Dependence]] = field(init=False)
    _threads: ThreadPoolExecutor = field(init=False)

    def __post_init__(self, at_once: int) -> None:
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="brink-look")
        self.maps = SolutionMaps(threads=self._threads, most_waiting=MOST_WAITING)
        self.courses = Courses(threads=self._threads, most_waiting=MOST_WAITING)
        self._dependences = SingleFlightCache(DEPENDENCES_KEPT, self._threads, MOST_WAITING)

    async def dependences(self, campaign: str, found: ReadArchive) -> list[Dependence]:
        """Return how the verdict depends on each parameter."""
        space, archive = found.plan.problem.space, found.archive
        return await self._dependences.get(campaign, found.generation, lambda: dependences(space, archive))

    def close(self) -> None:
        """Wait for those that are being computed, and begin no other."""
        self._threads.shutdown(cancel_futures=True)
