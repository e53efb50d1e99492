"""Owns the ego's route: its lane centre line, with what the map knows of it.

Implements `brink.sim.driving.interface.Route`.
"""

from dataclasses import dataclass, field

from brink.sim.world.line import ReferenceLine


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneRoute:
    """The lane centre line from start to goal.

    Attributes:
        line: Starts at the ego's start, ends at the goal.
        lane_width_m: Width of the ego's lane.
        speed_limit_mps: Speed limit on the whole route.
        stop_line_stations_m: Where a traffic light guards the lane, ascending.
        oncoming: Stretches (from, to) in stations with a lane for oncoming traffic directly to the left.
    """

    line: ReferenceLine
    lane_width_m: float
    speed_limit_mps: float
    stop_line_stations_m: tuple[float, ...] = ()
    oncoming: tuple[tuple[float, float], ...] = field(default=())

    @property
    def length_m(self) -> float:
        """Length from the first to the last station."""
        return self.line.length_m

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x_m, y_m, yaw_rad) at a station and offset; beyond the ends the route goes on straight."""
        return self.line.pose_at(station_m, offset_m)

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m, positive to the left."""
        return self.line.curvature_at(station_m)

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point of the route near a known station."""
        return self.line.project(x_m, y_m, near_station_m)

    def oncoming_lane_at(self, station_m: float) -> bool:
        """Return whether a lane for oncoming traffic lies directly to the left here."""
        return any(start_m <= station_m <= end_m for start_m, end_m in self.oncoming)
