"""A short fault trial, and its audit: lost, doubled and stuck jobs are detected."""

import json
from typing import Any

import pytest
from sqlalchemy import update
from support.processes import environment
from support.queue import RESULT, Queue

from benchmarks.chaos import ChaosPlan, Findings, Ledger, audit, run_trial
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, SolutionRow
from brink.server.states import CampaignStatus, SolutionVerdict
from brink.worker.wire import LeasedJob

SHORT = ChaosPlan(minutes=0.25, faults=8, every_s=1.2, share=0.2, simulations=100, drives=False)


def ignore(part: str, done: int, total: int) -> None:
    """Ignore the progress of the trial."""


@pytest.mark.long("a fault trial by wall clock")
def test_nothing_is_lost_in_a_fault_trial() -> None:
    outcome = run_trial(SHORT, ignore)
    findings = outcome.findings
    assert findings == Findings()
    assert outcome.same == len(outcome.digests) >= 2
    assert outcome.broken.total() >= 8
    assert outcome.messages.total() >= 1


@pytest.mark.long("a fault trial by wall clock")
def test_trial_reveals_a_queue_that_ignores_lease_tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    plan = ChaosPlan(
        minutes=0.4, faults=1, every_s=5.0, share=0.4, simulations=100, drives=False, plugins=("unfenced",)
    )
    assert run_trial(plan, ignore).findings.doubled


def note(ledger: Ledger, jobs: list[LeasedJob], status: str = "accepted", result: str = RESULT) -> None:
    results: list[Any] = [{"job": job.job, "token": job.token, "outcome": json.loads(result)} for job in jobs]
    statuses = [{"job": job.job, "status": status} for job in jobs]
    ledger.note(json.dumps({"results": results}).encode(), json.dumps({"statuses": statuses}).encode())


def findings_of(engines: Engines, ledger: Ledger, campaigns: dict[str, int]) -> tuple[list[str], ...]:
    with engines.reader.connect() as connection:
        found = audit(connection, ledger, campaigns)
    return list(found.lost), list(found.doubled), list(found.stuck)


def judge(queue: Queue, campaign: str, *, counted: int) -> None:
    """Give all solutions a verdict, and set the number that their campaign counts."""
    safe = {"verdict": SolutionVerdict.SAFE, "robustness": 1.0}
    queue.run(lambda c: c.execute(update(SolutionRow).values(safe)))
    queue.run(
        lambda c: c.execute(update(CampaignRow).where(CampaignRow.id == campaign).values(evaluated=counted))
    )


class TestAudit:
    def test_accepted_verdict_that_is_not_stored_is_lost(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(2), Ledger()
        jobs = queue.lease()
        queue.complete(jobs[0])
        note(ledger, jobs)
        lost, doubled, _ = findings_of(engines, ledger, {campaign: 0})
        assert lost == [f"job {jobs[1].job}: accepted, but it is leased"]
        assert doubled == []

    def test_verdict_that_differs_from_the_accepted_one_is_lost(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(1), Ledger()
        jobs = queue.lease()
        queue.complete(*jobs)
        note(ledger, jobs, result=RESULT.replace('"objectives":{}', '"objectives":{"gap":1.0}'))
        lost, _, _ = findings_of(engines, ledger, {campaign: 0})
        assert lost == [f"job {jobs[0].job}: accepted, but it is done"]

    def test_verdict_accepted_twice_is_doubled(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(1), Ledger()
        jobs = queue.lease()
        queue.complete(*jobs)
        note(ledger, jobs)
        note(ledger, jobs, status="duplicate")
        assert findings_of(engines, ledger, {campaign: 0})[1] == []
        note(ledger, jobs)
        assert findings_of(engines, ledger, {campaign: 0})[1] == [f"job {jobs[0].job}: accepted 2 times"]

    def test_open_work_is_stuck_and_missing_verdicts_are_lost(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(1)
        lost, _, stuck = findings_of(engines, Ledger(), {campaign: 1})
        assert stuck == ["job 1 is queued", f"campaign {campaign} is running"]
        assert lost == [f"campaign {campaign}: 0 verdicts of 1 simulations"]

    def test_quarantined_job_is_lost_but_not_stuck(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(2)
        jobs = queue.lease_all()
        queue.fail(jobs[0], final=True)
        queue.complete(jobs[1])
        queue.set_status(campaign, CampaignStatus.FINISHED)
        lost, doubled, stuck = findings_of(engines, Ledger(), {campaign: 0})
        assert lost == [f"job {jobs[0].job} is quarantined"]
        assert (doubled, stuck) == ([], [])

    def test_solution_counted_without_a_verdict_is_doubled(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(2)
        judge(queue, campaign, counted=2)
        assert findings_of(engines, Ledger(), {campaign: 2})[1] == []
        judge(queue, campaign, counted=3)
        assert findings_of(engines, Ledger(), {campaign: 2})[1] == [
            f"campaign {campaign}: counts 3 solutions, 2 have a verdict"
        ]

    def test_campaign_that_was_not_submitted_is_doubled(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(1)
        assert findings_of(engines, Ledger(), {})[1] == [f"campaign {campaign} was not submitted"]

    def test_failed_attempts_are_charged_wrongly_unless_episodes_were_killed(
        self, queue: Queue, engines: Engines
    ) -> None:
        queue.campaign(2, max_losses=9)
        killed, lost = queue.lease_all()
        queue.fail(killed)
        queue.run_out(lost)
        queue.end_backoffs()
        while jobs := queue.lease("w2"):
            queue.complete(*jobs)
        assert [(row.attempt, row.losses) for row in queue.jobs()] == [(2, 0), (2, 1)]
        with engines.reader.connect() as connection:
            assert audit(connection, Ledger(), {}, crashes=1).charged == ()
            assert audit(connection, Ledger(), {}, charged=["job 1"]).charged == (
                "job 1",
                "1 failed attempts, but 0 episodes were killed",
            )

    def test_internal_errors_are_findings(self, engines: Engines) -> None:
        ledger = Ledger()
        ledger.errors["POST /api/v1/jobs/results"] += 2
        with engines.reader.connect() as connection:
            assert audit(connection, ledger, {}).errors == ("POST /api/v1/jobs/results: 2 times",)
