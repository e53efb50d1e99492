"""Episodes as the dashboard draws them: a trace in columns, and the pictures of a film, one at a time."""

import base64
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, completes, expect, row_counts, submit
from support.traces import filmed, grey_jpeg, make_trace

from brink.server.db.engine import Engines
from brink.server.operations.prune import prune
from brink.sim.episode import Json
from brink.sim.trace import BOX_COLUMNS, PERCEIVED_COLUMNS, Ragged, Trace
from brink.worker.wire import Completed, JobFailed, LeasedJob

NUMBER = 3


def kept(client: httpx.Client, document: bytes | None) -> str:
    """Return the path of a solution whose trace is that document."""

    def judge(job: LeasedJob) -> Completed | JobFailed:
        outcome = completes(job)
        if not job.record or document is None:
            return outcome
        return outcome.model_copy(update={"trace": base64.b64encode(document).decode()})

    worker = FakeWorker(client, judge=judge)
    campaign = submit(client, ball(simulations=20, execution={"keep_traces": 0}))
    assert worker.work(campaign)["status"] == "finished"
    path = f"/api/v1/campaigns/{campaign}/solutions/{NUMBER}"
    assert client.get(f"{path}/episode", params={"wait_s": 0}).status_code == 202
    assert worker.report(worker.lease()) == ["accepted"]
    return path


def episode(client: httpx.Client, trace: Trace) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{kept(client, trace.to_bytes())}/episode"))
    return found


def numbers(column: list[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in column])


def test_an_episode_says_in_columns_what_its_trace_holds(client: httpx.Client) -> None:
    trace = make_trace()
    told = episode(client, trace)
    samples = len(trace.time_s)
    assert told["time_s"] == pytest.approx(trace.time_s, abs=5e-4)
    for place, (name, within) in enumerate(
        {"x_m": 5e-4, "y_m": 5e-4, "yaw_rad": 5e-5, "speed_mps": 5e-4, "accel_mps2": 5e-4}.items()
    ):
        assert told["ego"][name] == pytest.approx(trace.ego[:, place], abs=within * 1.01)
    assert (told["ego"]["length_m"], told["ego"]["width_m"]) == trace.ego_size_m
    assert [actor["name"] for actor in told["actors"]] == [actor.name for actor in trace.actors]
    for actor, shown in zip(trace.actors, told["actors"], strict=True):
        np.testing.assert_allclose(numbers(shown["x_m"]), actor.motion[:, 0], atol=6e-4)
        assert (shown["kind"], len(shown["yaw_rad"])) == (actor.kind, samples)
    oncoming = next(actor for actor in told["actors"] if actor["name"] == "oncoming")
    assert oncoming["x_m"][0] is None, "it is not there yet"
    assert oncoming["x_m"][-1] is not None
    assert told["plan_mode"] == list(trace.plan_mode)
    assert told["lights"] == list(trace.lights)
    assert [surface["kind"] for surface in told["scene"]] == [surface.kind for surface in trace.scene]
    assert told["scene"][0]["points"] == trace.scene[0].points.tolist()
    assert told["robustness"].keys() == trace.robustness.keys()
    assert told["units"] == {"front-gap@1": "m", "progress@1": "s"}
    assert [event["kind"] for event in told["events"]] == ["nudge", "violation"]
    assert told["film"] is None
    decisive = int(np.flatnonzero(trace.robustness["front-gap@1"] < 0)[0])
    assert told["story"] == {"requirement": "front-gap@1", "violated": True, "decisive": decisive}
    assert "sunset" in told["words"]["scenario"]
    assert told["words"]["report"] == "injected"


def test_boxes_belong_to_samples(client: httpx.Client) -> None:
    trace = make_trace(samples=80)
    told = episode(client, trace)
    for name, ragged, columns in (
        ("seen", trace.seen_boxes, BOX_COLUMNS),
        ("given", trace.given_boxes, BOX_COLUMNS),
        ("perceived", trace.perceived, PERCEIVED_COLUMNS),
    ):
        assert told[name]["first"] == ragged.first.tolist()
        assert tuple(told[name]["columns"]) == columns
        assert told[name]["columns"][columns[2]] == pytest.approx(ragged.rows[:, 2], abs=0.051)
    camera = told["camera"]
    assert (camera["width_px"], camera["focal_px"], camera["horizon_px"]) == (800, 400, 300)


def test_what_has_no_bound_is_null(client: httpx.Client) -> None:
    trace = make_trace(samples=40)
    unbounded = np.full(40, np.inf, np.float32)
    told = episode(client, replace(trace, robustness={**trace.robustness, "red-light@1": unbounded}))
    assert told["robustness"]["red-light@1"] == [None] * 40


def test_a_film_comes_with_its_boxes_and_its_pictures_one_by_one(client: httpx.Client) -> None:
    path = kept(client, filmed(make_trace(samples=40)).to_bytes())
    film = expect(client.get(f"{path}/episode"))["film"]
    assert (film["size_px"], film["samples"]) == ([320, 240], [0, 2, 4])
    assert film["judged"]["columns"]["ignored"] == [0] * 40
    assert film["found"]["columns"]["score"][:2] == [1, 0.975]
    assert film["found"]["columns"]["score"][-1] == 0.1, "nobody looks at what is less sure"
    assert film["found"]["first"][-6:] == [35, 36, 37, 37, 37, 37]
    assert film["regions"]["warning"][0] == [130, 150]
    for index in range(3):
        picture = client.get(f"{path}/pictures/{index}.jpg")
        assert (picture.status_code, picture.headers["content-type"]) == (200, "image/jpeg")
        assert picture.headers["x-content-type-options"] == "nosniff"
        assert picture.content == grey_jpeg(64 + 8 * index)
    assert "has 3 pictures" in expect(client.get(f"{path}/pictures/3.jpg"), 404)["detail"]


def test_there_are_no_pictures_without_a_film_or_a_trace(client: httpx.Client, engines: Engines) -> None:
    path = kept(client, make_trace(samples=40).to_bytes())
    expect(client.get(f"{path}/pictures/0.jpg"), 404)
    with engines.writer.begin() as connection:
        prune(connection, ended=None, traces=timedelta(days=-1), really=True)
    assert "no trace" in expect(client.get(f"{path}/pictures/0.jpg"), 404)["detail"]
    expect(client.get(path.replace(f"/{NUMBER}", "/9999") + "/pictures/0.jpg"), 404)


def test_what_is_no_jpeg_is_not_handed_on_as_one(client: httpx.Client) -> None:
    trace = filmed(make_trace(samples=40))
    assert trace.film is not None
    page = replace(trace, film=replace(trace.film, pictures=(b"<html>", *trace.film.pictures[1:])))
    path = kept(client, page.to_bytes())
    assert "no JPEG" in expect(client.get(f"{path}/pictures/0.jpg"), 404)["detail"]
    assert client.get(f"{path}/pictures/1.jpg").status_code == 200


def _short_ego(trace: Trace) -> Trace:
    return replace(trace, ego=trace.ego[:-1])


def _no_samples(trace: Trace) -> Trace:
    return replace(trace, time_s=trace.time_s[:0])


def _backwards(trace: Trace) -> Trace:
    return replace(trace, time_s=trace.time_s[::-1])


def _rows_past_the_end(trace: Trace) -> Trace:
    first = trace.given_boxes.first.copy()
    first[-1] += 7
    return replace(trace, given_boxes=replace(trace.given_boxes, first=first))


def _other_columns(trace: Trace) -> Trace:
    seen = trace.seen_boxes
    return replace(trace, seen_boxes=Ragged(columns=("a", "b"), first=seen.first, rows=seen.rows[:, :2]))


def _half_a_word(trace: Trace) -> Trace:
    return replace(trace, plan_mode=("\ud800", *trace.plan_mode[1:]))


def _picture_of_no_sample(trace: Trace) -> Trace:
    film = filmed(trace).film
    assert film is not None
    return replace(trace, film=replace(film, samples=film.samples + 10_000))


def _unbounded_scene(trace: Trace) -> Trace:
    surface = replace(trace.scene[0], points=np.full((4, 2), np.nan, np.float32))
    return replace(trace, scene=(surface,))


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    "spoil",
    [
        _short_ego,
        _no_samples,
        _backwards,
        _rows_past_the_end,
        _other_columns,
        _half_a_word,
        _picture_of_no_sample,
        _unbounded_scene,
    ],
)
def test_a_trace_that_does_not_fit_together_is_a_conflict(
    client: httpx.Client, spoil: Callable[[Trace], Trace]
) -> None:
    path = kept(client, spoil(make_trace(samples=40)).to_bytes())
    assert "cannot be drawn" in expect(client.get(f"{path}/episode"), 409)["detail"]


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_a_trace_that_is_none_is_a_conflict(client: httpx.Client) -> None:
    path = kept(client, b"the trace")
    assert "cannot be drawn" in expect(client.get(f"{path}/episode"), 409)["detail"]
    expect(client.get(f"{path}/pictures/0.jpg"), 404)


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_an_episode_is_about_what_was_violated_where_the_campaign_judges_no_single_requirement(
    client: httpx.Client,
) -> None:
    far = np.full(40, 9.0, np.float32)
    fast = np.where(np.arange(40) < 25, 1.0, -0.5).astype(np.float32)
    told = episode(
        client, replace(make_trace(samples=40), robustness={"front-gap@1": far, "speed-limit@1": fast})
    )
    assert told["story"] == {"requirement": "speed-limit@1", "violated": True, "decisive": 25}


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_words_that_cannot_be_told_are_left_out(client: httpx.Client) -> None:
    behaviour: Json = {"mode": "detector", "perturbations": [{"gene": "snow", "level": {}}]}
    about: dict[str, Json] = {"spec": {"scenario": {"crossing_m": "far"}, "behaviour": behaviour}}
    told = episode(client, replace(make_trace(samples=40), about=about))
    assert told["words"]["report"] == "detected"
    assert told["words"]["scenario"].startswith("None")


def test_nobody_waits_for_an_episode_that_no_worker_can_make(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    FakeWorker(client, capabilities=("another-simulator@1",)).lease()
    before = row_counts(engines)
    answer = client.get(f"/api/v1/campaigns/{campaign}/solutions/{NUMBER}/episode", params={"wait_s": 20})
    assert "no live worker can run faulty@1" in expect(answer, 503)["detail"]
    assert answer.headers["Retry-After"] == "5"
    assert row_counts(engines) == before, "nothing is asked for"


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_a_simulator_without_traces_has_no_episodes(client: httpx.Client) -> None:
    path = kept(client, None)
    assert "records no trace" in expect(client.get(f"{path}/episode"), 409)["detail"]
