"""Drives in recorded traffic: the route, the edges of the road, other road users, and verdicts."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from brink.sim.commonroad.example import example_document
from brink.sim.commonroad.files import document_of
from brink.sim.commonroad.recording import Recording, packed
from brink.sim.commonroad.roads import Place, place_of
from brink.sim.commonroad.simulator import CommonRoadDrive
from brink.sim.commonroad.world import RecordedWorld, make_recorded_world
from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.episode import EpisodeSpec
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.trace import Trace

FOLDER = Path(__file__).parents[4] / "examples" / "commonroad"
FORMULAS: dict[str, Any] = {"on-road": {"stl": "always (road_edge_gap_m > -0.2)", "unit": "m"}}
MISS = {"type": "miss", "target": "lead", "magnitude": 8.0, "onset": "time", "onset_s": 0.0}


def read(name: str, old: str = "", new: str = "") -> Recording:
    text = (FOLDER / f"{name}.xml").read_text(encoding="utf-8")
    assert old in text
    return Recording.of(document_of(text.replace(old, new) if old else text))


def body(place: Place, station_m: float, offset_m: float) -> Rectangle:
    return Rectangle(*place.route.pose_at(station_m, offset_m), 2.25, 0.9)


def test_the_route_follows_the_lane() -> None:
    place = place_of(read("bend"))
    route = place.route
    assert route.speed_limit_mps == 13.89
    assert route.lane_width_m == pytest.approx(3.5, abs=0.01)
    for station_m in range(0, 200, 5):
        x_m, y_m, yaw_rad = route.pose_at(station_m)
        at = (
            min(max(station_m - 60.0, 0.0), 60.0 * math.pi / 3.0) / 60.0
        )  # 60 m straight on, then a bend of 60 m
        assert yaw_rad == pytest.approx(at, abs=0.04)
        if at > 0.0 and station_m < 122:
            assert math.hypot(x_m - 60.0, y_m - 60.0) == pytest.approx(60.0, abs=0.1)
    assert route.curvature_at(90.0) == pytest.approx(1.0 / 60.0, rel=0.1)
    assert route.oncoming_lane_at(50.0)


def test_the_route_changes_to_the_lane_of_the_goal() -> None:
    route = place_of(read("cut-in", 'position><lanelet ref="1"', 'position><lanelet ref="2"')).route
    assert [round(route.pose_at(station_m)[1], 1) for station_m in (0, 60, 120)] == [0.0, 3.5, 3.5]
    kinks = [abs(route.pose_at(s + 0.01)[2] - route.pose_at(s - 0.01)[2]) for s in range(1, 200)]
    assert max(kinks) < 1e-3


def test_the_edges_of_the_road_are_those_of_all_lanes() -> None:
    place = place_of(read("bend"))
    edges = place.edges
    for offset_m, gap_m in ((0.0, 0.85), (-1.0, -0.15), (3.5, 0.85), (1.75, 2.6)):
        assert edges.gap_m(body(place, 30.0, offset_m)) == pytest.approx(gap_m, abs=0.02)


def test_a_gap_between_lanes_is_road_if_it_is_narrow() -> None:
    text = (FOLDER / "cut-in.xml").read_text(encoding="utf-8")
    lower, _, upper = text.partition('<lanelet id="2">')
    for gap_m, is_road in ((1.0, True), (3.0, False)):
        moved = upper.replace("<y>1.75</y>", f"<y>{1.75 + gap_m}</y>").replace("<y>5.25</y>", "<y>8.25</y>")
        place = place_of(Recording.of(document_of(f'{lower}<lanelet id="2">{moved}')))
        gap = place.edges.gap_m(Rectangle(100.0, 1.75 + 0.5 * gap_m, 0.0, 2.25, 0.4))
        assert gap is not None
        assert (gap > 0.0) == is_road


def drive_on(world: RecordedWorld, seconds: float, speed_mps: float) -> None:
    """Move the ego along x at a speed, and all others with it."""
    ego = world.ego
    ego.speed_mps = speed_mps
    for step in range(round(seconds / CONTROL_STEP_S)):
        ego.x_m += speed_mps * CONTROL_STEP_S
        world.advance(step)


def test_others_follow_their_recording() -> None:
    recording = read("cut-in")
    world = make_recorded_world(place_of(recording), speed_share=1.0, reacting=False)
    drive_on(world, 4.1, 8.5)
    car, truck, *_ = world.vehicles
    states = recording.road_users[0].states
    assert [car.x_m, car.y_m, car.yaw_rad, car.speed_mps] == pytest.approx(
        (0.5 * (states[20] + states[21])).tolist()
    )
    assert truck.x_m == pytest.approx(-25.0 + 4.1 * 8.5)
    assert world.walkers[0].y_m == pytest.approx(9.0 - 4.1 * 1.3)
    drive_on(world, 10.0, 8.5)
    assert not car.is_here or car.x_m == pytest.approx(states[50][0])
    assert world.taken_out == []


def behind() -> Place:
    """Return a place with the truck alone, which follows the ego in its lane."""
    recording = read("cut-in", "<y>3.50</y>", "<y>0.00</y>")
    return place_of(replace(recording, road_users=recording.road_users[1:2]))


def test_who_drives_into_the_ego_from_behind_is_taken_out() -> None:
    world = make_recorded_world(behind(), speed_share=1.0, reacting=False)
    drive_on(world, 6.0, 1.0)
    assert world.taken_out == ["truck-11"]
    assert not world.vehicles[0].is_here


def test_vehicles_that_react_keep_their_distance_and_catch_up() -> None:
    world = make_recorded_world(behind(), speed_share=1.0, reacting=True)
    truck, gaps = world.vehicles[0], []
    for step in range(round(9.9 / CONTROL_STEP_S)):
        if step == 120:
            world.ego.y_m = 3.5  # out of its way
        world.ego.x_m += 4.0 * CONTROL_STEP_S
        world.ego.speed_mps = 4.0
        world.advance(step)
        if step < 120:
            gaps.append(signed_gap_m(Rectangle.of(world.ego), Rectangle.of(truck)))
    assert min(gaps) > 1.0
    assert world.taken_out == []
    assert truck.speed_mps == pytest.approx(10.5, abs=0.5)  # 2 m/s faster than recorded, to catch up


def spec(name: str, *errors: dict[str, Any], **scenario: Any) -> EpisodeSpec:
    text = packed(
        example_document()
        if name == "braking"
        else document_of((FOLDER / f"{name}.xml").read_text(encoding="utf-8"))
    )
    return EpisodeSpec(
        simulator="commonroad@1",
        scenario={"file": name, "recording": text, "start_speed": 1.0, "reacting": False, **scenario},
        behaviour={"mode": "errors", "on": "objects", "errors": list(errors)},
        requirements=("no-collision@1", "on-road"),
        formulas=FORMULAS,
        seed=3,
        duration_s=8.0,
    )


@pytest.mark.parametrize("name", ["braking", "bend"])
def test_a_lead_that_is_not_reported_is_hit(name: str) -> None:
    simulator = CommonRoadDrive()
    safe = simulator.run(spec(name))
    assert not safe.verdicts["no-collision@1"].violated
    assert not safe.verdicts["on-road"].violated
    hit = simulator.run(spec(name, MISS), record=True)
    assert hit.verdicts["no-collision@1"].violated
    assert hit.features["collided_with"] == "car-10"
    assert hit.trace is not None
    trace = Trace.from_bytes(hit.trace)
    assert trace.about["words"] == (
        f"{name}, starts at 100% of the recorded speed; the lead is not reported for 8.0 s from 0.0 s on"
    )
    assert "road" in {surface.kind for surface in trace.scene}
    assert [event.kind for event in trace.events].count("collision") == 1


@pytest.mark.parametrize(("low", "high", "holds"), [(-0.1, 0.1, True), (6.2, 6.4, True), (1.0, 2.0, False)])
def test_a_goal_has_a_heading_whole_turns_aside(low: float, high: float, holds: bool) -> None:
    document = example_document()
    area = [[-5_000, 10_000, 0, -10_000], [-2_000, 0, 4_000, 0]]
    goal = {**document["goals"][0], "areas": [area], "steps": [0, 80], "yaw_rad": [low, high]}
    place = place_of(Recording.of({**document, "goals": [goal]}))
    world = make_recorded_world(place, speed_share=1.0, reacting=False)
    assert world.goal_reached(0.0) == holds
    assert not world.goal_reached(8.1)


def test_the_goal_ends_a_drive_in_its_time_alone() -> None:
    document = example_document()
    place = {"areas": [[[20_000, 80_000, 0, -80_000], [-2_000, 0, 4_000, 0]]], "lanelets": []}
    results = []
    for steps in ([0, 80], [79, 80]):
        goal = {**document["goals"][0], **place, "steps": steps}
        drive = spec("braking")
        text = packed({**document, "goals": [goal]})
        result = CommonRoadDrive().run(replace(drive, scenario={**drive.scenario, "recording": text}))
        results.append((result.features["ended"], result.features["ended_at_s"]))
    (early, early_s), (late, late_s) = results
    assert (early, late) == ("goal", "goal")
    assert isinstance(early_s, float)
    assert early_s < 4.0
    assert late_s == pytest.approx(7.9, abs=0.051)
