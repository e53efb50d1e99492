"""How long the coordinator has been away: when to try again, and when to say so."""

import logging
import time
from collections.abc import Callable
from random import Random
from typing import Final

from brink.worker.backoff import Backoff
from brink.worker.errors import CoordinatorAway

log = logging.getLogger(__name__)

FIRST_SILENCE_S: Final = 5.0
LONGEST_SILENCE_S: Final = 300.0
"""A line at the first failure, then at intervals that double from the first to the longest."""


class Outage:
    """Counts failures in a row, and logs them at growing intervals.

    Args:
        server: For the log.
        backoff: Waits between attempts.
        rng: Spreads the waits.
        clock: Monotonic seconds.

    Attributes:
        since_s: When the outage began, or None if there is none.
    """

    def __init__(
        self, server: str, backoff: Backoff, rng: Random, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.since_s: float | None = None
        self._server = server
        self._backoff = backoff
        self._rng = rng
        self._clock = clock
        self._failures = 0
        self._silence_s = FIRST_SILENCE_S
        self._quiet_until_s = 0.0

    def failed(self, away: CoordinatorAway, *, unsent: int) -> float:
        """Note one more failure and return how long to wait before the next attempt.

        Args:
            away: What happened.
            unsent: Outcomes that wait for the coordinator, for the log.
        """
        now_s = self._clock()
        self._failures += 1
        if self.since_s is None:
            self.since_s = now_s
            self._silence_s = FIRST_SILENCE_S
            self._quiet_until_s = now_s
        if now_s >= self._quiet_until_s:
            about = {"for_s": round(now_s - self.since_s), "unsent": unsent}
            log.warning("waiting for the coordinator: %s", away, extra=about)
            self._quiet_until_s = now_s + self._silence_s
            self._silence_s = min(LONGEST_SILENCE_S, 2 * self._silence_s)
        if away.retry_after_s is not None:
            return away.retry_after_s
        return self._backoff.delay_s(self._failures, self._rng)

    def over(self) -> None:
        """Note that the coordinator answered."""
        if self.since_s is not None:
            about = {"after_s": round(self._clock() - self.since_s, 1)}
            log.info("the coordinator at %s is back", self._server, extra=about)
        self.since_s = None
        self._failures = 0
