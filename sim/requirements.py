"""Safety requirements: the protocol, its base class `Margin`, and those that ship with Brink.

To add one, write its class here and list its id in pyproject.toml and docs/reference/problems.md. Its words are in
`brink.sim.verdict`, `brink.search.analysis.violations` and `brink.pictures.reference`; otherwise, texts use its id.

A requirement measures robustness over time: a distance to violation in units such as metres or seconds, negative
when violated; zero satisfies. It is created for each episode, observes one `WorldSample` per control step in order of
time, and gives its verdict at the end: the smallest robustness and the time of the first violation. Robustness is
always finite: each requirement clips it to its horizon, which is also its value where the requirement does not apply.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from brink.sim.driving.interface import LightState
from brink.sim.episode import Json, Verdict
from brink.sim.errors import SimulationCrashed
from brink.sim.plane import half_extents_m

REQUIRED_GAP_M = 1.5
LANE_TOLERANCE_M = 0.2
SPEED_TOLERANCE_MPS = 0.5
DANGEROUS_STOP_BELOW_MPS = 0.5

STUCK_S = 10.0
DANGEROUS_S = 4.0
STANDS_BELOW_MPS = 0.3

_CONTACT_M = 0.01
"""Minimum violation of a collision, so that a contact at zero closing speed still counts as a violation."""
_MIN_OVERRUN_M = 1e-6


class CollisionKind(StrEnum):
    """Kind of object that the ego collided with."""

    VEHICLE = "vehicle"
    PEDESTRIAN = "pedestrian"
    OBJECT = "object"


@dataclass(frozen=True, slots=True, kw_only=True)
class Collision:
    """The ego's collision.

    Attributes:
        kind: Class of the counterpart.
        counterpart: Its name in the trace.
        impact_speed_mps: Closing speed at contact, >= 0.
    """

    kind: CollisionKind
    counterpart: str
    impact_speed_mps: float


# Not frozen: one is created every control step, and creating a frozen one takes three times as long.
@dataclass(slots=True, kw_only=True)
class WorldSample:
    """Exact facts about the ego at the end of a control step. Treat as immutable.

    Attributes:
        time_s: Simulated time, increasing.
        x_m: Centre of the ego.
        y_m: Centre of the ego.
        yaw_rad: Heading of the ego.
        speed_mps: Speed along the heading; negative when rolling back.
        station_m: Station of the ego's centre on its route.
        offset_m: Offset of the ego's centre, positive to the left of the route's centre line.
        heading_error_rad: The ego's yaw minus the route's yaw at its station, in (-pi, pi].
        ego_length_m: Length of the ego's body.
        ego_width_m: Width of the ego's body.
        lane_left_m: Offset of the left edge of the ego's lane (the road's centre line), > `lane_right_m`.
        lane_right_m: Offset of the right edge of the ego's lane, usually negative.
        speed_limit_mps: Speed limit at the ego's station.
        front_gap_m: Bumper-to-bumper clearance to the nearest vehicle ahead in the ego's corridor; 0 on contact,
            None if there is none.
        pedestrian_gap_m: Clearance to the nearest pedestrian in any direction; None if none is near.
        nearest_gap_m: Clearance to the nearest body of any kind in any direction; None if none is near.
        closing_speed_mps: Rate at which `nearest_gap_m` shrinks; negative when it grows.
        collision: The ego's collision in this step, or None.
        light: State of the traffic light at the stop line of `stop_line_gap_m`, or None.
        stop_line_gap_m: Distance from the ego's front bumper forward to the stop line; negative from the moment the
            bumper passes the line until the rear does. None if there is no stop line.
        may_wait: Whether a good driver could stand still here: at a red or amber light, close behind a vehicle or
            person, or at the goal.
        in_conflict_area: Whether part of the ego is in the oncoming lane, in a junction or on a crossing.
        goal_reached: Whether the ego has reached the end of its route.
        brakes_for_nothing: Whether emergency braking is active and, since it began, no person has been in the warning
            region or heading into it.
        road_edge_gap_m: How far the ego's body is inside the road, negative once a corner has left it; None if that
            is not measured.
    """

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    station_m: float
    offset_m: float
    heading_error_rad: float
    ego_length_m: float
    ego_width_m: float
    lane_left_m: float
    lane_right_m: float
    speed_limit_mps: float
    front_gap_m: float | None = None
    pedestrian_gap_m: float | None = None
    nearest_gap_m: float | None = None
    closing_speed_mps: float = 0.0
    collision: Collision | None = None
    light: LightState | None = None
    stop_line_gap_m: float | None = None
    may_wait: bool = False
    in_conflict_area: bool = False
    goal_reached: bool = False
    brakes_for_nothing: bool = False
    road_edge_gap_m: float | None = None


class Requirement(Protocol):
    """One requirement in one episode. A plug-in is a factory without arguments that returns one."""

    @property
    def unit(self) -> str:
        """Unit of the robustness, such as ``m``, ``s`` or ``m/s²``."""

    @property
    def horizon(self) -> float:
        """Upper bound on the absolute value of the robustness, finite and > 0."""

    def observe(self, sample: WorldSample) -> float:
        """Process the next sample and return the robustness at it, which is finite.

        Args:
            sample: Later than all samples before it.
        """

    def verdict(self) -> Verdict:
        """Return the smallest robustness so far (the horizon before any sample) and the first violation."""

    def features(self) -> Mapping[str, Json]:
        """Return additional facts that this requirement has measured, by name; empty if there are none."""


def verdicts_of(requirements: Mapping[str, Requirement]) -> dict[str, Verdict]:
    """Return the verdicts at the end of an episode, by requirement id.

    Raises:
        SimulationCrashed: A robustness is not finite.
    """
    verdicts = {name: requirement.verdict() for name, requirement in requirements.items()}
    for name, verdict in verdicts.items():
        if not math.isfinite(verdict.robustness):
            raise SimulationCrashed(f"{name}: expected a finite robustness, got {verdict.robustness}")
    return verdicts


def features_of(requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    """Return the features of all requirements, each name prefixed with the requirement's id."""
    return {
        f"{name}:{key}": value
        for name, requirement in requirements.items()
        for key, value in requirement.features().items()
    }


class Margin(ABC):
    """Base class of requirements whose robustness is a function of the current control step.

    A subclass sets `unit` and `horizon` and implements `robustness_at`; clipping, the verdict and the time of the
    first violation are taken care of.
    """

    unit = "m"
    horizon = 50.0

    def __init__(self) -> None:
        self._smallest = self.horizon
        self._violated_at_s: float | None = None

    @abstractmethod
    def robustness_at(self, sample: WorldSample) -> float:
        """Return the robustness at a sample; `observe` clips it to the horizon."""

    def observe(self, sample: WorldSample) -> float:
        """Process the next sample and return the robustness at it, which is finite.

        Raises:
            ValueError: The sample holds a NaN.
        """
        robustness = self.robustness_at(sample)
        horizon = self.horizon
        if robustness > horizon:
            robustness = horizon
        elif robustness < -horizon:
            robustness = -horizon
        elif math.isnan(robustness):
            raise ValueError(
                f"{type(self).__name__}: the sample at {sample.time_s} s contains a NaN: {sample!r}"
            )
        if robustness < self._smallest:
            self._smallest = robustness
        if robustness < 0.0 and self._violated_at_s is None:
            self._violated_at_s = sample.time_s
        return robustness

    def verdict(self) -> Verdict:
        """Return the smallest robustness so far (the horizon before any sample) and the first violation."""
        return Verdict(robustness=self._smallest, unit=self.unit, violated_at_s=self._violated_at_s)

    def features(self) -> Mapping[str, Json]:
        """Return additional facts that this requirement has measured, by name."""
        return {}


class FrontGap(Margin):
    """`front-gap`: the ego keeps at least 1.5 m to the nearest vehicle ahead in its corridor, bumper to bumper.

    Robustness: the gap minus the required gap, in metres; the horizon if no vehicle is ahead. Source: the requirement
    of the case study of Sharifi et al. 2023, section 6.1, here measured by exact clearance.
    """

    unit = "m"
    horizon = 50.0

    def __init__(self, required_gap_m: float = REQUIRED_GAP_M) -> None:
        super().__init__()
        self._required_gap_m = required_gap_m
        self._smallest_gap_m: float | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the gap minus the required gap; the horizon if no vehicle is ahead."""
        gap_m = sample.front_gap_m
        if gap_m is None:
            return self.horizon
        if self._smallest_gap_m is None or gap_m < self._smallest_gap_m:
            self._smallest_gap_m = gap_m
        return gap_m - self._required_gap_m

    def features(self) -> Mapping[str, Json]:
        """Return the smallest gap in metres; None if there was never a vehicle ahead."""
        return {"smallest_front_gap_m": self._smallest_gap_m}


class MovingFrontGap(FrontGap):
    """`front-gap@2`: the ego keeps at least 1.5 m to the nearest vehicle ahead, while it moves at 0.3 m/s or faster.

    Who stands cannot keep others from coming close. Robustness: that of `FrontGap`; 0 where a standing ego would
    violate it.
    """

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the gap minus the required gap, at least 0 while the ego stands; the horizon without a vehicle."""
        robustness = super().robustness_at(sample)
        return max(robustness, 0.0) if abs(sample.speed_mps) < STANDS_BELOW_MPS else robustness


class NoCollision(Margin):
    """`no-collision`: the ego hits no vehicle, no pedestrian and no object.

    Robustness: the clearance to the nearest body in metres. After a collision at closing speed v it is
    -(0.01 + v * 0.1 s) m, so that a harder impact is a deeper violation.
    """

    unit = "m"
    horizon = 20.0

    def __init__(self) -> None:
        super().__init__()
        self._collision: Collision | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the clearance to the nearest body, negative on a collision."""
        collision = sample.collision
        if collision is not None:
            if self._collision is None:
                self._collision = collision
            return -(_CONTACT_M + 0.1 * collision.impact_speed_mps)
        gap_m = sample.nearest_gap_m
        return self.horizon if gap_m is None else max(gap_m, 0.0)

    def features(self) -> Mapping[str, Json]:
        """Return the counterpart and the closing speed of the first collision; both None if there was none."""
        collision = self._collision
        if collision is None:
            return {"collision_with": None, "collision_kind": None, "impact_speed_mps": None}
        return {
            "collision_with": collision.counterpart,
            "collision_kind": collision.kind.value,
            "impact_speed_mps": collision.impact_speed_mps,
        }


class LaneKeeping(Margin):
    """`lane-keeping`: the ego's body stays inside its lane, within the width of a lane marking.

    Robustness: the distance of the body's outermost corner from the lane's edge plus the tolerance, in metres.
    """

    unit = "m"
    horizon = 5.0

    def __init__(self, tolerance_m: float = LANE_TOLERANCE_M) -> None:
        super().__init__()
        self._tolerance_m = tolerance_m

    def robustness_at(self, sample: WorldSample) -> float:
        """Return how far the body is inside the lane, plus the tolerance."""
        _, reach_m = half_extents_m(sample.ego_length_m, sample.ego_width_m, sample.heading_error_rad)
        to_left = sample.lane_left_m - sample.offset_m - reach_m
        to_right = sample.offset_m - reach_m - sample.lane_right_m
        return min(to_left, to_right) + self._tolerance_m


class RedLight(Margin):
    """`red-light`: the ego's front bumper does not pass a stop line while its light is red.

    Passing at amber is allowed, and so is driving on at red after passing at amber or green. Robustness, in metres:
    before a red light the distance to the line, past a line that was crossed at red minus the overrun, otherwise the
    horizon. The overrun counts while the light is red, so stopping just past the line is a small violation and
    driving on a large one.
    """

    unit = "m"
    horizon = 10.0

    def __init__(self) -> None:
        super().__init__()
        self._was_before = False
        self._entered_at_red = False

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the distance to a red light's stop line, negative once past it."""
        gap_m = sample.stop_line_gap_m
        if gap_m is None:
            self._was_before = self._entered_at_red = False
            return self.horizon
        is_red = sample.light is LightState.RED
        if gap_m >= 0.0:
            self._was_before, self._entered_at_red = True, False
            return gap_m if is_red else self.horizon
        if self._was_before:
            self._entered_at_red = is_red
            self._was_before = False
        if not (self._entered_at_red and is_red):
            self._entered_at_red = False
            return self.horizon
        return min(gap_m, -_MIN_OVERRUN_M)


class SpeedLimit(Margin):
    """`speed-limit`: the ego stays below the speed limit plus the tolerance of its speedometer.

    Robustness: the limit plus the tolerance minus the speed, in m/s.
    """

    unit = "m/s"
    horizon = 50.0

    def __init__(self, tolerance_mps: float = SPEED_TOLERANCE_MPS) -> None:
        super().__init__()
        self._tolerance_mps = tolerance_mps

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the limit plus the tolerance minus the speed."""
        return sample.speed_limit_mps + self._tolerance_mps - abs(sample.speed_mps)


class Progress(Margin):
    """`progress`: the ego does not get stuck, and does not stop where that is dangerous.

    Standing still with a cause (a red light, a vehicle or person close ahead, the goal) is allowed. Without one it is
    allowed for ten seconds in the ego's lane, and for four in the oncoming lane, in a junction or on a crossing.
    Robustness: how much longer the ego may stand still, in seconds.

    Args:
        stuck_s: Longest standstill without a cause.
        dangerous_s: The same where stopping is dangerous.
        stands_below_mps: A slower ego is standing still.
    """

    unit = "s"
    horizon = 30.0

    def __init__(
        self,
        stuck_s: float = STUCK_S,
        dangerous_s: float = DANGEROUS_S,
        stands_below_mps: float = STANDS_BELOW_MPS,
    ) -> None:
        super().__init__()
        self._stuck_s = stuck_s
        self._dangerous_s = dangerous_s
        self._stands_below_mps = stands_below_mps
        self._idle_s = 0.0
        self._danger_s = 0.0
        self._longest_idle_s = 0.0
        self._longest_danger_s = 0.0
        self._time_s: float | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the time left before a standstill without a cause is too long; the full time while the ego moves."""
        elapsed_s = 0.0 if self._time_s is None else sample.time_s - self._time_s
        self._time_s = sample.time_s
        stands = abs(sample.speed_mps) < self._stands_below_mps
        if not stands or sample.may_wait or sample.goal_reached:
            self._idle_s = self._danger_s = 0.0
        else:
            self._idle_s += elapsed_s
            self._danger_s = self._danger_s + elapsed_s if sample.in_conflict_area else 0.0
            self._longest_idle_s = max(self._longest_idle_s, self._idle_s)
            self._longest_danger_s = max(self._longest_danger_s, self._danger_s)
        left_s = self._stuck_s - self._idle_s
        return min(left_s, self._dangerous_s - self._danger_s) if sample.in_conflict_area else left_s

    def features(self) -> Mapping[str, Json]:
        """Return the longest standstill without a cause, anywhere and in conflict areas, in seconds."""
        return {"longest_idle_s": self._longest_idle_s, "longest_dangerous_stop_s": self._longest_danger_s}


class NoDangerousStop(Margin):
    """`no-dangerous-stop`: emergency braking never brings the ego to a standstill without a reason on the road.

    Robustness: the ego's speed above standstill in m/s while it brakes without a reason; the horizon while it does
    not brake, or if a person has been in the warning region or heading into it since braking began. Source: Ferreira
    et al. 2022, who describe dangerous stops without measuring them.
    """

    unit = "m/s"
    horizon = 8.0

    def __init__(self) -> None:
        super().__init__()
        self._stops = 0
        self._stands = False

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the speed above standstill while the ego brakes without a reason, else the horizon."""
        if not sample.brakes_for_nothing:
            self._stands = False
            return self.horizon
        margin_mps = sample.speed_mps - DANGEROUS_STOP_BELOW_MPS
        if margin_mps < 0.0 and not self._stands:
            self._stops += 1
            self._stands = True
        return margin_mps

    def features(self) -> Mapping[str, Json]:
        """Return the number of dangerous stops."""
        return {"dangerous_stops": self._stops}
