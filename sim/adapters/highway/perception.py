"""The ego's perception of other vehicles: the truth within its range, changed by the errors of the episode.

It reads the world and never changes it. Positions are in metres with y to the left of x, headings counter-clockwise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from brink.sim.adapters.highway.specification import MAGNITUDES, RANGE_M, ErrorType, PerceptionError, Target
from brink.sim.adapters.recording import Perceived, Pose
from brink.sim.world.streams import Stream, generator

BESIDE_M: Final = 10.0
"""A vehicle in a neighbouring lane is a target until its centre is this far behind the ego's."""
CROSSING_RAD: Final = math.radians(50.0)
"""A vehicle whose heading differs by more from the ego's goes another way. Lane changes reach 45 degrees."""
CAR_M: Final = (5.0, 2.0)
"""Length and width of highway-env's vehicles."""
GHOST_ASIDE_M: Final = 15.0
GHOST_MPS: Final = 8.0
"""Where a crossing ghost appears, to the right of the ego's way, and how fast it drives. Other ghosts stand still."""
_LANE_M: Final = 4.0
_GHOST_TRACKS: Final = 1_000_000
_STREAM_STRIDE: Final = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class NearbyVehicle:
    """The true state of another vehicle.

    Attributes:
        number: Unique in the episode.
        pose: Where it is.
        along_m: How far ahead of the ego it is on the ego's way, centre to centre; negative behind.
        lane: 0 on the ego's way, -1 in the lane to the left of it, 1 to the right; None elsewhere.
    """

    number: int
    pose: Pose
    along_m: float
    lane: int | None


class Perception:
    """Perceives one episode; called once for each step, in order.

    Args:
        errors: The errors.
        seed: The episode's seed.
    """

    def __init__(self, errors: Sequence[PerceptionError], seed: int) -> None:
        self._errors = [_ActiveError(error, index, seed) for index, error in enumerate(errors)]

    @property
    def steps(self) -> list[tuple[int, int] | None]:
        """First and last step at which each error changed what the ego perceives; None if it never did."""
        return [one.steps for one in self._errors]

    def perceive(
        self, step: int, time_s: float, ego: Pose, bodies: Sequence[NearbyVehicle]
    ) -> list[Perceived]:
        """Return what the ego perceives.

        Args:
            step: Number of the step.
            time_s: Its time.
            ego: Where the ego is.
            bodies: All other vehicles.
        """
        near = [body for body in bodies if distance_m(ego, body.pose) <= RANGE_M]
        for error in self._errors:
            error.update(step, time_s, ego, near)
        perceived = []
        for body in near:
            pose: Pose | None = body.pose
            for error in self._errors:
                if pose is not None:
                    pose = error.applied(step, ego, body, pose)
            if pose is not None:
                length_m, width_m = CAR_M
                perceived.append(Perceived(track=body.number, pose=pose, length_m=length_m, width_m=width_m))
        perceived += [
            ghost for error in self._errors if (ghost := error.ghost(step, time_s, ego)) is not None
        ]
        return perceived


class _ActiveError:
    """One error during an episode: its window, its target, and when it had an effect."""

    def __init__(self, error: PerceptionError, index: int, seed: int) -> None:
        self._error = error
        self._index = index
        self._seed = seed
        self._scale = MAGNITUDES[error.type]
        self._opened_s: float | None = None
        self._open = False
        self._target: int | None = None
        self._entered_s: dict[int, float] = {}
        self._time_s = 0.0
        self._ghost: Pose | None = None
        self._noise: dict[int, np.random.Generator] = {}
        self.steps: tuple[int, int] | None = None

    def update(self, step: int, time_s: float, ego: Pose, near: Sequence[NearbyVehicle]) -> None:
        """Open or close the window, and record which vehicles came into range."""
        self._time_s = time_s
        known_s = -math.inf if step == 0 else time_s
        self._entered_s = {body.number: self._entered_s.get(body.number, known_s) for body in near}
        error = self._error
        if not self._scale.has_window:
            self._open = True
            return
        if self._opened_s is None and time_s >= error.onset_s:
            candidates = [body for body in near if self._is_target(ego, body)]
            if error.type is ErrorType.GHOST:
                self._opened_s, self._ghost = time_s, _ghost_pose(error, ego)
            elif candidates:
                self._opened_s = time_s
                self._target = min(candidates, key=lambda body: distance_m(ego, body.pose)).number
        self._open = self._opened_s is not None and time_s < self._opened_s + error.duration_s

    def applied(self, step: int, ego: Pose, body: NearbyVehicle, pose: Pose) -> Pose | None:
        """Return the perceived pose of a vehicle with this error; None if it is not perceived."""
        if not self._open or not self._concerns(ego, body):
            return pose
        changed = self._changed(ego, body, pose)
        if changed != pose:
            self._acted(step)
        return changed

    def ghost(self, step: int, time_s: float, ego: Pose) -> Perceived | None:
        """Return the ghost of this error, if it is present."""
        if self._ghost is None or self._opened_s is None or not self._open:
            return None
        length_m, width_m = CAR_M
        pose = _moved(self._ghost, (time_s - self._opened_s) * self._ghost.speed_mps)
        if distance_m(ego, pose) > RANGE_M:
            return None
        self._acted(step)
        return Perceived(track=_GHOST_TRACKS + self._index, pose=pose, length_m=length_m, width_m=width_m)

    def _acted(self, step: int) -> None:
        self.steps = (step if self.steps is None else self.steps[0], step)

    def _is_target(self, ego: Pose, body: NearbyVehicle) -> bool:
        crossing = abs(_wrapped(body.pose.yaw_rad - ego.yaw_rad)) > CROSSING_RAD
        match self._error.target:
            case Target.AHEAD:
                return body.lane == 0 and body.along_m > 0.0
            case Target.LEFT:
                return body.lane == -1 and not crossing and body.along_m > -BESIDE_M
            case Target.RIGHT:
                return body.lane == 1 and not crossing and body.along_m > -BESIDE_M
            case Target.CROSSING:
                return crossing
            case Target.ALL:
                return True

    def _concerns(self, ego: Pose, body: NearbyVehicle) -> bool:
        if self._scale.has_window and self._error.target is not Target.ALL:
            return body.number == self._target
        return self._is_target(ego, body)

    def _changed(self, ego: Pose, body: NearbyVehicle, pose: Pose) -> Pose | None:
        error = self._error
        match error.type:
            case ErrorType.MISS:
                return None
            case ErrorType.LATE:
                late = self._time_s < self._entered_s[body.number] + error.magnitude
                return None if late else pose
            case ErrorType.SHORT_RANGE:
                return None if distance_m(ego, body.pose) > error.magnitude else pose
            case ErrorType.GHOST:
                return pose
            case ErrorType.TOO_FAR:
                share = 1.0 + error.magnitude
                return replace(
                    pose,
                    x_m=ego.x_m + share * (pose.x_m - ego.x_m),
                    y_m=ego.y_m + share * (pose.y_m - ego.y_m),
                )
            case ErrorType.TOO_FAST:
                return replace(pose, speed_mps=pose.speed_mps + error.magnitude)
            case ErrorType.POSITION_NOISE:
                along_m, across_m = (error.magnitude * draw for draw in self._draws(body.number, 2))
                return _moved(pose, along_m, across_m)
            case ErrorType.SPEED_NOISE:
                (draw,) = self._draws(body.number, 1)
                return replace(pose, speed_mps=pose.speed_mps + error.magnitude * draw)

    def _draws(self, number: int, count: int) -> list[float]:
        """Return normal draws from the vehicle's own generator, so that other vehicles do not shift them."""
        if number not in self._noise:
            index = self._index * _STREAM_STRIDE + number
            self._noise[number] = generator(self._seed, Stream.DRIVING_SYSTEM, index)
        return [float(draw) for draw in self._noise[number].normal(size=count)]


def _ghost_pose(error: PerceptionError, ego: Pose) -> Pose:
    """Return the pose at which a ghost appears: straight ahead of the ego at that time."""
    aside_m = {Target.LEFT: _LANE_M, Target.RIGHT: -_LANE_M, Target.CROSSING: -GHOST_ASIDE_M}
    place = _moved(ego, error.distance_m, aside_m.get(error.target, 0.0))
    if error.target is Target.CROSSING:
        return replace(place, yaw_rad=_wrapped(ego.yaw_rad + math.pi / 2), speed_mps=GHOST_MPS)
    return replace(place, speed_mps=0.0)


def _moved(pose: Pose, along_m: float, across_m: float = 0.0) -> Pose:
    """Return a pose moved along its heading, and to the left of it."""
    cosine, sine = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return replace(
        pose,
        x_m=pose.x_m + along_m * cosine - across_m * sine,
        y_m=pose.y_m + along_m * sine + across_m * cosine,
    )


def distance_m(one: Pose, other: Pose) -> float:
    """Return the distance between two centres."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)


def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
