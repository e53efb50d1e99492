"""Exported drives, read back from OpenSCENARIO: who is where when, against the trace, and what is around them."""

import csv
import itertools
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from support.drives import absent, encounter_drive, street_drive, urban_drive
from support.standards import NetworkReader, ScenarioReader, number, place, schema_errors
from support.traces import make_trace

from brink.scenarios.exportable import EXPORTABLE, PROBLEMS, EgoControl, NotExportable, check_exportable
from brink.scenarios.folder import Origin, write_openscenario
from brink.scenarios.opendrive import DRY_FRICTION, opendrive
from brink.scenarios.openscenario import openscenario
from brink.scenarios.worlds import world_of
from brink.sim.driving.interface import LightState
from brink.sim.trace import Trace
from brink.sim.world.road import build_road
from brink.sim.world.scenario import RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.scenery import fixtures
from brink.sim.world.weather import conditions
from brink.sim.world.world import signal_plan

CREATED_AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
OPENSCENARIO = "OpenSCENARIO_1_2.xsd"
CLOSE_M = 0.01
LAMPS = {"on;off;off": LightState.RED, "off;on;off": LightState.AMBER, "off;off;on": LightState.GREEN}
ORIGIN = Origin(campaign="3f2a0000", name="quickstart", number=17, words="a drive", deciding=("front-gap@1",))
URBAN = ("urban-2", "urban-4", "urban-7", "urban-10")
"""One drive on each curve."""
ALL_DRIVES = pytest.mark.parametrize("drive", [*URBAN, "encounter", "street"])
URBAN_DRIVES = pytest.mark.parametrize("drive", URBAN)


def trace_of(drive: str) -> Trace:
    if drive == "encounter":
        return encounter_drive()
    return street_drive() if drive == "street" else urban_drive(int(drive.removeprefix("urban-")))


def written(trace: Trace, ego: EgoControl = EgoControl.RECORDED) -> ScenarioReader:
    root = openscenario(
        trace, world_of(trace), ego=ego, road_file="road.xodr", title="a drive", created_at=CREATED_AT
    )
    return ScenarioReader(root)


@cache
def recorded(drive: str) -> ScenarioReader:
    return written(trace_of(drive))


@cache
def network_of(drive: str) -> NetworkReader:
    return NetworkReader(opendrive(world_of(trace_of(drive)).network, CREATED_AT))


def scenario_of(trace: Trace) -> UrbanScenario:
    spec = trace.about["spec"]
    assert isinstance(spec, Mapping)
    scenario = spec["scenario"]
    assert isinstance(scenario, Mapping)
    return UrbanScenario.from_json(scenario)


@ALL_DRIVES
@pytest.mark.parametrize("ego", EgoControl)
def test_every_drive_is_valid_against_the_schema(drive: str, ego: EgoControl, tmp_path: Path) -> None:
    files = write_openscenario(trace_of(drive), ORIGIN, tmp_path, ego=ego, created_at=CREATED_AT)
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    assert schema_errors(tmp_path / "scenario.xosc", OPENSCENARIO) == []
    assert schema_errors(tmp_path / "road.xodr", "opendrive_17_core.xsd") == []
    header = ET.parse(tmp_path / "scenario.xosc").getroot().find("FileHeader")
    assert header is not None
    assert (header.attrib["revMajor"], header.attrib["revMinor"]) == ("1", "2")


@ALL_DRIVES
def test_every_road_user_is_within_a_centimetre_of_the_trace(drive: str) -> None:
    trace, scenario = trace_of(drive), recorded(drive)
    kept = np.append(np.diff(trace.time_s) > 0.0, True)
    tracks = {"ego": trace.ego, **{actor.name: actor.motion for actor in trace.actors}}
    moving = {name: track for name, track in tracks.items() if name != "novelty"}
    for name, track in moving.items():
        (trajectory,) = scenario.trajectories(name)
        assert trajectory.time_s == pytest.approx(trace.time_s[kept], abs=1e-5)
        bodies = scenario.bodies(name)
        assert np.hypot(*(bodies - track[kept, :2]).T).max() < CLOSE_M
        assert np.cos(trajectory.places[:, 3] - track[kept, 2]).min() > 1.0 - 1e-6
        assert np.abs(np.diff(trajectory.places[:, 3])).max(initial=0.0) < math.pi, "headings do not jump"
        assert scenario.start(name) == pytest.approx(trajectory.places[0])
    times = scenario.root.findall(".//Timing")
    assert {(one.attrib["domainAbsoluteRelative"], one.attrib["scale"]) for one in times} == {
        ("absolute", "1.0")
    }


@ALL_DRIVES
def test_bodies_and_axles_agree_with_the_reference_point(drive: str) -> None:
    trace, scenario = trace_of(drive), recorded(drive)
    sizes = {
        "ego": trace.ego_size_m,
        **{actor.name: (actor.length_m, actor.width_m) for actor in trace.actors},
    }
    for name, body in scenario.entities().items():
        size = body.find("BoundingBox/Dimensions")
        assert size is not None
        length_m, height_m = number(size, "length"), number(size, "height")
        if name in sizes:
            assert (length_m, number(size, "width")) == pytest.approx(sizes[name], abs=1e-5)
        centre = body.find("BoundingBox/Center")
        assert centre is not None
        assert number(centre, "z") == pytest.approx(0.5 * height_m)
        if body.tag == "Vehicle":
            front, rear = body.find("Axles/FrontAxle"), body.find("Axles/RearAxle")
            assert front is not None
            assert rear is not None
            assert number(rear, "positionX") == 0.0
            assert number(front, "positionX") == pytest.approx(2.0 * scenario.centre_m(name))
            assert body.attrib["vehicleCategory"] == ("van" if length_m > 5.0 else "car")
            assert height_m == pytest.approx(2.3 if length_m > 5.0 else 1.5)
        else:
            assert scenario.centre_m(name) == 0.0
    ego = scenario.entities()["ego"]
    assert scenario.centre_m("ego") == pytest.approx(1.35)
    assert ego.find("Properties/Property[@value='ego_vehicle']") is not None


@ALL_DRIVES
def test_every_vehicle_drives_on_an_exported_lane(drive: str) -> None:
    trace, network = trace_of(drive), network_of(drive)
    for actor in trace.actors:
        if actor.kind == "vehicle":
            for x_m, y_m, _, _ in actor.motion[::10].tolist():
                lanes = network.lanes_at(x_m, y_m, kinds=("driving", "parking", "border"))
                assert any(one.across_m <= one.half_width_m for one in lanes), (actor.name, x_m, y_m)


@URBAN_DRIVES
def test_vehicles_stand_on_the_surface_of_their_lane_and_pitch_with_it(drive: str) -> None:
    scenario, network = recorded(drive), network_of(drive)
    for name in ("ego", "lead", "oncoming-1"):
        (trajectory,) = scenario.trajectories(name)
        for x_m, y_m, z_m, h_rad, _ in trajectory.places[::7].tolist():
            near = [one for one in network.lanes_at(x_m, y_m, h_rad) if one.across_m < 0.7]
            assert min(abs(z_m - one.road.height_m(one.s_m)) for one in near) < 0.05
        places = trajectory.places
        ways_m = np.hypot(*np.diff(places[:, :2], axis=0).T)
        climbs_m = -np.tan(0.5 * (places[:-1, 4] + places[1:, 4])) * ways_m
        assert places[-1, 2] - places[0, 2] == pytest.approx(climbs_m.sum(), abs=0.15)


@URBAN_DRIVES
def test_lights_show_what_they_showed(drive: str) -> None:
    trace, scenario = trace_of(drive), recorded(drive)
    spec = trace.about["spec"]
    assert isinstance(spec, Mapping)
    if scenario_of(trace).road_curve is not RoadCurve.CROSSROAD:
        assert scenario.root.find(".//TrafficSignals") is None
        assert not any(trace.lights)
        return
    plan = signal_plan(scenario_of(trace), int(str(spec["seed"])))
    for time_s, shown in zip(trace.time_s.astype(float).tolist(), trace.lights, strict=True):
        for signal, truth in (
            ("1", plan.main_at),
            ("2", plan.main_at),
            ("3", plan.side_at),
            ("4", plan.side_at),
        ):
            # A state may change within the rounding of the recorded time.
            states = {truth(time_s - 1e-4), truth(time_s + 1e-4)}
            assert LAMPS[scenario.lamps_at(signal, time_s)] in states
        if shown:
            assert LAMPS[scenario.lamps_at("1", time_s)].value == shown
    assert any(trace.lights)
    names = [one.attrib["name"] for one in scenario.root.iter("TrafficSignalController")]
    assert names == [one.attrib["id"] for one in network_of(drive).root.iterfind("controller")]


@URBAN_DRIVES
def test_parked_cars_stand_where_the_scenery_has_them(drive: str) -> None:
    trace, scenario = trace_of(drive), recorded(drive)
    place_ = scenario_of(trace)
    road = build_road(place_.road_curve, place_.road_id, place_.road_length)
    expected = [one for one in fixtures(road) if one.kind == "parked-car"]
    parked = [name for name in scenario.entities() if name.startswith("parked-")]
    assert len(parked) == len(expected)
    for name, car in zip(parked, expected, strict=True):
        start = scenario.start(name)
        assert start is not None
        x_m, y_m, _, h_rad, _ = start
        ahead_m = scenario.centre_m(name)
        assert (
            math.hypot(x_m + ahead_m * math.cos(h_rad) - car.x_m, y_m + ahead_m * math.sin(h_rad) - car.y_m)
            < CLOSE_M
        )
        assert scenario.events(name) == []


@pytest.mark.parametrize("drive", ["urban-2", "urban-7", "urban-10", "encounter", "street"])
def test_a_controlled_ego_has_a_start_a_speed_and_a_route(drive: str) -> None:
    trace = trace_of(drive)
    controlled, recorded_ = written(trace, EgoControl.CONTROLLED), recorded(drive)
    assert controlled.trajectories("ego") == []
    assert controlled.start("ego") == recorded_.start("ego")
    assert controlled.parameter("ego_start_speed_mps") == pytest.approx(float(trace.ego[0, 3]), abs=1e-5)
    private = controlled.root.find(".//Init//Private[@entityRef='ego']")
    assert private is not None
    (speed,) = private.iter("AbsoluteTargetSpeed")
    assert speed.attrib["value"] == "$ego_start_speed_mps"
    (assigned,) = private.iter("AssignControllerAction")
    assert (assigned.attrib["activateLateral"], assigned.attrib["activateLongitudinal"]) == ("true", "true")
    (route,) = private.iter("Route")
    points = [world_place(one) for one in route.iter("Waypoint")]
    for x_m, y_m, h_rad in points:
        assert network_of(drive).lanes_at(x_m, y_m, h_rad)[0].across_m < CLOSE_M
    apart = [math.dist(one[:2], other[:2]) for one, other in itertools.pairwise(points)]
    assert min(apart) > 0.05
    others = [name for name in recorded_.entities() if name != "ego"]
    assert [name for name in controlled.entities() if name != "ego"] == others
    for name in others:
        assert len(controlled.trajectories(name)) == len(recorded_.trajectories(name))
    assert recorded_.root.find(".//AssignControllerAction") is None


def world_place(waypoint: ET.Element) -> tuple[float, float, float]:
    found = next(waypoint.iter("WorldPosition"))
    return number(found, "x"), number(found, "y"), number(found, "h")


def test_absent_road_users_enter_and_leave() -> None:
    trace = absent(urban_drive(1), "lead", (0, 12), (40, 60), (100, 10_000))
    scenario = written(trace)
    events = scenario.events("lead")
    assert [next(iter(event)).attrib["name"] for event in events] == [
        "lead enters 1",
        "lead moves 1",
        "lead leaves 1",
        "lead enters 2",
        "lead moves 2",
        "lead leaves 2",
    ]
    assert scenario.start("lead") is None
    assert scenario.start("oncoming-1") is not None
    for (first, end), moved, (enters, moves, leaves) in zip(
        ((12, 40), (60, 100)), scenario.trajectories("lead"), (events[:3], events[3:]), strict=True
    ):
        assert moved.time_s == pytest.approx(trace.time_s[first:end], abs=1e-5)
        (added,) = enters.iter("AddEntityAction")
        assert place(added) == pytest.approx(moved.places[0])
        assert begins_s(enters) == pytest.approx(float(trace.time_s[first]), abs=1e-5)
        (after,) = moves.iter("StoryboardElementStateCondition")
        assert after.attrib["storyboardElementRef"] == enters.attrib["name"], "it moves once it is there"
        assert next(leaves.iter("EntityAction")).attrib["entityRef"] == "lead"
        assert next(leaves.iter("DeleteEntityAction")) is not None
        assert begins_s(leaves) == pytest.approx(float(trace.time_s[end]), abs=1e-5)


def begins_s(event: ET.Element) -> float:
    (condition,) = event.iter("SimulationTimeCondition")
    assert condition.attrib["rule"] == "greaterOrEqual"
    return number(condition, "value")


@pytest.mark.parametrize(("gaps", "events"), [([(0, 30), (31, 10_000)], 2), ([(0, 10_000)], 0)])
def test_a_road_user_seen_once_or_never_does_not_move(
    gaps: list[tuple[int, int]], events: int, tmp_path: Path
) -> None:
    trace = absent(urban_drive(1), "lead", *gaps)
    times_s = [begins_s(event) for event in written(trace).events("lead")]
    assert len(times_s) == events
    assert times_s == sorted(times_s)
    write_openscenario(trace, ORIGIN, tmp_path, ego=EgoControl.RECORDED, created_at=CREATED_AT)
    assert schema_errors(tmp_path / "scenario.xosc", OPENSCENARIO) == []


def test_the_last_of_two_samples_at_the_same_time_counts() -> None:
    trace = urban_drive(0)
    times = trace.time_s.copy()
    times[-1] = times[-2]
    (trajectory,) = written(replace(trace, time_s=times)).trajectories("ego")
    assert (np.diff(trajectory.time_s) > 0.0).all()
    assert len(trajectory.time_s) == len(times) - 1
    (whole,) = recorded("urban-0").trajectories("ego")
    assert trajectory.places[-1] == pytest.approx(whole.places[-1])


@pytest.mark.parametrize("time_of_day", TimeOfDay)
@pytest.mark.parametrize("weather", Weather)
def test_weather_is_written_for_every_word(time_of_day: TimeOfDay, weather: Weather, tmp_path: Path) -> None:
    trace = encounter_drive()
    spec = trace.about["spec"]
    assert isinstance(spec, Mapping)
    place_ = spec["scenario"]
    assert isinstance(place_, Mapping)
    changed = {**place_, "time_of_day": time_of_day.value, "weather": weather.value}
    trace = replace(trace, about={**trace.about, "spec": {**spec, "scenario": changed}})
    write_openscenario(trace, ORIGIN, tmp_path, ego=EgoControl.RECORDED, created_at=CREATED_AT)
    assert schema_errors(tmp_path / "scenario.xosc", OPENSCENARIO) == []
    scenario = ScenarioReader(ET.parse(tmp_path / "scenario.xosc").getroot())
    friction = scenario.parameter("friction_scale") * DRY_FRICTION
    assert friction == pytest.approx(conditions(time_of_day, weather).friction, abs=1e-6)
    condition = next(scenario.root.iter("RoadCondition"))
    assert condition.attrib["frictionScaleFactor"] == "$friction_scale"
    rain = next(scenario.root.iter("Precipitation"))
    assert (rain.attrib["precipitationType"] == "rain") == ("rain" in weather)
    assert (number(rain, "precipitationIntensity") > 0.0) == ("rain" in weather)
    assert (condition.attrib["wetness"] == "dry") == (weather in (Weather.CLEAR, Weather.CLOUDY))
    sun = next(scenario.root.iter("Sun"))
    assert (number(sun, "elevation") < 0.0) == (time_of_day is TimeOfDay.NIGHT)
    assert 0.0 <= number(sun, "azimuth") < 2.0 * math.pi


def test_boxes_and_verdicts_stand_beside_the_scenario(tmp_path: Path) -> None:
    trace = urban_drive(4)
    write_openscenario(trace, ORIGIN, tmp_path, ego=EgoControl.RECORDED, created_at=CREATED_AT)
    with (tmp_path / "boxes.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == len(trace.seen_boxes.rows) + len(trace.given_boxes.rows) > 0
    assert list(rows[0])[3:] == ["x_min_px", "x_max_px", "y_min_px", "y_max_px"]
    verdicts = json.loads((tmp_path / "verdicts.json").read_text())
    assert (verdicts["campaign"], verdicts["solution"], verdicts["spec"]["seed"]) == ("3f2a0000", 17, 4)
    assert list(verdicts["requirements"]) == ["front-gap@1", "no-collision@1", "red-light@1"]
    for name, one in verdicts["requirements"].items():
        least = float(trace.robustness[name].min())
        assert one["robustness"] == (pytest.approx(least, abs=1e-5) if math.isfinite(least) else None)
        assert one["violated"] == (least < 0.0) == (one["violated_at_s"] is not None)
        assert one["decides_the_verdict"] == (name == "front-gap@1")
        assert one["unit"] == "m"


def test_the_same_drive_is_exported_to_the_same_files(tmp_path: Path) -> None:
    for name in ("one", "other"):
        write_openscenario(
            urban_drive(10), ORIGIN, tmp_path / name, ego=EgoControl.RECORDED, created_at=CREATED_AT
        )
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "other" / file.name).read_bytes(), file.name


def test_a_drive_without_known_roads_is_refused() -> None:
    with pytest.raises(
        NotExportable, match=r"no roads that can be exported; expected a drive of urban-injected@1"
    ):
        world_of(make_trace())
    for simulator in ("brink-dataset@2", "mine@1"):
        with pytest.raises(NotExportable, match=f"a drive of {simulator}"):
            check_exportable(simulator)
    with pytest.raises(NotExportable, match="that was not simulated"):
        check_exportable(None)


def test_the_problems_named_in_the_refusal_are_those_with_exportable_drives() -> None:
    found = []
    for point in entry_points(group="brink.problems"):
        problem = point.load()
        if getattr(problem(problem.params_type()), "needs", None) in EXPORTABLE:
            found.append(point.name)
    assert sorted(found) == sorted(PROBLEMS)
