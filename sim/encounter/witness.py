"""Observes an encounter: the closest approach of every road user, and the circumstances of it and of violations.

Circumstances are raw facts about the moment at which a requirement was first violated, or at which a road user came
closest. Rules elsewhere classify them and can be changed without simulating again.
"""

import math
from collections import deque
from typing import Final, NamedTuple

from brink.sim.driving.interface import CONTROL_STEP_S, Driving, PlanMode
from brink.sim.encounter.world import EncounterWorld, ScriptedUser
from brink.sim.episode import Json, JsonObject
from brink.sim.plane import Rectangle, half_extents_m, signed_gap_m
from brink.sim.requirements import STANDS_BELOW_MPS, WorldSample
from brink.sim.trace import ACTION
from brink.sim.urban.recorder import Recorder

NEARBY_M: Final = 15.0
"""Without a collision, the nearest road user within this distance is the counterpart of a violation."""

IN_WAY_M: Final = 35.0
"""A road user is in the ego's way within this distance ahead if it reaches into the swept width."""

_COUNTERPART_AHEAD: Final = ("front-gap@1", "front-gap@2")
"""Requirements whose counterpart is the road user in the ego's way, even if others are nearer."""

_LOOKBACK: Final = round(0.5 / CONTROL_STEP_S)
_JUNCTION_M: Final = 12.0
_CROSSING_M: Final = 4.0
_CURVED_1PM: Final = 1e-3


def bearing_rad(ego: Rectangle, other: Rectangle) -> float:
    """Return the direction of another body's nearest point, relative to the ego, in (-pi, pi].

    Angles are measured after scaling the ego's body to a square, so that its corners lie at 45 degrees.
    """
    near_x, near_y = other.nearest_point((ego.x_m, ego.y_m))
    at_x, at_y = ego.nearest_point((near_x, near_y))
    # If they overlap, the other's nearest point lies inside the ego and gives the direction.
    x_m, y_m = (near_x, near_y) if math.hypot(near_x - at_x, near_y - at_y) > 1e-9 else (at_x, at_y)
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    dx, dy = x_m - ego.x_m, y_m - ego.y_m
    along = (dx * cos_yaw + dy * sin_yaw) / ego.half_length_m
    across = (dy * cos_yaw - dx * sin_yaw) / ego.half_width_m
    return math.atan2(across, along)


class _Moment(NamedTuple):
    """The state needed to describe the circumstances of a control step later.

    Attributes:
        sample: The facts about the ego.
        plan: The plan's mode.
        before: Speed, yaw and offset of the ego, `over_s` earlier.
        over_s: Time between the two.
    """

    sample: WorldSample
    plan: str
    before: tuple[float, float, float]
    over_s: float


class _OtherThen(NamedTuple):
    """A road user in a control step.

    Attributes:
        place: Its place among the road users.
        body: Its footprint.
        action: What its script has it do.
        speed_mps: Its speed.
        before_mps: Its speed, `over_s` earlier.
        over_s: Time between the two.
        in_way_s: For how long it has been in the ego's way.
    """

    place: int
    body: Rectangle
    action: str
    speed_mps: float
    before_mps: float
    over_s: float
    in_way_s: float


class EncounterWitness:
    """Observes one encounter.

    Args:
        world: The world.
        recorder: Records the road users' actions, if given.

    Attributes:
        gaps_m: Smallest gap of each road user to the ego so far; infinite before the first.
        moving_gap_m: Smallest gap of any road user to the ego while the ego moved; infinite before the first.
        contact_at_s: When a road user first touched the ego, even one that drives into a standing ego, in which it
            collides with nobody; None if none has.
        brakes_at_s: When the ego's driver first planned to stop, for a road user or a light; None if not so far.
        violations: Circumstances of each violation so far.
    """

    def __init__(self, world: EncounterWorld, recorder: Recorder | None = None) -> None:
        self._world = world
        self._recorder = recorder
        self._actions = [""] * len(world.road_users)
        self.gaps_m = [math.inf] * len(world.road_users)
        self._in_way_since_s: list[float | None] = [None] * len(world.road_users)
        self._history: deque[tuple[float, float, float]] = deque(maxlen=_LOOKBACK + 1)
        self._speeds: list[deque[float]] = [deque(maxlen=_LOOKBACK + 1) for _ in world.road_users]
        self._radius_m = 0.5 * math.hypot(world.ego.length_m, world.ego.width_m)
        self._sample: WorldSample | None = None
        self._mode = ""
        self.moving_gap_m = math.inf
        self._closest: tuple[_Moment, _OtherThen] | None = None
        self._closest_moving: tuple[_Moment, _OtherThen] | None = None
        self.contact_at_s: float | None = None
        self.brakes_at_s: float | None = None
        self._seen: set[str] = set()
        self.violations: list[JsonObject] = []

    def see(self, sample: WorldSample, driving: Driving) -> None:
        """Observe a control step, after all road users have moved."""
        self._sample = sample
        mode = driving.plan.mode
        self._mode = str(mode)
        if mode is PlanMode.STOP and self.brakes_at_s is None:
            self.brakes_at_s = sample.time_s
        self._history.append((sample.speed_mps, sample.yaw_rad, sample.offset_m))
        ego: Rectangle | None = None
        moves = abs(sample.speed_mps) >= STANDS_BELOW_MPS
        closest_m, closest, closest_moving = self.criticality_m, None, None
        for index, user in enumerate(self._world.road_users):
            self._speeds[index].append(user.speed_mps)
            dx, dy = user.x_m - sample.x_m, user.y_m - sample.y_m
            reach_m = self._radius_m + 0.5 * math.hypot(user.length_m, user.width_m)
            known_m = max(self.gaps_m[index], self.moving_gap_m) if moves else self.gaps_m[index]
            if math.hypot(dx, dy) - reach_m < known_m:
                ego = ego or Rectangle.of(self._world.ego)
                gap_m = signed_gap_m(ego, Rectangle.of(user))
                self.gaps_m[index] = min(self.gaps_m[index], gap_m)
                if gap_m < closest_m:
                    closest_m, closest = gap_m, index
                if moves and gap_m < self.moving_gap_m:
                    self.moving_gap_m, closest_moving = gap_m, index
            self._watch_way(index, user, sample)
            if self._recorder is not None and (action := user.stretch.action) != self._actions[index]:
                self._actions[index] = action
                self._recorder.event(sample.time_s, ACTION, f"{user.name}:{action}")
        if closest_m < 0.0 and self.contact_at_s is None:
            self.contact_at_s = sample.time_s
        if closest is not None:
            self._closest = self._moment(sample), self._other(closest, sample)
        if closest_moving is not None:
            self._closest_moving = self._moment(sample), self._other(closest_moving, sample)

    @property
    def criticality_m(self) -> float:
        """Smallest distance between the ego and any road user; infinite if there are no road users."""
        return min(self.gaps_m, default=math.inf)

    @property
    def closest(self) -> Json:
        """The circumstances of the closest approach of any road user; None if there are no road users."""
        return None if self._closest is None else self._circumstances(*self._closest)

    @property
    def closest_moving(self) -> Json:
        """The circumstances of the closest approach while the ego moved; None if there was none."""
        return None if self._closest_moving is None else self._circumstances(*self._closest_moving)

    def _watch_way(self, index: int, user: ScriptedUser, sample: WorldSample) -> None:
        """Track how long a road user has been in the ego's way."""
        dx, dy = user.x_m - sample.x_m, user.y_m - sample.y_m
        in_way = -IN_WAY_M < dx < IN_WAY_M and -IN_WAY_M < dy < IN_WAY_M
        if in_way:
            line = self._world.route.line
            at_m, off_m = line.project(user.x_m, user.y_m, sample.station_m)
            turn = user.yaw_rad - line.pose_at(at_m)[2]
            _, half_m = half_extents_m(user.length_m, user.width_m, turn)
            within = abs(off_m - sample.offset_m) < half_m + 0.5 * sample.ego_width_m
            in_way = within and 0.0 < at_m - sample.station_m < IN_WAY_M
        if not in_way:
            self._in_way_since_s[index] = None
        elif self._in_way_since_s[index] is None:
            self._in_way_since_s[index] = sample.time_s

    def violated(self, requirement: str) -> None:
        """Record the circumstances of a requirement's first violation."""
        sample = self._sample
        if requirement in self._seen or sample is None:
            return
        self._seen.add(requirement)
        hit = sample.collision
        if hit is not None:
            names = [user.name for user in self._world.road_users]
            index = names.index(hit.counterpart) if hit.counterpart in names else None
        else:
            index = self._in_way(sample) if requirement in _COUNTERPART_AHEAD else None
            index = self._nearest(sample) if index is None else index
        other = None if index is None else self._other(index, sample)
        self.violations.append(
            {
                "requirement": requirement,
                **self._circumstances(self._moment(sample), other),
                "collision": None if hit is None else hit.kind.value,
                "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
            }
        )

    def _in_way(self, sample: WorldSample) -> int | None:
        """Return the nearest road user in the ego's way, if any."""
        ego = Rectangle.of(self._world.ego)
        gaps = [
            (signed_gap_m(ego, Rectangle.of(user)), index)
            for index, user in enumerate(self._world.road_users)
            if self._in_way_since_s[index] is not None
        ]
        return min(gaps)[1] if gaps else None

    def _nearest(self, sample: WorldSample) -> int | None:
        ego = Rectangle.of(self._world.ego)
        gaps = [
            (signed_gap_m(ego, Rectangle.of(user)), index)
            for index, user in enumerate(self._world.road_users)
            if math.hypot(user.x_m - sample.x_m, user.y_m - sample.y_m) < NEARBY_M + 8.0
        ]
        gap_m, index = min(gaps, default=(math.inf, 0))
        return index if gap_m < NEARBY_M else None

    def _moment(self, sample: WorldSample) -> _Moment:
        over_s = max(CONTROL_STEP_S, (len(self._history) - 1) * CONTROL_STEP_S)
        return _Moment(sample=sample, plan=self._mode, before=self._history[0], over_s=over_s)

    def _other(self, index: int, sample: WorldSample) -> _OtherThen:
        user, speeds, since_s = (
            self._world.road_users[index],
            self._speeds[index],
            self._in_way_since_s[index],
        )
        return _OtherThen(
            place=index,
            body=Rectangle.of(user),
            action=user.stretch.action,
            speed_mps=user.speed_mps,
            before_mps=speeds[0],
            over_s=max(CONTROL_STEP_S, (len(speeds) - 1) * CONTROL_STEP_S),
            in_way_s=0.0 if since_s is None else sample.time_s - since_s,
        )

    def _circumstances(self, moment: _Moment, other: _OtherThen | None) -> JsonObject:
        sample = moment.sample
        return {
            "time_s": sample.time_s,
            "ego": _ego_facts(moment),
            "other": None if other is None else self._other_facts(sample, other),
            "place": self._place_facts(sample),
        }

    def _other_facts(self, sample: WorldSample, other: _OtherThen) -> JsonObject:
        size = self._world.ego
        ego = Rectangle(sample.x_m, sample.y_m, sample.yaw_rad, 0.5 * size.length_m, 0.5 * size.width_m)
        return {
            "index": other.place + 1,
            "kind": self._world.road_users[other.place].kind.value,
            "action": other.action,
            "gap_m": signed_gap_m(ego, other.body),
            "bearing_rad": bearing_rad(ego, other.body),
            "heading_rad": _turned(other.body.yaw_rad - sample.yaw_rad),
            "speed_mps": other.speed_mps,
            "accel_mps2": (other.speed_mps - other.before_mps) / other.over_s,
            "in_way_s": other.in_way_s,
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


def _turned(angle_rad: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def _ego_facts(moment: _Moment) -> JsonObject:
    sample, (speed_mps, yaw_rad, offset_m) = moment.sample, moment.before
    return {
        "speed_mps": sample.speed_mps,
        "accel_mps2": (sample.speed_mps - speed_mps) / moment.over_s,
        "yaw_rate_radps": _turned(sample.yaw_rad - yaw_rad) / moment.over_s,
        "offset_m": sample.offset_m,
        "offset_rate_mps": (sample.offset_m - offset_m) / moment.over_s,
        "plan": moment.plan,
    }
