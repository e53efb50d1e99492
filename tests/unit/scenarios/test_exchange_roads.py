"""Exported roads, read back from OpenDRIVE, against the driving world: all road kinds, to less than a centimetre."""

import math
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import pytest
from support.standards import NetworkReader, RoadReader, number, schema_errors

from brink.scenarios.opendrive import opendrive
from brink.scenarios.street_network import street_network
from brink.scenarios.urban_network import UrbanGround, reach_of, urban_network
from brink.sim.aeb.specification import AebScenario, Occluder
from brink.sim.aeb.street import KERB_M, LANE_Y_M, PAVEMENT_M, make_street
from brink.sim.world.line import ReferenceLine
from brink.sim.world.road import (
    CROSSING_WIDTH_M,
    STOP_LINE_BEFORE_CROSSING_M,
    Road,
    build_road,
    ego_route,
    joining_lane,
    side_lane,
    stream_lane,
)
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, Weather
from brink.sim.world.scenery import BEFORE_M, BEYOND_M, fixtures

CREATED_AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
OPENDRIVE = "opendrive_17_core.xsd"
CLOSE_M = 0.01
KINDS = [
    (curve, road_id, (road_id + place) % 3) for place, curve in enumerate(RoadCurve) for road_id in range(3)
]
"""Every curve with every style and every length; of one curve, each style has another length."""
ALL_ROADS = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: "-".join(map(str, kind)))


@cache
def exported(kind: tuple[RoadCurve, int, int]) -> tuple[Road, NetworkReader]:
    road = build_road(*kind)
    return road, NetworkReader(opendrive(urban_network(road, reach_of(road, ())), CREATED_AT))


def along(
    line: ReferenceLine, from_m: float, to_m: float, every_m: float = 1.0
) -> list[tuple[float, float, float]]:
    count = math.ceil((to_m - from_m) / every_m)
    return [line.pose_at(from_m + (to_m - from_m) * index / count) for index in range(count + 1)]


def main_roads(network: NetworkReader) -> list[RoadReader]:
    return [road for road in network.roads.values() if len(road.id) == 1]


@ALL_ROADS
def test_every_road_kind_is_valid_against_the_schema(
    kind: tuple[RoadCurve, int, int], tmp_path: Path
) -> None:
    _, network = exported(kind)
    file = tmp_path / "road.xodr"
    ET.ElementTree(network.root).write(file)
    assert schema_errors(file, OPENDRIVE) == []
    header = network.root.find("header")
    assert header is not None
    assert (header.attrib["revMajor"], header.attrib["revMinor"]) == ("1", "7")
    assert header.attrib["date"] == "2026-01-02T03:04:05+00:00"


@ALL_ROADS
def test_every_lane_of_the_world_is_the_middle_of_an_exported_lane(kind: tuple[RoadCurve, int, int]) -> None:
    road, network = exported(kind)
    width_m = road.style.lane_width_m
    lines = [road.forward, road.backward, *(stream_lane(road, stream) for stream in (1, 2))]
    lines += [ego_route(road, task).line for task in DrivingTask]
    for junction in road.junctions:
        if junction.right and junction.left:
            lines += [side_lane(junction, width_m, from_right=right) for right in (True, False)]
        elif junction.right:
            lines.append(joining_lane(road, junction))
    for line in lines:
        for x_m, y_m, yaw_rad in along(line, 0.0, min(line.length_m, road.length_m + 15.0)):
            assert network.lanes_at(x_m, y_m, yaw_rad)[0].across_m < CLOSE_M, (x_m, y_m)


@ALL_ROADS
def test_lanes_and_edges_of_the_main_road_are_where_the_world_has_them(
    kind: tuple[RoadCurve, int, int],
) -> None:
    road, network = exported(kind)
    pavement_m = road.kerb_m + road.style.pavement_m
    first_m = -BEFORE_M
    for part in main_roads(network):
        from_m = first_m
        for step in range(math.floor(part.length_m) + 1):
            for t_m in (part.centre_m(-1), part.edge_m(-1), part.edge_m(1), -pavement_m, pavement_m):
                point, heading = part.point(step, t_m)
                x_m, y_m, yaw_rad = road.centre.pose_at(from_m + step, t_m)
                assert math.hypot(point.real - x_m, point.imag - y_m) < CLOSE_M
                assert math.cos(heading - yaw_rad) > 1.0 - 1e-9
        for side in (-1, 1):
            outer = max(abs(lane) for lane in part.lanes if lane * side > 0)
            assert part.lane_kind(side * outer) == "sidewalk"
            assert part.edge_m(side * (outer - 1)) == pytest.approx(side * road.kerb_m, abs=1e-9)
            assert part.edge_m(side * outer) == pytest.approx(side * pavement_m, abs=1e-9)
            kinds = [part.lane_kind(side * index) for index in range(1, outer + 1)]
            assert kinds == ["driving", *(["parking"] if road.style.parking else []), "sidewalk"]
        first_m = from_m + part.length_m + 2.0 * junction_reach_m(network, part)
    assert first_m == pytest.approx(road.length_m + BEYOND_M, abs=1e-6)


def junction_reach_m(network: NetworkReader, part: RoadReader) -> float:
    """Return half the length of the way straight on at the end of a road; 0 if it ends in no junction."""
    after = part.link("successor")
    if after is None:
        return 0.0
    ways = [
        road
        for road in network.roads.values()
        if road.in_junction
        and road.link("predecessor") == (part.id, "end")
        and len((road.link("successor") or ("", ""))[0]) == 1
    ]
    (straight_on,) = ways
    return 0.5 * straight_on.length_m


@ALL_ROADS
def test_lanes_join_at_junctions_in_place_direction_and_height(kind: tuple[RoadCurve, int, int]) -> None:
    _, network = exported(kind)
    connecting = [road for road in network.roads.values() if road.in_junction]
    assert len(connecting) == 12
    for road in connecting:
        for name, own_s_m in (("predecessor", 0.0), ("successor", road.length_m)):
            found = road.link(name)
            assert found is not None
            other = network.roads[found[0]]
            other_s_m = 0.0 if found[1] == "start" else other.length_m
            assert road.height_m(own_s_m) == pytest.approx(other.height_m(other_s_m), abs=1e-6)
            for lane, element in road.lanes.items():
                linked = element.find(f"link/{name}")
                assert linked is not None
                joined = int(linked.attrib["id"])
                for own_t, other_t in (
                    (road.centre_m(lane), other.centre_m(joined)),
                    (road.edge_m(lane), other.edge_m(joined)),
                ):
                    here, heading = road.point(own_s_m, own_t)
                    there, other_heading = other.point(other_s_m, other_t)
                    assert abs(here - there) < 1e-6
                    turned = math.pi if joined > 0 else 0.0
                    assert math.cos(heading - other_heading - turned) > 1.0 - 1e-9


@ALL_ROADS
def test_junctions_list_every_way_with_its_lanes(kind: tuple[RoadCurve, int, int]) -> None:
    _, network = exported(kind)
    listed = {}
    for junction in network.root.iterfind("junction"):
        for connection in junction.iterfind("connection"):
            assert connection.attrib["contactPoint"] == "start"
            links = {
                int(link.attrib["to"]): int(link.attrib["from"]) for link in connection.iterfind("laneLink")
            }
            listed[connection.attrib["connectingRoad"]] = (connection.attrib["incomingRoad"], links)
    assert set(listed) == {road.id for road in network.roads.values() if road.in_junction}
    for road_id, (incoming, links) in listed.items():
        road = network.roads[road_id]
        before = road.link("predecessor")
        assert before is not None
        assert incoming == before[0]
        for lane, element in road.lanes.items():
            linked = element.find("link/predecessor")
            assert linked is not None
            assert links[lane] == int(linked.attrib["id"])


@ALL_ROADS
def test_the_main_road_slopes_and_side_streets_are_level(kind: tuple[RoadCurve, int, int]) -> None:
    road, network = exported(kind)
    ground = UrbanGround(road)
    for part in network.roads.values():
        if part.in_junction:
            continue
        for s_m in (0.0, 0.5 * part.length_m, part.length_m):
            point, heading = part.point(s_m, part.centre_m(-1))
            height_m, slope = ground.at(point.real, point.imag, heading, on_foot=False)
            if len(part.id) == 1:
                station_m, _ = road.centre.project(point.real, point.imag, 0.5 * road.length_m)
                assert part.height_m(s_m) == pytest.approx(road.style.grade * station_m, abs=1e-6)
                assert slope == pytest.approx(road.style.grade, abs=1e-6)
            else:
                assert part.height_m(s_m) == part.height_m(0.0)
            assert height_m == pytest.approx(part.height_m(s_m), abs=1e-6)


@ALL_ROADS
def test_the_ground_under_the_ego_is_the_exported_surface(kind: tuple[RoadCurve, int, int]) -> None:
    road, network = exported(kind)
    ground = UrbanGround(road)
    for task in DrivingTask:
        line, last_m = ego_route(road, task).line, math.nan
        for x_m, y_m, yaw_rad in along(line, 0.0, line.length_m, every_m=0.5):
            height_m, slope = ground.at(x_m, y_m, yaw_rad, on_foot=False)
            lanes = [one for one in network.lanes_at(x_m, y_m, yaw_rad) if one.across_m < CLOSE_M]
            assert min(abs(height_m - one.road.height_m(one.s_m)) for one in lanes) < 0.02
            assert abs(slope) <= abs(road.style.grade) + 1e-9
            if not math.isnan(last_m):
                assert abs(height_m - last_m) < 0.5 * abs(road.style.grade) + 0.02, "no steps"
            last_m = height_m


@ALL_ROADS
def test_objects_stand_where_the_scenery_has_them(kind: tuple[RoadCurve, int, int]) -> None:
    road, network = exported(kind)
    for word in ("building", "tree"):
        expected = sorted((one.x_m, one.y_m) for one in fixtures(road) if one.kind == word)
        got = []
        for part in network.roads.values():
            for one in part.objects(word):
                point, heading = part.point(number(one, "s"), number(one, "t"))
                got.append((point.real, point.imag))
                if word == "building":
                    (fixture,) = [
                        f
                        for f in fixtures(road)
                        if math.hypot(f.x_m - point.real, f.y_m - point.imag) < CLOSE_M
                    ]
                    assert math.cos(heading + number(one, "hdg") - fixture.yaw_rad) > 1.0 - 1e-9
                    assert number(one, "length") == pytest.approx(fixture.length_m)
                    assert number(one, "height") == fixture.height_m
        assert len(got) == len(expected)
        for (x_m, y_m), (other_x_m, other_y_m) in zip(sorted(got), expected, strict=True):
            assert math.hypot(x_m - other_x_m, y_m - other_y_m) < CLOSE_M


@ALL_ROADS
def test_the_crossing_and_the_stop_line_are_outlined(kind: tuple[RoadCurve, int, int]) -> None:
    road, network = exported(kind)
    half_m = 0.5 * CROSSING_WIDTH_M
    stop_m = road.crossing_m - half_m - STOP_LINE_BEFORE_CROSSING_M
    lane_m = road.style.lane_width_m
    expected = {
        "crosswalk": [
            road.centre.pose_at(road.crossing_m + u_m, v_m)
            for u_m in (-half_m, half_m)
            for v_m in (-road.kerb_m, road.kerb_m)
        ],
        "roadMark": [
            road.centre.pose_at(stop_m + u_m, v_m) for u_m in (-0.15, 0.15) for v_m in (-lane_m, -0.1)
        ]
        if road.junctions[0].lit
        else [],
    }
    for word, corners in expected.items():
        outlines = [outlined(part, one) for part in network.roads.values() for one in part.objects(word)]
        assert len(outlines) == (1 if corners else 0)
        for x_m, y_m, _ in corners:
            assert min(abs(corner - complex(x_m, y_m)) for corner in outlines[0]) < CLOSE_M


def outlined(part: RoadReader, one: ET.Element) -> list[complex]:
    middle, heading = part.point(number(one, "s"), number(one, "t"))
    turn = complex(math.cos(heading + number(one, "hdg")), math.sin(heading + number(one, "hdg")))
    return [
        middle + turn * complex(number(corner, "u"), number(corner, "v"))
        for corner in one.iter("cornerLocal")
    ]


@ALL_ROADS
def test_lights_stand_where_traffic_stops_and_are_controlled_in_two_groups(
    kind: tuple[RoadCurve, int, int],
) -> None:
    road, network = exported(kind)
    signals = [
        (part, one) for part in network.roads.values() for one in part.element.iterfind("signals/signal")
    ]
    if not road.junctions[0].lit:
        assert signals == []
        assert network.root.find("controller") is None
        return
    junction = road.junctions[0]
    assert [one.attrib["id"] for _, one in signals] == ["1", "2", "3", "4"]
    for part, one in signals:
        point, heading = part.point(number(one, "s"), number(one, "t"))
        middle, _ = part.point(number(one, "s"), 0.0)
        from_junction_m = abs(middle - complex(junction.x_m, junction.y_m))
        assert from_junction_m == pytest.approx(road.stop_line_before_junction_m, abs=CLOSE_M)
        against = 0.0 if one.attrib["orientation"] == "+" else math.pi
        inward = complex(junction.x_m, junction.y_m) - middle
        driving = complex(math.cos(heading + against), math.sin(heading + against))
        assert (inward * driving.conjugate()).real > 0.0, "for traffic towards the junction"
        assert ((point - middle) * driving.conjugate()).imag < 0.0, "on its right"
    groups = {
        one.attrib["id"]: [control.attrib["signalId"] for control in one]
        for one in network.root.iterfind("controller")
    }
    assert groups == {"1": ["1", "2"], "2": ["3", "4"]}
    assert [one.attrib["id"] for one in network.root.iterfind("junction/controller")] == ["1", "2"]


def test_roads_reach_beyond_every_road_user() -> None:
    road = build_road(RoadCurve.CROSSROAD, 0, 0)
    junction = road.junctions[0]
    points = [(-180.0, 1.7), (road.length_m + 333.0, -1.7), (junction.x_m + 1.7, 240.0), (30.0, 90.0)]
    network = NetworkReader(opendrive(urban_network(road, reach_of(road, points)), CREATED_AT))
    for x_m, y_m in points[:3]:
        assert network.lanes_at(x_m, y_m)[0].across_m < 0.1
    assert network.lanes_at(*points[3]) == [], "off the road"


def test_the_emergency_brakes_street_is_one_straight_road(tmp_path: Path) -> None:
    scenario = AebScenario(
        time_of_day=TimeOfDay.NOON,
        weather=Weather.CLEAR,
        occluder=Occluder.VAN,
        crossing_m=55.0,
        arrival_s=0.0,
        oncoming_m=60.0,
    )
    street = make_street(scenario, 4)
    root = opendrive(street_network(street, -70.0, 140.0), CREATED_AT)
    file = tmp_path / "road.xodr"
    ET.ElementTree(root).write(file)
    assert schema_errors(file, OPENDRIVE) == []
    (road,) = NetworkReader(root).roads.values()
    first, _ = road.reference(0.0)
    last, _ = road.reference(road.length_m)
    assert first.real <= -70.0
    assert last.real >= 160.0
    assert road.point(0.0, road.centre_m(-1))[0].imag == pytest.approx(LANE_Y_M)
    assert road.edge_m(-2) == pytest.approx(-KERB_M)
    assert road.edge_m(3) == pytest.approx(KERB_M + PAVEMENT_M)
    for one in (*road.objects("building"), *road.objects("tree"), *road.objects("streetLamp")):
        assert 0.0 <= number(one, "s") <= road.length_m
    got = sorted(road.point(number(one, "s"), number(one, "t"))[0].real for one in road.objects("building"))
    assert got == pytest.approx(sorted(one.x_m for one in street.scene.buildings))
