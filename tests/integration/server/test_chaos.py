"""The trial by faults in short, and that it would notice if something were lost, doubled or stuck."""

import json
from typing import Any

import pytest
from sqlalchemy import update
from support.processes import environment
from support.queue import RESULT, Queue

from brink.bench.chaos.ledger import Ledger, audit
from brink.bench.chaos.trial import ChaosPlan, run_trial
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, SolutionRow
from brink.server.states import CampaignStatus, SolutionVerdict
from brink.worker.wire import LeasedJob

SHORT = ChaosPlan(minutes=0.25, faults=8, every_s=1.2, share=0.05, simulations=100, drives=False)


def told(part: str, done: int, total: int) -> None:
    """Listen to nothing."""


@pytest.mark.slow
def test_nothing_is_lost_while_everything_breaks() -> None:
    outcome = run_trial(SHORT, told)
    findings = outcome.findings
    assert (findings.lost, findings.doubled, findings.stuck) == ((), (), ())
    assert outcome.same == len(outcome.digests) >= 2
    assert outcome.broken.total() >= 8
    assert outcome.messages.total() >= 1


@pytest.mark.slow
def test_a_queue_without_fences_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    plan = ChaosPlan(
        minutes=0.15, faults=1, every_s=5.0, share=0.4, simulations=100, drives=False, plugins=("unfenced",)
    )
    assert run_trial(plan, told).findings.doubled


def said(ledger: Ledger, jobs: list[LeasedJob], status: str = "accepted", result: str = RESULT) -> None:
    results: list[Any] = [{"job": job.job, "token": job.token, "outcome": json.loads(result)} for job in jobs]
    statuses = [{"job": job.job, "status": status} for job in jobs]
    ledger.note(json.dumps({"results": results}).encode(), json.dumps({"statuses": statuses}).encode())


def findings_of(engines: Engines, ledger: Ledger, campaigns: dict[str, int]) -> tuple[list[str], ...]:
    with engines.reader.connect() as connection:
        found = audit(connection, ledger, campaigns)
    return list(found.lost), list(found.doubled), list(found.stuck)


def judge(queue: Queue, campaign: str, *, counted: int) -> None:
    """Give all solutions of a campaign a verdict, and have the campaign count so many."""
    safe = {"verdict": SolutionVerdict.SAFE, "robustness": 1.0}
    queue.run(lambda c: c.execute(update(SolutionRow).values(safe)))
    queue.run(
        lambda c: c.execute(update(CampaignRow).where(CampaignRow.id == campaign).values(evaluated=counted))
    )


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
class TestAudit:
    def test_a_verdict_that_was_taken_but_is_not_stored_is_lost(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(2), Ledger()
        jobs = queue.lease()
        queue.complete(jobs[0])
        said(ledger, jobs)
        lost, doubled, _ = findings_of(engines, ledger, {campaign: 0})
        assert lost == [f"job {jobs[1].job}: taken, but it is leased"]
        assert doubled == []

    def test_another_verdict_than_the_one_taken_is_a_loss(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(1), Ledger()
        jobs = queue.lease()
        queue.complete(*jobs)
        said(ledger, jobs, result=RESULT.replace('"objectives":{}', '"objectives":{"gap":1.0}'))
        lost, _, _ = findings_of(engines, ledger, {campaign: 0})
        assert lost == [f"job {jobs[0].job}: taken, but it is done"]

    def test_a_verdict_taken_twice_is_doubled(self, queue: Queue, engines: Engines) -> None:
        campaign, ledger = queue.campaign(1), Ledger()
        jobs = queue.lease()
        queue.complete(*jobs)
        said(ledger, jobs)
        said(ledger, jobs, status="duplicate")
        assert findings_of(engines, ledger, {campaign: 0})[1] == []
        said(ledger, jobs)
        assert findings_of(engines, ledger, {campaign: 0})[1] == [f"job {jobs[0].job}: taken 2 times"]

    def test_open_jobs_and_campaigns_are_stuck_and_missing_verdicts_lost(
        self, queue: Queue, engines: Engines
    ) -> None:
        campaign = queue.campaign(1)
        lost, _, stuck = findings_of(engines, Ledger(), {campaign: 1})
        assert stuck == ["job 1 is queued", f"campaign {campaign} is running"]
        assert lost == [f"campaign {campaign}: 0 verdicts of 1 simulations"]

    def test_a_job_in_quarantine_is_lost_and_not_stuck(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(2)
        jobs = queue.lease_all()
        queue.fail(jobs[0], final=True)
        queue.complete(jobs[1])
        queue.set_status(campaign, CampaignStatus.FINISHED)
        lost, doubled, stuck = findings_of(engines, Ledger(), {campaign: 0})
        assert lost == [f"job {jobs[0].job} is quarantined"]
        assert (doubled, stuck) == ([], [])

    def test_solutions_that_are_counted_without_a_verdict_are_doubled(
        self, queue: Queue, engines: Engines
    ) -> None:
        campaign = queue.campaign(2)
        judge(queue, campaign, counted=2)
        assert findings_of(engines, Ledger(), {campaign: 2})[1] == []
        judge(queue, campaign, counted=3)
        assert findings_of(engines, Ledger(), {campaign: 2})[1] == [
            f"campaign {campaign}: counts 3 solutions, 2 have a verdict"
        ]

    def test_a_campaign_that_nobody_submitted_is_doubled(self, queue: Queue, engines: Engines) -> None:
        campaign = queue.campaign(1)
        assert findings_of(engines, Ledger(), {})[1] == [f"campaign {campaign}: nobody submitted it"]
