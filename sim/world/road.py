"""Owns the shape of a road: its reference lines, junctions, crossing and roadside, from (curve, id, length).

The centre line runs between the two lanes; station 0 is where the ego starts, and traffic keeps to the right.
Around a junction every road is straight, so that turns are quarter circles between lane centre lines.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from brink.sim.urban.scenario import RoadCurve
from brink.sim.world.line import Piece, ReferenceLine

LENGTHS_M = (90.0, 140.0, 200.0)
SPEED_LIMIT_MPS = 30.0 / 3.6
RIGHT_TURN_RADIUS_M = 7.0
LEFT_TURN_RADIUS_M = 9.0
SIDE_STREET_M = 60.0
"""How far from the junction drivers who come out of a side street can start, and drivers who turn into it matter."""
PARKING_STRIP_M = 2.1
CROSSING_WIDTH_M = 3.0
STOP_LINE_BEFORE_CROSSING_M = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadStyle:
    """How one of the three roads of a shape differs from its sisters.

    Attributes:
        radius_m: Radius of the curve's centre line; 0 for straight roads.
        grade: Rise over run in the ego's direction, positive uphill.
        lane_width_m: Width of each lane.
        pavement_m: Width of each pavement.
        parking: Whether cars are parked along the road.
        trees: Whether trees stand along it.
        main_stream: Where most of the traffic goes: 0 along the road, 1 into the first exit, 2 into the second.
        pace: How fast others drive here, as a share of what they would elsewhere.
    """

    radius_m: float
    grade: float
    lane_width_m: float
    pavement_m: float
    parking: bool
    trees: bool
    main_stream: int
    pace: float


def _style(
    radius_m: float, grade: float, lane_width_m: float, *, parking: bool, main_stream: int, pace: float
) -> RoadStyle:
    return RoadStyle(
        radius_m=radius_m,
        grade=grade,
        lane_width_m=lane_width_m,
        pavement_m=2.0 if parking else 2.6,
        parking=parking,
        trees=not parking,
        main_stream=main_stream,
        pace=pace,
    )


STYLES: Mapping[RoadCurve, tuple[RoadStyle, RoadStyle, RoadStyle]] = {
    RoadCurve.STRAIGHT: (
        _style(0.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        _style(0.0, 0.05, 3.2, parking=True, main_stream=1, pace=0.85),
        _style(0.0, -0.06, 3.3, parking=True, main_stream=0, pace=0.92),
    ),
    RoadCurve.RIGHT: (
        _style(40.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        _style(28.0, 0.0, 3.3, parking=True, main_stream=0, pace=0.92),
        _style(22.0, -0.04, 3.2, parking=False, main_stream=1, pace=0.96),
    ),
    RoadCurve.LEFT: (
        _style(38.0, 0.0, 3.4, parking=True, main_stream=0, pace=0.95),
        _style(30.0, 0.03, 3.3, parking=False, main_stream=2, pace=1.0),
        _style(22.0, 0.0, 3.2, parking=True, main_stream=0, pace=0.90),
    ),
    RoadCurve.CROSSROAD: (
        _style(0.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        _style(0.0, 0.04, 3.3, parking=True, main_stream=1, pace=0.95),
        _style(0.0, -0.05, 3.2, parking=False, main_stream=0, pace=0.95),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Junction:
    """Where side streets meet the road.

    Attributes:
        x_m: Where the centre lines meet.
        y_m: The same.
        yaw_rad: Direction of the road there.
        station_m: On the centre line.
        forward_m: Its station on the forward lane.
        backward_m: Its station on the backward lane.
        right: Whether a side street leaves to the right.
        left: Whether a side street leaves to the left.
        lit: Whether it has traffic lights.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    station_m: float
    forward_m: float
    backward_m: float
    right: bool
    left: bool
    lit: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """A road with its side streets.

    Attributes:
        curve: Its shape.
        style: What tells it from its sisters.
        length_m: Length of the centre line.
        centre: Between the two lanes.
        forward: Centre line of the ego's lane.
        backward: Centre line of the oncoming lane, in its own direction.
        junctions: In the ego's order: the first exit is at the first, the second at the last.
        crossing_m: Station of the pedestrian crossing's middle, on the centre line.
    """

    curve: RoadCurve
    style: RoadStyle
    length_m: float
    centre: ReferenceLine
    forward: ReferenceLine
    backward: ReferenceLine
    junctions: tuple[Junction, ...]
    crossing_m: float

    @property
    def kerb_m(self) -> float:
        """Distance of the kerb from the centre line."""
        return self.style.lane_width_m + (PARKING_STRIP_M if self.style.parking else 0.0)

    @property
    def walkway_m(self) -> float:
        """Distance of the middle of the pavement from the centre line."""
        return self.kerb_m + 0.5 * self.style.pavement_m

    @property
    def side_street_m(self) -> float:
        """How far the side streets go, from the middle of their junction: beyond every route into them."""
        return self.length_m + 20.0

    @property
    def stop_line_before_junction_m(self) -> float:
        """Distance of the stop line from the middle of a lit junction."""
        return self.kerb_m + CROSSING_WIDTH_M + 1.0 + STOP_LINE_BEFORE_CROSSING_M


@lru_cache(maxsize=64)
def build_road(curve: RoadCurve, road_id: int, road_length: int) -> Road:
    """Return the road of a scenario.

    Args:
        curve: Shape.
        road_id: 0 to 2.
        road_length: 0 to 2.
    """
    style = STYLES[curve][road_id]
    length_m = LENGTHS_M[road_length]
    centre = _centre_line(curve, style.radius_m, length_m)
    half_lane_m = 0.5 * style.lane_width_m
    forward = centre.parallel(-half_lane_m)
    backward = centre.parallel(half_lane_m).backwards()

    def junction(share: float, *, right: bool, left: bool, lit: bool) -> Junction:
        x_m, y_m, yaw_rad = centre.pose_at(share * length_m)
        return Junction(
            x_m=x_m,
            y_m=y_m,
            yaw_rad=yaw_rad,
            station_m=share * length_m,
            forward_m=forward.project(x_m, y_m, share * length_m)[0],
            backward_m=backward.project(x_m, y_m, backward.length_m - share * length_m)[0],
            right=right,
            left=left,
            lit=lit,
        )

    if curve is RoadCurve.CROSSROAD:
        junctions: tuple[Junction, ...] = (junction(0.55, right=True, left=True, lit=True),)
        kerb_m = style.lane_width_m + (PARKING_STRIP_M if style.parking else 0.0)
        crossing_m = junctions[0].station_m - kerb_m - 1.0 - 0.5 * CROSSING_WIDTH_M
    else:
        junctions = (
            junction(0.36, right=True, left=False, lit=False),
            junction(0.84, right=False, left=True, lit=False),
        )
        crossing_m = 0.22 * length_m + 6.0
    return Road(
        curve=curve,
        style=style,
        length_m=length_m,
        centre=centre,
        forward=forward,
        backward=backward,
        junctions=junctions,
        crossing_m=crossing_m,
    )


def _centre_line(curve: RoadCurve, radius_m: float, length_m: float) -> ReferenceLine:
    if curve is RoadCurve.RIGHT or curve is RoadCurve.LEFT:
        bend = (1.0 if curve is RoadCurve.LEFT else -1.0) / radius_m
        pieces = (Piece(0.50 * length_m), Piece(0.18 * length_m, bend), Piece(0.32 * length_m))
    else:
        pieces = (Piece(0.50 * length_m), Piece(0.50 * length_m), Piece(1e-3))
    return ReferenceLine(0.0, 0.0, 0.0, pieces)


def turn_off(inbound: ReferenceLine, junction_m: float, lane_width_m: float, *, right: bool) -> ReferenceLine:
    """Return a lane that turns off at a junction, with `SIDE_STREET_M` of side street at its end.

    Args:
        inbound: Lane centre line that runs straight through the junction.
        junction_m: Station of the junction's middle on it.
        lane_width_m: Width of the lanes of both streets.
        right: Whether it turns right; otherwise left.
    """
    return inbound.up_to(
        turn_begins_m(junction_m, lane_width_m, right=right), turn_piece(right=right), Piece(SIDE_STREET_M)
    )


def turn_begins_m(junction_m: float, lane_width_m: float, *, right: bool) -> float:
    """Return the station at which a turn leaves its lane."""
    half_m = 0.5 * lane_width_m
    return junction_m - (half_m + RIGHT_TURN_RADIUS_M if right else LEFT_TURN_RADIUS_M - half_m)


def turn_piece(*, right: bool) -> Piece:
    """Return the quarter circle of a turn."""
    radius_m = RIGHT_TURN_RADIUS_M if right else LEFT_TURN_RADIUS_M
    return Piece(0.5 * math.pi * radius_m, (-1.0 if right else 1.0) / radius_m)


def side_lane(junction: Junction, lane_width_m: float, *, from_right: bool) -> ReferenceLine:
    """Return the lane that comes out of a side street and runs straight over the junction.

    Its station `SIDE_STREET_M` is level with the junction's middle.
    """
    outward_rad = junction.yaw_rad + (-0.5 if from_right else 0.5) * math.pi
    line = ReferenceLine(
        junction.x_m + SIDE_STREET_M * math.cos(outward_rad),
        junction.y_m + SIDE_STREET_M * math.sin(outward_rad),
        outward_rad + math.pi,
        (Piece(2.0 * SIDE_STREET_M),),
    )
    return line.parallel(-0.5 * lane_width_m)


def joining_lane(road: Road, junction: Junction) -> ReferenceLine:
    """Return the lane that comes out of the right side street and turns right, into the ego's lane."""
    lane_width_m = road.style.lane_width_m
    inbound = side_lane(junction, lane_width_m, from_right=True)
    joins_m = junction.forward_m + 0.5 * lane_width_m + RIGHT_TURN_RADIUS_M
    return inbound.up_to(
        turn_begins_m(SIDE_STREET_M, lane_width_m, right=True),
        turn_piece(right=True),
        *road.forward.pieces_from(joins_m),
    )
