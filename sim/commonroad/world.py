"""The world of a drive in recorded traffic: the ego in place of the planning problem, and all others.

Others follow their recordings, linear between two states, whatever the ego does. Who would drive into the ego from
behind is taken out first, since recorded drivers could not see an ego that drives more slowly than whoever was
recorded in its place: that is nobody's collision, and the drive says how often it happened.

*Reacting* vehicles keep to their recorded paths, and drive as recorded until somebody is ahead: then the Intelligent
Driver Model limits their speed, and afterwards they catch up.

References:
    Treiber, Hennecke, Helbing 2000, Congested traffic states in empirical observations and microscopic simulations.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from brink.sim.bullet.engine import Engine
from brink.sim.commonroad.recording import NOT_VEHICLES, Interval, Recording, RoadUser, contains
from brink.sim.commonroad.roads import Place
from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.requirements import WorldSample
from brink.sim.urban.facts import Facts
from brink.sim.world.ego import EGO_CAR, EgoCar, EgoMotion
from brink.sim.world.road import LaneRoute, Road, SignalPlan
from brink.sim.world.scenario import TimeOfDay, Weather
from brink.sim.world.vehicle import Mover, VehicleSize
from brink.sim.world.weather import Conditions, conditions

HEIGHTS_M: Final = {"truck": 3.2, "bus": 3.2, "train": 3.5, "pedestrian": 1.75, "bicycle": 1.75}
OTHER_HEIGHT_M: Final = 1.5
TAKEN_OUT_M: Final = 0.3
"""Who is about to drive into the ego from behind is taken out this close to it."""
_GONE: Final = (math.nan, math.nan, math.nan, 0.0)
_SIDE_M: Final = 0.2
_LOOKS_EVERY_STEPS: Final = 4
_LOOKS_M: Final = 10.0
_LOOKS_S: Final = 3.0
_ACCEL_MPS2, _DECEL_MPS2, _GAP_M, _HEADWAY_S = 1.5, 2.0, 2.0, 1.0
_CATCHES_UP_MPS: Final = 2.0


class RecordedUser:
    """A recorded road user during a drive. Mutable; NaN while it is absent.

    Args:
        recorded: Its recording.
        recording: The recording that it is part of.
        reacts: Whether it keeps its distance from whoever is ahead.
    """

    def __init__(self, recorded: RoadUser, recording: Recording, *, reacts: bool) -> None:
        self.name = f"{recorded.kind}-{recorded.id}"
        self.kind = recorded.kind
        self.length_m, self.width_m = recorded.length_m, recorded.width_m
        self.size = VehicleSize(
            recorded.length_m, recorded.width_m, HEIGHTS_M.get(recorded.kind, OTHER_HEIGHT_M)
        )
        self.accel_mps2 = 0.0
        self.is_gone = False
        self.stands = recorded.stands
        self._reacts = reacts and not recorded.stands and recorded.kind != "pedestrian"
        self._states = recorded.states
        self._steps_per_s = 1.0 / recording.step_s
        self._first_step = recorded.first_step - recording.start_step
        self._way_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(recorded.states[:, :2], axis=0).T))))
        self._lag_m = 0.0
        self._limit_mps2 = math.inf
        self._place(0.0)

    @property
    def is_vehicle(self) -> bool:
        """Whether it is a vehicle."""
        return self.kind not in NOT_VEHICLES

    @property
    def is_here(self) -> bool:
        """Whether it is present."""
        return not math.isnan(self.x_m)

    def look(self, others: Sequence[Mover]) -> None:
        """Look around for whoever is ahead; only vehicles that react do."""
        if self._reacts and self.is_here:
            self._limit_mps2 = min(
                (self._accel_behind(one) for one in others if one is not self), default=math.inf
            )

    def advance(self, time_s: float) -> None:
        """Move to where it is at a time, one control step later than before."""
        before_mps, was_here, at_m = self.speed_mps, self.is_here, self._at_m
        self._place(time_s)
        if self._reacts and was_here and self.is_here and not self.is_gone:
            self._hold_back(at_m, before_mps)
        is_here = was_here and self.is_here
        self.accel_mps2 = (self.speed_mps - before_mps) / CONTROL_STEP_S if is_here else 0.0

    def _place(self, time_s: float) -> None:
        """Stand where it was recorded at a time."""
        at = 0.0 if self.stands else time_s * self._steps_per_s - self._first_step
        at = round(at, 6)
        last = len(self._states) - 1
        if self.is_gone or not 0.0 <= at <= last:
            (self.x_m, self.y_m, self.yaw_rad, self.speed_mps), self._at_m = _GONE, 0.0
            return
        index = min(int(at), max(last - 1, 0))
        share = at - index
        following = min(index + 1, last)
        old, new = self._states[index], self._states[following]
        self.x_m, self.y_m, self.yaw_rad, self.speed_mps = (old + share * (new - old)).tolist()
        self._at_m = float(self._way_m[index] + share * (self._way_m[following] - self._way_m[index]))

    def _hold_back(self, before_m: float, before_mps: float) -> None:
        """Stay as far behind the recording as the vehicle ahead demands."""
        recorded_m, recorded_mps = self._at_m, self.speed_mps
        behind_m = before_m - self._lag_m
        limited_mps = max(0.0, before_mps + min(self._limit_mps2, 3.0) * CONTROL_STEP_S)
        if self._lag_m > 0.0:
            limited_mps = min(limited_mps, recorded_mps + _CATCHES_UP_MPS)
        at_m = behind_m + limited_mps * CONTROL_STEP_S
        if at_m >= recorded_m - 1e-9:
            self._lag_m = 0.0
            return
        self._lag_m = recorded_m - at_m
        self.x_m, self.y_m, self.yaw_rad = (
            float(np.interp(at_m, self._way_m, self._states[:, column])) for column in range(3)
        )
        self.speed_mps = limited_mps

    def _accel_behind(self, other: Mover) -> float:
        """Return the largest acceleration behind somebody; infinite if nobody is in the way."""
        dx, dy = other.x_m - self.x_m, other.y_m - self.y_m
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        ahead_m = dx * cos_yaw + dy * sin_yaw
        if not 0.0 < ahead_m < _LOOKS_M + _LOOKS_S * self.speed_mps + other.length_m:
            return math.inf
        turn = other.yaw_rad - self.yaw_rad
        cos_turn, sin_turn = abs(math.cos(turn)), abs(math.sin(turn))
        half_across_m = 0.5 * (self.width_m + cos_turn * other.width_m + sin_turn * other.length_m)
        if abs(dy * cos_yaw - dx * sin_yaw) > half_across_m + _SIDE_M:
            return math.inf
        half_along_m = 0.5 * (self.length_m + cos_turn * other.length_m + sin_turn * other.width_m)
        gap_m = max(ahead_m - half_along_m, 0.1)
        speed = max(self.speed_mps, 0.0)
        closing = (
            speed * (speed - other.speed_mps * math.cos(turn)) / (2.0 * math.sqrt(_ACCEL_MPS2 * _DECEL_MPS2))
        )
        wanted_m = _GAP_M + max(0.0, speed * _HEADWAY_S + closing)
        return max(_ACCEL_MPS2 * (1.0 - (wanted_m / gap_m) ** 2), -8.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedWorld:
    """The world of a drive in recorded traffic; its members are mutable.

    Implements `brink.sim.world.world.World`.

    Attributes:
        place: The recording with its road.
        weather: The driving conditions: those of a clear noon.
        ego: The car under test.
        vehicles: All others but people.
        walkers: People.
        taken_out: Names of those who would have driven into the ego from behind.
        leaves_road_m: Minus infinity: stations are never those of a street of Brink's own.
    """

    place: Place
    weather: Conditions
    ego: EgoMotion
    vehicles: tuple[RecordedUser, ...]
    walkers: tuple[RecordedUser, ...]
    taken_out: list[str] = field(default_factory=list)
    leaves_road_m: float = -math.inf

    @property
    def road(self) -> Road:
        """The road."""
        return self.place.road

    @property
    def route(self) -> LaneRoute:
        """The ego's route."""
        return self.place.route

    @property
    def signals(self) -> SignalPlan | None:
        """None: recordings have no traffic lights."""
        return None

    def advance(self, step: int) -> None:
        """Advance all road users except the ego by one control step, from the step with this number."""
        if step % _LOOKS_EVERY_STEPS == 0:
            others: list[Mover] = [self.ego, *(one for one in (*self.vehicles, *self.walkers) if one.is_here)]
            for vehicle in self.vehicles:
                vehicle.look(others)
        time_s = (step + 1) * CONTROL_STEP_S
        ego = Rectangle.of(self.ego)
        for user in (*self.vehicles, *self.walkers):
            user.advance(time_s)
            if self._comes_from_behind(user) and signed_gap_m(ego, Rectangle.of(user)) < TAKEN_OUT_M:
                user.is_gone = True
                user.advance(time_s)
                self.taken_out.append(user.name)

    def _comes_from_behind(self, user: RecordedUser) -> bool:
        """Return whether somebody is behind the ego, goes its way, and is faster."""
        ego = self.ego
        dx, dy = user.x_m - ego.x_m, user.y_m - ego.y_m
        reach_m = 0.5 * (ego.length_m + user.length_m)
        if user.stands or not dx * dx + dy * dy < (reach_m + 2.0) ** 2:  # also if it is absent
            return False
        behind_m = -(dx * math.cos(ego.yaw_rad) + dy * math.sin(ego.yaw_rad))
        turn = user.yaw_rad - ego.yaw_rad
        return (
            behind_m > 0.5 * ego.length_m
            and math.cos(turn) > 0.7
            and user.speed_mps * math.cos(turn) > ego.speed_mps
        )

    def grade_at(self, station_m: float) -> float:
        """Return 0: maps are flat."""
        return 0.0

    def goal_reached(self, time_s: float) -> bool:
        """Return whether the ego is in a goal state, which has a place, at a time."""
        recording, ego = self.place.recording, self.ego
        step = round(recording.start_step + time_s / recording.step_s, 6)
        return any(
            goal.steps.holds(step)
            and goal.speed_mps.holds(ego.speed_mps)
            and _holds_angle(goal.yaw_rad, ego.yaw_rad)
            and any(contains(area, ego.x_m, ego.y_m) for area in goal.areas)
            for goal in recording.goals
        )


def _holds_angle(interval: Interval, angle_rad: float) -> bool:
    """Return whether an angle lies in an interval, whole turns aside."""
    if math.isinf(interval.low):
        return True
    turns = round((0.5 * (interval.low + interval.high) - angle_rad) / (2.0 * math.pi))
    return interval.holds(angle_rad + 2.0 * math.pi * turns)


class RecordedFacts(Facts):
    """Measures the facts of a drive in recorded traffic."""

    def __init__(self, world: RecordedWorld, engine: Engine) -> None:
        super().__init__(world, engine)
        self._recorded = world

    def measure(self, time_s: float, *, emergency: bool = False) -> WorldSample:
        """Return the current facts about the ego."""
        world = self._recorded
        sample = super().measure(time_s, emergency=emergency)
        sample.goal_reached = sample.goal_reached or world.goal_reached(time_s)
        sample.road_edge_gap_m = world.place.edges.gap_m(Rectangle.of(world.ego))
        return sample


def make_recorded_world(place: Place, *, speed_share: float, reacting: bool) -> RecordedWorld:
    """Return the world of a drive at time 0.

    Args:
        place: The recording with its road.
        speed_share: The ego's speed at the start, as a share of the recorded one.
        reacting: Whether other vehicles keep their distance.
    """
    recording = place.recording
    x_m, y_m, yaw_rad, speed_mps = recording.start
    weather = conditions(TimeOfDay.NOON, Weather.CLEAR)
    users = [RecordedUser(one, recording, reacts=reacting) for one in recording.road_users]
    return RecordedWorld(
        place=place,
        weather=weather,
        ego=EgoCar((x_m, y_m, yaw_rad), speed_mps * speed_share, friction=weather.friction, model=EGO_CAR),
        vehicles=tuple(user for user in users if user.kind != "pedestrian"),
        walkers=tuple(user for user in users if user.kind == "pedestrian"),
    )
