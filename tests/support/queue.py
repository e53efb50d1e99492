"""The queue's SQL in the hands of a test: campaigns made of jobs, units run one at a time, time moved by hand."""

import itertools
import secrets
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import Any, TypeVar

from sqlalchemy import Connection, Row, select, update

from brink.server.campaigns import step_store, store
from brink.server.campaigns.body import Budget, CampaignBody, Execution, PluginChoice
from brink.server.campaigns.deletion import erase_all, mark_deleted
from brink.server.campaigns.step_store import Asked, NewSolution
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow, SweepRow
from brink.server.db.sql import database_now
from brink.server.queue import exchange, lease_store, outages, report_store
from brink.server.queue.exchange import Exchange
from brink.server.queue.job_store import NewJob
from brink.server.queue.lease_policy import LeaseDemand, LeaseTerms
from brink.server.queue.outages import Sweep
from brink.server.queue.report_store import Outcome, Report
from brink.server.states import CampaignStatus
from brink.worker.wire import HeldLease, LeasedJob
from support.problems import SIMULATOR

T = TypeVar("T")
RESULT = '{"kind":"completed","verdicts":{},"objectives":{},"features":{},"provenance":{}}'
TERMS = LeaseTerms(lease_s=60.0, retry_backoff_s=10.0, live_workers=1)


def lease(
    connection: Connection, worker: str, capabilities: Sequence[str], max_jobs: int, terms: LeaseTerms
) -> list[LeasedJob]:
    """Lease jobs to one worker."""
    demand = LeaseDemand(worker=worker, capabilities=tuple(capabilities), max_jobs=max_jobs, terms=terms)
    return exchange.run_exchanges(connection, [Exchange(terms=terms, demand=demand)])[0].granted


def report(connection: Connection, outcomes: Sequence[Outcome], terms: LeaseTerms) -> Report:
    """Store outcomes, and say which campaigns have no open job left."""
    return exchange.run_exchanges(connection, [Exchange(terms=terms, outcomes=tuple(outcomes))])[0].report


def held(job: LeasedJob) -> HeldLease:
    """Return the lease of a job."""
    return HeldLease(job=job.job, token=job.token)


@dataclass(frozen=True, slots=True, kw_only=True)
class Queue:
    """One database's queue."""

    engines: Engines
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def run(self, unit: Callable[[Connection], T]) -> T:
        """Run a unit in a transaction of its own."""
        with self.engines.writer.begin() as connection:
            return unit(connection)

    def limit_parameters(self, most: int) -> None:
        """Let a statement of the writer have so many parameters at most; SQLite alone can be told."""
        with self.engines.writer.connect() as connection:
            driver = connection.connection.driver_connection
            assert isinstance(driver, sqlite3.Connection)
            driver.setlimit(sqlite3.SQLITE_LIMIT_VARIABLE_NUMBER, most)

    def campaign(
        self,
        jobs: int | Sequence[str],
        *,
        priority: int = 0,
        cache: bool = True,
        max_attempts: int = 3,
        max_losses: int = 3,
        needs: str = SIMULATOR,
    ) -> str:
        """Store a campaign with that many jobs, or with a job for each of these hashes; return its id."""
        body = CampaignBody(
            name="test",
            problem=PluginChoice(id="ball@1"),
            algorithm=PluginChoice(id="ga@1"),
            budget=Budget(simulations=1000),
            priority=priority,
            execution=Execution(cache=cache, max_attempts=max_attempts, max_losses=max_losses),
        )
        name = f"{next(self._numbers):08x}"  # the same each time: ties between campaigns are broken by id
        hashes = [secrets.token_hex(32) for _ in range(jobs)] if isinstance(jobs, int) else list(jobs)
        solutions = [
            NewSolution(
                number=number,
                vector=b"",
                seed=number,
                job=NewJob(spec="{}", spec_hash=spec_hash, needs=needs, timeout_s=60.0),
            )
            for number, spec_hash in enumerate(hashes)
        ]

        def unit(connection: Connection) -> None:
            row = store.campaign_row(name, body, body.document_hash())
            store.insert_campaigns(connection, [row])
            found = store.CAMPAIGNS.find(connection, name)
            assert found is not None
            asked = Asked(first=0, generations=[solutions] if solutions else [], end=None)
            step_store.insert_generations(connection, found, asked)

        self.run(unit)
        return name

    def set_status(self, campaign: str, status: CampaignStatus) -> None:
        """Change what a campaign is."""
        self.run(lambda connection: store.set_status(connection, campaign, status, ""))

    def lease(
        self,
        worker: str = "w1",
        max_jobs: int = 100,
        capabilities: Sequence[str] = (SIMULATOR,),
        *,
        live_workers: int = 1,
        lease_s: float = 60.0,
        elsewhere: Sequence[str] = (),
    ) -> list[LeasedJob]:
        """Lease jobs."""
        terms = replace(TERMS, live_workers=live_workers, lease_s=lease_s, elsewhere=frozenset(elsewhere))
        return self.run(lambda c: lease(c, worker, capabilities, max_jobs, terms))

    def lease_together(
        self, asks: Sequence[tuple[str, int, Sequence[str]]], *, live_workers: int = 1
    ) -> Sequence[list[LeasedJob]]:
        """Lease jobs to several workers at once: each with most jobs and capabilities."""
        terms = replace(TERMS, live_workers=live_workers)
        wanted = [
            LeaseDemand(worker=worker, max_jobs=most, capabilities=tuple(capabilities), terms=terms)
            for worker, most, capabilities in asks
        ]
        replies = self.exchange(*(Exchange(terms=terms, demand=demand) for demand in wanted))
        return [granted for _, granted in replies]

    def exchange(self, *exchanges: Exchange) -> list[tuple[Report, list[LeasedJob]]]:
        """Report and lease jobs, all in one commit; return the report and the grant of each exchange."""
        replies = self.run(lambda connection: exchange.run_exchanges(connection, exchanges))
        return [(reply.report, reply.granted) for reply in replies]

    def lease_all(self, worker: str = "w1") -> list[LeasedJob]:
        """Lease jobs until no more are granted."""
        granted: list[LeasedJob] = []
        while more := self.lease(worker):
            granted += more
        return granted

    def report(self, *outcomes: Outcome, retry_backoff_s: float = 10.0) -> Report:
        """Report outcomes."""
        terms = replace(TERMS, retry_backoff_s=retry_backoff_s)
        return self.run(lambda c: report(c, outcomes, terms))

    def complete(self, *jobs: LeasedJob, result: str = RESULT) -> tuple[str, ...]:
        """Report jobs as completed; return what became of each report."""
        return self.report(*(Outcome(job=j.job, token=j.token, result=result) for j in jobs)).statuses

    def fail(self, *jobs: LeasedJob, final: bool = False, error: str = "crashed: boom") -> tuple[str, ...]:
        """Report jobs as failed; return what became of each report."""
        return self.report(
            *(Outcome(job=j.job, token=j.token, result=None, error=error, final=final) for j in jobs)
        ).statuses

    def renew(self, *jobs: LeasedJob) -> list[int]:
        """Renew leases; return the jobs that are still held."""
        return self.run(lambda c: lease_store.renew(c, [held(job) for job in jobs], 60.0))

    def release(self, *jobs: LeasedJob) -> int:
        """Give leases back; return how many were."""
        return self.run(lambda c: lease_store.release(c, [held(job) for job in jobs]))

    def expire(self) -> tuple[tuple[str, ...], int]:
        """Take back the leases that ran out; return the campaigns that are idle now, and how many leases."""
        taken = self.run(lambda c: report_store.expire(c, TERMS))
        return taken.campaigns, len(taken.lost) + len(taken.interrupted)

    def begin_sweep(self, *, resuming: bool = False) -> Sweep | None:
        """Begin a sweep of a coordinator that sweeps every second, with leases of 60 s."""
        return self.run(
            lambda c: outages.begin_sweep(c, lease_s=TERMS.lease_s, sweep_s=1.0, resuming=resuming)
        )

    def be_away(self, *, seconds: float) -> None:
        """Let this time pass without a coordinator: leases end earlier, and so was the last sweep."""

        def unit(connection: Connection) -> None:
            for column in (JobRow.lease_expires_at, SweepRow.swept_at):
                found = connection.execute(select(column.class_.id, column).where(column.is_not(None))).all()
                for row_id, moment in found:
                    change = update(column.class_).where(column.class_.id == row_id)
                    connection.execute(change.values({column: moment - timedelta(seconds=seconds)}))

        self.run(unit)

    def run_out(self, *jobs: LeasedJob) -> None:
        """Let leases run out and take them back."""
        self.end_leases(*jobs)
        assert self.expire()[1] == len(jobs)

    def end_leases(self, *jobs: LeasedJob) -> None:
        """Let leases run out, and nobody take them back yet."""
        self._move("lease_expires_at", [job.job for job in jobs])

    def retry(self, job: int) -> None:
        """Retry a job by hand."""
        self.run(lambda connection: store.retry_job(connection, job))

    def delete(self, campaign: str) -> None:
        """End a campaign, delete it, and erase it."""
        self.run(lambda c: store.set_status(c, campaign, CampaignStatus.CANCELLED, ""))
        self.run(lambda connection: mark_deleted(connection, [campaign]))
        erase_all(self.engines)

    def end_backoffs(self) -> None:
        """Let all backoffs end."""
        self._move("not_before", None)

    def _move(self, column: str, jobs: Sequence[int] | None) -> None:
        def unit(connection: Connection) -> None:
            past = database_now(connection) - timedelta(seconds=1)
            change = update(JobRow).where(getattr(JobRow, column).is_not(None)).values({column: past})
            connection.execute(change if jobs is None else change.where(JobRow.id.in_(jobs)))

        self.run(unit)

    def jobs(self, campaign: str | None = None) -> list[Row[Any]]:
        """Return the rows of all jobs, or of a campaign's, ascending by id."""
        query = select(JobRow.__table__).order_by(JobRow.id)
        if campaign is not None:
            query = query.where(JobRow.campaign_id == campaign)
        return self.run(lambda connection: list(connection.execute(query)))

    def job(self, job: int) -> Row[Any]:
        """Return the row of a job."""
        return next(row for row in self.jobs() if row.id == job)

    def states(self, campaign: str) -> list[str]:
        """Return the states of a campaign's jobs, ascending by id."""
        return [str(row.status) for row in self.jobs(campaign)]
