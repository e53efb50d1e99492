"""Owns what is told of an encounter: how near everybody came to the ego, and the circumstances of each violation.

Circumstances are raw facts of the moment at which a requirement was first violated. Rules elsewhere make types of
them, and can be changed without simulating again.
"""

import math
from collections import deque
from typing import Final

from brink.sim.driving.interface import DrivingSystem
from brink.sim.encounter.rectangles import Rectangle, bearing_rad, signed_gap_m
from brink.sim.encounter.road_users import ScriptedUser
from brink.sim.encounter.world import EncounterWorld
from brink.sim.episode import JsonObject
from brink.sim.requirements import WorldSample
from brink.sim.trace import ACTION
from brink.sim.urban.recorder import Recorder
from brink.sim.world.world import STEP_S

NEARBY_M: Final = 15.0
"""A violation that is no collision has the nearest road user as its counterpart if it is within this."""

IN_WAY_M: Final = 35.0
"""A road user is in the ego's way if it is so near ahead and reaches into the width that the ego sweeps."""

_AHEAD: Final = ("front-gap@1",)
"""Requirements whose counterpart is in the ego's way, however near others are."""

_LOOKBACK: Final = round(0.5 / STEP_S)
_JUNCTION_M: Final = 12.0
_CROSSING_M: Final = 4.0
_CURVED_1PM: Final = 1e-3


class EncounterWitness:
    """Watches one encounter.

    Args:
        world: What to watch.
        recorder: Is told what everybody does, if the episode is recorded.
    """

    def __init__(self, world: EncounterWorld, recorder: Recorder | None = None) -> None:
        self._world = world
        self._recorder = recorder
        self._actions = [""] * len(world.everybody)
        self.gaps_m = [math.inf] * len(world.everybody)
        self._in_way_since_s: list[float | None] = [None] * len(world.everybody)
        self._history: deque[tuple[float, float, float]] = deque(maxlen=_LOOKBACK + 1)
        self._speeds: list[deque[float]] = [deque(maxlen=_LOOKBACK + 1) for _ in world.everybody]
        self._radius_m = 0.5 * math.hypot(world.ego.length_m, world.ego.width_m)
        self._sample: WorldSample | None = None
        self._mode = ""
        self._seen: set[str] = set()
        self.violations: list[JsonObject] = []

    def see(self, sample: WorldSample, driving: DrivingSystem) -> None:
        """Take note of a control step, after everybody has moved."""
        self._sample = sample
        self._mode = driving.plan.mode.value
        self._history.append((sample.speed_mps, sample.yaw_rad, sample.offset_m))
        ego: Rectangle | None = None
        for index, user in enumerate(self._world.everybody):
            self._speeds[index].append(user.speed_mps)
            dx, dy = user.x_m - sample.x_m, user.y_m - sample.y_m
            reach_m = self._radius_m + 0.5 * math.hypot(user.length_m, user.width_m)
            if math.hypot(dx, dy) - reach_m < self.gaps_m[index]:
                ego = ego or self._ego()
                gap_m = signed_gap_m(ego, rectangle_of(user))
                self.gaps_m[index] = min(self.gaps_m[index], gap_m)
            self._watch_way(index, user, sample)
            if self._recorder is not None and (action := user.stretch.action) != self._actions[index]:
                self._actions[index] = action
                self._recorder.event(sample.time_s, ACTION, f"{user.name}:{action}")

    @property
    def criticality_m(self) -> float:
        """How near anybody came to the ego; infinite if nobody is about."""
        return min(self.gaps_m, default=math.inf)

    def _ego(self) -> Rectangle:
        ego = self._world.ego
        return Rectangle(ego.x_m, ego.y_m, ego.yaw_rad, 0.5 * ego.length_m, 0.5 * ego.width_m)

    def _watch_way(self, index: int, user: ScriptedUser, sample: WorldSample) -> None:
        """Note since when somebody has been in the ego's way."""
        dx, dy = user.x_m - sample.x_m, user.y_m - sample.y_m
        there = -IN_WAY_M < dx < IN_WAY_M and -IN_WAY_M < dy < IN_WAY_M
        if there:
            line = self._world.route.line
            at_m, off_m = line.project(user.x_m, user.y_m, sample.station_m)
            turn = user.yaw_rad - line.pose_at(at_m)[2]
            half_m = 0.5 * (abs(math.cos(turn)) * user.width_m + abs(math.sin(turn)) * user.length_m)
            within = abs(off_m - sample.offset_m) < half_m + 0.5 * sample.ego_width_m
            there = within and 0.0 < at_m - sample.station_m < IN_WAY_M
        if not there:
            self._in_way_since_s[index] = None
        elif self._in_way_since_s[index] is None:
            self._in_way_since_s[index] = sample.time_s

    def violated(self, requirement: str) -> None:
        """Take note of the circumstances, the first time that a requirement is violated."""
        sample = self._sample
        if requirement in self._seen or sample is None:
            return
        self._seen.add(requirement)
        hit = sample.collision
        if hit is not None:
            names = [user.name for user in self._world.everybody]
            index = names.index(hit.counterpart) if hit.counterpart in names else None
        else:
            index = self._in_way(sample) if requirement in _AHEAD else None
            index = self._nearest(sample) if index is None else index
        self.violations.append(
            {
                "requirement": requirement,
                "time_s": sample.time_s,
                "ego": self._ego_facts(sample),
                "other": None if index is None else self._other_facts(index, sample),
                "place": self._place_facts(sample),
                "collision": None if hit is None else hit.kind.value,
                "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
            }
        )

    def _in_way(self, sample: WorldSample) -> int | None:
        """Return the nearest of those in the ego's way."""
        ego = self._ego()
        gaps = [
            (signed_gap_m(ego, rectangle_of(user)), index)
            for index, user in enumerate(self._world.everybody)
            if self._in_way_since_s[index] is not None
        ]
        return min(gaps)[1] if gaps else None

    def _nearest(self, sample: WorldSample) -> int | None:
        ego = self._ego()
        gaps = [
            (signed_gap_m(ego, rectangle_of(user)), index)
            for index, user in enumerate(self._world.everybody)
            if math.hypot(user.x_m - sample.x_m, user.y_m - sample.y_m) < NEARBY_M + 8.0
        ]
        gap_m, index = min(gaps, default=(math.inf, 0))
        return index if gap_m < NEARBY_M else None

    def _ego_facts(self, sample: WorldSample) -> JsonObject:
        speed, yaw_rad, offset_m = self._history[0]
        over_s = max(STEP_S, (len(self._history) - 1) * STEP_S)
        turned = (sample.yaw_rad - yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        return {
            "speed_mps": sample.speed_mps,
            "accel_mps2": (sample.speed_mps - speed) / over_s,
            "yaw_rate_radps": turned / over_s,
            "offset_m": sample.offset_m,
            "offset_rate_mps": (sample.offset_m - offset_m) / over_s,
            "plan": self._mode,
        }

    def _other_facts(self, index: int, sample: WorldSample) -> JsonObject:
        user = self._world.everybody[index]
        ego, other = self._ego(), rectangle_of(user)
        speeds, since_s = self._speeds[index], self._in_way_since_s[index]
        over_s = max(STEP_S, (len(speeds) - 1) * STEP_S)
        heading = (user.yaw_rad - sample.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        return {
            "index": index + 1,
            "kind": user.kind.value,
            "action": user.stretch.action,
            "gap_m": signed_gap_m(ego, other),
            "bearing_rad": bearing_rad(ego, other),
            "heading_rad": heading,
            "speed_mps": user.speed_mps,
            "accel_mps2": (speeds[-1] - speeds[0]) / over_s,
            "in_way_s": 0.0 if since_s is None else sample.time_s - since_s,
        }

    def _place_facts(self, sample: WorldSample) -> JsonObject:
        world = self._world
        road = world.road
        near = [junction.forward_m for junction in road.junctions]
        on_road = sample.station_m < world.leaves_road_m
        curved = abs(world.route.curvature_at(sample.station_m)) > _CURVED_1PM
        if any(abs(sample.station_m - at_m) < _JUNCTION_M for at_m in near):
            element = "junction"
        elif on_road and abs(sample.station_m - road.crossing_m) < _CROSSING_M:
            element = "crossing"
        else:
            element = "curve" if curved else "straight"
        return {
            "station_m": sample.station_m,
            "element": element,
            "light": None if sample.light is None else sample.light.value,
        }


def rectangle_of(user: ScriptedUser) -> Rectangle:
    """Return the body of a road user from above."""
    return Rectangle(user.x_m, user.y_m, user.yaw_rad, 0.5 * user.length_m, 0.5 * user.width_m)
