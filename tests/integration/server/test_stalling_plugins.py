"""Plug-ins that hang, or raise errors: their own campaign pauses, and nobody else notices."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import httpx
import pytest
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    expect,
    progress,
    submit,
    undisturbed_digest,
)
from support.marks import mostly_long
from support.problems import Ball, BallParams

from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.random_search import RandomSearch, RandomSearchState
from brink.search.settings import setting
from brink.server import user_code
from brink.server.campaigns import result_check
from brink.server.problems.base import Vectors
from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
from brink.server.user_code import USER_CODE
from brink.sim import catalogue
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed


class Fault:
    """What happens in one method of the plug-ins.

    Attributes:
        place: The method.
        raises: What it raises; None if it hangs.
        released: Set when what hangs is to return.
        times_out: Whether the time limit of a call is over as soon as it hangs, so that no test waits for it, and
            none depends on how fast the machine is.
        hanging: The threads that hang.
    """

    def __init__(self) -> None:
        self.place = ""
        self.times_out = True
        self.hanging: set[threading.Thread] = set()
        self.released = threading.Event()
        self.raises: BaseException | None = None

    def at(self, place: str) -> None:
        """Hang, or raise an error, if this is the place."""
        if place == self.place:
            if self.raises is not None:
                raise self.raises
            self.hanging.add(threading.current_thread())
            self.released.wait()

    def wait(self, call: user_code._Call, limit_s: float) -> Any:
        """Replace `_Call.wait`."""
        while self.times_out and not call.answer.done():
            if USER_CODE._waiting[call] in self.hanging:
                raise TimeoutError
            time.sleep(0.002)  # between two looks
        return call.answer.result(limit_s)


FAULT = Fault()


@dataclass(frozen=True, slots=True, kw_only=True)
class StuckParams(BallParams):
    """Parameters of the ball, and whether this campaign's problem can hang."""

    sticks: bool = setting(False, help="Whether it hangs when it is armed.")


class StuckBall(Ball):
    """The ball, whose methods hang."""

    id: ClassVar[str] = "stuck-ball@1"
    params_type: ClassVar[type[Any]] = StuckParams

    def __init__(self, params: StuckParams) -> None:
        self.fault = FAULT if params.sticks else Fault()
        self.fault.at("construction")
        super().__init__(params)

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode at a point."""
        self.fault.at("episode")
        return super().episode(vectors, seed)

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict at a point."""
        self.fault.at("evaluation")
        return super().evaluation(outcome)

    def words(self, vectors: Vectors) -> str:
        """Describe a point."""
        self.fault.at("words")
        return "somewhere"


class StuckState(RandomSearchState):
    """The state of random search, whose properties hang."""

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """The oldest generation that was not told yet."""
        FAULT.at("pending")
        return self.ledger.pending


class StuckSearch(RandomSearch):
    """Random search, whose methods hang."""

    id = "stuck-random@1"

    def ask(self, state: RandomSearchState) -> tuple[RandomSearchState, tuple[Candidate, ...]]:
        """Return the state with one more generation in flight, and that generation."""
        FAULT.at("ask")
        return super().ask(state)

    def tell(self, state: RandomSearchState, evaluations: Mapping[int, Evaluation]) -> RandomSearchState:
        """Return the state after the pending generation was evaluated."""
        FAULT.at("tell")
        told = super().tell(state, evaluations)
        return StuckState(config=told.config, ledger=told.ledger)


@pytest.fixture
def fault(monkeypatch: pytest.MonkeyPatch, small_problems: None) -> Iterator[Fault]:
    """Have this process know the plug-ins, and release what hangs in the end."""
    monkeypatch.setitem(catalogue._registered[PROBLEMS], StuckBall.id, StuckBall)
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {StuckSearch.id: StuckSearch})
    monkeypatch.setattr(result_check, "CHECK_S", 0.2)
    FAULT.__init__()  # type: ignore[misc]
    monkeypatch.setattr(user_code._Call, "wait", lambda call, limit_s: FAULT.wait(call, limit_s))
    yield FAULT
    FAULT.place = ""
    FAULT.released.set()
    for one in USER_CODE.stalled():
        one.thread.join(60.0)


@pytest.fixture
def stuck_client(database_url: str, fault: Fault) -> Iterator[httpx.Client]:
    with coordinator(database_url) as client:
        yield client


def stuck(*, simulations: int = 40) -> dict[str, Any]:
    """Return the body of a campaign whose problem and algorithm can hang."""
    search = {"id": StuckSearch.id, "params": {"generation_size": 10, "in_flight": 1}}
    return ball(simulations=simulations) | {
        "problem": {"id": StuckBall.id, "params": {"sticks": True}},
        "algorithm": search,
    }


def is_paused(client: httpx.Client, campaign: str) -> Callable[[], bool]:
    """Return the condition that a campaign is paused."""
    return lambda: expect(client.get(f"/api/v1/campaigns/{campaign}"))["status"] == "paused"


@pytest.mark.parametrize(
    "place",
    mostly_long(
        ["evaluation", "ask", "tell", "episode", "pending"], ["evaluation", "tell"], "another method"
    ),
)
def test_a_step_that_hangs_pauses_its_own_campaign_and_no_other_notices(
    stuck_client: httpx.Client, fault: Fault, place: str
) -> None:
    campaign, other = submit(stuck_client, stuck()), submit(stuck_client, ball(simulations=40))
    worker = FakeWorker(stuck_client)
    fault.place = place
    jobs = worker.lease_all()
    assert set(worker.report(jobs)) == {"accepted"}
    done = worker.work(other)
    assert (done["status"], done["digest"]) == ("finished", undisturbed_digest(ball(simulations=40)))
    eventually(is_paused(stuck_client, campaign), "the campaign pauses")
    reason = expect(stuck_client.get(f"/api/v1/campaigns/{campaign}"))["status_reason"]
    assert f"{place} of stuck-" in reason
    assert "did not return within 60 s. Resume when this is fixed." in reason
    assert expect(stuck_client.get("/readyz")) is None


def test_a_campaign_whose_code_still_hangs_pauses_again_at_once_and_goes_on_when_it_returned(
    stuck_client: httpx.Client, fault: Fault
) -> None:
    campaign, worker = submit(stuck_client, stuck()), FakeWorker(stuck_client)
    fault.place = "tell"
    worker.report(worker.lease_all())
    eventually(is_paused(stuck_client, campaign), "the campaign pauses")
    expect(stuck_client.post(f"/api/v1/campaigns/{campaign}/resume"))
    eventually(is_paused(stuck_client, campaign), "the campaign pauses again")
    reason = progress(stuck_client, campaign)["status_reason"]
    assert "tell of stuck-random@1 has not returned from an earlier call" in reason
    fault.place = ""
    fault.released.set()
    eventually(lambda: not USER_CODE.stalled(campaign), "the call has ended")
    expect(stuck_client.post(f"/api/v1/campaigns/{campaign}/resume"))
    done = worker.work(campaign)
    assert (done["status"], done["evaluated"]) == ("finished", 40)


def test_after_a_restart_the_campaign_is_still_paused(database_url: str, fault: Fault) -> None:
    with coordinator(database_url) as client:
        campaign, worker = submit(client, stuck()), FakeWorker(client)
        fault.place = "evaluation"
        worker.report(worker.lease_all())
        eventually(is_paused(client, campaign), "the campaign pauses")
    with coordinator(database_url) as client:
        assert is_paused(client, campaign)()
        began = time.monotonic()
        expect(client.post(f"/api/v1/campaigns/{campaign}/cancel"))
        assert time.monotonic() - began < 30.0


def test_results_are_acknowledged_although_their_check_hangs(database_url: str, fault: Fault) -> None:
    fault.times_out = False
    with coordinator(database_url, plugin_timeout_s=3600.0) as client:
        campaign, other = submit(client, stuck()), submit(client, ball())
        worker = FakeWorker(client)
        jobs = worker.lease_all()
        assert {job.campaign for job in jobs} == {campaign, other}
        fault.place = "evaluation"
        assert worker.report(jobs) == ["accepted"] * len(jobs)
        assert worker.report(jobs) == ["duplicate"] * len(jobs)
        stored = {job["id"] for job in expect(client.get("/api/v1/jobs", params={"status": "done"}))["jobs"]}
        assert stored >= {job.job for job in jobs}
        for path in ("pause", "cancel"):  # while the step hangs
            assert expect(client.post(f"/api/v1/campaigns/{campaign}/{path}"))["id"] == campaign
        expect(client.delete(f"/api/v1/campaigns/{campaign}"), 204)


@pytest.mark.parametrize(("unchecked_s", "then"), [(3600.0, "accepted"), (0.0, "invalid")])
def test_results_are_checked_again_some_time_after_a_check_that_hung(
    stuck_client: httpx.Client, fault: Fault, monkeypatch: pytest.MonkeyPatch, unchecked_s: float, then: str
) -> None:
    monkeypatch.setattr(result_check, "UNCHECKED_S", unchecked_s)
    campaign = submit(stuck_client, stuck())
    worker = FakeWorker(stuck_client, judge=lambda job: Completed(verdicts={}))
    fault.place = "construction"
    assert worker.report(worker.lease(max_jobs=1)) == ["accepted"], "it is not checked"
    fault.place = ""
    fault.released.set()
    eventually(lambda: not USER_CODE.stalled(f"results of {campaign}"), "the call has ended")
    monkeypatch.setattr(result_check, "CHECK_S", 60.0)
    assert worker.report(worker.lease(max_jobs=1)) == [then]


def test_a_submission_whose_problem_hangs_is_refused_and_others_are_accepted(
    stuck_client: httpx.Client, fault: Fault
) -> None:
    fault.place = "construction"
    answers: list[httpx.Response] = []
    threads = [
        threading.Thread(target=lambda: answers.append(stuck_client.post("/api/v1/campaigns", json=stuck())))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    submit(
        stuck_client, {**ball(simulations=10), "problem": {"id": "mtq@1"}, "algorithm": {"id": "random@1"}}
    )
    submit(stuck_client, ball(simulations=40))
    for thread in threads:
        thread.join()
    for answer in answers:
        assert answer.status_code == 503
        assert int(answer.headers["retry-after"]) > 0
    told = [str(answer.json()["detail"]) for answer in answers]
    assert any("construction of stuck-ball@1 did not return within 60 s" in one for one in told)
    assert all("stuck-ball@1" in one for one in told)


@pytest.mark.parametrize("error", [RuntimeError("no licence"), SystemExit(3)])
def test_a_submission_whose_problem_raises_an_error_is_refused_with_it(
    stuck_client: httpx.Client, fault: Fault, error: BaseException
) -> None:
    fault.place, fault.raises = "construction", error
    (found,) = expect(stuck_client.post("/api/v1/campaigns", json=stuck()), 422)["errors"]
    assert found["pointer"] == "/problem/id"
    assert str(error) in found["message"]


def test_a_plug_in_that_ends_the_process_pauses_its_campaign(
    stuck_client: httpx.Client, fault: Fault
) -> None:
    campaign, worker = submit(stuck_client, stuck()), FakeWorker(stuck_client)
    fault.place, fault.raises = "tell", SystemExit(3)
    worker.report(worker.lease_all())
    eventually(is_paused(stuck_client, campaign), "the campaign pauses")
    assert "SystemExit: 3" in progress(stuck_client, campaign)["status_reason"]


def test_the_catalogue_leaves_out_a_problem_that_hangs(
    stuck_client: httpx.Client, fault: Fault, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hangs(self: StuckBall, params: StuckParams) -> None:
        fault.at("construction")

    fault.place = "construction"
    monkeypatch.setattr(StuckBall, "__init__", hangs)
    listed = {one["id"] for one in expect(stuck_client.get("/api/v1/problems"))}
    assert {"ball@1", "mtq@1"} <= listed
    assert StuckBall.id not in listed


def test_pages_about_a_campaign_whose_problem_hangs_say_so_and_its_progress_is_shown(
    stuck_client: httpx.Client, fault: Fault
) -> None:
    campaign, worker = submit(stuck_client, stuck()), FakeWorker(stuck_client)
    worker.work(campaign, until=lambda found: found["evaluated"] >= 10)
    fault.place = "words"
    answer = stuck_client.get(f"/api/v1/campaigns/{campaign}/solutions")
    assert answer.status_code == 503
    assert "words of stuck-ball@1 did not return within" in answer.json()["detail"]
    assert progress(stuck_client, campaign)["status"] == "running"


@pytest.mark.parametrize("place", ["tell", "evaluation"])
def test_a_coordinator_stops_while_code_hangs(
    database_url: str, fault: Fault, caplog: pytest.LogCaptureFixture, place: str
) -> None:
    fault.times_out = False
    with coordinator(database_url, plugin_timeout_s=3600.0) as client:
        worker = FakeWorker(client)
        submit(client, stuck())
        fault.place = place
        worker.report(worker.lease_all())
        eventually(lambda: bool(USER_CODE._waiting), "it hangs")
        began = time.monotonic()
    assert time.monotonic() - began < 60.0
    assert not [record for record in caplog.records if record.exc_info]


def test_reading_results_whose_evaluation_hangs_leaves_no_connection_with_an_old_snapshot(
    stuck_client: httpx.Client, fault: Fault
) -> None:
    campaign, worker = submit(stuck_client, stuck()), FakeWorker(stuck_client)
    jobs = worker.lease_all()
    worker.report(jobs[:-1])
    fault.place = "evaluation"
    assert progress(stuck_client, campaign)["status"] == "running"
    for seed in range(3):
        later = submit(stuck_client, ball(seed=seed))
        assert expect(stuck_client.get(f"/api/v1/campaigns/{later}"))["id"] == later
