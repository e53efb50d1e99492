"""Pedestrians: how they walk, and which of them use the pavement, the crossing, or cross elsewhere.

A walker follows the pavement (a station and an offset on the road's centre line). To cross, it turns to the road,
walks up to the kerb, waits there for a gap, and walks straight across. While crossing, it looks again: it stops
before the path of a vehicle that would hit it, and hurries out of that path. Walkers look around five times per
second and move ten times per second.
"""

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import TypeAlias

from brink.sim.world.line import ReferenceLine
from brink.sim.world.road import Road, SignalPlan
from brink.sim.world.scenario import DrivingTask
from brink.sim.world.streams import Stream, generator
from brink.sim.world.vehicle import Mover
from brink.sim.world.weather import Conditions

PERSON_LENGTH_M = 0.45
PERSON_WIDTH_M = 0.55
PERSON_HEIGHT_M = 1.75
WALKER_STEP_S = 0.1
KERB_SETBACK_M = 0.45
GAP_S = 3.5
"""Pedestrians do not step in front of vehicles that would reach them within this time."""
WALK_ACCEL_MPS2 = 2.5
"""A standing person walks at full speed after half a second, about one step."""
HURRY_SHARE = 1.5
"""Pedestrians leave the way of an approaching vehicle at this multiple of their walking speed."""
TRUST_MPS2 = 3.0
"""Those on a zebra crossing rely on drivers who can still stop with this braking."""
BESIDE_LANE_M = 0.6
"""Pedestrians who let a vehicle pass stop this far from its path."""

ZEBRA_SHARE = 1.0 / 3.0
ELSEWHERE_SHARE = 1.0 / 6.0
CLEAR_OF_JUNCTION_M = 6.0
NEEDED_RED_S = 4.0
"""Pedestrians start across a crossing with lights only if the road stays red for at least this long."""

_STANDS_BELOW_MPS = 1e-6
_MOST_MPS = WALK_ACCEL_MPS2 * WALKER_STEP_S
"""Largest change of speed in a step."""


class Phase(IntEnum):
    """The current activity of a walker."""

    ALONG = 0
    TO_KERB = 1
    WAITING = 2
    CROSSING = 3


GoAhead: TypeAlias = Callable[[float], bool]
"""Returns whether pedestrians have the right of way at a time, for example by a traffic light."""


class Walker:
    """A pedestrian. Mutable: create a new one for each episode.

    Args:
        name: Unique name in the episode.
        centre: The road's centre line.
        station_m: Position along the road.
        offset_m: Position across the road; the sign selects the pavement.
        speed_mps: Walking speed.
        ahead: Whether it walks in the direction of the centre line.
        crosses_at_m: Station at which it crosses the road, or None.
        kerb_m: Distance of the kerb from the centre line.
        patience_s: Waiting time at the kerb after which it accepts any gap that lets vehicles stop.
        go_ahead: Returns whether it has the right of way, regardless of traffic; None where there is no light.
        on_zebra: Whether it uses a crossing where vehicles must give way.
    """

    __slots__ = (
        "_cos_yaw",
        "_go_ahead",
        "_sin_yaw",
        "_target_m",
        "_waited_s",
        "_wanted_mps",
        "ahead",
        "centre",
        "crosses_at_m",
        "kerb_m",
        "length_m",
        "name",
        "offset_m",
        "on_zebra",
        "patience_s",
        "phase",
        "speed_mps",
        "station_m",
        "walking_mps",
        "width_m",
        "x_m",
        "y_m",
        "yaw_rad",
    )

    def __init__(
        self,
        *,
        name: str,
        centre: ReferenceLine,
        station_m: float,
        offset_m: float,
        speed_mps: float,
        ahead: bool,
        crosses_at_m: float | None,
        kerb_m: float,
        patience_s: float,
        go_ahead: GoAhead | None = None,
        on_zebra: bool = False,
    ) -> None:
        self.name = name
        self.length_m = PERSON_LENGTH_M
        self.width_m = PERSON_WIDTH_M
        self.centre = centre
        self.station_m = station_m
        self.offset_m = offset_m
        self.walking_mps = speed_mps
        self.speed_mps = speed_mps
        self.ahead = ahead
        self.crosses_at_m = crosses_at_m
        self.kerb_m = kerb_m
        self.patience_s = patience_s
        self.phase = Phase.ALONG
        self.on_zebra = on_zebra
        self._go_ahead = go_ahead
        self._waited_s = 0.0
        self._wanted_mps = speed_mps
        self._target_m = -offset_m
        self._place()

    @property
    def has_right_of_way(self) -> bool:
        """Whether vehicles must give way to this pedestrian."""
        return self.on_zebra and self.phase is not Phase.ALONG

    def is_near(self, offset_m: float, half_m: float, margin_m: float) -> bool:
        """Return whether this pedestrian is in a strip along the road, or close to it and not moving away.

        Args:
            offset_m: Middle of the strip.
            half_m: Half its width.
            margin_m: How far from the strip is close.
        """
        to_go_m = offset_m - self.offset_m
        leaves = self.phase is Phase.CROSSING and to_go_m * self._target_m < 0.0
        return abs(to_go_m) < (half_m if leaves else half_m + margin_m)

    def _place(self) -> None:
        self.x_m, self.y_m, along = self.centre.pose_at(self.station_m, self.offset_m)
        if self.phase is Phase.ALONG:
            yaw = along if self.ahead else along + math.pi
        else:
            yaw = along + (0.5 * math.pi if self._target_m > 0 else -0.5 * math.pi)
        self.yaw_rad = yaw
        self._cos_yaw = math.cos(yaw)
        self._sin_yaw = math.sin(yaw)

    def look(self, time_s: float, movers: Sequence[Mover]) -> None:
        """Look around and decide what to do next.

        Args:
            time_s: Simulated time.
            movers: The vehicles and the ego.
        """
        if self.phase is Phase.ALONG:
            at_m = self.crosses_at_m
            if at_m is not None and (self.station_m >= at_m if self.ahead else self.station_m <= at_m):
                self.phase = Phase.TO_KERB
        elif self.phase is Phase.WAITING:
            self._waited_s += 2.0 * WALKER_STEP_S
            if self._may_go(time_s, movers):
                self.phase = Phase.CROSSING
                self._wanted_mps = self.walking_mps * 1.1
        elif self.phase is Phase.CROSSING:
            if abs(self.offset_m - self._target_m) < 0.3:
                self.phase = Phase.ALONG
                self.crosses_at_m = None
                self._wanted_mps = self.walking_mps
            else:
                self._wanted_mps = self._crossing_mps(movers)
        self._place()

    def _may_go(self, time_s: float, movers: Sequence[Mover]) -> bool:
        if self._go_ahead is not None:
            return self._go_ahead(time_s)
        # On a zebra crossing, an impatient walker also steps out in front of drivers who can still stop.
        trusting = self.on_zebra and self._waited_s > self.patience_s
        for mover in movers:
            dx, dy = self.x_m - mover.x_m, self.y_m - mover.y_m
            distance_m = math.hypot(dx, dy)
            speed = mover.speed_mps
            if distance_m > 40.0:
                continue
            ahead_m = dx * math.cos(mover.yaw_rad) + dy * math.sin(mover.yaw_rad)
            room_m = 0.5 * mover.length_m + 0.5
            if ahead_m < -room_m or (speed < 0.3 and ahead_m > room_m):
                continue
            gap_m = 0.8 * speed + speed * speed / 6.0 if trusting else GAP_S * speed
            if ahead_m < 4.0 + gap_m:
                return False
        return True

    def _crossing_mps(self, movers: Sequence[Mover]) -> float:
        """Return how fast to go on across the road, given those who approach."""
        walking_mps = self.walking_mps * 1.1
        for mover in movers:
            dx, dy = self.x_m - mover.x_m, self.y_m - mover.y_m
            speed = mover.speed_mps
            if speed < 0.3 or abs(dx) > 30.0 or abs(dy) > 30.0:
                continue
            cos_yaw, sin_yaw = math.cos(mover.yaw_rad), math.sin(mover.yaw_rad)
            ahead_m = dx * cos_yaw + dy * sin_yaw - 0.5 * mover.length_m
            if ahead_m < 0.0:
                continue
            # Across the mover's path, in the walker's direction; negative on this side of it.
            heading = self._sin_yaw * cos_yaw - self._cos_yaw * sin_yaw
            across_m = math.copysign(1.0, heading) * (dy * cos_yaw - dx * sin_yaw)
            half_m = 0.5 * (mover.width_m + self.width_m) + 0.2
            arrives_s = ahead_m / speed
            enters_s, leaves_s = (-half_m - across_m) / walking_mps, (half_m - across_m) / walking_mps
            if leaves_s < 0.0 or arrives_s < enters_s - 0.3 or arrives_s > leaves_s + 0.8:
                continue
            if across_m > -half_m:
                return walking_mps * HURRY_SHARE
            stops = self.on_zebra and speed * speed < 2.0 * TRUST_MPS2 * max(ahead_m - 1.0, 0.1)
            if not stops and -half_m - across_m < BESIDE_LANE_M + 0.5 * self.speed_mps**2 / WALK_ACCEL_MPS2:
                return 0.0
        return walking_mps

    def move(self) -> None:
        """Advance by `WALKER_STEP_S`."""
        to_kerb_m, wanted_mps = math.inf, self._wanted_mps
        if self.phase is Phase.TO_KERB:
            to_kerb_m = max(abs(self.offset_m) - self.kerb_m - KERB_SETBACK_M, 0.0)
            wanted_mps = min(wanted_mps, _stopping_within_mps(to_kerb_m))
        change_mps = wanted_mps - self.speed_mps
        if change_mps != 0.0:
            self.speed_mps += min(max(change_mps, -_MOST_MPS), _MOST_MPS)
        if self.phase is Phase.TO_KERB and self.speed_mps < _STANDS_BELOW_MPS:
            self.phase = Phase.WAITING
            self.speed_mps = self._wanted_mps = 0.0
        step_m = self.speed_mps * WALKER_STEP_S
        if self.speed_mps <= _MOST_MPS:
            step_m = min(step_m, to_kerb_m)
        if step_m == 0.0:
            return
        if self.phase is Phase.ALONG:
            way_m = step_m if self.ahead else -step_m
            self.station_m = self.centre.station_after(self.station_m, self.offset_m, way_m)
        else:
            self.offset_m += step_m if self._target_m > 0 else -step_m
        self.x_m += self._cos_yaw * step_m
        self.y_m += self._sin_yaw * step_m


def _stopping_within_mps(to_go_m: float) -> float:
    """Return the speed of the next step after which a walker who brakes in all further steps stops in time."""
    half_step_s = 0.5 * WALKER_STEP_S
    return WALK_ACCEL_MPS2 * (math.sqrt(half_step_s**2 + 2.0 * to_go_m / WALK_ACCEL_MPS2) - half_step_s)


def make_people(
    road: Road, weather: Conditions, signals: SignalPlan | None, *, count: int, seed: int, task: DrivingTask
) -> list[Walker]:
    """Return all walkers of an episode.

    Args:
        road: The road they walk along.
        weather: Sets their walking speed and patience.
        signals: The lights of the crossing, if it has any.
        count: Number of walkers.
        seed: The episode's seed.
        task: The ego's task; walkers who cross elsewhere do so where the ego passes.
    """
    walkers = []
    at_zebra, elsewhere = round(count * ZEBRA_SHARE), round(count * ELSEWHERE_SHARE)
    reach_m = road.length_m if task is DrivingTask.FOLLOW_ROAD else 0.8 * road.length_m
    go_ahead: GoAhead | None = None
    if signals is not None:
        go_ahead = _with_light(signals)
    for index in range(count):
        rng = generator(seed, Stream.PEDESTRIAN, index)
        speed = weather.walking_mps * float(rng.uniform(0.92, 1.08))
        ahead = index % 2 == 0
        side = 1.0 if index % 4 < 2 else -1.0
        direction = 1.0 if ahead else -1.0
        crosses_at_m: float | None = None
        if index < at_zebra:
            crosses_at_m = road.crossing_m + float(rng.uniform(-0.8, 0.8))
            arrives_s = 1.0 + 9.0 * (index // 2) + 0.8 * (index % 2) + float(rng.uniform(-0.5, 0.5))
            station_m = crosses_at_m - direction * speed * arrives_s
        elif index < at_zebra + elsewhere:
            place = (index - at_zebra + 1) / (elsewhere + 1)
            wanted_m = reach_m * (0.30 + 0.65 * place) + float(rng.uniform(-1.5, 1.5))
            crosses_at_m = _clear_of_junctions(road, wanted_m)
            arrives_s = crosses_at_m / 7.0 + 3.0 + float(rng.uniform(-1.0, 1.0))
            station_m = crosses_at_m - direction * speed * arrives_s
        else:
            station_m = road.length_m * index / count + float(rng.uniform(-3.0, 3.0))
        walkers.append(
            Walker(
                name=f"pedestrian-{index + 1}",
                centre=road.centre,
                station_m=station_m,
                offset_m=side * (road.walkway_m + float(rng.uniform(-0.4, 0.4))),
                speed_mps=speed,
                ahead=ahead,
                crosses_at_m=crosses_at_m,
                kerb_m=road.kerb_m,
                patience_s=weather.patience_s,
                go_ahead=go_ahead if index < at_zebra else None,
                on_zebra=index < at_zebra and signals is None,
            )
        )
    return walkers


def _clear_of_junctions(road: Road, station_m: float) -> float:
    """Return the nearest station outside all junctions at which to cross the road."""
    reach_m = road.kerb_m + road.style.pavement_m + CLEAR_OF_JUNCTION_M
    for junction in road.junctions:
        beyond_m = station_m - junction.station_m
        if abs(beyond_m) < reach_m:
            return junction.station_m + math.copysign(reach_m, beyond_m)
    return station_m


def _with_light(signals: SignalPlan) -> GoAhead:
    def go_ahead(time_s: float) -> bool:
        return signals.main_red_for_s(time_s) > NEEDED_RED_S

    return go_ahead
