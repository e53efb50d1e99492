import itertools
import math

import pytest

from brink.sim.urban.scenario import DrivingTask, RoadCurve
from brink.sim.world.road import LENGTHS_M, Road, build_road
from brink.sim.world.roadside import fixtures
from brink.sim.world.scene import scene_surfaces
from brink.sim.world.task import ego_route, stream_lane

ROADS = [
    build_road(curve, road_id, length)
    for curve, road_id, length in itertools.product(RoadCurve, range(3), range(3))
]


@pytest.mark.parametrize("length", range(3))
def test_roads_are_about_as_long_as_they_say(length: int) -> None:
    for curve in RoadCurve:
        assert build_road(curve, 0, length).forward.length_m == pytest.approx(LENGTHS_M[length], rel=0.05)


def test_the_three_roads_of_a_shape_differ() -> None:
    for curve in RoadCurve:
        styles = {build_road(curve, road_id, 1).style for road_id in range(3)}
        assert len(styles) == 3


@pytest.mark.parametrize("task", list(DrivingTask))
def test_routes_have_no_gaps_and_end_where_the_task_says(task: DrivingTask) -> None:
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


def test_stop_lines_are_there_only_at_lights_and_before_the_junction() -> None:
    for road, task in itertools.product(ROADS, DrivingTask):
        route = ego_route(road, task)
        if road.curve is RoadCurve.CROSSROAD:
            (line_m,) = route.stop_line_stations_m
            assert 10.0 < line_m < road.junctions[0].forward_m - 2 * road.style.lane_width_m + 3.0
        else:
            assert route.stop_line_stations_m == ()


def test_there_is_no_oncoming_lane_inside_a_turn() -> None:
    for road, task in itertools.product(ROADS, (DrivingTask.FIRST_EXIT, DrivingTask.SECOND_EXIT)):
        route = ego_route(road, task)
        at_m = 0.0
        for piece in route.line.pieces:
            if abs(piece.curvature_1pm) > 1 / 12:
                assert not route.oncoming_lane_at(at_m + 0.5 * piece.length_m)
            at_m += piece.length_m
        assert route.oncoming_lane_at(2.0)


def test_nothing_stands_on_any_lane() -> None:
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


def test_scenes_show_every_kind_of_surface() -> None:
    kinds = {surface.kind for road in ROADS for surface in scene_surfaces(road)}
    assert kinds == {
        "road",
        "pavement",
        "marking",
        "crossing",
        "stop-line",
        "building",
        "parked-car",
        "tree",
    }


def test_equal_roads_are_one_object() -> None:
    road: Road = build_road(RoadCurve.LEFT, 1, 2)
    assert build_road(RoadCurve.LEFT, 1, 2) is road
