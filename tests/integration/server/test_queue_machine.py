"""The queue against a small model in memory: whatever is asked in whatever order, both stand the same."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from support.queue import Queue

from server.db.engine import open_engines
from server.db.models import CampaignStatus
from worker.wire import LeasedJob

WORKERS = st.sampled_from(["w1", "w2", "w3"])
MAX_ATTEMPTS = 2


@dataclass
class Model:
    """What the queue should say of one job."""

    campaign: str
    spec_hash: str
    status: str = "queued"
    attempt: int = 0
    token: str | None = None


class QueueMachine(RuleBasedStateMachine):
    """Leases, reports, expiries, releases and cancellations in any order."""

    template: ClassVar[Path]

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        file = Path(self.folder.name) / "brink.db"
        shutil.copyfile(self.template, file)
        self.queue = Queue(engines=open_engines(f"sqlite:///{file}"))
        self.jobs: dict[int, Model] = {}
        self.leases: list[LeasedJob] = []
        self.results: set[str] = set()

    def teardown(self) -> None:
        self.queue.engines.dispose()
        self.folder.cleanup()

    @precondition(lambda self: len(self.jobs) < 20)
    @rule(hashes=st.lists(st.sampled_from("abcdefgh"), min_size=1, max_size=5))
    def enqueue(self, hashes: list[str]) -> None:
        campaign = self.queue.campaign(hashes, max_attempts=MAX_ATTEMPTS)
        for row in self.queue.jobs(campaign):
            known = row.spec_hash in self.results
            self.jobs[row.id] = Model(campaign, row.spec_hash, "done" if known else "queued")

    @rule(worker=WORKERS, max_jobs=st.integers(1, 4))
    def lease(self, worker: str, max_jobs: int) -> None:
        granted = self.queue.lease(worker, max_jobs)
        assert len(granted) <= max_jobs
        running = {job.spec_hash for job in self.jobs.values() if job.status == "leased"}
        for lease in granted:
            job = self.jobs[lease.job]
            assert job.status == "queued"
            assert job.spec_hash not in running
            running.add(job.spec_hash)
            assert lease.attempt == job.attempt + 1
            assert lease.attempt == 1 or len(granted) == 1
            job.status, job.attempt, job.token = "leased", lease.attempt, lease.token
        self.leases += granted

    @precondition(lambda self: self.leases)
    @rule(data=st.data(), failed=st.booleans(), final=st.booleans())
    def report(self, data: st.DataObject, failed: bool, final: bool) -> None:
        lease = data.draw(st.sampled_from(self.leases))
        job = self.jobs[lease.job]
        holds = job.token == lease.token
        expected = "stale" if not holds else "accepted" if job.status == "leased" else "duplicate"
        got = self.queue.fail(lease, final=final) if failed else self.queue.complete(lease)
        assert got == (expected,)
        if expected != "accepted":
            return
        if failed:
            job.status = "quarantined" if final or job.attempt >= MAX_ATTEMPTS else "queued"
            return
        job.status = "done"
        self.results.add(job.spec_hash)
        for twin in self.jobs.values():
            if twin.spec_hash == job.spec_hash and twin.status == "queued":
                twin.status = "done"

    @precondition(lambda self: self.leases)
    @rule(data=st.data())
    def release(self, data: st.DataObject) -> None:
        lease = data.draw(st.sampled_from(self.leases))
        job = self.jobs[lease.job]
        holds = job.status == "leased" and job.token == lease.token
        assert self.queue.release(lease) == int(holds)
        if holds:
            job.status, job.attempt, job.token = "queued", job.attempt - 1, None

    @precondition(lambda self: any(job.status == "leased" for job in self.jobs.values()))
    @rule(data=st.data())
    def run_out(self, data: st.DataObject) -> None:
        number = data.draw(st.sampled_from([n for n, job in self.jobs.items() if job.status == "leased"]))
        job = self.jobs[number]
        lease = next(lease for lease in self.leases if lease.token == job.token)
        self.queue.run_out(lease)
        job.status, job.token = "quarantined" if job.attempt >= MAX_ATTEMPTS else "queued", None

    @precondition(lambda self: any(self.lost(lease) for lease in self.leases))
    @rule(data=st.data())
    def report_late(self, data: st.DataObject) -> None:
        lease = data.draw(st.sampled_from([lease for lease in self.leases if self.lost(lease)]))
        assert self.queue.complete(lease) == ("stale",)

    def lost(self, lease: LeasedJob) -> bool:
        """Whether somebody else has what this lease was for, or nobody."""
        return self.jobs[lease.job].token != lease.token

    @rule()
    def end_backoffs(self) -> None:
        self.queue.end_backoffs()

    @precondition(lambda self: self.jobs)
    @rule(data=st.data())
    def cancel(self, data: st.DataObject) -> None:
        campaign = data.draw(st.sampled_from(sorted({job.campaign for job in self.jobs.values()})))
        self.queue.set_status(campaign, CampaignStatus.CANCELLED)
        for job in self.jobs.values():
            if job.campaign == campaign and job.status in ("queued", "leased"):
                job.status, job.token = "cancelled", None

    @precondition(lambda self: self.leases)
    @rule(data=st.data())
    def renew(self, data: st.DataObject) -> None:
        lease = data.draw(st.sampled_from(self.leases))
        job = self.jobs[lease.job]
        holds = job.status == "leased" and job.token == lease.token
        assert self.queue.renew(lease) == ([lease.job] if holds else [])

    @invariant()
    def they_stand_the_same(self) -> None:
        rows = {row.id: (row.status, row.attempt) for row in self.queue.jobs()}
        assert rows == {number: (job.status, job.attempt) for number, job in self.jobs.items()}


def test_the_queue_stands_where_its_model_stands(sqlite_file: Path) -> None:
    machine = type("Machine", (QueueMachine,), {"template": sqlite_file})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=25,
            stateful_step_count=30,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )
