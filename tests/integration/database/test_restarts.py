"""Restarts and races: whatever happens in between, a campaign finds the same, bit for bit."""

import random
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import Connection, func, select, text, update
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    finish,
    progress,
    reached,
    submit,
    undisturbed_digest,
)
from support.coordinators import Coordinators
from support.databases import few_on_postgres, on_postgres, on_sqlite
from support.llm_endpoint import serving
from support.traffic import driven, seeded

from brink.server.campaigns import advance, others, step_store, store
from brink.server.campaigns.advance import Stepper
from brink.server.campaigns.others import PATIENCE_S, OtherCoordinators
from brink.server.db.engine import Engines
from brink.server.db.models import CheckpointRow, GenerationRow, SolutionRow
from brink.server.errors import Damaged, Unavailable
from brink.server.llm.calls import claim
from brink.server.queue import job_store
from brink.server.queue.report_store import Outcome
from brink.server.queue.wakeups import count_listening
from brink.server.states import CampaignStatus
from brink.sim import catalogue
from brink.worker.wire import LeasedJob

pytestmark = pytest.mark.usefixtures("small_problems", "few_trees")

CAMPAIGNS = {
    "mlcshe": ball(
        simulations=100, algorithm={"id": "mlcshe@1", "params": {"population_size": 5, "archive_size": 2}}
    ),
    "random": ball(simulations=100, algorithm={"id": "random@1", "params": {"generation_size": 30}}),
    "edge": ball(
        simulations=80,
        algorithm={
            "id": "edge@1",
            "params": {"generation_size": 7, "in_flight": 4, "d_th": 0.05, "explore": 0.2},
        },
    ),
    "thresholds": ball(
        simulations=80,
        algorithm={
            "id": "edge@2",
            "params": {"generation_size": 7, "in_flight": 4, "explore": 0.3, "trials": 18},
        },
    ),
}
"""Campaigns whose algorithms can start from known results."""
COLD = {
    **CAMPAIGNS,
    "straddle": ball(
        simulations=80,
        algorithm={"id": "straddle@1", "params": {"initial": 14, "generation_size": 7, "in_flight": 3}},
    ),
}
"""A campaign of each kind of state; contract tests restore the state of every algorithm after each generation."""
IN_FLIGHT = ("random", "thresholds", "straddle")
"""Campaigns of `COLD` with several generations in flight."""


@few_on_postgres("name", COLD, ["mlcshe", "thresholds"], "runs a campaign twice")
def test_a_coordinator_that_is_started_again_finds_the_same(database_url: str, name: str) -> None:
    campaign, held = "", list[LeasedJob]()
    for wanted in (10, 27, 55, 1000):
        with coordinator(database_url) as client:
            worker = FakeWorker(client)
            campaign = campaign or submit(client, COLD[name])
            assert set(worker.report(held)) <= {"accepted"}
            stands = worker.work(campaign, until=reached(wanted))
            held = worker.lease(max_jobs=3)
    assert stands["status"] == "finished"
    assert stands["digest"] == undisturbed_digest(COLD[name])


def test_leases_outlive_their_coordinator(database_url: str) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        jobs = FakeWorker(client).lease()
    with coordinator(database_url) as client:
        worker = FakeWorker(client)
        assert set(worker.report(jobs)) == {"accepted"}
        assert set(worker.report(jobs)) == {"duplicate"}
        assert worker.work(campaign)["digest"] == undisturbed_digest(ball())


@pytest.fixture
def two(engines: Engines) -> Iterator[Coordinators]:
    made = Coordinators(engines, ball())
    yield made
    made.close()


def test_two_coordinators_write_each_step_once(two: Coordinators) -> None:
    moved: list[bool] = []
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()
        begin = threading.Barrier(2)

        def step(stepper: Stepper, begin: threading.Barrier = begin) -> None:
            begin.wait(30)
            moved.append(stepper.advance("c0ffee"))

        threads = [threading.Thread(target=step, args=(stepper,)) for stepper in two.steppers]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
    assert two.campaign.status is CampaignStatus.FINISHED
    generations = two.queue.run(
        lambda c: list(c.execute(select(GenerationRow.number).order_by(GenerationRow.number)).scalars())
    )
    assert generations == list(range(two.campaign.generation))
    assert two.digest() == undisturbed_digest(ball())


@on_sqlite
def test_coordinators_that_take_turns_find_the_same(two: Coordinators) -> None:
    turn = 0
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()
        turn += 1
        two.steppers[turn % 2].advance("c0ffee")
    assert two.digest() == undisturbed_digest(ball())


@pytest.fixture
def overlapping(engines: Engines) -> Iterator[Coordinators]:
    """Two coordinators of a campaign with four generations in flight, of 30, 30, 30 and 10 candidates."""
    made = Coordinators(engines, CAMPAIGNS["random"])
    yield made
    made.close()


@on_sqlite
def test_generations_in_flight_are_told_in_the_order_of_asking(overlapping: Coordinators) -> None:
    jobs: list[LeasedJob] = []
    while leased := overlapping.lease():
        jobs += leased
    numbers = [overlapping.queue.job(job.job).number for job in jobs]
    assert numbers == list(range(100)), "all are queued at once, and older generations are simulated first"
    stepper = overlapping.steppers[0]
    overlapping.report(jobs[1:])
    assert not stepper.advance("c0ffee"), "one simulation of the first generation is still open"
    assert overlapping.campaign.evaluated == 0
    overlapping.report(jobs[:1])
    assert stepper.advance("c0ffee")
    assert (overlapping.campaign.generation, overlapping.campaign.status) == (4, CampaignStatus.FINISHED)
    assert overlapping.digest() == undisturbed_digest(CAMPAIGNS["random"])


@few_on_postgres("name", IN_FLIGHT, ["random", "thresholds"], "other algorithms", later=True)
def test_coordinators_that_take_turns_with_generations_in_flight_find_the_same(
    engines: Engines, name: str
) -> None:
    overlapping = Coordinators(engines, COLD[name])
    rng, turn = random.Random(0), 0
    while overlapping.campaign.status is CampaignStatus.RUNNING:
        jobs = [*overlapping.lease(), *overlapping.lease()]
        rng.shuffle(jobs)
        for begin in range(0, len(jobs), 7):
            overlapping.report(jobs[begin : begin + 7])
            turn += 1
            overlapping.steppers[turn % 2].advance("c0ffee")
    overlapping.close()
    assert overlapping.digest() == undisturbed_digest(COLD[name])


class Clock:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def stepper_beside(two: Coordinators, clock: Clock, *, others_known: bool = True) -> Stepper:
    """Return a stepper of a coordinator that knows, or does not know, of another one."""
    beside = OtherCoordinators(two.engines, two.writers[1], lambda: others_known, clock)
    return Stepper(two.engines, two.writers[1], max_stored_distances=1000, seeds=two.seeds[1], others=beside)


@pytest.fixture
def steps_worth_leaving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave steps however short they are, on SQLite as well."""
    monkeypatch.setattr(others, "WORTH_LEAVING_S", 0.0)


@on_sqlite
@pytest.mark.usefixtures("steps_worth_leaving")
def test_a_due_step_is_left_for_a_while_to_the_coordinator_that_has_the_search(two: Coordinators) -> None:
    clock, first = Clock(), two.steppers[0]
    second = stepper_beside(two, clock)
    two.simulate()
    assert not second.advance("c0ffee"), "the first has the search in memory"
    assert first.advance("c0ffee")
    two.simulate()
    clock.now_s += PATIENCE_S
    assert not second.advance("c0ffee"), "this step has only just become due"
    clock.now_s += PATIENCE_S
    assert second.advance("c0ffee"), "the first does not take it"
    two.simulate()
    assert second.advance("c0ffee"), "now the second has the search"
    while two.campaign.status is CampaignStatus.RUNNING:
        two.simulate()
        second.advance("c0ffee")
    assert two.digest() == undisturbed_digest(ball())


@on_sqlite
@pytest.mark.usefixtures("steps_worth_leaving")
def test_a_step_is_left_for_half_a_minute_at_most(two: Coordinators) -> None:
    clock = Clock()
    two.simulate()
    two.steppers[0].advance("c0ffee")
    two.queue.run(lambda connection: connection.execute(update(GenerationRow).values(step_s=100.0)))
    two.simulate()
    second = stepper_beside(two, clock)
    assert not second.advance("c0ffee")
    clock.now_s += 29.0
    assert not second.advance("c0ffee")
    clock.now_s += 1.0
    assert second.advance("c0ffee")


@on_sqlite
@pytest.mark.usefixtures("steps_worth_leaving")
def test_a_coordinator_that_knows_of_no_other_takes_all_steps_at_once(two: Coordinators) -> None:
    two.simulate()
    assert stepper_beside(two, Clock(), others_known=False).advance("c0ffee")


@on_sqlite
def test_a_short_step_is_not_left_to_others_that_cannot_be_told(two: Coordinators) -> None:
    two.simulate()
    assert stepper_beside(two, Clock()).advance("c0ffee")


@on_sqlite
@pytest.mark.usefixtures("steps_worth_leaving")
def test_a_coordinator_that_takes_over_takes_the_next_step(two: Coordinators) -> None:
    second = stepper_beside(two, Clock())
    two.simulate()
    second.take_over("c0ffee")
    assert second.advance("c0ffee")


@on_sqlite
@pytest.mark.usefixtures("steps_worth_leaving")
def test_a_step_that_was_taken_over_but_never_came_is_forgotten_with_its_campaign(two: Coordinators) -> None:
    second = stepper_beside(two, Clock())
    second.take_over("c0ffee")
    two.queue.set_status("c0ffee", CampaignStatus.PAUSED)
    assert not second.advance("c0ffee")
    two.queue.set_status("c0ffee", CampaignStatus.RUNNING)
    two.simulate()
    assert not second.advance("c0ffee"), "it is left to the first one"


@on_postgres
def test_a_step_that_is_left_is_taken_at_once_by_the_coordinator_that_has_the_search(
    database_url: str, engines: Engines
) -> None:
    """Were it not told, it would find the step when it sweeps next, after a minute."""

    def listening() -> int:
        with engines.reader.connect() as connection:
            return count_listening(connection)

    assert listening() == 0
    with coordinator(database_url, sweep_s=60.0) as first:
        with coordinator(database_url, sweep_s=60.0) as second:
            eventually(lambda: listening() == 2, "both listen")
            campaign = submit(first, ball())
            assert FakeWorker(second).work(campaign)["status"] == "finished"
        eventually(lambda: listening() == 1, "the second one has gone")


def test_a_stale_step_is_not_written(two: Coordinators) -> None:
    two.simulate()
    first, second = two.steppers
    assert first.advance("c0ffee")
    assert not second.advance("c0ffee")
    assert not first.advance("c0ffee")
    assert two.campaign.generation == 1


def test_a_campaign_that_advances_is_left_to_the_other(
    two: Coordinators, monkeypatch: pytest.MonkeyPatch
) -> None:
    two.simulate()
    first, second = two.steppers
    assert first.advance("c0ffee")
    two.simulate()
    look = job_store.generation_outcomes

    def overtaken(*arguments: Any) -> Any:
        monkeypatch.setattr(job_store, "generation_outcomes", look)
        jobs = look(*arguments)
        assert first.advance("c0ffee")
        return jobs

    monkeypatch.setattr(job_store, "generation_outcomes", overtaken)
    assert not second.advance("c0ffee")
    assert (two.campaign.generation, two.campaign.status) == (2, CampaignStatus.RUNNING)


@pytest.fixture
def waiting(engines: Engines) -> Iterator[Coordinators]:
    """Two coordinators of a campaign that waits for seeds; the endpoint is none that answers."""
    with serving() as endpoint:
        made = Coordinators(engines, seeded(endpoint, differential="always"), driven)
        yield made
        made.close()


@on_sqlite
def test_seeds_that_another_received_are_shared(
    waiting: Coordinators, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = waiting.steppers
    look = job_store.generation_outcomes

    def overtaken(*arguments: Any) -> Any:
        monkeypatch.setattr(job_store, "generation_outcomes", look)
        jobs = look(*arguments)
        assert jobs == []
        assert first.advance("c0ffee")
        return jobs

    monkeypatch.setattr(job_store, "generation_outcomes", overtaken)
    assert not second.advance("c0ffee"), "it must not tell a generation without its jobs"
    assert waiting.campaign.status is CampaignStatus.RUNNING
    waiting.simulate()
    assert second.advance("c0ffee")
    assert waiting.campaign.generation == 1


@on_sqlite
def test_whoever_still_waits_for_seeds_that_another_had_goes_on_with_those(waiting: Coordinators) -> None:
    first, second = waiting.steppers
    waiting.seeds[1].says = None
    assert not second.advance("c0ffee"), "it waits"
    assert first.advance("c0ffee")
    waiting.simulate()
    assert second.advance("c0ffee")
    assert waiting.campaign.generation == 1


@on_postgres
def test_one_of_two_may_ask_for_seeds(engines: Engines, waiting: Coordinators) -> None:
    """The other waits until the first has decided, although there is no claim yet that could be locked."""
    claimed: list[bool] = []

    def ask() -> None:
        with engines.writer.begin() as connection:
            claimed.append(claim(connection, "c0ffee", "second", 60.0))

    def waits_for_a_lock() -> bool:
        with engines.reader.connect() as connection:
            waiting = text(
                "SELECT count(*) FROM pg_stat_activity "
                "WHERE datname = current_database() AND wait_event_type = 'Lock'"
            )
            return bool(connection.execute(waiting).scalar_one())

    second = threading.Thread(target=ask)
    with engines.writer.begin() as connection:
        assert claim(connection, "c0ffee", "first", 60.0)
        second.start()
        eventually(waits_for_a_lock, "the second one waits")
    second.join(30)
    assert claimed == [False]
    with engines.writer.begin() as connection:
        assert claim(connection, "c0ffee", "first", 60.0), "who has it may keep it"
        assert not claim(connection, "nobody", "first", 60.0), "there is no such campaign"


@on_sqlite
def test_a_step_on_a_paused_campaign_is_not_written(
    two: Coordinators, monkeypatch: pytest.MonkeyPatch
) -> None:
    two.simulate()
    write = step_store.write_step

    def pause_first(connection: Connection, step: Any) -> bool:
        store.set_status(connection, "c0ffee", CampaignStatus.PAUSED, "")
        return write(connection, step)

    monkeypatch.setattr(step_store, "write_step", pause_first)
    assert not two.steppers[0].advance("c0ffee")
    assert (two.campaign.generation, two.campaign.status) == (0, CampaignStatus.PAUSED)
    count = two.queue.run(lambda c: c.execute(select(func.count()).select_from(GenerationRow)).scalar_one())
    assert count == 0


@on_sqlite
def test_losing_the_database_ends_no_campaign(two: Coordinators, monkeypatch: pytest.MonkeyPatch) -> None:
    two.simulate()

    def away(connection: Connection, step: Any) -> bool:
        raise OperationalError("COMMIT", {}, Exception("server closed the connection"))

    with monkeypatch.context() as patched:
        patched.setattr(step_store, "write_step", away)
        with pytest.raises(Unavailable):
            two.steppers[0].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.RUNNING
    assert two.steppers[0].advance("c0ffee")
    assert two.campaign.generation == 1


@on_postgres
def test_a_step_whose_connection_is_lost_ends_no_campaign(
    two: Coordinators, monkeypatch: pytest.MonkeyPatch
) -> None:
    two.simulate()
    write = step_store.write_step

    def cut(connection: Connection, step: Any) -> bool:
        pid = connection.execute(text("SELECT pg_backend_pid()")).scalar_one()
        with two.engines.reader.connect() as other:
            other.execute(text("SELECT pg_terminate_backend(:pid, 5000)"), {"pid": pid})
        return write(connection, step)

    with monkeypatch.context() as patched:
        patched.setattr(step_store, "write_step", cut)
        with pytest.raises(Unavailable):
            two.steppers[0].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.RUNNING
    assert two.steppers[0].advance("c0ffee")


@on_sqlite
@pytest.mark.parametrize(
    "passing",
    [
        PoolTimeout("QueuePool limit reached"),
        DBAPIError("SELECT", {}, Exception("idle in transaction"), connection_invalidated=True),
    ],
)
def test_a_busy_database_ends_nothing(
    two: Coordinators, monkeypatch: pytest.MonkeyPatch, passing: Exception
) -> None:
    two.simulate()

    def busy(*_: Any) -> None:
        raise passing

    with monkeypatch.context() as patched:
        patched.setattr(step_store, "read_archive", busy)
        with pytest.raises(type(passing)):
            two.steppers[1].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.RUNNING
    assert two.steppers[1].advance("c0ffee")


@on_sqlite
def test_internal_error_pauses_and_loses_nothing(two: Coordinators, monkeypatch: pytest.MonkeyPatch) -> None:
    two.simulate()

    def faulty(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("ours")

    with monkeypatch.context() as patched:
        patched.setattr(advance, "distinct_boundary", faulty)
        with pytest.raises(ZeroDivisionError):
            two.steppers[0].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.PAUSED
    assert "ZeroDivisionError: ours. Resume when this is fixed" in two.campaign.status_reason
    two.queue.set_status("c0ffee", CampaignStatus.RUNNING)
    assert two.steppers[0].advance("c0ffee")
    assert two.campaign.generation == 1


@on_sqlite
def test_a_damaged_checkpoint_is_not_believed(two: Coordinators) -> None:
    two.simulate()
    assert two.steppers[0].advance("c0ffee")
    two.queue.run(lambda c: c.execute(update(CheckpointRow).values(neighbours=b"\0" * 160)))
    two.simulate()
    with pytest.raises(Damaged, match="damaged"):
        two.steppers[1].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.FAILED
    assert "checkpoint of generation 1 is damaged" in two.campaign.status_reason


@on_sqlite
def test_a_campaign_waits_for_its_missing_problem(two: Coordinators, monkeypatch: pytest.MonkeyPatch) -> None:
    two.simulate()
    with monkeypatch.context() as patched:
        patched.setattr(catalogue, "_registered", {})
        assert not two.steppers[1].advance("c0ffee")
    assert two.campaign.status is CampaignStatus.PAUSED
    assert "ball@1" in two.campaign.status_reason
    two.queue.set_status("c0ffee", CampaignStatus.RUNNING)
    assert two.steppers[1].advance("c0ffee")


@on_sqlite
def test_a_job_retried_during_the_step_is_awaited(two: Coordinators, monkeypatch: pytest.MonkeyPatch) -> None:
    first, *others = two.queue.lease(max_jobs=1)
    two.queue.report(Outcome(job=first.job, token=first.token, result=None, error="invalid: no", final=True))
    assert not others
    two.simulate()
    stepper = two.steppers[0]
    write_up = stepper._make_step

    def retried_meanwhile(*args: Any) -> Any:
        step = write_up(*args)
        two.queue.run(lambda connection: store.retry_job(connection, first.job))
        return step

    with monkeypatch.context() as patched:
        patched.setattr(stepper, "_make_step", retried_meanwhile)
        assert not stepper.advance("c0ffee")
    two.simulate()
    assert stepper.advance("c0ffee")
    assert (two.campaign.failed, two.campaign.evaluated) == (0, 20)


@on_sqlite
def test_a_campaign_goes_on_only_with_the_candidates_that_it_asked_for(two: Coordinators) -> None:
    two.simulate()
    assert two.steppers[0].advance("c0ffee")
    two.simulate()
    with two.engines.writer.begin() as connection:
        pending = SolutionRow.generation == 1
        vector = connection.execute(select(SolutionRow.vector).where(pending).limit(1)).scalar_one()
        connection.execute(update(SolutionRow).where(pending).values(vector=bytes(len(vector))))
    assert not two.steppers[1].advance("c0ffee")  # it has to restore the state, and asks again
    assert two.campaign.status is CampaignStatus.PAUSED
    assert "has changed since" in two.campaign.status_reason


@on_sqlite
def test_the_sweeper_takes_a_step_that_nobody_took(database_url: str, two: Coordinators) -> None:
    two.simulate()  # as if the coordinator had died between the last result and the step
    with coordinator(database_url) as client:
        eventually(lambda: progress(client, "c0ffee")["generation"] == 1, "the step")
        FakeWorker(client).work("c0ffee")
        assert progress(client, "c0ffee")["digest"] == undisturbed_digest(ball())


@few_on_postgres("name", ["random", "thresholds"], ["random"], "runs a campaign four times", later=True)
def test_a_warm_campaign_that_is_started_again_finds_the_same(database_url: str, name: str) -> None:
    """Also before its first generation was told, when what it started from is all that there is to restore."""
    digests = set()
    with coordinator(database_url) as client:
        source = finish(client, ball(seed=7, algorithm={"id": "random@1"}))
        given = {"values": {"where.x": 0.25, "what.y": -1.5}}
        mixed = {"solutions": [given, {"values": {"where.x": 0.5, "what.y": 0.0}, "robustness": -0.5}]}
    for start in ({"campaign": source}, mixed):
        body = {**CAMPAIGNS[name], "start_from": start, "execution": {"cache": False}}
        for stops in ((1000,), (1, 27, 1000)):
            campaign, held = "", list[LeasedJob]()
            for wanted in stops:
                with coordinator(database_url) as client:
                    worker = FakeWorker(client)
                    campaign = campaign or submit(client, body)
                    assert set(worker.report(held)) <= {"accepted"}
                    stands = worker.work(campaign, until=reached(wanted))
                    held = worker.lease(max_jobs=3)
            assert stands["status"] == "finished"
            digests.add((str(start), stands["digest"]))
    assert len(digests) == 2
