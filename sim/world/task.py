"""Owns where a driving task leads: the ego's route on a road, and the lanes that other drivers take."""

from brink.sim.urban.scenario import DrivingTask
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import SPEED_LIMIT_MPS, Junction, Road, turn_begins_m, turn_piece
from brink.sim.world.route import LaneRoute

MIN_EXIT_STREET_M = 30.0


def ego_route(road: Road, task: DrivingTask) -> LaneRoute:
    """Return the ego's route; every task is about as long as the road."""
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
    )


def exit_junction(road: Road, *, right: bool) -> Junction:
    """Return where the first exit (right) or the second (left) leaves the road."""
    return road.junctions[0 if right else -1]


def stream_lane(road: Road, stream: int) -> ReferenceLine:
    """Return the lane of a traffic stream: 0 along the road, 1 into the first exit, 2 into the second."""
    if stream == 0:
        return road.forward
    right = stream == 1
    begins_m = turn_begins_m(exit_junction(road, right=right).forward_m, road.style.lane_width_m, right=right)
    return road.forward.up_to(begins_m, turn_piece(right=right), Piece(road.length_m))
