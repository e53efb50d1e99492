"""Roads: reference lines, junctions, crossing and traffic lights, and the routes and lanes over them.

A road is determined by (curve, id, length). The centre line runs between the two lanes; the ego starts at station 0,
and traffic keeps to the right. Roads are straight around junctions, so that turns are quarter circles between lane
centre lines. Traffic lights run fixed cycles in which the two directions are never green together.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from brink.sim.driving.interface import Crossing, LightState
from brink.sim.trace import Surface
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.scenario import DrivingTask, RoadCurve

LENGTHS_M = (90.0, 140.0, 200.0)
SPEED_LIMIT_MPS = 30.0 / 3.6
RIGHT_TURN_RADIUS_M = 7.0
LEFT_TURN_RADIUS_M = 9.0
SIDE_STREET_M = 60.0
"""Drivers who leave a side street start this far from the junction; those who enter one matter up to there."""
PARKING_STRIP_M = 2.1
CROSSING_WIDTH_M = 3.0
STOP_LINE_BEFORE_CROSSING_M = 1.5
MIN_EXIT_STREET_M = 30.0

MAIN_GREEN_S = 12.0
SIDE_GREEN_S = 7.0
AMBER_S = 2.5
ALL_RED_S = 2.0
CYCLE_S = MAIN_GREEN_S + SIDE_GREEN_S + 2.0 * (AMBER_S + ALL_RED_S)


@dataclass(frozen=True, slots=True)
class RoadStyle:
    """The properties in which the three roads of the same shape differ.

    Attributes:
        radius_m: Radius of the curve's centre line; 0 for straight roads.
        grade: Rise over run in the ego's direction, positive uphill.
        lane_width_m: Width of each lane.
        parking: Whether cars are parked along the road; otherwise trees stand along it.
        main_stream: Where the lead vehicle goes: 0 along the road, 1 into the first exit, 2 into the second.
        pace: Speed of other drivers here, as a share of their usual speed.
    """

    radius_m: float
    grade: float
    lane_width_m: float
    parking: bool
    main_stream: int
    pace: float

    @property
    def pavement_m(self) -> float:
        """Width of each pavement."""
        return 2.0 if self.parking else 2.6


STYLES: Mapping[RoadCurve, tuple[RoadStyle, RoadStyle, RoadStyle]] = {
    RoadCurve.STRAIGHT: (
        RoadStyle(0.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        RoadStyle(0.0, 0.05, 3.2, parking=True, main_stream=1, pace=0.85),
        RoadStyle(0.0, -0.06, 3.3, parking=True, main_stream=0, pace=0.92),
    ),
    RoadCurve.RIGHT: (
        RoadStyle(40.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        RoadStyle(28.0, 0.0, 3.3, parking=True, main_stream=0, pace=0.92),
        RoadStyle(22.0, -0.04, 3.2, parking=False, main_stream=1, pace=0.96),
    ),
    RoadCurve.LEFT: (
        RoadStyle(38.0, 0.0, 3.4, parking=True, main_stream=0, pace=0.95),
        RoadStyle(30.0, 0.03, 3.3, parking=False, main_stream=2, pace=1.0),
        RoadStyle(22.0, 0.0, 3.2, parking=True, main_stream=0, pace=0.90),
    ),
    RoadCurve.CROSSROAD: (
        RoadStyle(0.0, 0.0, 3.5, parking=False, main_stream=0, pace=1.0),
        RoadStyle(0.0, 0.04, 3.3, parking=True, main_stream=1, pace=0.95),
        RoadStyle(0.0, -0.05, 3.2, parking=False, main_stream=0, pace=0.95),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Junction:
    """A junction of the road with side streets.

    Attributes:
        x_m: Intersection of the centre lines.
        y_m: Intersection of the centre lines.
        yaw_rad: Direction of the road at the junction.
        station_m: Station on the centre line.
        forward_m: Station on the forward lane.
        backward_m: Station on the backward lane.
        right: Whether a side street leaves to the right.
        left: Whether a side street leaves to the left.
        lit: Whether the junction has traffic lights.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Fixture:
    """A body that never moves.

    Attributes:
        kind: ``building``, ``parked-car`` or ``tree``.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
        height_m: Height.
        x_m: Centre of its footprint.
        y_m: Centre of its footprint.
        yaw_rad: Heading.
    """

    kind: str
    length_m: float
    width_m: float
    height_m: float
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenery:
    """What a road has of its own, in place of what stands along every road of its style.

    Attributes:
        fixtures: All bodies that never move.
        surfaces: The surfaces of the scene in drawing order, without the fixtures.
    """

    fixtures: tuple[Fixture, ...]
    surfaces: tuple[Surface, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """A road with its side streets.

    Attributes:
        curve: Shape of the road.
        style: Properties that distinguish it from other roads of this shape.
        length_m: Length of the centre line.
        centre: Centre line, between the two lanes.
        forward: Centre line of the ego's lane.
        backward: Centre line of the oncoming lane, in its own direction of travel.
        junctions: In driving order; the first exit is at the first junction, the second exit at the last.
        crossing_m: Station of the middle of the pedestrian crossing on the centre line.
        scenery: Its own scenery; None if it has that of `brink.sim.world.scenery`.
    """

    curve: RoadCurve
    style: RoadStyle
    length_m: float
    centre: ReferenceLine
    forward: ReferenceLine
    backward: ReferenceLine
    junctions: tuple[Junction, ...]
    crossing_m: float
    scenery: Scenery | None = None

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
        """Length of the side streets from the middle of their junction, longer than every route into them."""
        return self.length_m + 20.0

    @property
    def stop_line_before_junction_m(self) -> float:
        """Distance of the stop line from the middle of a junction with traffic lights."""
        return self.kerb_m + CROSSING_WIDTH_M + 1.0 + STOP_LINE_BEFORE_CROSSING_M


@lru_cache(maxsize=64)
def build_road(curve: RoadCurve, road_id: int, road_length: int) -> Road:
    """Return the road of a scenario.

    Args:
        curve: Shape of the road.
        road_id: One of the three roads of that shape, 0 to 2.
        road_length: Index into `LENGTHS_M`.
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


def turn_begins_m(junction_m: float, lane_width_m: float, *, right: bool) -> float:
    """Return the station at which a turn leaves its lane.

    Args:
        junction_m: Station of the middle of the junction on the lane.
        lane_width_m: Width of the lanes of both streets.
        right: Whether the turn is to the right; otherwise to the left.
    """
    half_m = 0.5 * lane_width_m
    return junction_m - (half_m + RIGHT_TURN_RADIUS_M if right else LEFT_TURN_RADIUS_M - half_m)


def turn_piece(*, right: bool) -> Piece:
    """Return the quarter circle that a turn follows."""
    radius_m = RIGHT_TURN_RADIUS_M if right else LEFT_TURN_RADIUS_M
    return Piece(0.5 * math.pi * radius_m, (-1.0 if right else 1.0) / radius_m)


def side_lane(junction: Junction, lane_width_m: float, *, from_right: bool) -> ReferenceLine:
    """Return the lane that leaves a side street and runs straight across the junction.

    Station `SIDE_STREET_M` of this lane is level with the middle of the junction.

    Args:
        junction: Where the side street meets the road.
        lane_width_m: Width of the lanes.
        from_right: Whether the side street is on the right of the road; otherwise on the left.
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
    """Return the lane that leaves the right side street and turns right into the ego's lane."""
    lane_width_m = road.style.lane_width_m
    inbound = side_lane(junction, lane_width_m, from_right=True)
    joins_m = junction.forward_m + 0.5 * lane_width_m + RIGHT_TURN_RADIUS_M
    return inbound.up_to(
        turn_begins_m(SIDE_STREET_M, lane_width_m, right=True),
        turn_piece(right=True),
        *road.forward.pieces_from(joins_m),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneRoute:
    """The ego's route: its lane centre line from start to goal, with map data.

    Implements `brink.sim.driving.interface.Route`.

    Attributes:
        line: Runs from the ego's start to the goal.
        lane_width_m: Width of the ego's lane.
        speed_limit_mps: Speed limit on the whole route.
        stop_line_stations_m: Stations of stop lines with a traffic light, ascending.
        oncoming: Stretches (from, to) in stations with an oncoming lane directly to the left.
        crossings: Crossings without traffic lights, in driving order.
    """

    line: ReferenceLine
    lane_width_m: float
    speed_limit_mps: float
    stop_line_stations_m: tuple[float, ...] = ()
    oncoming: tuple[tuple[float, float], ...] = field(default=())
    crossings: tuple[Crossing, ...] = ()

    @property
    def start_pose(self) -> tuple[float, float, float]:
        """x_m, y_m and yaw_rad at station 0."""
        return self.line.start

    @property
    def pieces(self) -> tuple[tuple[float, float], ...]:
        """The straights and arcs of the line: length in m, curvature in 1/m, positive to the left."""
        return tuple((piece.length_m, piece.curvature_1pm) for piece in self.line.pieces)

    @property
    def length_m(self) -> float:
        """Length from the first to the last station."""
        return self.line.length_m

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x_m, y_m, yaw_rad) at a station and offset; the route continues straight beyond its ends."""
        return self.line.pose_at(station_m, offset_m)

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m, positive to the left."""
        return self.line.curvature_at(station_m)

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point on the route near a known station.

        Args:
            x_m: Point to project.
            y_m: Point to project.
            near_station_m: Station at which the search starts.
        """
        return self.line.project(x_m, y_m, near_station_m)

    def oncoming_lane_at(self, station_m: float) -> bool:
        """Return whether an oncoming lane lies directly to the left of a station."""
        return any(start_m <= station_m <= end_m for start_m, end_m in self.oncoming)


def ego_route(road: Road, task: DrivingTask) -> LaneRoute:
    """Return the ego's route, which is about as long as the road for every task."""
    stop_lines = tuple(
        junction.forward_m - road.stop_line_before_junction_m for junction in road.junctions if junction.lit
    )
    lane_width_m = road.style.lane_width_m
    if task is DrivingTask.FOLLOW_ROAD:
        line = road.forward
        gap = [(j.forward_m - 12.0, j.forward_m + 12.0) for j in road.junctions if j.lit]
        oncoming = ((-20.0, gap[0][0]), (gap[0][1], line.length_m)) if gap else ((-20.0, line.length_m),)
    else:
        right = task is DrivingTask.FIRST_EXIT
        junction = exit_junction(road, right=right)
        begins_m = turn_begins_m(junction.forward_m, lane_width_m, right=right)
        arc = turn_piece(right=right)
        street_m = max(road.forward.length_m - begins_m - arc.length_m, MIN_EXIT_STREET_M)
        line = road.forward.up_to(begins_m, arc, Piece(street_m))
        oncoming = ((-20.0, begins_m - 6.0), (begins_m + arc.length_m + 3.0, line.length_m))
    return LaneRoute(
        line=line,
        lane_width_m=lane_width_m,
        speed_limit_mps=SPEED_LIMIT_MPS,
        stop_line_stations_m=stop_lines,
        oncoming=oncoming,
        crossings=_crossings(road, line),
    )


def _crossings(road: Road, line: ReferenceLine) -> tuple[Crossing, ...]:
    """Return the crossing on a route, if it is on it and pedestrians have priority there."""
    half_lane_m = 0.5 * road.style.lane_width_m
    x_m, y_m, _ = road.centre.pose_at(road.crossing_m, -half_lane_m)
    station_m, offset_m = line.project(x_m, y_m, road.crossing_m)
    if road.junctions[0].lit or abs(offset_m) > half_lane_m:
        return ()
    half_m = 0.5 * CROSSING_WIDTH_M
    crossing = Crossing(
        from_m=station_m - half_m,
        to_m=station_m + half_m,
        right_kerb_m=half_lane_m - road.kerb_m,
        left_kerb_m=half_lane_m + road.kerb_m,
    )
    return (crossing,)


def exit_junction(road: Road, *, right: bool) -> Junction:
    """Return the junction at which the first exit (right) or the second exit (left) leaves the road."""
    return road.junctions[0 if right else -1]


def stream_lane(road: Road, stream: int) -> ReferenceLine:
    """Return the lane of a traffic stream: 0 along the road, 1 into the first exit, 2 into the second."""
    if stream == 0:
        return road.forward
    right = stream == 1
    begins_m = turn_begins_m(exit_junction(road, right=right).forward_m, road.style.lane_width_m, right=right)
    return road.forward.up_to(begins_m, turn_piece(right=right), Piece(road.length_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalPlan:
    """The traffic-light plan of one junction.

    Attributes:
        phase_s: Position in the cycle at time 0; the main road's green starts at 0.
    """

    phase_s: float

    def main_at(self, time_s: float) -> LightState:
        """Return the state of the light for the main road."""
        return _state((time_s + self.phase_s) % CYCLE_S, MAIN_GREEN_S)

    def side_at(self, time_s: float) -> LightState:
        """Return the state of the light for the side streets."""
        begins_s = MAIN_GREEN_S + AMBER_S + ALL_RED_S
        return _state((time_s + self.phase_s - begins_s) % CYCLE_S, SIDE_GREEN_S)

    def main_red_for_s(self, time_s: float) -> float:
        """Return how long the main road's light stays red, 0 if it is not red; pedestrians cross while it is."""
        in_cycle_s = (time_s + self.phase_s) % CYCLE_S
        return CYCLE_S - in_cycle_s if in_cycle_s >= MAIN_GREEN_S + AMBER_S else 0.0


def _state(in_cycle_s: float, green_s: float) -> LightState:
    if in_cycle_s < green_s:
        return LightState.GREEN
    return LightState.AMBER if in_cycle_s < green_s + AMBER_S else LightState.RED
