"""The thread that renews leases, and gives up on jobs whose lease is lost."""

import logging
import time
from collections.abc import Callable
from typing import Final

from brink.worker.client import CoordinatorClient
from brink.worker.errors import CoordinatorAway
from brink.worker.holdings import Holdings
from brink.worker.wire import HeartbeatRequest, LeasedJob, WorkerIdentity

log = logging.getLogger(__name__)

RENEWALS_A_LEASE: Final = 3
RETRIES_A_RENEWAL: Final = 3
"""A renewal that failed is tried again this many times before the next would be due."""


class Heartbeat:
    """Renews every lease at each third of its time.

    Args:
        holdings: What is held.
        client: The way to the coordinator.
        identity: Who asks.
        abandon_after_s: Give a running job up if its lease is lost and it has run for this long.
        give_up: Ends the episode of a job.
    """

    def __init__(
        self,
        holdings: Holdings,
        client: CoordinatorClient,
        *,
        identity: WorkerIdentity,
        abandon_after_s: float,
        give_up: Callable[[LeasedJob], None],
    ) -> None:
        self._holdings = holdings
        self._client = client
        self._identity = identity
        self._abandon_after_s = abandon_after_s
        self._give_up = give_up
        self._lease_s: float | None = None
        self._due_s = 0.0
        self._ended = False
        self._given_up: LeasedJob | None = None

    def leases_hold(self, lease_s: float) -> None:
        """Note how long leases hold; safe from any thread."""
        with self._holdings.changed:
            if self._lease_s != lease_s:
                self._lease_s = lease_s
                self._due_s = time.monotonic() + lease_s / RENEWALS_A_LEASE
                self._holdings.changed.notify_all()

    def end(self) -> None:
        """Let `run` return; safe from any thread."""
        with self._holdings.changed:
            self._ended = True
            self._holdings.changed.notify_all()

    def run(self) -> None:
        """Renew leases until `end` is called.

        Raises:
            RequestRefused: The coordinator does not want this worker, or has no such address.
            UnexpectedReply: What answers is no coordinator.
        """
        while self._wait_until_due():
            self._give_up_lost()
            lease_s = self._lease_s
            leases = self._holdings.leases()
            if lease_s is None:
                continue
            now_s = time.monotonic()
            if now_s < self._due_s:
                continue
            self._due_s = now_s + lease_s / RENEWALS_A_LEASE
            if not leases:
                continue
            try:
                reply = self._client.heartbeat(HeartbeatRequest(worker=self._identity, leases=list(leases)))
            except CoordinatorAway as away:
                # The reporter says so in the log, at its growing intervals.
                log.debug("no renewal: %s", away)
                self._due_s = now_s + lease_s / RENEWALS_A_LEASE / RETRIES_A_RENEWAL
                continue
            self._holdings.renewed(leases, reply.held)
            self.leases_hold(reply.lease_s)
            self._give_up_lost()

    def _wait_until_due(self) -> bool:
        with self._holdings.changed:
            while not self._ended:
                times_s = [] if self._lease_s is None else [self._due_s]
                if (lost := self._lost()) is not None:
                    times_s.append(time.monotonic() + self._abandon_after_s - lost[1])
                left_s = min(times_s) - time.monotonic() if times_s else None
                if left_s is not None and left_s <= 0:
                    return True
                self._holdings.changed.wait(left_s)
            return False

    def _lost(self) -> tuple[LeasedJob, float] | None:
        lost = self._holdings.lost_for_s()
        return None if lost is None or lost[0] == self._given_up else lost

    def _give_up_lost(self) -> None:
        lost = self._lost()
        if lost is not None and lost[1] >= self._abandon_after_s:
            about = {"campaign": lost[0].campaign, "job": lost[0].job, "attempt": lost[0].attempt}
            log.info("giving up a running job whose lease was lost", extra=about)
            self._given_up = lost[0]
            self._give_up(lost[0])
