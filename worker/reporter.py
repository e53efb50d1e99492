"""The thread that speaks with the coordinator about jobs: reports outcomes, gives leases back, asks for more."""

import logging
import time
from collections.abc import Callable
from random import Random
from typing import Final

from brink.worker.backoff import Backoff
from brink.worker.client import CoordinatorClient
from brink.worker.errors import CoordinatorAway, RequestRefused
from brink.worker.holdings import Holdings, Poll, Report
from brink.worker.outage import Outage
from brink.worker.wire import LeaseReply, LeaseRequest, ResultsRequest, WorkerIdentity

log = logging.getLogger(__name__)

ABOUT_THE_BODY: Final = frozenset({400, 413, 422})
"""Refusals that blame what was sent; every other one blames the worker or its address."""

LONGEST_PAUSE_WHEN_STOPPING_S: Final = 0.5


class Reporter:
    """Runs the errands of the holdings.

    Args:
        holdings: What there is to tell and to ask.
        client: The way to the coordinator.
        identity: Who asks.
        capabilities: What this worker can run.
        wait_s: How long an idle worker's request may wait for a job.
        rng: Spreads the waits while the coordinator is away.
        on_lease: Told how long leases hold, whenever jobs were asked for.
    """

    def __init__(
        self,
        holdings: Holdings,
        client: CoordinatorClient,
        *,
        identity: WorkerIdentity,
        capabilities: tuple[str, ...],
        wait_s: float,
        rng: Random,
        on_lease: Callable[[float], None],
    ) -> None:
        self._holdings = holdings
        self._client = client
        self._identity = identity
        self._capabilities = list(capabilities)
        self._wait_s = wait_s
        self._on_lease = on_lease
        self._outage = Outage(client.server, Backoff(first_s=0.5, cap_s=10.0), rng)

    def run(self) -> None:
        """Run errands until the holdings have none left.

        Raises:
            RequestRefused: The coordinator does not want this worker, or has no such address.
            UnexpectedReply: What answers is no coordinator.
        """
        while (errand := self._holdings.next_errand()) is not None:
            try:
                if isinstance(errand, Poll):
                    self._poll(errand)
                else:
                    self._report(errand)
            except CoordinatorAway as away:
                delay_s = self._outage.failed(away, unsent=self._holdings.unsent)
                if self._holdings.stopping:
                    delay_s = min(delay_s, LONGEST_PAUSE_WHEN_STOPPING_S)
                self._holdings.postpone(delay_s)
            else:
                self._outage.over()

    @property
    def away(self) -> bool:
        """Whether the last request found no coordinator."""
        return self._outage.since_s is not None

    def _poll(self, poll: Poll) -> None:
        wait_s = self._wait_s if poll.idle_left_s is None else min(self._wait_s, poll.idle_left_s)
        self._granted(self._client.lease(self._request(poll.room, max(0.0, wait_s))))

    def _report(self, report: Report) -> None:
        request = ResultsRequest(
            worker=self._identity,
            results=[outcome.to_wire() for outcome in report.outcomes],
            release=list(report.release),
            lease=self._request(report.room, 0.0) if report.room else None,
        )
        began_s = time.monotonic()
        try:
            reply = self._client.report(request)
        except RequestRefused as refusal:
            if refusal.status not in ABOUT_THE_BODY or not report.outcomes:
                raise
            self._holdings.refused(report, str(refusal))
            return
        self._holdings.acknowledged(report, reply.statuses, wall_s=time.monotonic() - began_s)
        if reply.lease is not None:
            self._granted(reply.lease)

    def _granted(self, reply: LeaseReply) -> None:
        self._on_lease(reply.lease_s)
        self._holdings.granted(reply)

    def _request(self, room: int, wait_s: float) -> LeaseRequest:
        return LeaseRequest(
            worker=self._identity, capabilities=self._capabilities, max_jobs=room, wait_s=wait_s
        )
