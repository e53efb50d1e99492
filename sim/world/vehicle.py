"""Motion of other vehicles: along their lane, at their desired speed, behind any obstacle ahead.

The Intelligent Driver Model sets the acceleration; the lane sets the path. A vehicle looks around five times per
second and moves twenty times per second.

References:
    Treiber, Hennecke, Helbing 2000, Congested traffic states in empirical observations and microscopic simulations.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol, TypeAlias

from brink.sim.world.line import ReferenceLine

LOOK_EVERY_STEPS = 4
LOOK_AHEAD_M = 45.0
SIDE_CLEARANCE_M = 0.35
CORNERING_MPS2 = 1.9
COMFORT_MPS2 = 1.6
ACCEL_MPS2 = 1.6
_CLOSING_MPS2 = 2.0 * math.sqrt(ACCEL_MPS2 * COMFORT_MPS2)
STANDSTILL_GAP_M = 2.2
EMERGENCY_MPS2 = 6.5
BRAKE_LIGHTS_FROM_MPS2: Final = 0.7
HELD_BELOW_MPS: Final = 0.1


def brake_lights_on(speed_mps: float, accel_mps2: float) -> bool:
    """Return whether the brake lights of a driven vehicle are on: it slows down, or its brake holds it.

    UN Regulation No. 13-H, 5.2.22.4, on regenerative braking that begins when the accelerator is released: no brake
    lights up to 0.7 m/s^2, with them above 1.3 m/s^2, and the manufacturer decides in between. Here they are on in
    between. What a vehicle without it loses as it rolls, by drag and the engine, is less than 0.7 m/s^2 in a town.
    """
    return accel_mps2 < -BRAKE_LIGHTS_FROM_MPS2 or speed_mps < HELD_BELOW_MPS


class Mover(Protocol):
    """Anything with a position, a heading, a speed and an extent."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float

    @property
    def length_m(self) -> float:
        """Extent along its heading."""

    @property
    def width_m(self) -> float:
        """Extent across its heading."""


@dataclass(frozen=True, slots=True)
class VehicleSize:
    """Dimensions of a vehicle's body."""

    length_m: float
    width_m: float
    height_m: float


CAR = VehicleSize(4.4, 1.8, 1.5)
VAN = VehicleSize(5.6, 2.0, 2.3)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingStyle:
    """How a vehicle is driven.

    Attributes:
        speed_mps: Desired speed on a free, straight road.
        headway_s: Time gap to the vehicle ahead.
        braking_mps2: Hardest braking outside emergencies.
        friction: Friction of the road, which limits braking.
        slowdowns: Periods (from, to, share) in seconds during which the desired speed is reduced to a share.
    """

    speed_mps: float
    headway_s: float
    braking_mps2: float
    friction: float
    slowdowns: tuple[tuple[float, float, float], ...] = ()


MustStop: TypeAlias = "Callable[[Vehicle, float], bool]"


@dataclass(frozen=True, slots=True)
class StopPoint:
    """A point on a path where a vehicle may have to wait.

    Attributes:
        station_m: Where its front bumper stops.
        must_stop: Returns whether a vehicle has to stop there at a time.
    """

    station_m: float
    must_stop: MustStop


@dataclass(frozen=True, slots=True)
class PullOut:
    """A move from the roadside into the lane: from an offset at a station to 0 over a distance."""

    offset_m: float
    from_m: float
    over_m: float

    def share_at(self, station_m: float) -> float:
        """Return the completed share of the move, in [0, 1]."""
        return min(max((station_m - self.from_m) / self.over_m, 0.0), 1.0)

    def turn_at(self, station_m: float) -> float:
        """Return the heading relative to the lane."""
        share = self.share_at(station_m)
        return math.atan2(-self.offset_m * 6.0 * share * (1.0 - share), self.over_m)


class Vehicle:
    """Another vehicle. Mutable: create a new one for each episode.

    Args:
        name: Unique name in the episode.
        size: Dimensions of its body.
        path: Centre line of its lane.
        station_m: Station of its centre on the path.
        speed_mps: Initial speed on a straight path; it starts more slowly in a bend or too close before one.
        style: How it is driven.
        stops: Where it may have to wait, in any order.
        pull_out: Its move into the lane, if it starts at the roadside.
        starts_s: Time before which it stands still.
        phase: Offset of its turn to look around, in steps.
    """

    is_vehicle: ClassVar = True
    __slots__ = (
        "_arcs",
        "_gap_m",
        "_gap_speed_mps",
        "_phase",
        "_stop_m",
        "accel_mps2",
        "length_m",
        "name",
        "offset_m",
        "path",
        "pull_out",
        "size",
        "speed_mps",
        "starts_s",
        "station_m",
        "stops",
        "style",
        "width_m",
        "x_m",
        "y_m",
        "yaw_rad",
    )

    def __init__(
        self,
        *,
        name: str,
        size: VehicleSize,
        path: ReferenceLine,
        station_m: float,
        speed_mps: float,
        style: DrivingStyle,
        stops: Sequence[StopPoint] = (),
        pull_out: PullOut | None = None,
        starts_s: float = 0.0,
        phase: int = 0,
    ) -> None:
        self.name = name
        self.size = size
        self.length_m = size.length_m
        self.width_m = size.width_m
        self.path = path
        self.station_m = station_m
        self.offset_m = pull_out.offset_m if pull_out else 0.0
        self.accel_mps2 = 0.0
        self.style = style
        self.stops = tuple(sorted(stops, key=lambda stop: stop.station_m))
        self.pull_out = pull_out
        self.starts_s = starts_s
        self._arcs = _arc_speeds(path)
        self.speed_mps = self._wanted_before_bends(speed_mps)
        self._phase = phase % LOOK_EVERY_STEPS
        self._gap_m = math.inf
        self._gap_speed_mps = 0.0
        self._stop_m = math.inf
        self.x_m, self.y_m, self.yaw_rad = path.pose_at(station_m, self.offset_m)

    def looks_at(self, step: int) -> bool:
        """Return whether it is this vehicle's turn to look around in a 20 Hz step."""
        return step % LOOK_EVERY_STEPS == self._phase or step == 0

    def look(self, time_s: float, movers: Sequence[Mover]) -> None:
        """Look for obstacles and stop points ahead.

        Args:
            time_s: Simulated time.
            movers: All possible obstacles; may include the vehicle itself.
        """
        self._gap_m, self._gap_speed_mps = self._nearest(movers)
        front_m = self.station_m + 0.5 * self.length_m
        self._stop_m = math.inf
        for stop in self.stops:
            ahead_m = stop.station_m - front_m
            if -0.5 <= ahead_m < LOOK_AHEAD_M and stop.must_stop(self, time_s):
                braking_mps2 = self.speed_mps * self.speed_mps / (2.0 * max(ahead_m, 0.1))
                if braking_mps2 < self.style.braking_mps2 + 1.5:
                    self._stop_m = stop.station_m
                    break

    def _nearest(self, movers: Sequence[Mover]) -> tuple[float, float]:
        """Return the gap to the nearest obstacle on the path, and its speed along the path."""
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x_m, y_m, station_m = self.x_m, self.y_m, self.station_m
        reach_m = min(LOOK_AHEAD_M, 12.0 + 4.5 * self.speed_mps)
        gap_m, gap_speed = math.inf, 0.0
        for other in movers:
            dx, dy = other.x_m - x_m, other.y_m - y_m
            if not -reach_m < dx < reach_m or not -reach_m < dy < reach_m or other is self:
                continue
            if dx * cos_yaw + dy * sin_yaw < -4.0:
                continue
            at_m, off_m = self.path.project(other.x_m, other.y_m, station_m + 5.0)
            if at_m <= station_m or at_m > station_m + reach_m:
                continue
            turn = other.yaw_rad - self.path.pose_at(at_m)[2]
            cos_turn, sin_turn = math.cos(turn), abs(math.sin(turn))
            half_across = 0.5 * (abs(cos_turn) * other.width_m + sin_turn * other.length_m)
            # A vehicle at the roadside checks the lane that it will enter, not where it stands.
            if abs(off_m) > half_across + 0.5 * self.width_m + SIDE_CLEARANCE_M:
                continue
            half_along = 0.5 * (abs(cos_turn) * other.length_m + sin_turn * other.width_m)
            between_m = at_m - half_along - station_m - 0.5 * self.length_m
            if between_m < gap_m:
                gap_m, gap_speed = between_m, other.speed_mps * cos_turn
        return gap_m, gap_speed

    def _wanted_before_bends(self, wanted_mps: float) -> float:
        """Return the desired speed, reduced where the path bends or is about to bend."""
        station_m = self.station_m
        for begin_m, end_m, arc_mps in self._arcs:
            if station_m < end_m and arc_mps < wanted_mps:
                before_m = begin_m - station_m
                if before_m <= 0.0:
                    wanted_mps = arc_mps
                elif before_m < LOOK_AHEAD_M:
                    wanted_mps = min(wanted_mps, math.sqrt(arc_mps * arc_mps + 2.0 * COMFORT_MPS2 * before_m))
        return wanted_mps

    def move(self, time_s: float, dt_s: float) -> None:
        """Advance by one time step."""
        if time_s < self.starts_s:
            self.speed_mps = 0.0
            return
        style = self.style
        speed = self.speed_mps
        wanted = style.speed_mps
        for from_s, to_s, share in style.slowdowns:
            if from_s <= time_s < to_s:
                wanted *= share
        station_m = self.station_m
        wanted = self._wanted_before_bends(wanted)
        share = speed / wanted if wanted > 0.1 else math.inf
        squared = share * share
        accel = ACCEL_MPS2 * (1.0 - squared * squared)
        if accel < -style.braking_mps2:
            accel = -style.braking_mps2
        gap_m, gap_speed = self._gap_m, self._gap_speed_mps
        if gap_m < LOOK_AHEAD_M:
            accel = min(accel, _follow(speed, gap_speed, gap_m, style.headway_s, STANDSTILL_GAP_M))
            self._gap_m = gap_m + (gap_speed - speed) * dt_s
        if self._stop_m < math.inf:
            to_line_m = self._stop_m - station_m - 0.5 * self.length_m
            accel = min(accel, _follow(speed, 0.0, to_line_m + 0.6, 0.5, 0.5))
        hardest = min(EMERGENCY_MPS2, 9.0 * style.friction)
        if accel < -hardest:
            accel = -hardest
        faster = speed + accel * dt_s
        if faster < 0.0:
            faster = 0.0
        self.accel_mps2 = (faster - speed) / dt_s
        self.speed_mps = faster
        if faster == 0.0 and speed == 0.0:
            return
        along_m = 0.5 * (speed + faster) * dt_s
        turn = 0.0
        pull = self.pull_out
        if pull is None:
            station_m += along_m
        else:
            along_m *= math.cos(pull.turn_at(station_m))
            station_m = self.path.station_after(station_m, self.offset_m, along_m)
            share = pull.share_at(station_m)
            self.offset_m = pull.offset_m * (1.0 - share * share * (3.0 - 2.0 * share))
            turn = pull.turn_at(station_m)
        self.station_m = station_m
        self.x_m, self.y_m, yaw_rad = self.path.pose_at(station_m, self.offset_m)
        self.yaw_rad = yaw_rad + turn


def _follow(speed: float, ahead_speed: float, gap_m: float, headway_s: float, standstill_m: float) -> float:
    """Return the acceleration behind an obstacle: the model's interaction term, without the free-road term."""
    if gap_m <= 0.05:
        return -EMERGENCY_MPS2
    wanted_m = standstill_m + max(speed * headway_s + speed * (speed - ahead_speed) / _CLOSING_MPS2, 0.0)
    ratio = wanted_m / gap_m
    return ACCEL_MPS2 * (1.0 - ratio * ratio)


def _arc_speeds(path: ReferenceLine) -> tuple[tuple[float, float, float], ...]:
    """Return (from, to, speed) for each arc of a path."""
    arcs = []
    at_m = 0.0
    for piece in path.pieces:
        if piece.curvature_1pm != 0.0:
            arcs.append((at_m, at_m + piece.length_m, math.sqrt(CORNERING_MPS2 / abs(piece.curvature_1pm))))
        at_m += piece.length_m
    return tuple(arcs)
