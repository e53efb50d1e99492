"""Episodes as the dashboard draws them: a trace and its scene in columns, and the pictures of its film."""

from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, expect, row_counts, submit
from support.traces import filmed, grey_jpeg, make_trace
from test_traces_over_the_api import traces

from brink.server.db.engine import Engines
from brink.server.operations.prune import prune
from brink.sim.episode import Json
from brink.sim.replay.scene import EpisodeScene, map_centres
from brink.sim.trace import ACTION, BOX_COLUMNS, PERCEIVED_COLUMNS, Event, Ragged, Trace

NUMBER = 3
OBSTACLE_COLUMNS = ("yaw_rad", "drawn_length_m", "drawn_width_m", "ghost")


def kept(client: httpx.Client, document: bytes | None) -> str:
    """Return the path of a solution whose kept trace is this document."""
    worker = FakeWorker(client, judge=traces(document))
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


def test_episode_has_the_trace_in_columns(client: httpx.Client) -> None:
    trace = make_trace()
    found = episode(client, trace)
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
    assert found["story"] == {"requirement": "front-gap@1", "violated": True, "decisive": decisive}
    assert "sunset" in found["words"]["scenario"]
    assert found["words"]["report"] == "injected"


def test_boxes_and_obstacles_are_grouped_by_sample(client: httpx.Client) -> None:
    trace = make_trace(samples=80)
    found = episode(client, trace)
    for name, ragged, columns in (
        ("seen", trace.seen_boxes, BOX_COLUMNS),
        ("given", trace.given_boxes, BOX_COLUMNS),
        ("perceived", trace.perceived, (*PERCEIVED_COLUMNS, *OBSTACLE_COLUMNS)),
    ):
        assert found[name]["first"] == ragged.first.tolist()
        assert tuple(found[name]["columns"]) == columns
        assert found[name]["columns"][columns[2]] == pytest.approx(ragged.rows[:, 2], abs=0.051)
    camera = found["camera"]
    assert (camera["width_px"], camera["focal_px"], camera["horizon_px"]) == (800, 400, 300)


def test_episode_has_the_scene_model_of_replays(client: httpx.Client) -> None:
    trace = make_trace()
    found = episode(client, trace)
    scene = EpisodeScene.of(trace)
    assert found["ego"]["brakes"] == scene.ego_brakes.tolist()
    assert [actor["brakes"] for actor in found["actors"]] == [
        brakes.tolist() for brakes in scene.actors_brake
    ]
    assert [actor["shape"] for actor in found["actors"]] == ["car", "car", "person", "person"]
    assert found["perceived"]["columns"]["ghost"] == scene.obstacles.ghost.astype(int).tolist()
    assert 1 in found["perceived"]["columns"]["ghost"]
    kinds = [surface["kind"] for surface in found["scene"]]
    assert found["route_layer"] == kinds.index("building")
    building = found["scene"][kinds.index("building")]
    assert (building["paint"], building["outlined"], building["height_m"]) == ("building", True, 6)
    crossing = found["scene"][kinds.index("crossing")]
    assert (crossing["paint"], crossing["outlined"], crossing["height_m"]) == ("marking", False, 0)
    np.testing.assert_allclose(found["centre"]["x_m"], map_centres(trace, 12.0)[:, 0], atol=6e-4)
    assert len(found["shapes"]["car_body"]) == 12
    assert found["words"]["ghosts"] == ["ghost vehicle", "ghost person", "ghost obstacle"]
    assert (found["camera"]["from_m"], found["camera"]["to_m"]) == (0.4, 90)


def test_action_is_captioned_and_not_marked(client: httpx.Client) -> None:
    trace = make_trace(samples=40)
    action = Event(time_s=1.0, kind=ACTION, text="car-1:change_lane")
    first, *others = episode(client, replace(trace, events=(action, *trace.events)))["events"]
    assert (first["caption"], first["marked"]) == ("car-1: change lane", False)
    assert [event["caption"] for event in others] == ["nudges around vehicle", "front gap under 1.5 m"]
    assert all(event["marked"] for event in others)


def test_unbounded_robustness_is_null(client: httpx.Client) -> None:
    trace = make_trace(samples=40)
    unbounded = np.full(40, np.inf, np.float32)
    found = episode(client, replace(trace, robustness={**trace.robustness, "red-light@1": unbounded}))
    assert found["robustness"]["red-light@1"] == [None] * 40


def test_film_has_boxes_and_serves_its_pictures_one_by_one(client: httpx.Client) -> None:
    path = kept(client, filmed(make_trace(samples=40)).to_bytes())
    film = expect(client.get(f"{path}/episode"))["film"]
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
        picture = client.get(f"{path}/pictures/{index}.jpg")
        assert (picture.status_code, picture.headers["content-type"]) == (200, "image/jpeg")
        assert picture.headers["x-content-type-options"] == "nosniff"
        assert picture.content == grey_jpeg(64 + 8 * index)
    assert "has 3 pictures" in expect(client.get(f"{path}/pictures/3.jpg"), 404)["detail"]


def test_without_film_or_trace_there_are_no_pictures(client: httpx.Client, engines: Engines) -> None:
    path = kept(client, make_trace(samples=40).to_bytes())
    expect(client.get(f"{path}/pictures/0.jpg"), 404)
    with engines.writer.begin() as connection:
        prune(connection, ended=None, traces=timedelta(days=-1), really=True)
    assert "no trace" in expect(client.get(f"{path}/pictures/0.jpg"), 404)["detail"]
    expect(client.get(path.replace(f"/{NUMBER}", "/9999") + "/pictures/0.jpg"), 404)


def test_picture_that_is_no_jpeg_is_not_served(client: httpx.Client) -> None:
    trace = filmed(make_trace(samples=40))
    assert trace.film is not None
    page = replace(trace, film=replace(trace.film, pictures=(b"<html>", *trace.film.pictures[1:])))
    path = kept(client, page.to_bytes())
    assert "no JPEG" in expect(client.get(f"{path}/pictures/0.jpg"), 404)["detail"]
    assert client.get(f"{path}/pictures/1.jpg").status_code == 200


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


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
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
def test_inconsistent_trace_is_a_conflict(client: httpx.Client, spoil: Callable[[Trace], Trace]) -> None:
    path = kept(client, spoil(make_trace(samples=40)).to_bytes())
    assert "cannot be drawn" in expect(client.get(f"{path}/episode"), 409)["detail"]


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_document_that_is_no_trace_is_a_conflict(client: httpx.Client) -> None:
    path = kept(client, b"the trace")
    assert "cannot be drawn" in expect(client.get(f"{path}/episode"), 409)["detail"]
    expect(client.get(f"{path}/pictures/0.jpg"), 404)


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_story_is_the_violated_requirement_if_the_campaign_judges_none(
    client: httpx.Client,
) -> None:
    far = np.full(40, 9.0, np.float32)
    fast = np.where(np.arange(40) < 25, 1.0, -0.5).astype(np.float32)
    found = episode(
        client, replace(make_trace(samples=40), robustness={"front-gap@1": far, "speed-limit@1": fast})
    )
    assert found["story"] == {"requirement": "speed-limit@1", "violated": True, "decisive": 25}


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_malformed_descriptions_are_left_out(client: httpx.Client) -> None:
    behaviour: Json = {"mode": "detector", "perturbations": [{"gene": "snow", "level": {}}]}
    about: dict[str, Json] = {"spec": {"scenario": {"crossing_m": "far"}, "behaviour": behaviour}}
    found = episode(client, replace(make_trace(samples=40), about=about))
    assert found["words"]["report"] == "detected"
    assert found["words"]["scenario"].startswith("None")


def test_episode_that_no_worker_can_make_is_refused_at_once(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    FakeWorker(client, capabilities=("another-simulator@1",)).lease()
    before = row_counts(engines)
    answer = client.get(f"/api/v1/campaigns/{campaign}/solutions/{NUMBER}/episode", params={"wait_s": 20})
    assert "no live worker can run faulty@1" in expect(answer, 503)["detail"]
    assert answer.headers["Retry-After"] == "5"
    assert row_counts(engines) == before, "no job is enqueued"


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_simulator_that_records_no_traces_has_no_episodes(client: httpx.Client) -> None:
    path = kept(client, None)
    assert "records no trace" in expect(client.get(f"{path}/episode"), 409)["detail"]
