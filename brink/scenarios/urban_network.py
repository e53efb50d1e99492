"""The road network of the urban world, with its junctions, and the height of its ground.

Each road is cut where its junctions begin, at the distance at which a right turn leaves its lane. There, the
reference lines of turns continue those of the roads that they connect: every lane of the network joins the next one.

The main road slopes and its side streets are level, as for the ego. Turns blend between the two.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.scenarios.network import (
    Contact,
    Dashes,
    Elevation,
    JunctionPart,
    Lane,
    LaneKind,
    Link,
    RoadNetwork,
    RoadObject,
    RoadPart,
    SignalGroup,
    TrafficLight,
    quarter_turn,
    stretch,
)
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import (
    CROSSING_WIDTH_M,
    LEFT_TURN_RADIUS_M,
    PARKING_STRIP_M,
    RIGHT_TURN_RADIUS_M,
    SPEED_LIMIT_MPS,
    STOP_LINE_BEFORE_CROSSING_M,
    Junction,
    Road,
)
from brink.sim.world.scenery import BEFORE_M, BEYOND_M, DASH_M, fixtures

MARKING_WIDTH_M: Final = 0.15
STOP_LINE_WIDTH_M: Final = 0.3
LIGHT_BESIDE_KERB_M: Final = 0.5
NEAR_M: Final = 6.0
"""A road user within this distance of a street's pavement is on that street."""
SPARE_M: Final = 10.0
"""Roads continue this far beyond the last road user on them."""
MAIN_LIGHTS, SIDE_LIGHTS = 1, 2
"""Ids of the two groups of traffic lights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """How far the roads of a network reach.

    Attributes:
        before_m: Beyond the start of the main road.
        beyond_m: Beyond its end.
        side_m: Along side streets, from the middle of their junction.
    """

    before_m: float
    beyond_m: float
    side_m: float


def junction_reach_m(road: Road) -> float:
    """Return the distance from the middle of a junction at which its connecting roads begin."""
    return RIGHT_TURN_RADIUS_M + 0.5 * road.style.lane_width_m


def reach_of(road: Road, points: Iterable[tuple[float, float]]) -> Reach:
    """Return how far the roads must reach: at least as far as the scenery, and beyond every road user.

    Args:
        road: The road.
        points: Positions of the road users.
    """
    ground = UrbanGround(road)
    near_m = road.kerb_m + road.style.pavement_m + NEAR_M
    first_m, last_m, side_m = -BEFORE_M, road.length_m + BEYOND_M, road.side_street_m
    for x_m, y_m in points:
        out_m = ground.side_street_m(x_m, y_m, near_m)
        if out_m is not None:
            side_m = max(side_m, _beyond(out_m))
            continue
        station_m, offset_m = ground.station(x_m, y_m)
        if abs(offset_m) < near_m:
            first_m, last_m = min(first_m, -_beyond(-station_m)), max(last_m, _beyond(station_m))
    return Reach(before_m=-first_m, beyond_m=last_m - road.length_m, side_m=side_m)


def _beyond(station_m: float) -> float:
    return SPARE_M * math.ceil(station_m / SPARE_M + 1.0)


class UrbanGround:
    """The height of the urban world's ground; it is 0 at the start of the main road.

    Args:
        road: The road.
    """

    def __init__(self, road: Road) -> None:
        self._road = road
        self._reach_m = junction_reach_m(road)
        self._stations_m = np.arange(-BEFORE_M, road.length_m + BEYOND_M, 4.0)
        self._middle = np.array(
            [road.centre.pose_at(station_m)[:2] for station_m in self._stations_m.tolist()]
        )

    def station(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return station and offset of a point on the main road."""
        nearest = int(np.hypot(self._middle[:, 0] - x_m, self._middle[:, 1] - y_m).argmin())
        return self._road.centre.project(x_m, y_m, float(self._stations_m[nearest]))

    def side_street_m(self, x_m: float, y_m: float, near_m: float) -> float | None:
        """Return the distance of a point in a side street from the middle of its junction; None outside of them.

        Args:
            x_m: The point.
            y_m: The point.
            near_m: Distance from the middle of a side street up to which a point counts as in it.
        """
        for junction in self._road.junctions:
            along_m, left_m = _local(junction, x_m, y_m)
            there = junction.left if left_m > 0 else junction.right
            if there and abs(along_m) < near_m and abs(left_m) > self._reach_m:
                return abs(left_m)
        return None

    def at(self, x_m: float, y_m: float, yaw_rad: float, *, on_foot: bool) -> tuple[float, float]:
        """Return the height under a road user, and the slope along its heading, positive uphill.

        Roads are level across, so in a junction, surfaces of different slope overlap: a vehicle has the height of the
        reference line on its left, half a lane away. Pedestrians cross the main road there, and are on it.
        """
        grade, road = self._road.style.grade, self._road
        if grade == 0.0:
            return 0.0, 0.0
        walk_m = road.kerb_m + road.style.pavement_m
        for junction in road.junctions:
            along_m, left_m = _local(junction, x_m, y_m)
            height_m = grade * junction.station_m
            there = junction.left if left_m > 0 else junction.right
            if there and abs(along_m) < walk_m and abs(left_m) >= self._reach_m:
                return height_m, 0.0
            if not on_foot and max(abs(along_m), abs(left_m)) < self._reach_m:
                turn = yaw_rad - junction.yaw_rad
                along_m -= 0.5 * road.style.lane_width_m * math.sin(turn)
                return height_m + grade * along_m, grade * math.cos(turn)
        station_m, _ = self.station(x_m, y_m)
        turn = yaw_rad - road.centre.pose_at(station_m)[2]
        return grade * station_m, grade * math.cos(turn)


def _local(junction: Junction, x_m: float, y_m: float) -> tuple[float, float]:
    """Return a point relative to a junction: along the main road, and to its left."""
    dx, dy = x_m - junction.x_m, y_m - junction.y_m
    cos_yaw, sin_yaw = math.cos(junction.yaw_rad), math.sin(junction.yaw_rad)
    return dx * cos_yaw + dy * sin_yaw, dy * cos_yaw - dx * sin_yaw


def urban_network(road: Road, reach: Reach) -> RoadNetwork:
    """Return the network of a road and its side streets.

    Args:
        road: The road.
        reach: How far the roads reach.
    """
    return _NetworkBuilder(road, reach).network()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Arm:
    """A road that ends at a junction.

    Attributes:
        road: Its id.
        contact: Its end at the junction.
        inward_rad: Direction of traffic into the junction.
        height_m: Height of its end.
        slope: Slope of its end, in the direction of traffic into the junction.
    """

    road: int
    contact: Contact
    inward_rad: float
    height_m: float
    slope: float


class _NetworkBuilder:
    """Builds the network of one road.

    Ids: main roads are 1, 2, 3; side streets of junction j 10 j + 1 (right) and 10 j + 2 (left); junction j is
    100 j, and its connecting roads count up from there.
    """

    def __init__(self, road: Road, reach: Reach) -> None:
        self._road = road
        self._reach = reach
        self._reach_m = junction_reach_m(road)
        strip = (Lane(LaneKind.PARKING, PARKING_STRIP_M),) if road.style.parking else ()
        border = (Lane(LaneKind.BORDER, PARKING_STRIP_M),) if road.style.parking else ()
        self._driving = Lane(LaneKind.DRIVING, road.style.lane_width_m)
        pavement = Lane(LaneKind.SIDEWALK, road.style.pavement_m)
        self._street = (self._driving, *strip, pavement)
        self._corner = (self._driving, *border, pavement)
        cuts = [-reach.before_m]
        for junction in road.junctions:
            cuts += [junction.station_m - self._reach_m, junction.station_m + self._reach_m]
        cuts.append(road.length_m + reach.beyond_m)
        self._main = {number: (cuts[2 * number - 2], cuts[2 * number - 1]) for number in self._main_ids()}
        self._objects = self._placed_objects()

    def _main_ids(self) -> range:
        return range(1, len(self._road.junctions) + 2)

    def network(self) -> RoadNetwork:
        """Return the network."""
        roads = [self._main_road(number) for number in self._main_ids()]
        junctions = []
        for number, junction in enumerate(self._road.junctions, start=1):
            arms = self._arms(number, junction)
            roads += [self._side_street(number, junction, arm) for arm in arms if arm.road > 10]
            connecting = list(self._connecting_roads(number, junction, arms))
            roads += [part for part, _ in connecting]
            groups = (MAIN_LIGHTS, SIDE_LIGHTS) if junction.lit else ()
            junctions.append(
                JunctionPart(
                    id=100 * number,
                    name=f"junction {number}",
                    connections=tuple((arm.road, part.id, _sign_into(arm)) for part, arm in connecting),
                    signal_groups=groups,
                )
            )
        lit = any(junction.lit for junction in self._road.junctions)
        lights = (
            SignalGroup(id=MAIN_LIGHTS, name="main road", lights=(1, 2)),
            SignalGroup(id=SIDE_LIGHTS, name="side streets", lights=(3, 4)),
        )
        return RoadNetwork(
            name=f"Brink {self._road.curve.value} road",
            roads=tuple(roads),
            junctions=tuple(junctions),
            signal_groups=lights if lit else (),
        )

    def _main_road(self, number: int) -> RoadPart:
        from_m, to_m = self._main[number]
        grade = self._road.style.grade
        return RoadPart(
            id=number,
            name=f"main road {number}",
            line=stretch(self._road.centre, from_m, to_m),
            left=self._street,
            right=self._street,
            elevations=(Elevation(a=grade * from_m, b=grade),),
            predecessor=Link(100 * (number - 1)) if number > 1 else None,
            successor=Link(100 * number) if number < len(self._main) else None,
            middle=self._dashes(-BEFORE_M - from_m),
            objects=tuple(self._objects.get(number, ())),
            lights=tuple(self._main_lights(number)),
            speed_limit_mps=SPEED_LIMIT_MPS,
        )

    def _main_lights(self, number: int) -> Iterable[TrafficLight]:
        from_m, _ = self._main[number]
        before_m, beside_m = self._road.stop_line_before_junction_m, self._road.kerb_m + LIGHT_BESIDE_KERB_M
        for index, junction in enumerate(self._road.junctions, start=1):
            if junction.lit and index == number:
                yield TrafficLight(
                    id=1,
                    name="main road, in the ego's direction",
                    along=True,
                    s_m=junction.station_m - before_m - from_m,
                    t_m=-beside_m,
                )
            if junction.lit and index + 1 == number:
                yield TrafficLight(
                    id=2,
                    name="main road, oncoming",
                    along=False,
                    t_m=beside_m,
                    s_m=junction.station_m + before_m - from_m,
                )

    def _side_street(self, number: int, junction: Junction, arm: _Arm) -> RoadPart:
        outward_rad = arm.inward_rad + math.pi
        x_m, y_m = self._entry(junction, arm)
        right = arm.road % 10 == 1
        lights: tuple[TrafficLight, ...] = ()
        if junction.lit:
            lights = (
                TrafficLight(
                    id=3 if right else 4,
                    name=f"side street, from the {'right' if right else 'left'}",
                    along=False,
                    s_m=self._road.stop_line_before_junction_m - self._reach_m,
                    t_m=self._road.kerb_m + LIGHT_BESIDE_KERB_M,
                ),
            )
        return RoadPart(
            id=arm.road,
            name=f"side street {number}, to the {'right' if right else 'left'}",
            line=ReferenceLine(x_m, y_m, outward_rad, (Piece(self._reach.side_m - self._reach_m),)),
            left=self._street,
            right=self._street,
            elevations=(Elevation(a=arm.height_m),),
            predecessor=Link(100 * number),
            middle=self._dashes(self._road.kerb_m + 3.0 - self._reach_m),
            lights=lights,
            speed_limit_mps=SPEED_LIMIT_MPS,
        )

    def _dashes(self, first_m: float) -> Dashes:
        return Dashes(width_m=MARKING_WIDTH_M, dash_m=DASH_M, first_m=first_m)

    def _arms(self, number: int, junction: Junction) -> list[_Arm]:
        """Return the roads that meet at a junction, the main road first, in the ego's direction."""
        grade, yaw_rad = self._road.style.grade, junction.yaw_rad
        height_m = grade * junction.station_m
        rise_m = grade * self._reach_m
        before = _Arm(
            road=number, contact=Contact.END, inward_rad=yaw_rad, height_m=height_m - rise_m, slope=grade
        )
        after = _Arm(
            road=number + 1,
            contact=Contact.START,
            inward_rad=yaw_rad + math.pi,
            height_m=height_m + rise_m,
            slope=-grade,
        )
        sides = [
            _Arm(
                road=10 * number + index,
                contact=Contact.START,
                inward_rad=yaw_rad + turn * math.pi,
                height_m=height_m,
                slope=0.0,
            )
            for index, turn, there in ((1, 0.5, junction.right), (2, -0.5, junction.left))
            if there
        ]
        return [before, after, *sides]

    def _entry(self, junction: Junction, arm: _Arm) -> tuple[float, float]:
        """Return the end of a road at a junction."""
        return (
            junction.x_m - self._reach_m * math.cos(arm.inward_rad),
            junction.y_m - self._reach_m * math.sin(arm.inward_rad),
        )

    def _connecting_roads(
        self, number: int, junction: Junction, arms: list[_Arm]
    ) -> Iterable[tuple[RoadPart, _Arm]]:
        """Yield every path through a junction, with the road that it comes from; straight on first."""
        ways = [(one, other) for one in arms for other in arms if one is not other]
        ways.sort(key=lambda way: _turn(*way) != 0)
        for index, (one, other) in enumerate(ways, start=1):
            turn = _turn(one, other)
            has_street_right = any(_turn(one, third) < 0 for third in arms if third is not one)
            x_m, y_m = self._entry(junction, one)
            line = ReferenceLine(x_m, y_m, one.inward_rad, self._way(turn))
            road_id = 100 * number + index
            along_main = one.road == number and other.road == number + 1
            part = RoadPart(
                id=road_id,
                name=f"junction {number}, from road {one.road} to road {other.road}",
                line=line,
                left=(),
                right=self._corner if turn < 0 or (turn == 0 and not has_street_right) else (self._driving,),
                elevations=_elevations(line, one, other),
                junction=100 * number,
                predecessor=Link(one.road, one.contact),
                successor=Link(other.road, other.contact),
                lane_signs=(_sign_into(one), -_sign_into(other)),
                objects=tuple(self._objects.get(100 * number, ())) if along_main else (),
                speed_limit_mps=SPEED_LIMIT_MPS,
            )
            yield part, one

    def _way(self, turn: int) -> tuple[Piece, ...]:
        """Return the reference line through a junction: straight on (0), to the right (-1) or to the left (1)."""
        if turn == 0:
            return (Piece(2.0 * self._reach_m),)
        if turn < 0:
            return (quarter_turn(self._reach_m, right=True),)
        radius_m = LEFT_TURN_RADIUS_M - 0.5 * self._road.style.lane_width_m
        straight = Piece(self._reach_m - radius_m)
        return (straight, quarter_turn(radius_m, right=False), straight)

    def _placed_objects(self) -> Mapping[int, list[RoadObject]]:
        """Return the objects on and beside the main road, by the id of its part or of their junction."""
        placed: dict[int, list[RoadObject]] = {}
        ground = UrbanGround(self._road)
        for index, fixture in enumerate(fixtures(self._road)):
            if fixture.kind == "parked-car":
                continue
            station_m, offset_m = ground.station(fixture.x_m, fixture.y_m)
            heading_rad = fixture.yaw_rad - self._road.centre.pose_at(station_m)[2]
            self._place(
                placed,
                fixture.kind,
                f"{fixture.kind} {index + 1}",
                station_m,
                offset_m,
                (fixture.length_m, 0.0 if fixture.kind == "tree" else fixture.width_m, fixture.height_m),
                heading_rad,
            )
        width_m = 2.0 * self._road.kerb_m
        self._place(
            placed, "crosswalk", "crossing", self._road.crossing_m, 0.0, (CROSSING_WIDTH_M, width_m, 0.0)
        )
        if self._road.junctions[0].lit:
            stop_m = self._road.crossing_m - 0.5 * CROSSING_WIDTH_M - STOP_LINE_BEFORE_CROSSING_M
            lane_m = self._road.style.lane_width_m
            self._place(
                placed,
                "roadMark",
                "stop line",
                stop_m,
                -0.5 * (lane_m + 0.1),
                (STOP_LINE_WIDTH_M, lane_m - 0.1, 0.0),
            )
        return placed

    def _place(
        self,
        placed: dict[int, list[RoadObject]],
        kind: str,
        name: str,
        station_m: float,
        offset_m: float,
        size_m: tuple[float, float, float],
        heading_rad: float = 0.0,
    ) -> None:
        key, from_m = self._part_at(station_m)
        length_m, width_m, height_m = size_m
        placed.setdefault(key, []).append(
            RoadObject(
                kind=kind,
                name=name,
                s_m=station_m - from_m,
                t_m=offset_m,
                heading_rad=heading_rad,
                length_m=length_m,
                width_m=width_m,
                height_m=height_m,
            )
        )

    def _part_at(self, station_m: float) -> tuple[int, float]:
        """Return the main road, or else the junction, at a station, and where it begins."""
        for number, (from_m, to_m) in self._main.items():
            if from_m <= station_m <= to_m:
                return number, from_m
            if station_m < from_m:
                return 100 * (number - 1), from_m - 2.0 * self._reach_m
        last = len(self._main)
        return last, self._main[last][0]


def _elevations(line: ReferenceLine, one: _Arm, other: _Arm) -> tuple[Elevation, ...]:
    """Return the height of a path through a junction: straights continue the roads, the turn blends between them."""
    if one.height_m == other.height_m and one.slope == other.slope == 0.0:
        return (Elevation(a=one.height_m),)
    straight_m = line.pieces[0].length_m if len(line.pieces) > 1 else 0.0
    turn_m = line.length_m - 2.0 * straight_m
    start = (one.height_m + straight_m * one.slope, one.slope)
    end = (other.height_m + straight_m * other.slope, -other.slope)
    blend = Elevation.between(straight_m, turn_m, start, end)
    if not straight_m:
        return (blend,)
    return (
        Elevation(a=one.height_m, b=one.slope),
        blend,
        Elevation(from_m=straight_m + turn_m, a=end[0], b=end[1]),
    )


def _sign_into(arm: _Arm) -> int:
    """Return the sign of the lanes into the junction: right ones at a road's end, left ones at its start."""
    return -1 if arm.contact is Contact.END else 1


def _turn(one: _Arm, other: _Arm) -> int:
    """Return the exit from a junction for an entry and a turn: 0 straight on, 1 left, -1 right."""
    return round(math.sin(other.inward_rad + math.pi - one.inward_rad))
