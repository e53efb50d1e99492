"""How much work a worker holds: enough to stay busy, no more than that.

Jobs held here are jobs that no other worker can run: near the end of a generation that makes the others wait. So a
worker holds a set time of work, not a set number of jobs, and asks again when what is left covers the round trip.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

_WEIGHT = 0.2
"""Weight of the newest measurement in the moving averages: about the last ten count."""

_SHORTEST_S = 1e-6
"""Keeps the counts finite for episodes that the clock cannot see; the caps make their exact length irrelevant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """What a worker has learnt of its own speed.

    Attributes:
        max_jobs: Most jobs to hold, >= 1.
        prefetch_s: Work to hold, in seconds.
        episode_s: Moving average of an episode's time, or None before the first.
        round_trip_s: Moving average of a request's time.
    """

    max_jobs: int
    prefetch_s: float
    episode_s: float | None = None
    round_trip_s: float = 0.005

    def after_episode(self, wall_s: float) -> Self:
        """Return the pace with one more episode."""
        if self.episode_s is None:
            return replace(self, episode_s=wall_s)
        return replace(self, episode_s=self.episode_s + _WEIGHT * (wall_s - self.episode_s))

    def after_request(self, wall_s: float) -> Self:
        """Return the pace with one more request."""
        return replace(self, round_trip_s=self.round_trip_s + _WEIGHT * (wall_s - self.round_trip_s))

    @property
    def hold(self) -> int:
        """How many jobs to hold, the running one included, in [1, max_jobs].

        Only one as long as nothing is known, and where an episode takes so long that fetching the next one after
        it costs little: a second one would wait here while other workers have nothing to do.
        """
        if self.episode_s is None:
            return 1
        return 1 + min(self.max_jobs - 1, round(self.prefetch_s / max(self.episode_s, _SHORTEST_S)))

    @property
    def low(self) -> int:
        """Ask again when so few jobs wait besides the running one: enough for the round trip, at most half."""
        if self.episode_s is None:
            return 0
        in_two_trips = math.ceil(2 * self.round_trip_s / max(self.episode_s, _SHORTEST_S))
        return min(self.hold // 2, max(1, in_two_trips))
