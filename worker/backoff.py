"""Retries while a server does not respond: exponential backoff, and one log line per interval of an outage."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Final

from brink.worker.errors import CoordinatorUnavailable

log = logging.getLogger(__name__)

FIRST_LOG_INTERVAL_S: Final = 5.0
LONGEST_LOG_INTERVAL_S: Final = 300.0
"""An outage is logged when it starts, then at intervals that double from the first to the longest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Backoff:
    """Exponential backoff with a cap, and with jitter so that clients do not retry in lockstep.

    Attributes:
        first_s: Longest wait after the first failure.
        cap_s: Longest wait after any failure.
    """

    first_s: float
    cap_s: float

    def delay_s(self, failures: int, rng: Random) -> float:
        """Return a random wait between 50% and 100% of the exponentially growing, capped time.

        Args:
            failures: Consecutive failures so far, >= 1.
            rng: Source of the jitter.
        """
        # The exponent is bounded so that the power stays finite; the cap is reached long before 2**32.
        longest_s = min(self.cap_s, self.first_s * 2.0 ** min(failures - 1, 32))
        return longest_s * rng.uniform(0.5, 1.0)


class Outage:
    """Counts consecutive failures of a coordinator, and logs an outage at growing intervals.

    Args:
        server: URL of the coordinator, for the log.
        backoff: Waits between attempts.
        rng: Source of the jitter.
        clock: Monotonic clock, in seconds.

    Attributes:
        since_s: Start of the outage on the clock, or None while the coordinator responds.
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
        self._log_interval_s = FIRST_LOG_INTERVAL_S
        self._next_log_s = 0.0

    def record_failure(self, error: CoordinatorUnavailable, *, unsent: int) -> float:
        """Record a failed request and return how long to wait before the next attempt.

        Args:
            error: What happened.
            unsent: Number of outcomes waiting to be reported, for the log.
        """
        now_s = self._clock()
        self._failures += 1
        if self.since_s is None:
            self.since_s = now_s
            self._log_interval_s = FIRST_LOG_INTERVAL_S
            self._next_log_s = now_s
        if now_s >= self._next_log_s:
            fields = {"for_s": round(now_s - self.since_s), "unsent": unsent}
            log.warning("waiting for the coordinator: %s", error, extra=fields)
            self._next_log_s = now_s + self._log_interval_s
            self._log_interval_s = min(LONGEST_LOG_INTERVAL_S, 2 * self._log_interval_s)
        if error.retry_after_s is not None:
            return error.retry_after_s
        return self._backoff.delay_s(self._failures, self._rng)

    def record_success(self) -> None:
        """Record that the coordinator responded."""
        if self.since_s is not None:
            fields = {"after_s": round(self._clock() - self.since_s, 1)}
            log.info("the coordinator at %s is back", self._server, extra=fields)
        self.since_s = None
        self._failures = 0
