"""A model of the queue in memory, and a state machine that drives the queue and the model and compares them.

The model knows nothing of SQL: it says in plain Python which worker should get which jobs, and what becomes of them.

A *history* is a list of steps, each the name of a rule with its arguments. Hypothesis searches for histories that
tell the queue and its model apart; a history that it found can be replayed without a search.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any, ClassVar, TypeVar

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from sqlalchemy import text

from brink.server.db.engine import Engines
from brink.server.errors import Conflict, NotFound
from brink.server.queue.exchange import Exchange
from brink.server.queue.lease_policy import LeaseDemand
from brink.server.queue.report_store import Outcome
from brink.server.states import CampaignStatus
from brink.worker.wire import LeasedJob
from support.queue import RESULT, TERMS, Queue

T = TypeVar("T")

WORKERS = ("w1", "w2", "w3")
NEEDS = ("faulty@1", "other@1")
MAX_ATTEMPTS = 2
MAX_LOSSES = 3
MAX_JOBS = 24
TURN = 4

Step = tuple[str, dict[str, Any]]
PICK = st.integers(0, 29)
"""Chooses among what there is at a step: the item with this number, counted round and round."""


@dataclass
class ModelCampaign:
    """A campaign as the queue should see it."""

    id: str
    priority: int
    cache: bool
    status: CampaignStatus = CampaignStatus.RUNNING
    turn: int = 0
    served: int = 0


@dataclass
class ModelJob:
    """The state that a job should be in."""

    id: int
    campaign: ModelCampaign
    spec_hash: str
    needs: str
    status: str = "queued"
    attempt: int = 0
    max_attempts: int = MAX_ATTEMPTS
    losses: int = 0
    max_losses: int = MAX_LOSSES
    token: str | None = None
    lost_token: str | None = None
    interrupted: bool = False
    worker: str | None = None
    failed_worker: str | None = None
    due: bool = True


@dataclass
class Model:
    """The state that the queue should be in."""

    jobs: dict[int, ModelJob] = field(default_factory=dict)
    campaigns: dict[str, ModelCampaign] = field(default_factory=dict)

    def known(self, spec_hash: str) -> bool:
        """Return whether a simulation has a result that equal simulations may reuse."""
        return any(
            job.spec_hash == spec_hash and job.status == "done" and job.campaign.cache
            for job in self.jobs.values()
        )

    def eligible(self, job: ModelJob, capabilities: Sequence[str]) -> bool:
        """Return whether a worker with these capabilities may be granted a job now."""
        runs = any(o.status == "leased" and o.spec_hash == job.spec_hash for o in self.jobs.values())
        return (
            job.status == "queued"
            and job.due
            and job.needs in capabilities
            and job.campaign.status is CampaignStatus.RUNNING
            and not (runs and job.campaign.cache)
        )

    def holdings(self, worker: str) -> list[ModelJob]:
        """Return the jobs that a worker holds."""
        return [job for job in self.jobs.values() if job.status == "leased" and job.worker == worker]

    def retries(self, worker: str, capabilities: Sequence[str], elsewhere: Sequence[str]) -> list[ModelJob]:
        """Return the due retries that a worker may be granted: those of the highest priority."""
        found = [
            job
            for job in self.jobs.values()
            if job.attempt > 0
            and self.eligible(job, capabilities)
            and (job.failed_worker != worker or job.needs not in elsewhere)
        ]
        best = max((job.campaign.priority for job in found), default=0)
        return [job for job in found if job.campaign.priority == best]

    def in_turn(self, capabilities: Sequence[str]) -> list[ModelCampaign]:
        """Return the campaigns with first attempts for these capabilities, in the order in which they are served."""
        serves = {
            job.campaign.id: job.campaign
            for job in self.jobs.values()
            if job.attempt == 0 and self.eligible(job, capabilities)
        }
        return sorted(serves.values(), key=lambda one: (-one.priority, one.turn, one.id))

    def fresh(
        self, capabilities: Sequence[str], max_jobs: int, live_workers: int
    ) -> tuple[list[int], dict[str, tuple[int, int]]]:
        """Return the first attempts that a worker should be granted.

        Args:
            capabilities: Of the worker.
            max_jobs: The most jobs that it asked for.
            live_workers: The number of live workers.

        Returns:
            The jobs, and the turn and the jobs served in it of each campaign whose turn changes.
        """
        waiting = sum(
            job.status == "queued" and job.campaign.status is CampaignStatus.RUNNING
            for job in self.jobs.values()
        )
        enough = live_workers * (max_jobs + 1) * 3 // 2
        limit = min(max_jobs, max(1, -(-2 * min(waiting, enough) // (3 * live_workers))))
        line = self.in_turn(capabilities)
        taken: list[ModelJob] = []
        stands: dict[str, tuple[int, int]] = {}
        for campaign in line:
            its = [
                job
                for job in self.jobs.values()
                if job.campaign is campaign and job.attempt == 0 and self.eligible(job, capabilities)
            ][: limit - len(taken)]
            taken += its
            if not its:
                break
            stands[campaign.id] = (campaign.turn, campaign.served + len(its))
            if campaign.served + len(its) >= TURN * live_workers:
                running = [one for one in self.campaigns.values() if one.status is CampaignStatus.RUNNING]
                last = max(one.turn for one in running)
                stands[campaign.id] = (max([last, *(turn for turn, _ in stands.values())]) + 1, 0)
        seen: set[str] = set()
        kept = []
        for job in taken:
            if not (job.campaign.cache and job.spec_hash in seen):
                seen.add(job.spec_hash)
                kept.append(job.id)
        return kept, stands

    def grant(self, worker: str, granted: Sequence[LeasedJob]) -> None:
        """Take in a grant."""
        for lease in granted:
            job = self.jobs[lease.job]
            job.status, job.attempt, job.token, job.worker = "leased", job.attempt + 1, lease.token, worker
            job.lost_token, job.interrupted = None, False

    def fail(self, job: ModelJob, *, final: bool) -> None:
        """Take in a failed attempt."""
        self._end_attempt(job, over=final or job.attempt - job.losses >= job.max_attempts)

    def run_out(self, job: ModelJob) -> None:
        """Take in a lease that ran out."""
        job.lost_token, job.token = job.token, None
        if job.interrupted:
            job.status, job.attempt, job.due = "queued", job.attempt - 1, True
            return
        job.losses += 1
        self._end_attempt(job, over=job.losses >= job.max_losses)

    def _end_attempt(self, job: ModelJob, *, over: bool) -> None:
        job.status, job.due = "quarantined" if over else "queued", over
        job.failed_worker = job.worker

    def restore(self, job: ModelJob) -> None:
        """Take in that the worker of a lease that ran out is there after all."""
        job.status, job.token, job.lost_token = "leased", job.lost_token, None
        job.attempt += job.interrupted
        job.losses -= not job.interrupted
        job.interrupted = False

    def finish(self, job: ModelJob) -> None:
        """Take in a result: queued equal simulations reuse it."""
        job.status = "done"
        for twin in self.jobs.values():
            shares = job.campaign.cache and twin.campaign.cache and twin.spec_hash == job.spec_hash
            if shares and twin.status == "queued":
                twin.status = "done"


def step(**arguments: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a method a rule of the machine that notes itself in the machine's history."""

    as_rule: Callable[[Callable[..., None]], Any] = rule(**arguments)  # type: ignore[call-overload]

    def decorate(method: Callable[..., None]) -> Callable[..., None]:
        @wraps(method)
        def noted(self: "QueueMachine", **given: Any) -> None:
            self.history.append((method.__name__, given))
            method(self, **given)

        made: Callable[..., None] = as_rule(noted)
        return made

    return decorate


def picked(pick: int, choices: Sequence[T]) -> T:
    """Return one of some choices."""
    return choices[pick % len(choices)]


class QueueMachine(RuleBasedStateMachine):
    """Whatever workers, sweepers and people do to a queue, in any order.

    Attributes:
        engines: Of the database, whose queue is emptied first.
        history: The steps so far.
        latest: The history of the machine that was made last.
    """

    engines: ClassVar[Engines]
    latest: ClassVar[list[Step]] = []

    def __init__(self) -> None:
        super().__init__()
        empty(self.engines)
        self.queue = Queue(engines=self.engines)
        self.queue.begin_sweep()
        self.model = Model()
        self.leases: list[LeasedJob] = []
        self.history: list[Step] = []
        QueueMachine.latest = self.history

    @precondition(lambda self: len(self.model.jobs) < MAX_JOBS)
    @step(
        hashes=st.lists(st.sampled_from("abcde"), min_size=1, max_size=5),
        needs=st.sampled_from([NEEDS[0], NEEDS[0], NEEDS[0], NEEDS[1]]),
        priority=st.sampled_from([0, 0, 1]),
        cache=st.booleans(),
    )
    def submit(self, hashes: list[str], needs: str, priority: int, cache: bool) -> None:
        name = self.queue.campaign(
            hashes,
            max_attempts=MAX_ATTEMPTS,
            max_losses=MAX_LOSSES,
            needs=needs,
            priority=priority,
            cache=cache,
        )
        campaign = ModelCampaign(name, priority, cache)
        known = {spec_hash: cache and self.model.known(spec_hash) for spec_hash in hashes}
        self.model.campaigns[name] = campaign
        for row in self.queue.jobs(name):
            status = "done" if known[row.spec_hash] else "queued"
            self.model.jobs[row.id] = ModelJob(row.id, campaign, row.spec_hash, needs, status)

    @step(
        worker=st.sampled_from(WORKERS),
        max_jobs=st.integers(1, 5),
        capabilities=st.sampled_from([NEEDS, NEEDS, NEEDS[:1], NEEDS[1:]]),
        live_workers=st.integers(1, 3),
        elsewhere=st.sampled_from([(), (), NEEDS]),
    )
    def lease(
        self,
        worker: str,
        max_jobs: int,
        capabilities: Sequence[str],
        live_workers: int,
        elsewhere: Sequence[str],
    ) -> None:
        self._lease(worker, max_jobs, capabilities, live_workers, elsewhere)

    def _lease(
        self,
        worker: str,
        max_jobs: int,
        capabilities: Sequence[str],
        live_workers: int,
        elsewhere: Sequence[str],
    ) -> None:
        compare = self.expected_grant(
            worker, max_jobs, capabilities, live_workers=live_workers, elsewhere=elsewhere
        )
        compare(
            self.queue.lease(worker, max_jobs, capabilities, live_workers=live_workers, elsewhere=elsewhere)
        )

    @step(
        asks=st.lists(
            st.tuples(
                st.sampled_from(WORKERS),
                st.integers(1, 5),
                st.sampled_from([NEEDS, NEEDS, NEEDS[:1], NEEDS[1:]]),
            ),
            min_size=2,
            max_size=4,
        ),
        live_workers=st.integers(1, 3),
    )
    def lease_together(self, asks: Sequence[tuple[str, int, Sequence[str]]], live_workers: int) -> None:
        granted = self.queue.lease_together(asks, live_workers=live_workers)
        assert len(granted) == len(asks)
        for (worker, max_jobs, capabilities), jobs in zip(asks, granted, strict=True):
            self.expected_grant(worker, max_jobs, capabilities, live_workers=live_workers, elsewhere=())(jobs)

    def expected_grant(
        self,
        worker: str,
        max_jobs: int,
        capabilities: Sequence[str],
        *,
        live_workers: int,
        elsewhere: Sequence[str],
    ) -> Callable[[Sequence[LeasedJob]], None]:
        """Return a function that compares a grant with the model as it is now, and takes it in."""
        held = self.model.holdings(worker)
        retries = self.model.retries(worker, capabilities, elsewhere)
        in_turn = self.model.in_turn(capabilities)
        fresh, stands = self.model.fresh(capabilities, max_jobs, live_workers)

        def compare(granted: Sequence[LeasedJob]) -> None:
            got = [lease.job for lease in granted]
            if any(job.attempt > 1 for job in held):
                assert got == [], "a worker that holds a retry gets nothing else"
            elif retries and (not in_turn or retries[0].campaign.priority >= in_turn[0].priority):
                if held:
                    assert got == [], "a worker that holds jobs waits for a due retry"
                else:
                    assert len(got) == 1, "a retry is granted alone"
                    assert got[0] in {job.id for job in retries}
            else:
                assert got == fresh
                for name, (turn, served) in stands.items():
                    self.model.campaigns[name].turn, self.model.campaigns[name].served = turn, served
            assert all(lease.attempt == self.model.jobs[lease.job].attempt + 1 for lease in granted)
            assert len({lease.token for lease in [*self.leases, *granted]}) == len(self.leases) + len(granted)
            self.model.grant(worker, granted)
            self.leases += granted

        return compare

    @step(worker=st.sampled_from(WORKERS), max_jobs=st.integers(1, 3))
    def lease_anything(self, worker: str, max_jobs: int) -> None:
        self._lease(worker, max_jobs, NEEDS, 1, ())

    @precondition(lambda self: self.leases)
    @step(pick=PICK, failed=st.booleans(), final=st.sampled_from([False, False, False, True]))
    def report(self, pick: int, failed: bool, final: bool) -> None:
        self.report_of(picked(pick, self.leases[-6:]), failed=failed, final=final)

    @precondition(lambda self: self.leases)
    @step(
        exchanges=st.lists(
            st.tuples(
                st.lists(st.tuples(PICK, st.sampled_from([False, False, False, True])), max_size=2),
                st.sampled_from(WORKERS),
                st.integers(0, 4),
            ),
            min_size=1,
            max_size=3,
        ),
        live_workers=st.integers(1, 3),
    )
    def exchange(
        self, exchanges: Sequence[tuple[Sequence[tuple[int, bool]], str, int]], live_workers: int
    ) -> None:
        """Workers report and lease in one commit; one that asks for no jobs only reports."""
        choices = [*self.leases[-6:], *self.lost]
        terms = replace(TERMS, live_workers=live_workers)
        reports = [
            [(picked(pick, choices), failed) for pick, failed in outcomes] for outcomes, _, _ in exchanges
        ]
        asked = [
            Exchange(
                terms=terms,
                outcomes=tuple(
                    Outcome(job=one.job, token=one.token, result=None if failed else RESULT, error="boom")
                    for one, failed in outcomes
                ),
                demand=LeaseDemand(worker=worker, capabilities=NEEDS, max_jobs=max_jobs, terms=terms)
                if max_jobs
                else None,
            )
            for outcomes, (_, worker, max_jobs) in zip(reports, exchanges, strict=True)
        ]
        answers = self.queue.exchange(*asked)
        expected = self.take_in_reports(list(itertools.chain.from_iterable(reports)))
        assert [status for report, _ in answers for status in report.statuses] == expected
        for (_, worker, max_jobs), (_, granted) in zip(exchanges, answers, strict=True):
            if max_jobs:
                self.expected_grant(worker, max_jobs, NEEDS, live_workers=live_workers, elsewhere=())(granted)

    @precondition(lambda self: self.lost)
    @step(pick=PICK, failed=st.booleans())
    def report_late(self, pick: int, failed: bool) -> None:
        self.report_of(picked(pick, self.lost), failed=failed, final=False)

    @precondition(lambda self: self.running)
    @step(pick=PICK)
    def fail_and_wait(self, pick: int) -> None:
        self.report_of(picked(pick, self.running), failed=True, final=False)
        self._end_backoffs()

    @precondition(lambda self: self.lost)
    @step(pick=PICK, renews=st.booleans())
    def meddle(self, pick: int, renews: bool) -> None:
        lease = picked(pick, self.lost)
        assert (self.queue.renew(lease) == []) if renews else (self.queue.release(lease) == 0)

    @property
    def lost(self) -> list[LeasedJob]:
        """Leases that no longer hold, those of running jobs first."""
        jobs = self.model.jobs
        lost = [one for one in self.leases if one.job in jobs and jobs[one.job].token != one.token]
        return sorted(lost, key=lambda one: jobs[one.job].status != "leased")[:4]

    @property
    def running(self) -> list[LeasedJob]:
        """Leases that hold."""
        jobs = self.model.jobs
        return [
            one
            for one in self.leases
            if one.job in jobs and jobs[one.job].token == one.token and jobs[one.job].status == "leased"
        ]

    def report_of(self, lease: LeasedJob, *, failed: bool, final: bool) -> None:
        """Report a job to the queue and to the model, and compare the answers."""
        got = self.queue.fail(lease, final=final) if failed else self.queue.complete(lease)
        assert list(got) == self.take_in_reports([(lease, failed)], final=final)

    def take_in_reports(self, reports: Sequence[tuple[LeasedJob, bool]], *, final: bool = False) -> list[str]:
        """Take in reports that are stored together, each with whether the attempt failed; return their statuses."""
        jobs = self.model.jobs
        for lease, _ in reports:
            job = jobs.get(lease.job)
            if job is not None and job.status == "queued" and job.lost_token == lease.token:
                self.model.restore(job)
        statuses = []
        accepted: dict[int, bool] = {}
        for lease, failed in reports:
            job = jobs.get(lease.job)
            if job is None or job.token != lease.token:
                statuses.append("stale")
            elif job.status != "leased" or lease.job in accepted:
                statuses.append("duplicate")
            else:
                statuses.append("accepted")
                accepted[lease.job] = failed
        for number in sorted(accepted, key=lambda number: accepted[number]):  # results are stored first
            if accepted[number]:
                self.model.fail(jobs[number], final=final)
            else:
                self.model.finish(jobs[number])
        return statuses

    @precondition(lambda self: self.leases)
    @step(pick=PICK)
    def release(self, pick: int) -> None:
        lease = picked(pick, self.leases[-6:])
        job = self.model.jobs.get(lease.job)
        holds = job is not None and job.status == "leased" and job.token == lease.token
        assert self.queue.release(lease) == int(holds)
        if job is not None and holds:
            job.status, job.attempt, job.token, job.worker = "queued", job.attempt - 1, None, None

    @precondition(lambda self: self.leases)
    @step(pick=PICK)
    def renew(self, pick: int) -> None:
        lease = picked(pick, self.leases[-6:])
        job = self.model.jobs.get(lease.job)
        holds = job is not None and job.status == "leased" and job.token == lease.token
        assert self.queue.renew(lease) == ([lease.job] if holds else [])
        if job is not None and holds:
            job.interrupted = False

    @precondition(lambda self: self.running)
    @step(pick=PICK, waits=st.booleans())
    def run_out(self, pick: int, waits: bool) -> None:
        lease = picked(pick, self.running)
        self.queue.run_out(lease)
        self.model.run_out(self.model.jobs[lease.job])
        if waits:
            self._end_backoffs()

    @step(restarts=st.booleans())
    def be_away(self, restarts: bool) -> None:
        """No coordinator is there for an hour, or one restarts so fast that no sweep is missing."""
        leased = [job for job in self.model.jobs.values() if job.status == "leased"]
        extended = [job for job in leased if not (restarts and job.interrupted)]
        if not restarts:
            self.queue.be_away(seconds=3600)
        begun = self.queue.begin_sweep(resuming=restarts)
        assert begun is not None
        assert begun.extended == len(extended)
        assert self.queue.expire()[1] == 0, "a lease ran out in an outage"
        for job in extended:
            job.interrupted = True

    @step()
    def sweep(self) -> None:
        assert self.queue.expire()[1] == 0, "a lease that holds was taken back"

    @step()
    def end_backoffs(self) -> None:
        self._end_backoffs()

    def _end_backoffs(self) -> None:
        self.queue.end_backoffs()
        for job in self.model.jobs.values():
            job.due = True

    @precondition(lambda self: self.model.jobs)
    @step(pick=PICK)
    def retry_by_hand(self, pick: int) -> None:
        job = self.model.jobs[picked(pick, sorted(self.model.jobs))]
        ended = job.campaign.status is CampaignStatus.CANCELLED
        try:
            self.queue.retry(job.id)
        except Conflict:
            assert job.status != "quarantined" or ended
            return
        assert job.status == "quarantined"
        assert not ended
        job.status, job.token, job.due = "queued", None, True
        job.max_attempts = job.attempt - job.losses + MAX_ATTEMPTS
        job.max_losses = job.losses + MAX_LOSSES

    @precondition(lambda self: self.model.campaigns)
    @step(pick=PICK)
    def pause_or_resume(self, pick: int) -> None:
        campaign = self.model.campaigns[picked(pick, sorted(self.model.campaigns))]
        if campaign.status is CampaignStatus.CANCELLED:
            return
        runs = campaign.status is CampaignStatus.RUNNING
        campaign.status = CampaignStatus.PAUSED if runs else CampaignStatus.RUNNING
        self.queue.set_status(campaign.id, campaign.status)

    @precondition(lambda self: len(self.model.campaigns) > 2)
    @step(pick=PICK)
    def cancel(self, pick: int) -> None:
        campaign = self.model.campaigns[picked(pick, sorted(self.model.campaigns))]
        self.queue.set_status(campaign.id, CampaignStatus.CANCELLED)
        campaign.status = CampaignStatus.CANCELLED
        for job in self.model.jobs.values():
            if job.campaign is campaign and job.status in ("queued", "leased"):
                job.status, job.token, job.worker = "cancelled", None, None

    @precondition(lambda self: len(self.model.campaigns) > 3)
    @step(pick=PICK)
    def delete(self, pick: int) -> None:
        name = picked(pick, sorted(self.model.campaigns))
        campaign = self.model.campaigns.pop(name)
        self.queue.delete(name)
        gone = [job.id for job in self.model.jobs.values() if job.campaign is campaign]
        for job in gone:
            del self.model.jobs[job]
        if gone:
            try:
                self.queue.retry(gone[0])
            except NotFound:
                return
            raise AssertionError("a job of a deleted campaign is still there")

    @invariant()
    def jobs_are_in_the_same_states(self) -> None:
        rows = {
            row.id: (row.status, row.attempt, row.max_attempts, row.losses, row.max_losses)
            for row in self.queue.jobs()
        }
        assert rows == {
            number: (job.status, job.attempt, job.max_attempts, job.losses, job.max_losses)
            for number, job in self.model.jobs.items()
        }

    @invariant()
    def no_simulation_runs_twice(self) -> None:
        running = [j.spec_hash for j in self.model.jobs.values() if j.status == "leased" and j.campaign.cache]
        assert len(running) == len(set(running))


def empty(engines: Engines) -> None:
    """Delete everything in a queue, so that ids start anew."""
    with engines.writer.begin() as connection:
        if engines.is_sqlite:
            for table in ("campaigns", "jobs", "traces"):
                connection.execute(text(f"DELETE FROM {table}"))
        else:
            connection.execute(text("TRUNCATE campaigns, jobs, traces RESTART IDENTITY CASCADE"))


def search(engines: Engines, *, histories: int, steps: int = 60, shrink: bool = True) -> None:
    """Search for a history that tells the queue and its model apart; raise at the first difference.

    Args:
        engines: Of a migrated database.
        histories: The number of histories to try.
        steps: The length of a history at most.
        shrink: Whether to make a history that fails shorter.
    """
    machine = type("Machine", (QueueMachine,), {"engines": engines})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=histories,
            stateful_step_count=steps,
            deadline=None,
            derandomize=True,
            database=None,
            phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
            suppress_health_check=list(HealthCheck),
            report_multiple_bugs=False,
        ),
    )


def replay(engines: Engines, history: Iterable[Step]) -> None:
    """Replay a history, and compare the queue with its model after each step."""
    machine = type("Machine", (QueueMachine,), {"engines": engines})()
    for name, arguments in history:
        getattr(machine, name)(**arguments)
        machine.jobs_are_in_the_same_states()
        machine.no_simulation_runs_twice()
