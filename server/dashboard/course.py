"""The course of a campaign: distinct boundary solutions over simulations, at thresholds that somebody chose."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np

from brink.search.analysis.boundary import BudgetPoint, dbs_by_budget
from brink.server.campaigns.archives import ReadArchive
from brink.server.single_flight import SingleFlightCache

POINTS: Final = 24
MOST: Final = 10_000
"""Solutions up to which a course is counted anew: each point counts the neighbours of all that were known by then."""
KEPT: Final = 64
DIGITS: Final = 3
"""Of thresholds: finer ones would say nothing more, and each pair is counted once."""


@dataclass(slots=True)
class Courses:
    """The courses that were asked for last.

    Attributes:
        threads: Where they are counted.
        most_waiting: How many may be under way.
    """

    threads: InitVar[Executor]
    most_waiting: InitVar[int]
    _latest: SingleFlightCache[Sequence[BudgetPoint]] = field(init=False)

    def __post_init__(self, threads: Executor, most_waiting: int) -> None:
        self._latest = SingleFlightCache(KEPT, threads, most_waiting)

    async def get(self, campaign: str, read: ReadArchive, t_b: float, d_th: float) -> Sequence[BudgetPoint]:
        """Return DBS at shares of what was simulated so far; nothing of an archive that is empty or too large."""
        if not 0 < len(read.archive) <= MOST:
            return ()
        t_b, d_th = round(t_b, DIGITS), round(d_th, DIGITS)
        return await self._latest.get(
            (campaign, t_b, d_th), read.generation, lambda: _counted(read, t_b, d_th)
        )


def _counted(read: ReadArchive, t_b: float, d_th: float) -> Sequence[BudgetPoint]:
    archive = read.archive
    spent = int(archive.numbers[-1]) + 1
    fractions = (np.arange(1, POINTS + 1) / POINTS).tolist()
    return list(dbs_by_budget(archive, spent, fractions, (t_b,), (d_th,)))
