"""The sources of findings: the database, and caches of slow computations."""

from dataclasses import dataclass

from brink.server.campaigns.archives import Archives
from brink.server.campaigns.boundaries import Boundaries
from brink.server.campaigns.outcomes import Outcomes
from brink.server.campaigns.pairs import Pairs
from brink.server.campaigns.reported import ReportedResults
from brink.server.campaigns.thresholds import Thresholds
from brink.server.campaigns.tolerance import Tolerances
from brink.server.db.engine import Engines
from brink.server.read_threads import ReadThreads


@dataclass(frozen=True, slots=True, kw_only=True)
class Sources:
    """The database, and caches that requests share."""

    engines: Engines
    pages: ReadThreads
    """Threads for tasks of up to a few seconds: reading archives and results, decoding and encoding them."""
    analyses: ReadThreads
    """Threads for longer tasks: comparing all solutions with each other."""
    archives: Archives
    boundaries: Boundaries
    outcomes: Outcomes
    reported: ReportedResults
    pairs: Pairs
    tolerances: Tolerances
    thresholds: Thresholds
