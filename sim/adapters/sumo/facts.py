"""What the ego of a simulation in SUMO does: one `WorldSample` for each step, and facts about the whole drive.

SUMO gives the middle of a vehicle's front bumper, and keeps vehicles in lanes: the nearest body is the vehicle ahead
or the one behind, unless SUMO reports a collision.
"""

import math
from dataclasses import dataclass
from typing import Any, Final

from brink.sim.adapters.sumo.library import Library
from brink.sim.driving.interface import LightState
from brink.sim.requirements import Collision, CollisionKind, WorldSample

AHEAD_M: Final = 100.0
"""How far ahead and behind other vehicles are looked for."""
RELEVANT_TTC_S: Final = 20.0
PASSED_M: Final = 1e-3
"""Minimum distance past a stop line that has been passed."""
_LIGHTS: Final = {
    "r": LightState.RED,
    "u": LightState.RED,
    "y": LightState.AMBER,
    "Y": LightState.AMBER,
    "g": LightState.GREEN,
    "G": LightState.GREEN,
}
"""State of a traffic light by SUMO's letter; of lights that are off, none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """A vehicle's body: its centre, heading (counter-clockwise from x), size and speed."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    length_m: float
    width_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A stop line that the ego is about to pass, or has just passed."""

    light: str
    link: int
    at_m: float


class SumoFacts:
    """Observes the ego of a running simulation.

    Args:
        sumo: The simulation, which has the ego.
        ego: Id of the ego.

    Attributes:
        lead: The vehicle ahead at the last sample; None without one.
        accel_mps2: The ego's acceleration at the last sample.
        smallest_gap_m: Smallest gap to a vehicle ahead; None without one.
        smallest_ttc_s: Shortest time to collision with the vehicle ahead; None if it was never shorter than 20 s.
        hardest_braking_mps2: The ego's hardest braking, >= 0.
    """

    def __init__(self, sumo: Library, ego: str) -> None:
        self._sumo = sumo
        self._ego = ego
        self._sizes: dict[str, tuple[float, float]] = {}
        self._lanes: dict[str, tuple[float, float]] = {}
        self._begun_m = float(sumo.vehicle.getDistance(ego))
        self._line: Line | None = None
        self.lead: str | None = None
        self.accel_mps2 = 0.0
        self.smallest_gap_m: float | None = None
        self.smallest_ttc_s: float | None = None
        self.hardest_braking_mps2 = 0.0

    def body(self, vehicle: str) -> VehicleState:
        """Return the body of a vehicle that is in the network."""
        own = self._sumo.vehicle
        size = self._sizes.get(vehicle)
        if size is None:
            size = self._sizes[vehicle] = float(own.getLength(vehicle)), float(own.getWidth(vehicle))
        x_m, y_m = own.getPosition(vehicle)
        yaw_rad = math.radians(90.0 - own.getAngle(vehicle))
        yaw_rad = math.remainder(yaw_rad, math.tau)
        back_m = size[0] / 2
        return VehicleState(
            x_m=x_m - back_m * math.cos(yaw_rad),
            y_m=y_m - back_m * math.sin(yaw_rad),
            yaw_rad=yaw_rad,
            speed_mps=float(own.getSpeed(vehicle)),
            length_m=size[0],
            width_m=size[1],
        )

    def sample(self, time_s: float, collision: Collision | None) -> WorldSample:
        """Return the facts of the step that has just ended.

        Args:
            time_s: When it ended.
            collision: The ego's collision in it.
        """
        own, ego = self._sumo.vehicle, self._ego
        body = self.body(ego)
        way_m = float(own.getDistance(ego)) - self._begun_m
        width_m, limit_mps = self._lane(own.getLaneID(ego))
        front_m, behind_m, closing_mps = self._gaps(ego, body.speed_mps)
        nearest_m = min((gap for gap in (front_m, behind_m) if gap is not None), default=None)
        if collision is not None:
            nearest_m = 0.0
        light, line_m = self._stop_line(way_m, body.length_m)
        self.accel_mps2 = float(own.getAcceleration(ego))
        self.hardest_braking_mps2 = max(self.hardest_braking_mps2, -self.accel_mps2)
        return WorldSample(
            time_s=time_s,
            x_m=body.x_m,
            y_m=body.y_m,
            yaw_rad=body.yaw_rad,
            speed_mps=body.speed_mps,
            station_m=way_m,
            offset_m=float(own.getLateralLanePosition(ego)),
            heading_error_rad=0.0,
            ego_length_m=body.length_m,
            ego_width_m=body.width_m,
            lane_left_m=width_m / 2,
            lane_right_m=-width_m / 2,
            speed_limit_mps=limit_mps,
            front_gap_m=front_m,
            nearest_gap_m=nearest_m,
            closing_speed_mps=closing_mps,
            collision=collision,
            light=light,
            stop_line_gap_m=line_m,
            may_wait=light in (LightState.RED, LightState.AMBER)
            or (front_m is not None and front_m < AHEAD_M / 10),
        )

    def _gaps(self, ego: str, speed_mps: float) -> tuple[float | None, float | None, float]:
        """Return the gaps ahead and behind, bumper to bumper, and how fast the smaller one shrinks."""
        own = self._sumo.vehicle
        ahead, behind = own.getLeader(ego, AHEAD_M), own.getFollower(ego, AHEAD_M)
        self.lead = None
        front_m = behind_m = None
        closing_mps = 0.0
        if ahead and ahead[0]:
            # SUMO subtracts the gap that a vehicle keeps when it stands.
            front_m = max(0.0, float(ahead[1]) + float(own.getMinGap(ego)))
            self.lead = str(ahead[0])
            closing_mps = speed_mps - float(own.getSpeed(self.lead))
            self._remember(front_m, closing_mps)
        if behind and behind[0]:
            behind_m = max(0.0, float(behind[1]) + float(own.getMinGap(behind[0])))
            if front_m is None or behind_m < front_m:
                closing_mps = float(own.getSpeed(behind[0])) - speed_mps
        return front_m, behind_m, closing_mps

    def _remember(self, gap_m: float, closing_mps: float) -> None:
        self.smallest_gap_m = gap_m if self.smallest_gap_m is None else min(self.smallest_gap_m, gap_m)
        ttc_s = gap_m / closing_mps if closing_mps > 0.0 else math.inf
        if ttc_s < (RELEVANT_TTC_S if self.smallest_ttc_s is None else self.smallest_ttc_s):
            self.smallest_ttc_s = ttc_s

    def _lane(self, lane: str) -> tuple[float, float]:
        """Return width and speed limit of a lane."""
        found = self._lanes.get(lane)
        if found is None:
            own = self._sumo.lane
            found = self._lanes[lane] = float(own.getWidth(lane)), float(own.getMaxSpeed(lane))
        return found

    def _stop_line(self, way_m: float, length_m: float) -> tuple[LightState | None, float | None]:
        """Return state and distance of the next traffic light, or of the one that the body is passing."""
        lights = self._sumo.vehicle.getNextTLS(self._ego)
        following = Line(light=lights[0][0], link=lights[0][1], at_m=way_m + lights[0][2]) if lights else None
        passing = self._line
        # SUMO reports a line as the next one until the bumper has passed it; each lane has a link of its own.
        if passing is not None and (following is None or following.light != passing.light):
            past_m = way_m - passing.at_m
            if -PASSED_M < past_m < length_m:
                return self._state(passing), min(-past_m, -PASSED_M)
        self._line = following
        if following is None:
            return None, None
        return self._state(following), max(0.0, following.at_m - way_m)

    def _state(self, line: Line) -> LightState | None:
        states = self._sumo.trafficlight.getRedYellowGreenState(line.light)
        return _LIGHTS.get(states[line.link])


def collision_of(sumo: Library, ego: str) -> Collision | None:
    """Return the ego's collision in the last step; None if it had none."""
    for one in sumo.simulation.getCollisions():
        if ego not in (one.collider, one.victim):
            continue
        other = one.victim if one.collider == ego else one.collider
        return Collision(
            kind=CollisionKind.VEHICLE, counterpart=str(other), impact_speed_mps=_impact_mps(sumo, one)
        )
    return None


def _impact_mps(sumo: Library, collision: Any) -> float:
    """Return the difference of the velocities of two vehicles that collide."""
    velocity = [0.0, 0.0]
    for vehicle, speed_mps, sign in (
        (collision.collider, collision.colliderSpeed, 1.0),
        (collision.victim, collision.victimSpeed, -1.0),
    ):
        yaw_rad = math.radians(90.0 - sumo.vehicle.getAngle(vehicle))
        velocity[0] += sign * speed_mps * math.cos(yaw_rad)
        velocity[1] += sign * speed_mps * math.sin(yaw_rad)
    return math.hypot(*velocity)
