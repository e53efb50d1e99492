"""`brink doctor` on databases in which results were altered: on SQLite and on Postgres."""

import json
from collections.abc import Mapping
from typing import Any

import pytest
from sqlalchemy import delete, select, update
from support.api import FakeWorker, ball, coordinator, submit
from support.databases import on_sqlite
from support.problems import simulated

from brink.server.db.engine import Engines
from brink.server.db.models import JobRow, SolutionRow
from brink.server.operations import doctor
from brink.server.operations.doctor import State, examine
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


def test_failed_solutions_are_no_damage(database_url: str, engines: Engines, small_problems: None) -> None:
    def fails_once(job: LeasedJob) -> Completed | JobFailed:
        return JobFailed(reason="invalid", message="x") if job.job == 5 else simulated(job.spec)

    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=40))
        assert FakeWorker(client, judge=fails_once).work(campaign)["failed"] == 1
    assert [state for state, _ in results(database_url, engines)] == [State.FINE]


@on_sqlite
def test_the_newest_results_are_verified_unless_all_are_to_be(
    database_url: str, engines: Engines, finished: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "VERIFIED_RESULTS", 20)
    expected = "verdicts of 20 solutions verified, the newest; --thorough verifies all"
    assert results(database_url, engines) == [(State.FINE, expected)]
    assert (
        results(database_url, engines, thorough=True)[0][1] == f"verdicts of {SOLUTIONS} solutions verified"
    )
