"""Exchanges: requests of workers that report, give back and lease jobs, several in one commit.

All outcomes are stored first, then all leases granted. On Postgres, this takes two round trips as long as nothing
unusual happens: one reads the reported jobs together with the queue, the other writes and commits. The queue as it
was before the outcomes were stored is also the queue afterwards, unless one of them changes more than its own job.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from sqlalchemy import Connection

from brink.server.db.statements import is_pipelined, read
from brink.server.queue import lease_store, report_store
from brink.server.queue.job_store import idle_campaigns
from brink.server.queue.lease_policy import LeaseDemand, LeaseTerms
from brink.server.queue.lease_store import Look
from brink.server.queue.report_store import Outcome, Report, ResultCheck
from brink.server.queue.workers import Contact, record_contact
from brink.worker.wire import HeldLease, LeasedJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """One request of a worker, as the writer executes it.

    Attributes:
        terms: The terms of retries.
        contacts: Contacts of workers to record.
        outcomes: The reported outcomes.
        release: Leases given back.
        demand: The jobs wanted next, if any.
        check: Refuses results that are of no use; None to store all.
    """

    terms: LeaseTerms
    contacts: tuple[Contact, ...] = ()
    outcomes: tuple[Outcome, ...] = ()
    release: tuple[HeldLease, ...] = ()
    demand: LeaseDemand | None = None
    check: ResultCheck | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExchangeReply:
    """The result of one exchange.

    Attributes:
        report: What became of the outcomes, and the campaigns that have no open job left after the commit.
        released: How many leases were given back.
        granted: The jobs granted.
    """

    report: Report
    released: int
    granted: list[LeasedJob] = field(default_factory=list)


def run_exchanges(connection: Connection, exchanges: Sequence[Exchange]) -> list[ExchangeReply]:
    """Run all exchanges that share a commit: first store their outcomes, then grant jobs in order."""
    for exchange in exchanges:
        for contact in exchange.contacts:
            record_contact(connection, contact)
    demands = [exchange.demand for exchange in exchanges if exchange.demand is not None]
    stored, look = _store_outcomes(connection, exchanges, demands)
    released = [lease_store.release(connection, exchange.release) for exchange in exchanges]
    granted = lease_store.lease_together(connection, demands, None if any(released) else look)
    # A campaign of whose current generation a job was just granted is not idle, and need not be looked up.
    idle = idle_campaigns(connection, set(stored.campaigns) - granted.busy)
    reported = [{outcome.job for outcome in exchange.outcomes} for exchange in exchanges]
    statuses, grants = iter(stored.statuses), iter(granted.jobs)
    return [
        ExchangeReply(
            report=Report(
                statuses=tuple(next(statuses) for _ in exchange.outcomes),
                campaigns=idle,
                owners=stored.owners,
                quarantined=tuple(attempt for attempt in stored.quarantined if attempt.job in jobs),
                unjudged=stored.unjudged,
            ),
            released=count,
            granted=next(grants) if exchange.demand is not None else [],
        )
        for exchange, count, jobs in zip(exchanges, released, reported, strict=True)
    ]


def _store_outcomes(
    connection: Connection, exchanges: Sequence[Exchange], demands: Sequence[LeaseDemand]
) -> tuple[Report, Look | None]:
    """Store all outcomes; return the report, and the queue as the demands find it if it is known already."""
    outcomes = [outcome for exchange in exchanges for outcome in exchange.outcomes]
    if not outcomes:
        return Report(statuses=(), campaigns=()), None
    ahead = lease_store.look_queries(demands) if demands and is_pipelined(connection) else []
    reported, *seen = read(connection, report_store.reported_query(outcomes), *ahead)
    stored = report_store.store_outcomes(
        connection, outcomes, reported, exchanges[0].terms.retry_backoff_s, exchanges[0].check
    )
    if not seen or stored.changes_queue:
        return stored, None
    look = lease_store.found_look(demands, seen)
    return stored, look if look.is_plain else None
