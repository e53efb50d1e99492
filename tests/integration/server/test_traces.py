"""Traces, replays and episodes: recorded by workers on request, kept, and drawn without blocking other requests."""

import asyncio
import base64
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

import httpx
import numpy as np
import pytest
from sqlalchemy import func, select, update
from support.api import (
    FakeWorker,
    ball,
    completes,
    coordinator,
    eventually,
    expect,
    finish,
    row_counts,
    submit,
)
from support.databases import Databases, module_sqlite_then_postgres, sqlite_then_postgres
from support.problems import small_problems
from support.traces import filmed, grey_jpeg, make_trace

import brink.server.campaigns.plan
from brink.api.client import Api
from brink.api.runs import CampaignRun
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.checks import PLUGIN_CHECKS_AT_ONCE, SLOW_AT_ONCE
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow, WorkerRow
from brink.server.queue import service
from brink.server.queue.wakeups import Wakeups
from brink.server.states import CampaignStatus, JobKind
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Ragged, Trace
from brink.worker.wire import Completed, JobFailed, LeasedJob

R = TypeVar("R")
UNTRACED = ball(simulations=20, execution={"keep_traces": 0})


def traces(document: bytes | None) -> Callable[[LeasedJob], Completed | JobFailed]:
    """Return a judge that adds this trace to the outcome of every job that requests one."""

    def judge(job: LeasedJob) -> Completed | JobFailed:
        outcome = completes(job)
        if not job.record or document is None:
            return outcome
        return outcome.model_copy(update={"trace": base64.b64encode(document).decode()})

    return judge


@sqlite_then_postgres
def test_trace_is_made_once_and_then_kept(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finish(client, UNTRACED, worker.judge)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    missing = expect(client.get(path, params={"wait_s": 0}), 404)
    assert (missing["title"], f"POST {path.removeprefix('/api/v1')} " in missing["detail"]) == (
        "Not recorded",
        True,
    )
    assert worker.lease() == [], "a safe request enqueues nothing"
    being_made = client.post(path)
    assert (being_made.status_code, being_made.headers["Location"]) == (202, path)
    assert being_made.headers["Retry-After"] == "2"
    assert client.post(path).status_code == 202  # requested only once
    assert client.get(path, params={"wait_s": 0}).status_code == 202
    (job,) = worker.lease()
    assert job.record
    assert worker.lease() == []
    assert worker.report([job]) == ["accepted"]
    kept = client.get(path, params={"wait_s": 0})
    assert (kept.status_code, kept.content) == (200, b"the trace")
    expect(client.post(path), 204)


@sqlite_then_postgres
def test_request_for_a_trace_waits_for_the_worker(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finish(client, UNTRACED, worker.judge)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.post(path).status_code == 202
    answers: list[httpx.Response] = []
    asking = threading.Thread(target=lambda: answers.append(client.get(path, params={"wait_s": 30})))
    asking.start()
    worker.report(worker.lease(wait_s=20))
    asking.join()
    assert (answers[0].status_code, answers[0].content) == (200, b"the trace")


@sqlite_then_postgres
def test_capable_worker_behind_another_is_woken(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "RECHECK_S", 600.0)
    monkeypatch.setattr(service, "SHARED_RECHECK_S", 600.0)
    worker = FakeWorker(client, id="who-can", judge=traces(b"the trace"))
    campaign = finish(client, UNTRACED, worker.judge)
    first = FakeWorker(client, id="who-cannot", capabilities=("another-simulator@1",))
    got: list[LeasedJob] = []
    waiting = [
        threading.Thread(target=lambda: first.lease(wait_s=6)),
        threading.Thread(target=lambda: got.extend(worker.lease(wait_s=20))),
    ]
    in_line: list[Wakeups] = []
    wait = Wakeups.wait

    async def noted(self: Wakeups, *given: Any, **named: Any) -> bool:
        in_line.append(self)
        return await wait(self, *given, **named)

    monkeypatch.setattr(Wakeups, "wait", noted)
    waiting[0].start()
    eventually(lambda: len(in_line) == 1, "the first waits")
    waiting[1].start()
    eventually(lambda: len(in_line) == 2, "the second waits")
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.post(path).status_code == 202
    waiting[1].join(10)
    assert [job.record for job in got] == [True]
    waiting[0].join()


@sqlite_then_postgres
def test_trace_no_worker_can_make_is_refused(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    FakeWorker(client, capabilities=("another-simulator@1",)).lease()
    before = row_counts(engines)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    answer = client.post(path)
    assert "no live worker can run faulty@1" in expect(answer, 503)["detail"]
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["Retry-After"] == "5"
    assert row_counts(engines) == before, "no job is enqueued"
    worker = FakeWorker(client, id="who-can", judge=traces(b"the trace"))
    worker.lease(max_jobs=1)
    assert client.post(path).status_code == 202


@sqlite_then_postgres
def test_trace_wait_ends_when_workers_leave(
    database_url: str, engines: Engines, small_problems: None
) -> None:
    with coordinator(database_url) as client:
        campaign = finish(client, UNTRACED)
        path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
        assert client.post(path).status_code == 202
        long_ago = datetime.now(UTC) - timedelta(hours=1)
        with engines.writer.begin() as connection:
            connection.execute(update(WorkerRow).values(last_seen_at=long_ago))
        expect(client.get(path, params={"wait_s": 20}), 503)


@sqlite_then_postgres
def test_worker_with_a_live_lease_can_make_a_trace(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    worker = FakeWorker(client)
    worker.lease(max_jobs=1)
    long_ago = datetime.now(UTC) - timedelta(hours=1)
    with engines.writer.begin() as connection:
        connection.execute(update(WorkerRow).values(last_seen_at=long_ago))
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.post(path).status_code == 202


@sqlite_then_postgres
def test_trace_job_is_leased_before_episodes(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finish(client, UNTRACED, worker.judge)
    submit(client, ball(seed=2, priority=100))
    client.post(f"/api/v1/campaigns/{campaign}/solutions/3/trace")
    assert worker.lease(max_jobs=1)[0].record


@sqlite_then_postgres
def test_failed_trace_reports_its_error_until_it_is_retried(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=lambda _: JobFailed(reason="invalid", message="no such road"))
    campaign = finish(client, UNTRACED)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.post(path).status_code == 202
    worker.report(worker.lease())
    document = expect(client.get(path, params={"wait_s": 5}), 409)
    assert "no such road" in document["detail"]
    (job,) = expect(client.get("/api/v1/jobs", params={"status": "quarantined"}))["jobs"]
    expect(client.post(f"/api/v1/jobs/{job['id']}/retry"), 204)
    worker.judge = traces(b"the trace")
    worker.report(worker.lease())
    assert client.get(path, params={"wait_s": 5}).content == b"the trace"


@sqlite_then_postgres
@pytest.mark.parametrize("garbage", ["no base64!", "AAA", "\u00fc"])
def test_trace_that_is_not_base64_is_rejected(client: httpx.Client, garbage: str) -> None:
    worker = FakeWorker(client)
    submit(client, ball())
    (job,) = worker.lease(max_jobs=1)
    outcome = {**completes(job).model_dump(), "trace": garbage}
    body = {"worker": worker.identity, "results": [{"job": job.job, "token": job.token, "outcome": outcome}]}
    (error,) = expect(client.post("/api/v1/jobs/results", json=body), 422)["errors"]
    assert error["pointer"] == "/results/0/outcome/trace"


@sqlite_then_postgres
def test_traces_of_the_best_boundary_solutions_are_kept(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"evidence"))
    campaign = submit(client, ball(execution={"keep_traces": 2}, simulations=120))
    done = worker.work(campaign)
    wanted = min(2, done["generations"][-1]["dbs"])
    assert wanted > 0
    eventually(lambda: not worker.report(worker.lease()), "all traces")
    boundary = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))
    for solution in boundary["solutions"][:wanted]:
        path = f"/api/v1/campaigns/{campaign}/solutions/{solution['number']}/trace"
        assert client.get(path, params={"wait_s": 0}).content == b"evidence"


@pytest.mark.long("runs campaigns")
def test_a_run_without_pictures_records_no_traces(listening_client: httpx.Client, engines: Engines) -> None:
    body = parse_body(ball(simulations=120))
    worker = FakeWorker(listening_client)

    async def asking(what: Callable[[CampaignRun, Api], Awaitable[R]], *, pictures: bool) -> R:
        url = str(listening_client.base_url)
        async with httpx.AsyncClient(base_url=url) as client:
            return await what(CampaignRun(body, pictures=pictures), Api(client, url))

    def latest(run: CampaignRun, api: Api) -> Awaitable[Progress | None]:
        return run.latest(api, [CampaignStatus.FINISHED])

    traced = {}
    for pictures in (True, False):
        campaign, _ = asyncio.run(asking(CampaignRun.submit, pictures=pictures))
        assert worker.work(campaign)["generations"][-1]["dbs"] > 0
        query = select(func.count()).where(JobRow.campaign_id == campaign, JobRow.kind == JobKind.TRACE)
        with engines.reader.connect() as connection:
            traced[pictures] = connection.execute(query).scalar_one()
        for also in (True, False):
            found = asyncio.run(asking(latest, pictures=also))
            assert found is not None
            assert found.id == campaign, "--resume continues it, with or without --no-pictures"
    assert traced[True] > 0
    assert traced[False] == 0


@pytest.mark.long("runs campaigns")
def test_requested_traces_do_not_keep_a_campaign_from_finishing(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = submit(client, ball(execution={"keep_traces": 12}, simulations=120))
    worker.work(campaign, until=lambda now: now["generation"] >= 1)
    for number in range(20):
        client.post(f"/api/v1/campaigns/{campaign}/solutions/{number}/trace")
    done = worker.work(campaign)
    assert (done["status"], done["status_reason"]) == ("finished", "")


@sqlite_then_postgres
def test_cancelled_campaign_still_makes_traces(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = submit(client, ball())
    FakeWorker(client, id="another").lease(max_jobs=1)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.post(path).status_code == 202
    expect(client.post(f"/api/v1/campaigns/{campaign}/cancel"))
    assert worker.report(worker.lease()) == ["accepted"]
    assert client.get(path, params={"wait_s": 0}).content == b"the trace"
    assert worker.lease() == []


@dataclass(slots=True)
class Ended:
    """A finished campaign of which each test has the trace of another solution kept."""

    client: httpx.Client
    campaign: str
    number: int = -1

    def kept(self, document: bytes | None) -> str:
        """Return the path of a solution whose kept trace is this document."""
        self.number += 1
        path = f"/api/v1/campaigns/{self.campaign}/solutions/{self.number}"
        worker = FakeWorker(self.client, judge=traces(document))
        assert self.client.post(f"{path}/trace").status_code == 202
        assert worker.report(worker.lease()) == ["accepted"]
        return path

    def episode(self, trace: Trace) -> dict[str, Any]:
        """Return the episode of a solution with this trace."""
        found: dict[str, Any] = expect(self.client.get(f"{self.kept(trace.to_bytes())}/episode"))
        return found


@pytest.fixture(scope="module")
def ended(module_databases: Databases) -> Iterator[Ended]:
    """A finished campaign with more solutions than there are tests of episodes."""
    with small_problems(), module_databases.database() as url, coordinator(url) as client:
        yield Ended(client, finish(client, ball(simulations=40, execution={"keep_traces": 0})))


def numbers(column: list[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in column])


@module_sqlite_then_postgres
def test_episode_has_the_trace_in_columns(ended: Ended) -> None:
    trace = make_trace()
    found = ended.episode(trace)
    samples = len(trace.time_s)
    assert found["time_s"] == pytest.approx(trace.time_s, abs=5e-4)
    for place, (name, within) in enumerate(
        {"x_m": 5e-4, "y_m": 5e-4, "yaw_rad": 5e-5, "speed_mps": 5e-4, "accel_mps2": 5e-4}.items()
    ):
        assert found["ego"][name] == pytest.approx(trace.ego[:, place], abs=within * 1.01)
    assert (found["ego"]["length_m"], found["ego"]["width_m"]) == trace.ego_size_m
    assert [actor["name"] for actor in found["actors"]] == [actor.name for actor in trace.actors]
    for actor, shown in zip(trace.actors, found["actors"], strict=True):
        np.testing.assert_allclose(numbers(shown["x_m"]), actor.motion[:, 0], atol=6e-4)
        assert (shown["kind"], len(shown["yaw_rad"])) == (actor.kind, samples)
    oncoming = next(actor for actor in found["actors"] if actor["name"] == "oncoming")
    assert oncoming["x_m"][0] is None, "absent at first"
    assert oncoming["x_m"][-1] is not None
    assert found["plan_mode"] == list(trace.plan_mode)
    assert found["lights"] == list(trace.lights)
    assert [surface["kind"] for surface in found["scene"]] == [surface.kind for surface in trace.scene]
    assert found["scene"][0]["points"] == trace.scene[0].points.tolist()
    assert found["robustness"].keys() == trace.robustness.keys()
    assert found["units"] == {"front-gap@1": "m", "progress@1": "s"}
    assert [event["kind"] for event in found["events"]] == ["nudge", "violation"]
    assert found["film"] is None
    decisive = int(np.flatnonzero(trace.robustness["front-gap@1"] < 0)[0])
    words = "violated the front gap at 17.5 s"
    assert found["story"] == {
        "requirement": "front-gap@1",
        "violated": True,
        "decisive": decisive,
        "words": words,
        "violations": [{"requirement": "front-gap@1", "sample": decisive, "time_s": 17.5, "words": words}],
    }
    assert "sunset" in found["words"]["scenario"]
    assert found["words"]["report"] == "injected"


@module_sqlite_then_postgres
def test_film_has_boxes_and_serves_its_pictures_one_by_one(ended: Ended) -> None:
    path = ended.kept(filmed(make_trace(samples=40)).to_bytes())
    film = expect(ended.client.get(f"{path}/episode"))["film"]
    assert (film["size_px"], film["samples"]) == ([320, 240], [0, 2, 4])
    assert film["judged"]["columns"]["ignored"] == [0] * 40
    assert film["found"]["columns"]["score"][:2] == [1, 0.975]
    assert film["found"]["columns"]["score"][-1] == 0.1, "detections with a lower score are left out"
    assert film["found"]["first"][-6:] == [35, 36, 37, 37, 37, 37]
    assert film["found"]["columns"]["counts"] == [1] * 37, "no threshold is recorded"
    assert (film["threshold"], film["least_score"]) == (0, 0.1)
    assert film["shown"] == [0, 0, 1, 1, *[2] * 36]
    assert film["regions"][film["person_region"]][0] == [130, 150]
    assert film["colours"].keys() == {"judged", "found", "region"}
    for index in range(3):
        picture = ended.client.get(f"{path}/pictures/{index}.jpg")
        assert (picture.status_code, picture.headers["content-type"]) == (200, "image/jpeg")
        assert picture.headers["x-content-type-options"] == "nosniff"
        assert picture.content == grey_jpeg(64 + 8 * index)
    assert "has 3 pictures" in expect(ended.client.get(f"{path}/pictures/3.jpg"), 404)["detail"]


@module_sqlite_then_postgres
def test_picture_that_is_no_jpeg_is_not_served(ended: Ended) -> None:
    trace = filmed(make_trace(samples=40))
    assert trace.film is not None
    page = replace(trace, film=replace(trace.film, pictures=(b"<html>", *trace.film.pictures[1:])))
    path = ended.kept(page.to_bytes())
    assert "not a JPEG" in expect(ended.client.get(f"{path}/pictures/0.jpg"), 404)["detail"]
    assert ended.client.get(f"{path}/pictures/1.jpg").status_code == 200


def _with_short_ego(trace: Trace) -> Trace:
    return replace(trace, ego=trace.ego[:-1])


def _without_samples(trace: Trace) -> Trace:
    return replace(trace, time_s=trace.time_s[:0])


def _in_reverse(trace: Trace) -> Trace:
    return replace(trace, time_s=trace.time_s[::-1])


def _with_rows_past_the_end(trace: Trace) -> Trace:
    first = trace.given_boxes.first.copy()
    first[-1] += 7
    return replace(trace, given_boxes=replace(trace.given_boxes, first=first))


def _with_other_columns(trace: Trace) -> Trace:
    seen = trace.seen_boxes
    return replace(trace, seen_boxes=Ragged(columns=("a", "b"), first=seen.first, rows=seen.rows[:, :2]))


def _with_lone_surrogate(trace: Trace) -> Trace:
    return replace(trace, plan_mode=("\ud800", *trace.plan_mode[1:]))


def _with_picture_of_no_sample(trace: Trace) -> Trace:
    film = filmed(trace).film
    assert film is not None
    return replace(trace, film=replace(film, samples=film.samples + 10_000))


def _with_unbounded_scene(trace: Trace) -> Trace:
    surface = replace(trace.scene[0], points=np.full((4, 2), np.nan, np.float32))
    return replace(trace, scene=(surface,))


@pytest.mark.parametrize(
    "spoil",
    [
        _with_short_ego,
        _without_samples,
        _in_reverse,
        _with_rows_past_the_end,
        _with_other_columns,
        _with_lone_surrogate,
        _with_picture_of_no_sample,
        _with_unbounded_scene,
    ],
)
def test_inconsistent_trace_is_a_conflict(ended: Ended, spoil: Callable[[Trace], Trace]) -> None:
    path = ended.kept(spoil(make_trace(samples=40)).to_bytes())
    assert "cannot be drawn" in expect(ended.client.get(f"{path}/episode"), 409)["detail"]


def test_document_that_is_no_trace_is_a_conflict(ended: Ended) -> None:
    path = ended.kept(b"the trace")
    assert "cannot be drawn" in expect(ended.client.get(f"{path}/episode"), 409)["detail"]
    expect(ended.client.get(f"{path}/pictures/0.jpg"), 404)


def test_malformed_descriptions_are_left_out(ended: Ended) -> None:
    behaviour: Json = {"mode": "detector", "perturbations": [{"gene": "snow", "level": {}}]}
    about: dict[str, Json] = {"spec": {"scenario": {"crossing_m": "far"}, "behaviour": behaviour}}
    found = ended.episode(replace(make_trace(samples=40), about=about))
    assert found["words"]["report"] == "detected"
    assert found["words"]["scenario"].startswith("None")


def test_simulator_that_records_no_traces_has_no_episodes(ended: Ended) -> None:
    path = ended.kept(None)
    assert "records no trace" in expect(ended.client.get(f"{path}/episode"), 409)["detail"]


MANY = 40
"""More requests than the coordinator has threads for other work."""


class Blocker:
    """A callable that blocks until it is released, and then fails.

    Attributes:
        within: Number of calls so far.
    """

    def __init__(self) -> None:
        self._released = threading.Event()
        self._lock = threading.Lock()
        self.within = 0

    def __call__(self, *_: Any) -> Any:
        with self._lock:
            self.within += 1
        self._released.wait(60)
        raise InvalidEpisode("not a trace")

    def release(self) -> None:
        self._released.set()


@contextmanager
def many_requests(client: httpx.Client, method: str, path: str, **options: Any) -> Iterator[list[int]]:
    """Send many requests at once; yield the list of statuses, which is complete after the block."""
    statuses: list[int] = []

    def ask() -> None:
        statuses.append(client.request(method, path, **options).status_code)

    threads = [threading.Thread(target=ask) for _ in range(MANY)]
    for thread in threads:
        thread.start()
    try:
        yield statuses
    finally:
        for thread in threads:
            thread.join()


def assert_others_are_served(client: httpx.Client) -> None:
    """Check that other requests are answered in the meantime."""
    for path in ("/readyz", "/api/v1/campaigns", "/metrics", "/api/v1/jobs"):
        assert client.get(path).status_code == 200
    assert FakeWorker(client, capabilities=("nothing",)).lease() == []


def test_drawing_does_not_block_other_requests(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = finish(client, UNTRACED)
    path = f"/api/v1/campaigns/{campaign}/solutions/3"
    client.post(f"{path}/trace")
    worker = FakeWorker(client, judge=traces(b"the trace"))
    worker.report(worker.lease())
    blocker = Blocker()
    monkeypatch.setattr(Trace, "from_bytes", blocker)
    with many_requests(client, "GET", f"{path}/replay.mp4") as statuses:
        try:
            eventually(lambda: blocker.within == SLOW_AT_ONCE, "some replays are being drawn")
            assert_others_are_served(client)
            expect(client.post("/api/v1/campaigns", json=ball(seed=2)), 201)
        finally:
            blocker.release()
    assert statuses == [409] * MANY


@pytest.mark.parametrize(
    ("problem", "at_once"),
    [("mtq@1", SLOW_AT_ONCE), ("ball@1", PLUGIN_CHECKS_AT_ONCE)],
    ids=["own", "plug-in"],
)
def test_checking_a_submission_blocks_no_request(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, problem: str, at_once: int
) -> None:
    submit(client, ball())
    blocker = Blocker()

    def checked(*given: Any) -> Any:
        try:
            return blocker(*given)
        except InvalidEpisode:
            return usual(*given)

    usual = brink.server.campaigns.plan.make_checked_plan
    monkeypatch.setattr(brink.server.campaigns.plan, "make_checked_plan", checked)
    body = {**ball(seed=2, simulations=20, algorithm={"id": "random@1"}), "problem": {"id": problem}}
    with many_requests(client, "POST", "/api/v1/campaigns", json=body) as statuses:
        try:
            eventually(lambda: blocker.within == at_once, "some submissions are being checked")
            assert_others_are_served(client)
        finally:
            blocker.release()
    assert statuses == [201] * MANY
