"""The scene model and the story of an episode: ghosts, braking, gaps; the decisive moment, its lead-up, captions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support.traces import make_trace, ragged

from brink.pictures import ReplayError
from brink.pictures.camera_view import SketchView
from brink.pictures.frame import FramePainter
from brink.pictures.map_view import HIDDEN_WHITE
from brink.pictures.scene import (
    EpisodeScene,
    closest_points,
    found_at,
    front_gap,
    is_there,
    map_centres,
    outline,
)
from brink.pictures.sheets import still
from brink.pictures.story import measured_words, story_of
from brink.pictures.style import FILLS, VEHICLE, lighter
from brink.sim.episode import Json
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import PERCEIVED_COLUMNS, VIOLATED_AT_S, Event, Surface, Trace
from brink.sim.world.vehicle import brake_lights_on

metres = st.floats(-50, 50)
sides = st.floats(0.5, 10)
angles = st.floats(-7, 7)


def perceiving(trace: Trace, *rows: tuple[float, ...]) -> Trace:
    """Return an episode in which these obstacles are perceived at sample 10, and none at any other."""
    samples = [list(rows) if sample == 10 else [] for sample in range(len(trace.time_s))]
    return replace(trace, perceived=ragged(PERCEIVED_COLUMNS, samples))


def test_perceived_obstacle_is_a_ghost_unless_a_road_user_of_its_kind_is_near() -> None:
    trace = make_trace()
    x_m, y_m, _, _ = trace.actors[0].motion[10].tolist()
    person_x_m, person_y_m, _, _ = trace.actors[2].motion[10].tolist()
    size = (0.0, 0.0, 4.5, 1.8)
    rows = [
        (1.0, 0.0, x_m + 2.4, y_m, *size),
        (2.0, 0.0, x_m + 2.6, y_m, *size),
        (3.0, 1.0, x_m, y_m, *size),
        (4.0, 1.0, person_x_m, person_y_m, *size),
        (5.0, 7.0, x_m, y_m, *size),
    ]
    ghosts = EpisodeScene.of(perceiving(trace, *rows)).obstacles.ghost
    assert ghosts.tolist() == [False, True, True, False, False], "an unknown label counts as a vehicle"


def test_a_reported_person_is_not_there_where_a_parked_car_is() -> None:
    trace = make_trace()
    size = (0.0, 0.0, 0.6, 0.6)
    parked = Surface(
        kind="parked-car",
        points=np.array([(30, 30), (34, 30), (34, 32), (30, 32)], np.float32),
        closed=True,
        width_m=0.0,
    )
    there = replace(
        perceiving(trace, (1.0, 1.0, 31.0, 31.0, *size), (2.0, 1.0, 60.0, 60.0, *size)), scene=(parked,)
    )
    scene = EpisodeScene.of(there)
    rows = range(there.perceived.first[10], there.perceived.first[11])
    assert [found_at(scene, 10, row) for row in rows] == [("parked-car",), ()]
    assert (is_there(0, ("parked-car",)), is_there(1, ("parked-car",))) == (True, False)
    assert (is_there(0, ("pedestrian",)), is_there(1, ("pedestrian",))) == (False, True)


@pytest.mark.parametrize(
    ("requirement", "robustness", "expected"),
    [
        ("front-gap@1", -0.31, ("1.2 m", "0.3 m short of 1.5 m")),
        ("front-gap@1", -0.02, ("1.48 m", "0.02 m short of 1.5 m")),
        ("front-gap", 13.2, ("14.7 m", "1.5 m required")),
        ("front-gap", 48.5, ("no vehicle ahead", "")),
        ("lane-keeping@1", -0.31, ("−0.3 m", "violated")),
        ("lane-keeping@1", 0.5, ("+0.5 m", "to spare")),
        ("no-dangerous-stop@1", -0.5, ("−0.5 m/s", "violated")),
        ("no-dangerous-stop@1", 0.5, ("+0.5 m/s", "to spare")),
        ("no-dangerous-stop@1", 8.0, ("no needless braking", "at this moment")),
    ],
)
def test_the_front_gap_is_a_distance_and_everything_else_a_margin(
    requirement: str, robustness: float, expected: tuple[str, str]
) -> None:
    unit = "m/s" if requirement.startswith("no-dangerous-stop") else "m"
    assert measured_words(requirement, robustness, unit) == expected


@pytest.mark.parametrize(("after_s", "shown"), [(0.0, 0), (0.02, 0), (0.08, 1)])
def test_a_violation_is_shown_at_the_sample_whose_time_reads_the_same(after_s: float, shown: int) -> None:
    trace = make_trace()
    sample = int(np.flatnonzero(trace.robustness["front-gap@1"] < 0)[0])
    exact_s = float(trace.time_s[sample]) + after_s
    timed = replace(trace, about={**trace.about, "violated_at_s": {"front-gap@1": exact_s}})
    story = story_of(timed)
    assert (story.decisive, story.shown) == (sample, sample + shown)
    assert f"{float(trace.time_s[story.shown]):.1f}" == f"{exact_s:.1f}"
    [moment] = [one for one in story.moments if one.reason == "violation"]
    assert (moment.sample, moment.time_s) == (story.shown, exact_s)


def test_absent_road_user_makes_no_obstacle_real() -> None:
    trace = make_trace()
    absent = trace.actors[0].motion.copy()
    x_m, y_m = absent[10, :2].tolist()
    absent[10] = np.nan
    there = replace(trace, actors=(replace(trace.actors[0], motion=absent),))
    scene = EpisodeScene.of(perceiving(there, (1.0, 0.0, x_m, y_m, 0.0, 0.0, 4.5, 1.8)))
    assert scene.obstacles.ghost.tolist() == [True]


def test_brake_lights_are_on_when_the_camera_sees_them_on() -> None:
    trace = make_trace(samples=4)
    lead = trace.actors[0].motion.copy()
    lead[:, 3] = [5.0, 4.95, 4.8, 0.0]
    ego = trace.ego.copy()
    ego[:, 3:] = [(8.0, -0.6), (8.0, -0.8), (8.0, 0.0), (0.0, 0.0)]
    changed = replace(trace, ego=ego, actors=(replace(trace.actors[0], motion=lead),))
    scene = EpisodeScene.of(changed)
    assert scene.ego_brakes.tolist() == [False, True, False, True]
    assert scene.actors_brake[0].tolist() == [False, False, True, True]
    assert scene.ego_brakes.tolist() == [brake_lights_on(*row) for row in ego[:, 3:].tolist()]


def test_road_users_of_whom_too_little_is_visible_are_hidden() -> None:
    trace = make_trace(samples=4)
    shares = np.array([1.0, 0.3, 0.1, np.nan], np.float32)
    seen = replace(trace, actors=(replace(trace.actors[0], visible=shares), trace.actors[1]))
    scene = EpisodeScene.of(seen)
    assert scene.actors_hidden[0].tolist() == [False, False, True, False]
    assert not scene.actors_hidden[1].any()
    strict = replace(seen, about={"spec": {"options": {"least_visible": 0.5}}})
    assert EpisodeScene.of(strict).actors_hidden[0].tolist() == [False, True, True, False]


def test_a_hidden_car_is_lighter_than_the_road() -> None:
    assert min(lighter(VEHICLE, HIDDEN_WHITE)) > max(FILLS["road"]) + 20


def test_the_pitch_is_zero_unless_the_trace_tells_it() -> None:
    trace = make_trace(samples=2)
    assert EpisodeScene.of(trace).pitch_rad.tolist() == [0.0, 0.0]
    told = replace(trace, pitch_rad=np.array([0.25, np.nan], np.float32))
    assert EpisodeScene.of(told).pitch_rad.tolist() == [0.25, 0.0]


def red_pixels(image: Image.Image, box: tuple[int, int, int, int]) -> int:
    pixels = np.asarray(image.crop(box)).astype(int)
    return int(((pixels[..., 0] > 170) & (pixels[..., 1:] < 90).all(axis=2)).sum())


def test_a_sketch_shows_brake_lights_and_moves_with_the_pitch() -> None:
    trace = make_trace(samples=3, lead_stops_at_m=18.0)
    lead = trace.actors[0].motion.copy()
    lead[:, :3] = (18.0, -1.75, 0.0)
    ego = trace.ego.copy()
    ego[:, :3] = (0.0, -1.75, 0.0)
    boxes = replace(trace.seen_boxes, first=np.zeros(4, np.int32), rows=trace.seen_boxes.rows[:0])
    images = {}
    for name, speed_mps, pitch_rad in (("drives", 5.0, 0.0), ("held", 0.0, 0.0), ("dives", 0.0, -0.02)):
        motion = lead.copy()
        motion[:, 3] = speed_mps
        shown = replace(
            trace,
            ego=ego,
            lights=("", "", ""),
            actors=(replace(trace.actors[0], motion=motion),),
            seen_boxes=boxes,
            given_boxes=boxes,
            pitch_rad=np.full(3, pitch_rad, np.float32),
        )
        images[name] = SketchView(shown, size_px=(800, 600)).draw(1)
    depth_m = 18.0 - 2.25 - 1.3
    row, aside = 300 + 400 * 1.0 / depth_m, 400 * 0.36 * 1.85 / depth_m
    for column in (400 - aside, 400 + aside):
        around = (round(column) - 4, round(row) - 4, round(column) + 5, round(row) + 5)
        assert red_pixels(images["drives"], around) == 0
        assert red_pixels(images["held"], around) > 15
        up = round(400 * math.tan(0.02))
        raised = (around[0], around[1] - up, around[2], around[3] - up)
        assert red_pixels(images["dives"], raised) > 15


def test_map_stays_where_the_ego_was_last_known() -> None:
    trace = make_trace()
    whole = map_centres(trace, 9.0)
    assert whole.shape == (200, 2)
    lost = trace.ego.copy()
    lost[150:] = np.nan
    centres = map_centres(replace(trace, ego=lost), 9.0)
    assert np.isfinite(centres).all()
    np.testing.assert_array_equal(centres[:140], whole[:140])
    np.testing.assert_allclose(centres[-1], centres[170])
    assert (
        map_centres(replace(trace, ego=np.full((200, 5), np.nan, np.float32)), 9.0).tolist() == [[0, 0]] * 200
    )


def test_first_violation_is_the_decisive_moment() -> None:
    trace = make_trace()
    story = story_of(trace)
    series = trace.robustness["front-gap@1"]
    assert story.requirement == "front-gap@1"
    assert story.violated
    assert series[story.decisive] < 0
    assert (series[: story.decisive] >= 0).all()
    assert story.least == pytest.approx(series.min())


def test_closest_approach_is_the_decisive_moment_if_nothing_is_violated() -> None:
    trace = make_trace(violated=False)
    story = story_of(trace)
    assert not story.violated
    assert story.decisive == trace.robustness["front-gap@1"].argmin()


def test_moments_ascend_and_include_the_decisive_one_and_its_lead_up() -> None:
    story = story_of(make_trace())
    samples = [moment.sample for moment in story.moments]
    assert samples == sorted(set(samples))
    assert 4 <= len(samples) <= 6
    reasons = {moment.sample: moment.reason for moment in story.moments}
    assert reasons[story.decisive] == "violation"
    assert "injected vehicle" in reasons.values()
    assert "1 s before" in reasons.values()


@pytest.mark.parametrize("violated", [True, False])
def test_every_injected_detection_has_a_moment_while_it_is_reported(violated: bool) -> None:
    trace = make_trace(violated=violated)
    injected = [moment for moment in story_of(trace).moments if moment.reason.startswith("injected ")]
    assert injected
    for moment in injected:
        labels = trace.given_boxes.at(moment.sample)[:, 0].astype(int)
        assert ("vehicle", "person").index(moment.reason.removeprefix("injected ")) in labels


def hits_a_pedestrian(trace: Trace, at_s: float) -> Trace:
    """Return the trace with a collision with its first pedestrian from a time on."""
    walker = next(actor.name for actor in trace.actors if actor.kind == "pedestrian")
    clearance = np.where(trace.time_s >= at_s - 1e-4, -0.5, 3.0).astype(np.float32)
    hit = Event(time_s=at_s, kind="collision", text=f"the ego hits {walker} at 5.0 m/s")
    robustness = {**trace.robustness, "no-collision@1": clearance}
    return replace(trace, robustness=robustness, events=(*trace.events, hit))


def test_violations_of_other_requirements_are_part_of_the_story() -> None:
    trace = hits_a_pedestrian(make_trace(violated=False), 12.8)
    story = story_of(trace, "front-gap@1")
    assert (story.violated, story.words) == (False, "front gap held; hit a pedestrian at 12.8 s")
    [other] = story.violations
    assert trace.time_s[other.sample] == pytest.approx(12.8)
    assert {m.reason: m.sample for m in story.moments}["hit a pedestrian"] == other.sample
    painter = FramePainter(trace, requirement="front-gap@1")
    assert painter.verdict().startswith("front gap held (")
    assert painter.verdict().endswith(" s); hit a pedestrian at 12.8 s")


def test_of_several_requirements_the_first_violated_one_is_the_story() -> None:
    trace = hits_a_pedestrian(make_trace(), 12.8)
    both = story_of(trace, ("front-gap@1", "no-collision@1"))
    assert both.requirement == "no-collision@1"
    assert both.words == "hit a pedestrian at 12.8 s; violated the front gap at 17.5 s"
    calm = story_of(make_trace(violated=False), ("progress@1", "front-gap@1"))
    assert (calm.requirement, calm.words) == ("front-gap@1", "front gap held")
    with pytest.raises(ReplayError, match=r"expected some that the trace records .* got red-light@1"):
        story_of(make_trace(), ("red-light@1",))


def test_without_a_named_requirement_the_story_is_about_the_violated_one() -> None:
    trace = hits_a_pedestrian(make_trace(violated=False), 12.8)
    story = story_of(trace)
    assert (story.requirement, story.words) == ("no-collision@1", "hit a pedestrian at 12.8 s")
    assert story_of(make_trace(violated=False)).requirement == "front-gap@1"


def test_of_two_violations_in_one_sample_the_earlier_one_is_the_story() -> None:
    trace = hits_a_pedestrian(make_trace(), 17.5)
    moments: dict[str, Json] = {"front-gap@1": 17.54, "no-collision@1": 17.52}
    exact = replace(trace, about={**trace.about, VIOLATED_AT_S: moments})
    assert story_of(exact).requirement == "no-collision@1"


def test_a_former_version_of_a_requirement_stands_for_the_present_one() -> None:
    trace = make_trace()
    assert story_of(trace, ("no-collision@1", "front-gap@2")).requirement == "front-gap@1"
    both = replace(trace, robustness={**trace.robustness, "front-gap@2": np.full_like(trace.time_s, 2.0)})
    assert not story_of(both, ("front-gap@2",)).violated


def test_a_standing_ego_has_no_front_gap_that_is_too_short() -> None:
    trace = make_trace()
    sample = int(np.flatnonzero(trace.robustness["front-gap@1"] < 0)[-1])
    stands = np.maximum(trace.robustness["front-gap@1"], 0)
    gap = front_gap(replace(trace, robustness={"front-gap@2": stands}), sample)
    assert gap is not None
    assert gap.gap_m < REQUIRED_GAP_M
    assert not gap.too_short
    assert measured_words("front-gap@2", 0.0, "m") == ("the ego stands", "")


@pytest.mark.parametrize("name", ["progress", "progress@1"])
def test_requirement_is_found_with_or_without_version(name: str) -> None:
    assert story_of(make_trace(), name).requirement == "progress@1"


def test_unknown_requirement_is_rejected_with_the_known_ones() -> None:
    with pytest.raises(ReplayError, match=r"front-gap@1, progress@1.*got 'speed'"):
        story_of(make_trace(), "speed")


def test_trace_without_samples_or_requirements_is_rejected() -> None:
    trace = make_trace()
    with pytest.raises(ReplayError, match="no samples"):
        story_of(replace(trace, time_s=np.empty(0, np.float32)))
    with pytest.raises(ReplayError, match="no requirement"):
        story_of(replace(trace, robustness={}))


def test_requirement_that_never_applies_is_not_violated() -> None:
    trace = make_trace()
    never = replace(trace, robustness={"front-gap@1": np.full(200, np.inf, np.float32)})
    assert not story_of(never).violated
    assert np.isinf(story_of(never).least)
    assert FramePainter(never).verdict() == "front gap never applied"
    assert still(never).width == 1280


def test_no_moment_lies_before_the_start_of_the_episode() -> None:
    trace = make_trace()
    early = np.ones(len(trace.time_s), np.float32)
    early[int(np.searchsorted(trace.time_s, 1.5))] = -1.0
    reasons = [m.reason for m in story_of(replace(trace, robustness={"front-gap@1": early})).moments]
    assert "1 s before" in reasons
    assert "2.5 s before" not in reasons
    assert "5 s before" not in reasons


def test_gap_line_ends_at_the_vehicle_ahead_and_has_the_recorded_length() -> None:
    trace = make_trace()
    found = front_gap(trace, story_of(trace).decisive)
    assert found is not None
    assert trace.actors[found.actor].name == "lead"
    assert np.hypot(*(found.ends[0] - found.ends[1])) == pytest.approx(found.gap_m, abs=0.05)


def test_gap_line_is_not_drawn_to_an_oncoming_vehicle_at_the_same_distance() -> None:
    trace = make_trace()
    sample = 10
    lead, oncoming = trace.actors[0].motion.copy(), trace.actors[1].motion.copy()
    oncoming[sample, :2] = lead[sample, 0], 1.75
    actors = (replace(trace.actors[1], motion=oncoming), replace(trace.actors[0], motion=lead))
    found = front_gap(replace(trace, actors=actors), sample)
    assert found is not None
    assert found.actor == 1


def test_no_gap_is_drawn_to_a_vehicle_that_was_hit() -> None:
    trace = make_trace()
    sample = story_of(trace).decisive
    hit = np.ones(len(trace.time_s), np.float32)
    touching = trace.actors[0].motion.copy()
    touching[sample - 1 : sample + 1, 0] -= 1.2
    actors = (replace(trace.actors[0], motion=touching), *trace.actors[1:])
    judged = replace(trace, actors=actors, robustness={"no-collision@1": hit})
    near = front_gap(judged, sample)
    assert near is not None
    assert near.gap_m < 1.0
    hit[sample] = -0.4
    assert front_gap(judged, sample) is None
    assert front_gap(judged, sample - 1) is not None


def test_facing_bumpers_are_measured_in_the_middle() -> None:
    start, end, gap_m = closest_points(outline(0, 0, 0, 4, 2), outline(10, 0, 0, 4, 2))
    assert gap_m == pytest.approx(6)
    np.testing.assert_allclose(start, (2, 0))
    np.testing.assert_allclose(end, (8, 0))


@given(metres, metres, angles, sides, sides, metres, metres, angles, sides, sides)
def test_shortest_line_is_symmetric_and_no_longer_than_between_corners(
    x: float, y: float, yaw: float, a: float, b: float, u: float, v: float, turn: float, c: float, d: float
) -> None:
    one, other = outline(x, y, yaw, a, b), outline(u, v, turn, c, d)
    start, end, gap_m = closest_points(one, other)
    assert gap_m == pytest.approx(closest_points(other, one)[2], abs=1e-9)
    assert gap_m <= np.hypot(*(one[:, None] - other).T).min() + 1e-9
    # The ends are averages of points whose distances differ by at most two centimetres.
    assert np.hypot(*(start - end)) <= gap_m + 0.03 or gap_m == 0


@given(metres, metres, angles)
def test_overlapping_outlines_have_no_gap(x: float, y: float, yaw: float) -> None:
    assert closest_points(outline(x, y, yaw, 4, 2), outline(x + 0.5, y, yaw + 1, 3, 1))[2] == 0
