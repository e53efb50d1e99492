"""Reference lines, roads, scenery, traffic lights, weather and random streams."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import LightState
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import CROSSING_WIDTH_M, CYCLE_S, SignalPlan, build_road, ego_route, stream_lane
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, Weather
from brink.sim.world.scenery import fixtures, scene_surfaces
from brink.sim.world.streams import Stream, generator
from brink.sim.world.weather import conditions

curvatures = st.one_of(st.just(0.0), st.floats(1 / 60, 1 / 8), st.floats(-1 / 8, -1 / 60))
pieces = st.lists(
    st.builds(Piece, st.floats(0.5, 11.0), curvatures), min_size=1, max_size=5
)  # at most a quarter circle each
lines = st.builds(ReferenceLine, st.floats(-50, 50), st.floats(-50, 50), st.floats(-math.pi, math.pi), pieces)


@given(lines, st.floats(-40, 80), st.floats(-3, 3), st.floats(-3, 3))
def test_projection_is_inverse(line: ReferenceLine, station_m: float, offset_m: float, hint_m: float) -> None:
    x_m, y_m, _ = line.pose_at(station_m, offset_m)
    found = line.project(x_m, y_m, station_m + hint_m)
    assert found == pytest.approx((station_m, offset_m), abs=1e-6)


@given(lines)
def test_a_line_has_no_gaps_and_no_kinks(line: ReferenceLine) -> None:
    at_m = 0.0
    for piece in line.pieces:
        before, after = line.pose_at(at_m - 1e-7), line.pose_at(at_m + 1e-7)
        assert math.dist(before[:2], after[:2]) < 1e-6
        assert math.cos(before[2] - after[2]) > 1 - 1e-9
        at_m += piece.length_m


@given(lines, st.floats(-3, 3), st.floats(0, 1))
def test_a_parallel_line_keeps_its_offset(line: ReferenceLine, offset_m: float, share: float) -> None:
    beside = line.parallel(offset_m)
    x_m, y_m, yaw_rad = beside.pose_at(share * beside.length_m)
    station_m, found_m = line.project(x_m, y_m, share * line.length_m)
    assert found_m == pytest.approx(offset_m, abs=1e-6)
    assert math.cos(line.pose_at(station_m)[2] - yaw_rad) == pytest.approx(1.0)


@given(lines, st.floats(0, 1))
def test_a_reversed_line_is_the_same_curve_in_the_other_direction(line: ReferenceLine, share: float) -> None:
    station_m = share * line.length_m
    there = line.pose_at(station_m, 1.0)
    back = line.backwards().pose_at(line.length_m - station_m, -1.0)
    assert there[:2] == pytest.approx(back[:2], abs=1e-6)
    assert math.cos(there[2] - back[2]) == pytest.approx(-1.0)


@given(lines, st.floats(0.1, 1.5))
def test_the_head_and_tail_of_a_line_add_up_to_the_line(line: ReferenceLine, share: float) -> None:
    cut_m = share * line.length_m
    whole = line.up_to(cut_m, *line.pieces_from(cut_m))
    for station_m in (0.0, 0.5 * cut_m, cut_m, 0.5 * (cut_m + line.length_m)):
        assert whole.pose_at(station_m) == pytest.approx(line.pose_at(station_m), abs=1e-6)


def test_a_line_without_pieces_is_rejected() -> None:
    with pytest.raises(ValueError, match="at least one"):
        ReferenceLine(0.0, 0.0, 0.0, [])


def test_a_parallel_line_beyond_the_centre_of_an_arc_is_rejected() -> None:
    with pytest.raises(ValueError, match="centre of an arc"):
        ReferenceLine(0.0, 0.0, 0.0, [Piece(5.0, 0.1)]).parallel(10.0)


ROADS = [
    build_road(curve, road_id, length)
    for curve, road_id, length in itertools.product(RoadCurve, range(3), range(3))
]


@pytest.mark.parametrize("task", list(DrivingTask))
def test_routes_have_no_gaps_and_lead_where_the_task_says(task: DrivingTask) -> None:
    turned = {
        DrivingTask.FOLLOW_ROAD: 0.0,
        DrivingTask.FIRST_EXIT: -0.5 * math.pi,
        DrivingTask.SECOND_EXIT: 0.5 * math.pi,
    }
    for road in ROADS:
        route = ego_route(road, task)
        junction = road.junctions[0 if task is DrivingTask.FIRST_EXIT else -1]
        end = route.pose_at(route.length_m)[2]
        expected = road.centre.pose_at(road.length_m)[2] if task is DrivingTask.FOLLOW_ROAD else None
        if expected is None:
            expected = junction.yaw_rad + turned[task]
        assert math.cos(end - expected) == pytest.approx(1.0)
        points = [route.pose_at(0.5 * i)[:2] for i in range(int(2 * route.length_m))]
        steps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
        assert max(steps) < 0.5 + 1e-6
        assert min(steps) > 0.49


def test_only_junctions_with_lights_have_stop_lines_before_them() -> None:
    for road, task in itertools.product(ROADS, DrivingTask):
        route = ego_route(road, task)
        if road.curve is RoadCurve.CROSSROAD:
            (line_m,) = route.stop_line_stations_m
            assert 10.0 < line_m < road.junctions[0].forward_m - 2 * road.style.lane_width_m + 3.0
        else:
            assert route.stop_line_stations_m == ()


def test_no_dash_is_on_the_crossing_or_in_a_junction() -> None:
    for road in ROADS:
        dashes = [surface.points for surface in scene_surfaces(road) if surface.kind == "marking"]
        for points in dashes:
            for x_m, y_m in points.tolist():
                station_m, offset_m = road.centre.project(x_m, y_m, road.crossing_m)
                is_near = math.dist(road.centre.pose_at(station_m, offset_m)[:2], (x_m, y_m)) < 0.01
                if is_near and abs(offset_m) < 0.05:
                    assert abs(station_m - road.crossing_m) >= 0.5 * CROSSING_WIDTH_M - 0.01
                    assert all(abs(station_m - one.station_m) > road.kerb_m for one in road.junctions)


def test_traffic_stops_at_a_line_on_each_arm_of_a_lit_junction() -> None:
    for road in ROADS:
        (junction, *_) = road.junctions
        lines = [one for one in scene_surfaces(road) if one.kind == "marking" and one.closed]
        if not junction.lit:
            assert lines == []
            continue
        for line in lines:
            x_m, y_m = line.points.mean(axis=0).tolist()
            away_rad = math.atan2(y_m - junction.y_m, x_m - junction.x_m) - junction.yaw_rad
            out_m = math.dist((x_m, y_m), (junction.x_m, junction.y_m))
            assert out_m * math.cos(math.remainder(away_rad, 0.5 * math.pi)) == pytest.approx(
                road.stop_line_before_junction_m, abs=1e-3
            )
            # Those who come in keep right: their line is to the left of the direction out.
            assert math.remainder(away_rad, 0.5 * math.pi) > 0.0
        assert len(lines) == 1 + junction.right + junction.left


def test_there_is_no_oncoming_lane_inside_a_turn() -> None:
    for road, task in itertools.product(ROADS, (DrivingTask.FIRST_EXIT, DrivingTask.SECOND_EXIT)):
        route = ego_route(road, task)
        at_m = 0.0
        for piece in route.line.pieces:
            if abs(piece.curvature_1pm) > 1 / 12:
                assert not route.oncoming_lane_at(at_m + 0.5 * piece.length_m)
            at_m += piece.length_m
        assert route.oncoming_lane_at(2.0)


def test_no_fixture_stands_on_a_lane() -> None:
    for road in ROADS:
        lanes = [road.forward, road.backward, stream_lane(road, 1), stream_lane(road, 2)]
        samples = [lane.pose_at(2.0 * i)[:2] for lane in lanes for i in range(int(road.length_m / 2))]
        for fixture in fixtures(road):
            cos_yaw, sin_yaw = math.cos(fixture.yaw_rad), math.sin(fixture.yaw_rad)
            for x_m, y_m in samples:
                dx, dy = x_m - fixture.x_m, y_m - fixture.y_m
                along, across = abs(dx * cos_yaw + dy * sin_yaw), abs(dy * cos_yaw - dx * sin_yaw)
                inside = along < 0.5 * fixture.length_m + 1.0 and across < 0.5 * fixture.width_m + 1.0
                assert not inside, (road.curve, fixture)


@given(st.floats(0, CYCLE_S), st.floats(0, 200))
def test_one_direction_is_always_red(phase_s: float, time_s: float) -> None:
    plan = SignalPlan(phase_s=phase_s)
    assert LightState.RED in (plan.main_at(time_s), plan.side_at(time_s))


@given(st.floats(0, CYCLE_S), st.floats(0, 200))
def test_red_lasts_for_the_predicted_time(phase_s: float, time_s: float) -> None:
    plan = SignalPlan(phase_s=phase_s)
    left_s = plan.main_red_for_s(time_s)
    if plan.main_at(time_s) is LightState.RED:
        assert plan.main_at(time_s + left_s - 1e-6) is LightState.RED
        assert plan.main_at(time_s + left_s + 1e-6) is LightState.GREEN
    else:
        assert left_s == 0.0


def test_random_streams_are_independent() -> None:
    first = generator(7, Stream.VEHICLE, 1).random(4)
    generator(7, Stream.VEHICLE, 0).random(100)
    assert (generator(7, Stream.VEHICLE, 1).random(4) == first).all()
    others = [
        generator(8, Stream.VEHICLE, 1),
        generator(7, Stream.PEDESTRIAN, 1),
        generator(7, Stream.VEHICLE),
    ]
    assert all((other.random(4) != first).all() for other in others)


def test_friction_depends_on_the_road_surface() -> None:
    expected = {
        Weather.CLEAR: 0.9,
        Weather.CLOUDY: 0.9,
        Weather.WET: 0.6,
        Weather.WET_CLOUDY: 0.6,
        Weather.MEDIUM_RAIN: 0.5,
        Weather.HARD_RAIN: 0.4,
    }
    for weather, friction in expected.items():
        assert conditions(TimeOfDay.NOON, weather).friction == friction
    assert 0.5 < conditions(TimeOfDay.NOON, Weather.SOFT_RAIN).friction < 0.6
