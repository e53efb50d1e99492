"""The requirement protocol, and the exact facts of a control step that requirements judge.

A requirement is a robustness over time: a distance to violation in metres, seconds or metres a second, negative if
violated, zero satisfied. It is made anew for every episode, observes one `WorldSample` a control step in order of
time, and gives its verdict at the end: the smallest robustness and the time of the first violation. Robustness is
always finite: each requirement cuts it at its own horizon, which is also its value where it does not apply.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from brink.sim.driving.interface import LightState
from brink.sim.episode import Json, Verdict


class CollisionKind(StrEnum):
    """What the ego hit."""

    VEHICLE = "vehicle"
    PEDESTRIAN = "pedestrian"
    OBJECT = "object"


@dataclass(frozen=True, slots=True, kw_only=True)
class Collision:
    """The ego's collision.

    Attributes:
        kind: The class of the counterpart.
        counterpart: Its name in the trace.
        impact_speed_mps: Closing speed at contact, >= 0.
    """

    kind: CollisionKind
    counterpart: str
    impact_speed_mps: float


# Not frozen: one is made every control step, and a frozen one costs three times as much to make.
@dataclass(slots=True, kw_only=True)
class WorldSample:
    """What is true of the ego at the end of a control step, by exact physics. Nobody changes it.

    Attributes:
        time_s: Simulated time, increasing.
        x_m: The ego's centre.
        y_m: The ego's centre.
        yaw_rad: The ego's yaw.
        speed_mps: Along its heading; negative if it rolls back.
        station_m: Of its centre on the route.
        offset_m: Of its centre, left of the route's centre line.
        heading_error_rad: Its yaw less the route's yaw at its station, in (-pi, pi].
        ego_length_m: Length of its body.
        ego_width_m: Width of its body.
        lane_left_m: Offset of the left edge of its lane (the centre line of the road), > `lane_right_m`.
        lane_right_m: Offset of the right edge of its lane, usually negative.
        speed_limit_mps: What is allowed here.
        front_gap_m: Clearance, bumper to bumper, to the nearest vehicle ahead in the ego's corridor; 0 on contact;
            None if there is none.
        pedestrian_gap_m: Clearance to the nearest pedestrian in any direction; None if there is none near.
        nearest_gap_m: Clearance to the nearest body of any kind in any direction; None if there is none near.
        closing_speed_mps: Speed at which `nearest_gap_m` shrinks; negative if it grows.
        collision: The ego's collision in this step, or None.
        light: State of the traffic light that guards the stop line of `stop_line_gap_m`, or None.
        stop_line_gap_m: From the ego's front bumper forward to that stop line; negative once the bumper is past it,
            for as long as the ego's rear is not. None if there is none.
        may_wait: Whether a good driver could stand here now: red or amber light, a vehicle or person close ahead,
            or the goal is reached.
        in_conflict_area: Whether part of the ego is in the oncoming lane, in a junction or on a crossing.
        goal_reached: Whether the ego has come to the end of its route.
        brakes_for_nothing: Whether emergency braking is on, and since it began nobody was in the region that calls
            for it, or on a course into it.
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


class Requirement(Protocol):
    """One requirement in one episode. A plug-in is a factory without arguments that makes one."""

    @property
    def unit(self) -> str:
        """The unit of the robustness: ``m``, ``s`` or ``m/s``."""
        ...

    @property
    def horizon(self) -> float:
        """No robustness is above this or below its negative; > 0 and finite."""
        ...

    def observe(self, sample: WorldSample) -> float:
        """Take the next control step and return the robustness at it, finite.

        Args:
            sample: Later than all samples before.
        """
        ...

    def verdict(self) -> Verdict:
        """Return the smallest robustness so far (the horizon before any sample) and the first violation."""
        ...

    def features(self) -> Mapping[str, Json]:
        """Return further facts of the episode that this requirement knows, by name; empty if none."""
        ...
