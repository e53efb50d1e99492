"""Work in pieces: no transaction stores much, and whatever happens between two pieces, a campaign finds the same."""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from sqlalchemy import Connection, func, select
from support.api import (
    FakeWorker,
    ball,
    completes,
    coordinator,
    eventually,
    expect,
    progress,
    submit,
    undisturbed_digest,
)
from support.coordinators import Coordinators
from support.databases import few_on_postgres, on_sqlite, sqlite_then_postgres

from brink.server.campaigns import advance, plan, step_store, view_store
from brink.server.campaigns.follow_ups import store as follow_ups
from brink.server.campaigns.store import set_status
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow, SolutionRow
from brink.server.experiments import service as experiments
from brink.server.queue import job_store
from brink.server.states import CampaignStatus, SolutionVerdict
from brink.worker.wire import Completed, JobFailed, LeasedJob

pytestmark = pytest.mark.usefixtures("small_problems", "few_trees")
API = "/api/v1/campaigns"
PIECE = 7
BODIES = {
    "random": ball(simulations=100, algorithm={"id": "random@1", "params": {"generation_size": 30}}),
    "ga": ball(simulations=100),
    "thresholds": ball(
        simulations=80,
        algorithm={"id": "edge@2", "params": {"generation_size": 9, "in_flight": 3, "trials": 18}},
    ),
}
"""With several generations in flight, one, and several that depend on each other."""


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each transaction store a few solutions only."""
    for module in (plan, advance, step_store, experiments):
        monkeypatch.setattr(module, "PIECE", PIECE)


@pytest.fixture
def inserted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list of how many solutions each call stores, and how many results are written with it."""
    sizes: list[int] = []

    def noted(function: Callable[..., Any], size: Callable[..., int]) -> Callable[..., Any]:
        def noting(*args: Any) -> Any:
            sizes.append(size(*args))
            return function(*args)

        return noting

    for name, size in (
        ("insert_generations", lambda connection, campaign, asked: sum(map(len, asked.generations))),
        ("_update_results", lambda connection, campaign, results: len(results)),
    ):
        monkeypatch.setattr(step_store, name, noted(getattr(step_store, name), size))
    return sizes


def stored(two: Coordinators) -> int:
    count = select(func.count()).select_from(SolutionRow)
    return two.queue.run(lambda connection: int(connection.execute(count).scalar_one()))


@pytest.fixture
def two(engines: Engines, small_pieces: None) -> Iterator[Coordinators]:
    made = Coordinators(engines, BODIES["random"])
    yield made
    made.close()


@on_sqlite
def test_a_large_submission_is_stored_in_pieces(client: httpx.Client, inserted: list[int]) -> None:
    params = {"generation_size": 700, "in_flight": 3}
    campaign = submit(client, ball(simulations=1_600, algorithm={"id": "random@1", "params": params}))
    eventually(lambda: progress(client, campaign)["queued"] == 1_600, "all pieces are stored")
    assert sum(inserted) == 1_600
    assert max(inserted) <= step_store.PIECE == 500


@few_on_postgres("name", BODIES, ["random"], "another algorithm", later=True)
def test_a_campaign_in_pieces_finds_the_same(
    client: httpx.Client, small_pieces: None, inserted: list[int], name: str
) -> None:
    campaign = submit(client, BODIES[name])
    done = FakeWorker(client).work(campaign)
    assert done["digest"] == undisturbed_digest(BODIES[name])
    assert max(inserted) <= PIECE


@pytest.mark.parametrize("pieces", [0, 1, 13])
def test_a_coordinator_that_is_killed_between_pieces_is_continued(two: Coordinators, pieces: int) -> None:
    for _ in range(pieces):
        two.steppers[0].advance("c0ffee")
    assert stored(two) == min(100, PIECE * (1 + pieces))
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()  # also of generations that are stored in part
        two.steppers[0] = two.stepper(0)  # and it is killed again after each piece, and after each step
        assert two.steppers[0].advance("c0ffee"), "it goes on"
    assert two.digest() == undisturbed_digest(BODIES["random"])


@on_sqlite
def test_a_coordinator_that_stops_between_pieces_reports_no_error(
    database_url: str, small_pieces: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    write_piece = step_store.write_piece

    def slowly(*args: Any, **settings: Any) -> int | None:
        time.sleep(0.02)  # so that pieces are left
        return write_piece(*args, **settings)

    monkeypatch.setattr(step_store, "write_piece", slowly)
    body = {
        "name": "x",
        "problem": {"id": "mtq@1"},
        "budget": {"simulations": 700},
        "algorithm": {"id": "random@1", "params": {"generation_size": 700}},
    }
    with coordinator(database_url) as client:
        submit(client, body)
    assert not [one.getMessage() for one in caplog.records if one.levelno >= logging.WARNING]


@on_sqlite
def test_nothing_is_told_before_everything_in_flight_is_stored(two: Coordinators) -> None:
    while stored(two) < 100:
        two.simulate()
        assert two.campaign.generation == 0, "its first generation was complete long ago"
        assert two.steppers[0].advance("c0ffee")
    two.simulate()
    assert two.steppers[0].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.FINISHED
    assert two.digest() == undisturbed_digest(BODIES["random"])


def test_two_coordinators_store_each_solution_once(two: Coordinators) -> None:
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()
        begin = threading.Barrier(2)

        def advance_one(place: int, begin: threading.Barrier = begin) -> None:
            begin.wait(30)
            two.steppers[place].advance("c0ffee")

        threads = [threading.Thread(target=advance_one, args=(place,)) for place in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
    assert stored(two) == 100
    assert two.digest() == undisturbed_digest(BODIES["random"])


@on_sqlite
@pytest.mark.parametrize("status", [CampaignStatus.PAUSED, CampaignStatus.CANCELLED])
def test_nothing_more_is_stored_of_a_campaign_that_was_stopped(
    two: Coordinators, status: CampaignStatus
) -> None:
    two.steppers[0].advance("c0ffee")
    two.queue.run(lambda connection: set_status(connection, "c0ffee", status, ""))
    assert not two.steppers[0].advance("c0ffee")
    assert stored(two) == 2 * PIECE
    if status is CampaignStatus.CANCELLED:
        return
    two.queue.run(lambda connection: set_status(connection, "c0ffee", CampaignStatus.RUNNING, ""))
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()
        two.steppers[0].advance("c0ffee")
    assert two.digest() == undisturbed_digest(BODIES["random"])


@on_sqlite
def test_results_of_a_large_generation_are_written_before_its_step_but_for_failures(
    client: httpx.Client, engines: Engines, small_pieces: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = ball(
        simulations=60,
        execution={"max_failed_share": 1.0, "max_attempts": 1},
        algorithm={"id": "random@1", "params": {"generation_size": 60}},
    )
    campaign, seen = submit(client, body), Counter[str]()
    write_step = step_store.write_step

    def looking(connection: Connection, step: step_store.Step) -> bool:
        seen.update(connection.execute(select(SolutionRow.verdict)).scalars())
        return write_step(connection, step)

    monkeypatch.setattr(step_store, "write_step", looking)
    done = FakeWorker(client, judge=fails_in_the_east).work(campaign)
    assert done["status"] == "finished"
    assert 0 < done["failed"] < 60 - PIECE
    pending = seen.pop(SolutionVerdict.PENDING)
    assert pending == max(PIECE, done["failed"]), (
        "those that failed, whose jobs may be retried, are among them"
    )
    assert SolutionVerdict.FAILED not in seen


def fails_in_the_east(job: LeasedJob) -> Completed | JobFailed:
    east = job.spec["scenario"]["x"] > 1.0
    return JobFailed(reason="invalid", message="boom") if east else completes(job)


@sqlite_then_postgres
def test_what_was_written_before_a_step_that_was_never_taken_is_not_known_to_other_campaigns(
    client: httpx.Client, small_pieces: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = {"generation_size": 30, "in_flight": 1}
    campaign = submit(client, ball(simulations=60, algorithm={"id": "random@1", "params": params}))
    write_step = step_store.write_step

    def cancelled(connection: Connection, step: step_store.Step) -> bool:
        if step.generation == 1:
            set_status(connection, campaign, CampaignStatus.CANCELLED, "")
        return write_step(connection, step)

    monkeypatch.setattr(step_store, "write_step", cancelled)
    done = FakeWorker(client).work(campaign)
    assert (done["status"], done["evaluated"]) == ("cancelled", 30)
    monkeypatch.undo()
    warm = submit(
        client, {**ball(simulations=60), "algorithm": {"id": "edge@1"}, "start_from": {"campaign": campaign}}
    )
    known = expect(client.get(f"{API}/{warm}/known"))["solutions"]
    assert max(one["number"] for one in known) < 30


@sqlite_then_postgres
def test_results_that_were_written_before_a_step_that_was_never_taken_are_read_by_nobody(
    client: httpx.Client, engines: Engines
) -> None:
    campaign = submit(client, ball(simulations=20, algorithm={"id": "random@1"}))
    wrote = [
        step_store.SolutionResult(number=number, verdict=verdict, robustness=robustness)
        for number, (verdict, robustness) in enumerate(
            [
                (SolutionVerdict.SAFE, 1.0),
                (SolutionVerdict.UNSAFE, -1.0),
                (SolutionVerdict.MEASURED, None),
                (SolutionVerdict.FAILED, None),
            ]
        )
    ]
    with engines.writer.begin() as connection:
        assert step_store.write_results(connection, campaign, 0, wrote)
    expect(client.post(f"{API}/{campaign}/cancel"))
    with engines.reader.connect() as connection:
        assert job_store.unsafe_outcomes(connection, campaign) == []
        assert view_store.read_measured(connection, campaign) == []
        assert follow_ups._verdicts(connection, campaign) == {}
    assert expect(client.get(f"{API}/{campaign}/solutions", params={"unsafe": True}))["solutions"] == []


@on_sqlite
def test_a_campaign_with_too_much_in_flight_is_refused_with_both_numbers(client: httpx.Client) -> None:
    params = {"generation_size": 10_000, "in_flight": 20}
    body = ball(simulations=10_000_000, algorithm={"id": "random@1", "params": params})
    error = expect(client.post(API, json=body), 422)
    [refused] = error["errors"]
    assert refused["pointer"] == "/algorithm/params/in_flight"
    assert "at most 20,000 candidates in flight" in refused["message"]
    assert "generation_size 10,000 x in_flight 20 = 200,000" in refused["message"]
    assert "in_flight may be at most 2" in refused["message"]
    params = {"population_size": 500, "archive_size": 100}
    body = ball(simulations=10_000_000, algorithm={"id": "mlcshe@1", "params": params})
    [refused] = expect(client.post(API, json=body), 422)["errors"]
    assert refused["pointer"] == "/algorithm/params/population_size"
    assert "got up to 100,000 in one generation" in refused["message"]


@on_sqlite
def test_an_experiment_is_stored_in_pieces(
    client: httpx.Client, engines: Engines, small_pieces: None, inserted: list[int]
) -> None:
    methods = [
        {"name": "GA", "id": "ga@1", "params": {"population_size": 10}},
        {"name": "RS", "id": "random@1"},
    ]
    body = {
        "name": "many",
        "problems": [{"id": "ball@1"}],
        "algorithms": methods,
        "seeds": {"first": 1, "count": 3},
        "budget": {"simulations": 20},
    }
    made = expect(client.post("/api/v1/experiments", json=body), 201)
    campaigns = [one["campaign"] for one in made["members"]]
    assert len(campaigns) == 6

    def queued(connection: Connection) -> int:
        return int(connection.execute(select(func.count()).select_from(JobRow)).scalar_one())

    def is_stored() -> bool:
        with engines.reader.connect() as connection:
            return queued(connection) == 3 * (10 + 20)

    eventually(is_stored, "each campaign is started by its first step")
    worker = FakeWorker(client)
    for one in campaigns:
        assert worker.work(one)["status"] == "finished"
    assert max(inserted) <= PIECE
