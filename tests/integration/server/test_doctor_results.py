"""`brink doctor` on databases in which results were altered."""

import json
from collections.abc import Mapping
from typing import Any

import pytest
from sqlalchemy import Connection, delete, select, update
from support.api import FakeWorker, ball, completes, coordinator, submit, undisturbed_digest
from support.problems import SIMULATOR, simulated
from support.queue import TERMS, lease, report

from brink.server.campaigns import step_store, store
from brink.server.campaigns.step_store import Step
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow, SolutionRow
from brink.server.operations import doctor
from brink.server.operations.doctor import State, examine
from brink.server.queue import job_store
from brink.server.queue.report_store import Outcome
from brink.server.settings import Settings
from brink.worker.wire import Completed, JobFailed, LeasedJob

NUMBER = 7
SOLUTIONS = 52
"""How many solutions a search for 40 evaluates, to complete its last generation."""


@pytest.fixture
def finished(database_url: str, small_problems: None) -> str:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=40))
        FakeWorker(client).work(campaign)
    return campaign


def results(database_url: str, engines: Engines, *, thorough: bool = False) -> list[tuple[State, str]]:
    """Return what the doctor says of results."""
    found = examine(Settings(database=database_url), engines, thorough=thorough)
    return [(one.state, one.found) for one in found if one.check == "results"]


def alter(engines: Engines, campaign: str, values: Mapping[str, Any], table: type[Any] = SolutionRow) -> None:
    """Alter the row of a solution or of its job."""
    its = (table.campaign_id == campaign, table.number == NUMBER)
    kind = () if table is SolutionRow else (JobRow.kind == "episode",)
    with engines.writer.begin() as connection:
        assert connection.execute(update(table).where(*its, *kind).values(**values)).rowcount == 1


def stored(engines: Engines, campaign: str) -> tuple[str, float, dict[str, Any]]:
    """Return the verdict of a solution, its robustness, and the result of its job."""
    query = (
        select(SolutionRow.verdict, SolutionRow.robustness, JobRow.result)
        .join(JobRow, (JobRow.campaign_id == SolutionRow.campaign_id) & (JobRow.number == SolutionRow.number))
        .where(SolutionRow.campaign_id == campaign, SolutionRow.number == NUMBER, JobRow.kind == "episode")
    )
    with engines.reader.connect() as connection:
        row = connection.execute(query).one()
    return row.verdict, row.robustness, json.loads(row.result)


@pytest.mark.parametrize("thorough", [False, True])
def test_sound_results_are_fine(database_url: str, engines: Engines, finished: str, thorough: bool) -> None:
    expected = [(State.FINE, f"verdicts of {SOLUTIONS} solutions verified")]
    assert results(database_url, engines, thorough=thorough) == expected


def test_an_altered_verdict_is_found(database_url: str, engines: Engines, finished: str) -> None:
    verdict, *_ = stored(engines, finished)
    other = "safe" if verdict == "unsafe" else "unsafe"
    alter(engines, finished, {"verdict": other})
    found = results(database_url, engines)
    assert {state for state, _ in found} == {State.WRONG}
    assert (State.WRONG, f"{finished}: solution 7: {other}, but its result says {verdict}") in found
    assert any("such rows" in words for _, words in found), "the campaign's own counts differ, too"


@pytest.mark.parametrize("verdict", ["failed", "pending"])
def test_a_withdrawn_verdict_is_found(
    database_url: str, engines: Engines, finished: str, verdict: str
) -> None:
    alter(engines, finished, {"verdict": verdict, "robustness": None})
    assert (
        State.WRONG,
        f"{finished}: {SOLUTIONS} solutions evaluated, but {SOLUTIONS - 1} such rows",
    ) in results(database_url, engines)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"robustness": 0.0625}, "robustness 0.0625"),
        ({"objectives": {"distance": 0.5}}, "its objectives differ"),
    ],
    ids=["robustness", "objectives"],
)
def test_an_altered_measure_is_found(
    database_url: str, engines: Engines, finished: str, values: dict[str, Any], words: str
) -> None:
    alter(engines, finished, values)
    ((state, found),) = results(database_url, engines)
    assert (state, f"solution 7: {words}" in found) == (State.WRONG, True)


@pytest.mark.parametrize("change", ["verdict", "objective", "none", "not JSON"])
def test_an_altered_result_is_found(database_url: str, engines: Engines, finished: str, change: str) -> None:
    result = stored(engines, finished)[2]
    if change == "verdict":
        result["verdicts"]["distance@1"]["robustness"] += 1e-9
    elif change == "objective":
        result["objectives"]["distance"] += 1e-9
    texts = {"none": None, "not JSON": json.dumps(result)[:-1]}
    alter(engines, finished, {"result": texts.get(change, json.dumps(result))}, JobRow)
    ((state, found),) = results(database_url, engines)
    assert (state, "solution 7: " in found) == (State.WRONG, True)


@pytest.mark.parametrize("values", [{"spec": "{}"}, {"spec_hash": "0" * 64}], ids=["spec", "hash"])
def test_a_specification_that_does_not_match_its_hash_is_found(
    database_url: str, engines: Engines, finished: str, values: dict[str, Any]
) -> None:
    alter(engines, finished, values, JobRow)
    ((state, found),) = results(database_url, engines)
    assert state is State.WRONG
    assert "solution 7: the specification of its job does not match its hash" in found


@pytest.mark.parametrize("running", [False, True])
def test_a_deleted_job_is_found(
    database_url: str, engines: Engines, small_problems: None, running: bool
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=40))
        if not running:
            FakeWorker(client).work(campaign)
    with engines.writer.begin() as connection:
        connection.execute(delete(JobRow).where(JobRow.campaign_id == campaign, JobRow.number == NUMBER))
    ((state, found),) = results(database_url, engines)
    assert (state, found) == (
        State.WRONG,
        f"{campaign}: the jobs of 1 solutions are missing, the first of them of solution 7",
    )


def fails_once(job: LeasedJob) -> Completed | JobFailed:
    return JobFailed(reason="invalid", message="x") if job.job == 5 else simulated(job.spec)


def jobs_words(database_url: str, engines: Engines) -> tuple[State, str]:
    """Return what the doctor says of jobs."""
    (found,) = (
        one
        for one in examine(Settings(database=database_url), engines, thorough=False)
        if one.check == "jobs"
    )
    return found.state, found.found


def test_a_job_is_worth_a_retry_until_the_search_has_gone_on_without_it(
    database_url: str, engines: Engines, small_problems: None
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=40))
        worker = FakeWorker(client, judge=fails_once)
        worker.report(worker.lease(max_jobs=8))
        state, words = jobs_words(database_url, engines)
        assert (state, words.endswith("not gone on without 1 of those in quarantine")) == (State.LOOK, True)
        worker.work(campaign, until=lambda now: now["generation"] >= 1)
        assert jobs_words(database_url, engines)[0] is State.FINE


@pytest.mark.long("runs a campaign")
def test_a_result_that_came_after_its_generation_was_told_is_history(
    database_url: str, engines: Engines, small_problems: None
) -> None:
    """Earlier versions accepted such retries."""
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=40))
        worker = FakeWorker(client, judge=fails_once)
        worker.work(campaign, until=lambda now: now["generation"] >= 1)
        with engines.writer.begin() as connection:
            assert job_store.requeue(connection, 5, more_attempts=3, more_losses=3)
        worker.judge = completes
        assert worker.work(campaign)["failed"] == 1
    words = "; 1 count as failed, since their jobs were retried too late"
    ((state, found),) = results(database_url, engines)
    assert (state, found.endswith(words)) == (State.FINE, True)
    with engines.writer.begin() as connection:
        connection.execute(update(SolutionRow).where(SolutionRow.failure.is_not(None)).values(failure=None))
    ((state, found),) = results(database_url, engines)
    assert (state, "failed, but its result says" in found) == (State.WRONG, True)


@pytest.mark.long("runs a campaign")
def test_a_job_that_is_retried_and_completed_during_the_step_counts(
    database_url: str, engines: Engines, small_problems: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_step = step_store.write_step
    retried: list[int] = []

    def retry_first(connection: Connection, step: Step) -> bool:
        """Retry and complete the failed job between the step's computation and its writing."""
        if not retried:
            store.retry_job(connection, 5)
            (job,) = lease(connection, "another", (SIMULATOR,), 1, TERMS)
            result = simulated(job.spec).model_dump_json()
            report(connection, [Outcome(job=job.job, token=job.token, result=result)], TERMS)
            retried.append(job.job)
        return write_step(connection, step)

    monkeypatch.setattr(step_store, "write_step", retry_first)
    with coordinator(database_url, sweep_s=0.1) as client:
        campaign = submit(client, ball(simulations=40))
        done = FakeWorker(client, judge=fails_once).work(campaign)
        undisturbed = undisturbed_digest(ball(simulations=40))
    assert retried == [5]
    assert (done["status"], done["failed"], done["digest"]) == ("finished", 0, undisturbed)
    assert results(database_url, engines) == [(State.FINE, f"verdicts of {SOLUTIONS} solutions verified")]


@pytest.mark.long("runs a campaign")
def test_the_newest_results_are_verified_unless_all_are_to_be(
    database_url: str, engines: Engines, finished: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "VERIFIED_RESULTS", 20)
    expected = "verdicts of 20 solutions verified, the newest; --thorough verifies all"
    assert results(database_url, engines) == [(State.FINE, expected)]
    assert (
        results(database_url, engines, thorough=True)[0][1] == f"verdicts of {SOLUTIONS} solutions verified"
    )
