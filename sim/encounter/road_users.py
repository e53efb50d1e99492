"""Owns how scripted road users move: along their scripts, but never into each other.

The ego is nobody that they look out for. A vehicle that would run into another one, or into a person, goes on through
its script more slowly until there is room again: what it does stays the same, when it does it changes.
"""

import math
from collections.abc import Sequence
from typing import Final

from brink.sim.encounter.script import Kind, Script, Stretch
from brink.sim.world.line import ReferenceLine
from brink.sim.world.pedestrians import PERSON_LENGTH_M, PERSON_WIDTH_M
from brink.sim.world.vehicle import CAR, VAN, VehicleSize
from brink.sim.world.world import RoadUser

SIZES: Final = {
    Kind.CAR: CAR,
    Kind.VAN: VAN,
    Kind.PEDESTRIAN: VehicleSize(PERSON_LENGTH_M, PERSON_WIDTH_M, 1.75),
}
STANDSTILL_M: Final = 1.5
HEADWAY_S: Final = 0.7
BRAKES_MPS2: Final = 6.0
PULLS_AWAY_MPS2: Final = 2.5
SIDE_M: Final = 0.3
_LOOKS_EVERY_STEPS: Final = 2


class ScriptedUser:
    """A road user with a script. Changes in place: made anew for every episode.

    Args:
        name: Unique in the episode.
        script: What it does.
        line: Centre line of the ego's first lane, along which stations run.
    """

    __slots__ = (
        "_line",
        "_pace",
        "_script",
        "_script_s",
        "kind",
        "length_m",
        "name",
        "size",
        "speed_mps",
        "width_m",
        "x_m",
        "y_m",
        "yaw_rad",
    )

    def __init__(self, name: str, script: Script, line: ReferenceLine) -> None:
        self.name = name
        self.kind = script.kind
        self.size = SIZES[script.kind]
        self.length_m = self.size.length_m
        self.width_m = self.size.width_m
        self._script = script
        self._line = line
        self._script_s = 0.0
        self._pace = 1.0
        self._place()

    @property
    def stretch(self) -> Stretch:
        """What it does now."""
        return self._script.stretch_at(self._script_s)

    def _place(self) -> None:
        s_m, d_m, heading_rad, speed_mps = self.stretch.at(self._script_s)
        self.x_m, self.y_m, along_rad = self._line.pose_at(s_m, d_m)
        self.yaw_rad = along_rad + heading_rad
        self.speed_mps = speed_mps * self._pace

    def advance(self, step: int, dt_s: float, others: Sequence[RoadUser]) -> None:
        """Move on by one step; people do not look, vehicles do."""
        if self.kind is not Kind.PEDESTRIAN:
            self._look(step, dt_s, others)
        self._script_s += self._pace * dt_s
        self._place()

    def _look(self, step: int, dt_s: float, others: Sequence[RoadUser]) -> None:
        scripted_mps = self.stretch.at(self._script_s)[3]
        if scripted_mps < 0.1:
            self._pace = 1.0
            return
        if step % _LOOKS_EVERY_STEPS:
            return
        blocked = any(self._would_hit(other) for other in others if other is not self)
        change = _LOOKS_EVERY_STEPS * dt_s / scripted_mps
        if blocked:
            self._pace = max(0.0, self._pace - BRAKES_MPS2 * change)
        else:
            self._pace = min(1.0, self._pace + PULLS_AWAY_MPS2 * change)

    def _would_hit(self, other: RoadUser) -> bool:
        """Return whether somebody is so close ahead, in its own width, that it must slow down."""
        dx, dy = other.x_m - self.x_m, other.y_m - self.y_m
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        ahead_m = dx * cos_yaw + dy * sin_yaw
        if ahead_m <= 0.0:
            return False
        turn = other.yaw_rad - self.yaw_rad
        cos_turn, sin_turn = abs(math.cos(turn)), abs(math.sin(turn))
        across_m = abs(dy * cos_yaw - dx * sin_yaw)
        half_across_m = 0.5 * (self.width_m + cos_turn * other.width_m + sin_turn * other.length_m)
        if across_m > half_across_m + SIDE_M:
            return False
        half_along_m = 0.5 * (self.length_m + cos_turn * other.length_m + sin_turn * other.width_m)
        slower_mps = max(0.0, self.speed_mps - other.speed_mps * math.cos(turn))
        room_m = (
            STANDSTILL_M + HEADWAY_S * self.speed_mps * 0.5 + slower_mps * slower_mps / (2.0 * BRAKES_MPS2)
        )
        return ahead_m - half_along_m < room_m
