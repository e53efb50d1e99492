"""The seam between a drive and the driving system under test: checks, fills in and translates what it decides."""

import math
import traceback
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final, NoReturn, get_args

from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    Command,
    EgoState,
    Observation,
    ObstacleLabel,
    PerceivedObstacle,
    PlanMode,
    PlanState,
    SeenObject,
)
from brink.sim.driving.obstacles import AlphaBetaTracker, GroundPlaneLocaliser, Track
from brink.sim.driving.settings import DrivingSettings
from brink.sim.driving.system import BoxTracking, ModularDriving
from brink.sim.driving_systems.interface import (
    MAX_MODE_CHARS,
    MAX_OBJECTS,
    MAX_POINTS,
    Decision,
    DrivingSystem,
    MakeDrivingSystem,
    Needs,
    Start,
    TrajectoryPoint,
)
from brink.sim.driving_systems.motion import pedal_accel, tracking_command, wheel_steer
from brink.sim.driving_systems.own import LEAVES_ALL
from brink.sim.errors import DrivingSystemFailed, InvalidEpisode, PluginMissing, SimulationCrashed

NEEDS: Final[tuple[str, ...]] = get_args(Needs)
_MODES: Final = {mode.value: mode for mode in PlanMode}
_SETTINGS: Final = DrivingSettings()
_LAST_LINES: Final = 6


class SystemUnderTest:
    """A driving system as simulators see it. Implements `brink.sim.driving.interface.Driving`.

    A decision without acceleration or steering gets that of Brink's own driving system, which then follows the drive
    from its first step: until it is needed, it costs nothing, and afterwards it is as if it had been there always.

    Args:
        name: Name of the driving system, for messages.
        make: Makes it.
        start: The start of the drive.

    Raises:
        DrivingSystemFailed: It cannot be made, or does not say what it needs.
    """

    __slots__ = (
        "_decision",
        "_earlier",
        "_filled",
        "_given",
        "_name",
        "_objects",
        "_observation",
        "_own",
        "_start",
        "_system",
        "_tracking",
        "_trajectory",
    )

    def __init__(self, name: str, make: MakeDrivingSystem, start: Start) -> None:
        self._name = name
        self._start = start
        self._system = self._made(make)
        needs = getattr(self._system, "needs", None)
        if needs not in NEEDS:
            raise DrivingSystemFailed(
                f"driving system {name}: expected an attribute needs, one of {', '.join(NEEDS)}; got {needs!r:.80}"
            )
        self._tracking = object_tracking(start) if needs == "objects" else None
        self._own: ModularDriving | None = None
        self._earlier: list[Observation] = []
        self._filled = False
        self._observation: Observation | None = None
        self._decision = Decision()
        self._given: object = None
        self._trajectory: tuple[TrajectoryPoint, ...] = ()
        self._objects: tuple[PerceivedObstacle, ...] = ()

    def _made(self, make: MakeDrivingSystem) -> DrivingSystem:
        try:
            return make(self._start)
        except (Exception, SystemExit) as error:  # noqa: BLE001  (foreign code; its error becomes ours)
            self._raise("it cannot be made", error)

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command.

        Raises:
            DrivingSystemFailed: The driving system raised an error, or returned no valid decision.
        """
        if self._tracking is not None:
            given = self._with_objects(observation, self._tracking)
        elif observation.objects is not None:
            given = replace(observation, objects=None)
        else:
            given = observation
        try:
            decision = self._system.step(given)
        except (Exception, SystemExit) as error:  # noqa: BLE001  (foreign code; its error becomes ours)
            self._raise(self._when(observation), error)
        if decision is LEAVES_ALL:
            self._filled = True
            command = self._own_command(observation)
        else:
            command = self._command(observation, decision)
        self._observation, self._decision = observation, decision
        return command

    @property
    def plan(self) -> PlanState:
        """What the driving system says about its plan, or else what follows from its command.

        If Brink's own decided anything in the last step, its plan takes the place of what is not said.
        """
        decision, observation = self._decision, self._observation
        mode, speed_mps, offset_m = decision.mode, decision.target_speed_mps, decision.target_offset_m
        own = self._own.plan if self._own is not None and self._filled else None
        if own is not None:
            mode = mode or own.mode
            speed_mps = own.target_speed_mps if speed_mps is None else speed_mps
            offset_m = own.target_offset_m if offset_m is None else offset_m
        ego = None if observation is None else observation.ego
        if speed_mps is None:
            speed_mps = 0.0 if ego is None else ego.speed_mps
        if offset_m is None:
            offset_m = 0.0 if ego is None else ego.offset_m
        return PlanState(mode=_MODES.get(mode, mode), target_speed_mps=speed_mps, target_offset_m=offset_m)

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The objects that the driving system believes in; if it never says, those that it got, or Brink's own.

        Raises:
            DrivingSystemFailed: They are no objects.
        """
        if self._observation is not None:
            try:
                believed = getattr(self._system, "believed_objects", None)
            except (Exception, SystemExit) as error:  # noqa: BLE001  (foreign code; its error becomes ours)
                self._raise("believed_objects", error)
            if believed is not None:
                return self._believed(self._observation, believed)
        if self._objects or self._own is None or not self._filled:
            return self._objects
        return self._own.obstacles

    def _with_objects(self, observation: Observation, tracking: BoxTracking) -> Observation:
        """Return an observation with objects in place of boxes, those of its own if it has any."""
        objects = observation.objects
        if objects is None:
            tracks = tracking.update(observation)
            objects = None if tracks is None else seen_objects(tracks, observation, self._start)
        if objects is not None:
            self._objects = tuple(_in_world(one, observation.ego) for one in objects)
        return Observation(
            time_s=observation.time_s,
            ego=observation.ego,
            boxes=None,
            light=observation.light,
            seen_s=observation.seen_s,
            objects=objects,
        )

    def _command(self, observation: Observation, decision: Decision) -> Command:
        """Return the command of a decision, after checking it."""
        if type(decision) is not Decision:
            self._reject(observation, f"a brink.sim.driving_systems.Decision, got {decision!r:.80}")
        self._check_words(observation, decision)
        accel, steer = decision.accel_mps2, decision.steer_rad
        is_other = decision.trajectory is not None or decision.pedal is not None or decision.wheel is not None
        if is_other or not (type(accel) is type(steer) is float and math.isfinite(accel + steer)):
            accel, steer = self._translated(observation, decision)
        if self._own is None and accel is not None and steer is not None:
            self._earlier.append(observation)
            return Command(accel, steer, decision.emergency)
        own = self._own_command(observation)
        self._filled = accel is None or steer is None
        return Command(
            own.accel_mps2 if accel is None else accel,
            own.steer_rad if steer is None else steer,
            decision.emergency,
        )

    def _translated(self, observation: Observation, decision: Decision) -> tuple[float | None, float | None]:
        """Return acceleration and steering of any decision, each None if it is left out."""
        car = self._start.car
        accel = self._number(observation, "accel_mps2", decision.accel_mps2)
        steer = self._number(observation, "steer_rad", decision.steer_rad)
        pedal = self._number(observation, "pedal", decision.pedal, most=1.0)
        wheel = self._number(observation, "wheel", decision.wheel, most=1.0)
        if decision.trajectory is not None:
            if not (accel is steer is pedal is wheel is None):
                self._reject(observation, "either a trajectory or a command, got both")
            trajectory = self._checked_trajectory(observation, decision.trajectory)
            return tracking_command(trajectory, observation.time_s, observation.ego, car)
        if (accel is not None and pedal is not None) or (steer is not None and wheel is not None):
            self._reject(observation, "a pedal or an acceleration, a wheel or a steering angle; got both")
        return (
            accel if pedal is None else pedal_accel(pedal, car),
            steer if wheel is None else wheel_steer(wheel, car),
        )

    def _own_command(self, observation: Observation) -> Command:
        """Return the command of Brink's own driving system, which is made when it is first needed."""
        if self._own is None:
            self._own = ModularDriving(self._start.route, camera=self._start.camera)
            for earlier in self._earlier:
                self._own.step(earlier)
            self._earlier.clear()
        return self._own.step(observation)

    def _number(
        self, observation: Observation, name: str, value: Any, *, most: float = math.inf
    ) -> float | None:
        """Return a number of a decision as a float; None if it is left out."""
        if value is None:
            return None
        if type(value) not in (float, int) or not math.isfinite(value) or abs(value) > most:
            expected = (
                "a finite float or int" if math.isinf(most) else f"a float or int in [-{most:g}, {most:g}]"
            )
            hint = "" if type(value) in (float, int) else f" ({type(value).__name__}; float(...) makes one)"
            self._reject(observation, f"{name}: {expected}, or None; got {value!r:.80}{hint}")
        return float(value)

    def _checked_trajectory(
        self, observation: Observation, trajectory: Sequence[TrajectoryPoint]
    ) -> Sequence[TrajectoryPoint]:
        """Return a trajectory after checking it; the same tuple, which cannot change, is checked once."""
        if trajectory is not self._given or not isinstance(trajectory, tuple):
            self._given, self._trajectory = trajectory, self._read_trajectory(observation, trajectory)
        trajectory = self._trajectory
        now_s, next_s = observation.time_s, observation.time_s + CONTROL_STEP_S
        if trajectory[0].time_s > now_s + 1e-6 or trajectory[-1].time_s < next_s - 1e-6:
            self._reject(
                observation,
                f"a trajectory from {now_s:.2f} s or earlier to {next_s:.2f} s or later; got "
                f"{trajectory[0].time_s:.2f} to {trajectory[-1].time_s:.2f} s",
            )
        return trajectory

    def _read_trajectory(self, observation: Observation, trajectory: Any) -> tuple[TrajectoryPoint, ...]:
        if not isinstance(trajectory, list | tuple) or not 2 <= len(trajectory) <= MAX_POINTS:
            self._reject(
                observation,
                f"trajectory: a list or tuple of 2 to {MAX_POINTS} points; got {trajectory!r:.80}",
            )
        points = tuple(self._point(observation, index, point) for index, point in enumerate(trajectory))
        if any(new.time_s <= old.time_s for old, new in pairwise(points)):
            self._reject(observation, "trajectory: points in ascending order of time_s, each once")
        return points

    def _point(self, observation: Observation, index: int, point: Any) -> TrajectoryPoint:
        if type(point) is not TrajectoryPoint:
            self._reject(observation, f"trajectory[{index}]: a TrajectoryPoint, got {point!r:.80}")
        values = []
        for name, value in zip(TrajectoryPoint._fields, point, strict=True):
            number = self._number(observation, f"trajectory[{index}].{name}", value)
            if number is None or (name == "speed_mps" and number < 0.0):
                self._reject(
                    observation, f"trajectory[{index}].{name}: a finite float, speeds >= 0; got {value!r}"
                )
            values.append(number)
        return TrajectoryPoint(*values)

    def _check_words(self, observation: Observation, decision: Decision) -> None:
        """Check what a decision says beside its command, and take note of the objects."""
        mode = decision.mode
        if type(mode) is not PlanMode and not (
            isinstance(mode, str) and len(mode) <= MAX_MODE_CHARS and mode.isprintable()
        ):
            self._reject(observation, f"mode: up to {MAX_MODE_CHARS} printable characters, got {mode!r:.80}")
        if type(decision.emergency) is not bool:
            self._reject(observation, f"emergency: True or False, got {decision.emergency!r:.80}")
        speed, offset = decision.target_speed_mps, decision.target_offset_m
        if not (type(speed) is type(offset) is float and math.isfinite(speed + offset)):
            self._number(observation, "target_speed_mps", speed)
            self._number(observation, "target_offset_m", offset)
        if decision.objects is not None:
            self._objects = self._believed(observation, decision.objects)

    def _believed(self, observation: Observation, objects: Any) -> tuple[PerceivedObstacle, ...]:
        """Return the objects that a decision names in world coordinates."""
        if not isinstance(objects, list | tuple) or len(objects) > MAX_OBJECTS:
            self._reject(
                observation, f"objects: a list or tuple of at most {MAX_OBJECTS}; got {objects!r:.80}"
            )
        believed = []
        for one in objects:
            kind = type(one)
            if kind is not PerceivedObstacle and kind is not SeenObject:
                self._reject(observation, f"objects: each a SeenObject or PerceivedObstacle, got {one!r:.80}")
            if type(one[0]) is not int or type(one[1]) is not ObstacleLabel:
                self._reject(observation, f"objects: an int and an ObstacleLabel first, got {one!r:.80}")
            if not _are_floats(one[2:]):
                for value in one[2:]:
                    self._number(observation, "objects", math.nan if value is None else value)
            believed.append(one if kind is PerceivedObstacle else _in_world(one, observation.ego))
        return tuple(believed)

    def _when(self, observation: Observation) -> str:
        return f"step {round(observation.time_s / CONTROL_STEP_S)} ({observation.time_s:.2f} s)"

    def _reject(self, observation: Observation, expected: str) -> NoReturn:
        raise DrivingSystemFailed(
            f"driving system {self._name}, {self._when(observation)}: expected {expected}"
        )

    def _raise(self, when: str, error: BaseException) -> NoReturn:
        """Raise an error of the driving system's code, with the last lines of its stack.

        Raises:
            DrivingSystemFailed: The code failed. It is final: the same drive would fail in the same way.
            MemoryError: It ran out of memory, which it might not on another machine.
            SimulatorError: A program failed; of the same type.
        """
        if isinstance(error, MemoryError):
            raise error
        if isinstance(error, InvalidEpisode | PluginMissing | SimulationCrashed):
            raise type(error)(f"driving system {self._name}, {when}: {error}") from error
        lines = "".join(traceback.format_exception(error)).rstrip().splitlines()[-_LAST_LINES:]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise DrivingSystemFailed(
            "\n".join([f"driving system {self._name}, {when}: {text:.500}", *lines])
        ) from error


def _are_floats(numbers: Sequence[Any]) -> bool:
    """Return whether all numbers are finite floats of Python: their sum is one only if they are."""
    try:
        total = sum(numbers)
    except TypeError:
        return False
    return type(total) is float and math.isfinite(total)


def object_tracking(start: Start) -> BoxTracking:
    """Return the localiser and tracker that make objects of boxes, for one drive."""
    localiser = GroundPlaneLocaliser(start.route, start.camera, _SETTINGS.localisation)
    return BoxTracking(localiser, AlphaBetaTracker(_SETTINGS.tracking))


def seen_objects(tracks: Sequence[Track], observation: Observation, start: Start) -> tuple[SeenObject, ...]:
    """Return tracks as objects in the ego's frame, moved on from the time of their image to the present.

    Their boxes do not show a heading: it is that of the lane, or the opposite for what comes the other way.

    Args:
        tracks: Confirmed tracks at the time of the image.
        observation: The present observation.
        start: The start of the drive.
    """
    ego, route = observation.ego, start.route
    age_s = 0.0 if observation.seen_s is None else observation.time_s - observation.seen_s
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    death_misses = _SETTINGS.tracking.death_misses
    objects = []
    for track in tracks:
        world_x, world_y = track.x_m + age_s * track.vx_mps, track.y_m + age_s * track.vy_mps
        dx, dy = world_x - ego.x_m, world_y - ego.y_m
        station_m, _ = route.project(world_x, world_y, ego.station_m + math.hypot(dx, dy))
        lane_rad = route.pose_at(station_m)[2]
        if (
            track.vx_mps * math.cos(lane_rad) + track.vy_mps * math.sin(lane_rad)
            < -_SETTINGS.tracking.stands_below_mps
        ):
            lane_rad += math.pi
        objects.append(
            SeenObject(
                id=track.number,
                label=track.label,
                existence=1.0 - track.misses / death_misses,
                x_m=dx * cos_yaw + dy * sin_yaw,
                y_m=dy * cos_yaw - dx * sin_yaw,
                yaw_rad=(lane_rad - ego.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi,
                vx_mps=track.vx_mps * cos_yaw + track.vy_mps * sin_yaw,
                vy_mps=track.vy_mps * cos_yaw - track.vx_mps * sin_yaw,
                length_m=track.length_m,
                width_m=track.width_m,
            )
        )
    return tuple(objects)


def _in_world(one: SeenObject, ego: EgoState) -> PerceivedObstacle:
    """Return an object in world coordinates."""
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    return PerceivedObstacle(
        track=one.id,
        label=one.label,
        x_m=ego.x_m + one.x_m * cos_yaw - one.y_m * sin_yaw,
        y_m=ego.y_m + one.x_m * sin_yaw + one.y_m * cos_yaw,
        vx_mps=one.vx_mps * cos_yaw - one.vy_mps * sin_yaw,
        vy_mps=one.vx_mps * sin_yaw + one.vy_mps * cos_yaw,
        length_m=one.length_m,
        width_m=one.width_m,
    )
