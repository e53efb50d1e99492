"""What workers bring and take in one request, for all requests that wait for the same commit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from sqlalchemy import Connection

from brink.server.queue import holding_store, lease_store, report_store
from brink.server.queue.values import LeaseTerms, LeaseWanted, Outcome, Report
from brink.worker.wire import HeldLease, LeasedJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """One request of a worker.

    Attributes:
        notes: What is to be noted of workers that were heard of.
        outcomes: What it reports.
        terms: How jobs that failed are tried again.
        release: Leases that it gives back.
        wanted: The jobs that it asks for.
    """

    terms: LeaseTerms
    notes: tuple[Callable[[Connection], None], ...] = ()
    outcomes: tuple[Outcome, ...] = ()
    release: tuple[HeldLease, ...] = ()
    wanted: LeaseWanted | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchanged:
    """The answer to one request.

    Attributes:
        report: What became of its outcomes, and the campaigns that have no open job left because of the commit.
        released: How many leases were given back.
        granted: The jobs that it has now.
    """

    report: Report
    released: int
    granted: list[LeasedJob] = field(default_factory=list)


def exchange(connection: Connection, requests: Sequence[Exchange]) -> list[Exchanged]:
    """Take in what all requests bring, then grant what they ask for, in their order."""
    for request in requests:
        for note in request.notes:
            note(connection)
    outcomes = [outcome for request in requests for outcome in request.outcomes]
    taken, now = report_store.take_in(connection, outcomes, requests[0].terms)
    released = [holding_store.release(connection, request.release) for request in requests]
    wanted = [request.wanted for request in requests if request.wanted is not None]
    granted = lease_store.lease_together(connection, wanted, now)
    # A campaign that just granted a job is not idle.
    idle = report_store.idle_campaigns(connection, set(taken.campaigns) - granted.campaigns)
    reported = [{outcome.job for outcome in request.outcomes} for request in requests]
    statuses, grants = iter(taken.statuses), iter(granted.jobs)
    return [
        Exchanged(
            report=Report(
                statuses=tuple(next(statuses) for _ in request.outcomes),
                campaigns=idle,
                owners=taken.owners,
                quarantined=tuple(loss for loss in taken.quarantined if loss.job in jobs),
            ),
            released=given_back,
            granted=next(grants) if request.wanted is not None else [],
        )
        for request, given_back, jobs in zip(requests, released, reported, strict=True)
    ]
