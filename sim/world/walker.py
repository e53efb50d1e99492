"""Owns how a person walks: along the pavement, and over the road where and when it seems safe.

A walker keeps to the pavement (a station and an offset on the road's centre line). One who wants to cross goes to
the place, turns to the road, waits for a gap, and walks straight over. People look around five times a second and
move ten times a second.
"""

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import TypeAlias

from brink.sim.world.line import ReferenceLine
from brink.sim.world.vehicle import Mover

LENGTH_M = 0.45
WIDTH_M = 0.55
HEIGHT_M = 1.75
STEP_S = 0.1
KERB_SETBACK_M = 0.45
GAP_S = 3.5
"""People do not step in front of what would be there sooner than this."""


class Phase(IntEnum):
    """What a walker is about."""

    ALONG = 0
    WAITING = 1
    CROSSING = 2


GoAhead: TypeAlias = Callable[[float], bool]
"""Says whether people have a right to cross at a time, such as by a light."""


class Walker:
    """A person on foot. Changes in place: made anew for every episode.

    Args:
        name: Unique in the episode.
        centre: The road's centre line.
        station_m: Where it is along the road.
        offset_m: Where it is across the road; the sign says on which pavement.
        speed_mps: How fast it walks.
        ahead: Whether it walks in the direction of the centre line.
        crosses_at_m: Station at which it crosses the road, or None.
        kerb_m: Distance of the kerb from the centre line.
        patience_s: How long it waits at the kerb before it takes any gap that lets vehicles stop.
        go_ahead: When it may cross whatever comes; None where there is no light.
        on_zebra: Whether it crosses where vehicles must let it.
    """

    __slots__ = (
        "_go_ahead",
        "_target_m",
        "_vx",
        "_vy",
        "_waited_s",
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
        self.length_m = LENGTH_M
        self.width_m = WIDTH_M
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
        self._target_m = -offset_m
        self._place()

    @property
    def wants_zebra(self) -> bool:
        """Whether vehicles must let it cross."""
        return self.on_zebra and self.phase is not Phase.ALONG

    def _place(self) -> None:
        self.x_m, self.y_m, along = self.centre.pose_at(self.station_m, self.offset_m)
        if self.phase is Phase.ALONG:
            yaw = along if self.ahead else along + math.pi
        else:
            yaw = along + (0.5 * math.pi if self._target_m > 0 else -0.5 * math.pi)
        self.yaw_rad = yaw
        speed = self.speed_mps
        self._vx = speed * math.cos(yaw)
        self._vy = speed * math.sin(yaw)

    def look(self, time_s: float, movers: Sequence[Mover]) -> None:
        """Decide what to do next.

        Args:
            time_s: Simulated time.
            movers: The vehicles and the ego.
        """
        if self.phase is Phase.ALONG:
            at_m = self.crosses_at_m
            if at_m is not None and (self.station_m >= at_m if self.ahead else self.station_m <= at_m):
                self.phase = Phase.WAITING
                self.speed_mps = 0.0
                self.offset_m = math.copysign(self.kerb_m + KERB_SETBACK_M, self.offset_m)
        elif self.phase is Phase.WAITING:
            self._waited_s += 2.0 * STEP_S
            if self._may_go(time_s, movers):
                self.phase = Phase.CROSSING
                self.speed_mps = self.walking_mps * 1.1
        elif abs(self.offset_m - self._target_m) < 0.3:
            self.phase = Phase.ALONG
            self.crosses_at_m = None
            self.speed_mps = self.walking_mps
        self._place()

    def _may_go(self, time_s: float, movers: Sequence[Mover]) -> bool:
        if self._go_ahead is not None:
            return self._go_ahead(time_s)
        # On a zebra somebody impatient also steps out before those who can still stop.
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

    def move(self) -> None:
        """Move on by `STEP_S`."""
        step_m = self.speed_mps * STEP_S
        if step_m == 0.0:
            return
        if self.phase is Phase.ALONG:
            self.station_m += step_m if self.ahead else -step_m
        else:
            self.offset_m += step_m if self._target_m > 0 else -step_m
        self.x_m += self._vx * STEP_S
        self.y_m += self._vy * STEP_S
