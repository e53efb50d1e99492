"""The episode loop: sense, decide, drive, advance the others, measure, and evaluate the requirements.

`Sensing` produces what the driving system receives: the localised ego with its errors, the light detector's readings
and the obstacle boxes. The obstacle detector is the component under test: its boxes are injected or the ground truth,
never noisy. The quality of the other parts depends on time of day and weather.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from brink.sim.bullet.engine import Engine
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    LATENCY_S,
    PERCEPTION_STEP_S,
    Box,
    Command,
    Driving,
    EgoState,
    LightReading,
    LightState,
    Observation,
)
from brink.sim.requirements import Requirement, WorldSample
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.erroneous_objects import ObjectReport, seen_from
from brink.sim.urban.facts import Facts
from brink.sim.urban.recorder import Recorder
from brink.sim.world.streams import Stream, generator
from brink.sim.world.world import EGO_STEPS, World, bodies_of, screens_of

Detects: TypeAlias = Callable[[float], tuple[Box, ...]]
"""Returns the detections of an obstacle detector at a simulated time."""

DRIFT_S = 1.5
"""Time constant of localisation errors."""

YAW_ERROR_RAD_PER_M = 0.03


@runtime_checkable
class ReportsObjects(Protocol):
    """An obstacle detector that reports objects, too.

    Attributes:
        objects: What it reported when it was last called.
    """

    objects: tuple[ObjectReport, ...]


class Sensing:
    """Produces the observations of an episode.

    Args:
        world: The world to sense.
        behaviour: The obstacle detector's behaviour.
        camera: The detector's camera.
        seed: The episode's seed.
        perception_steps: Number of perception steps.
        step_s: Time between perception steps.
        detects: The obstacle detector, if it is used in place of `behaviour`.

    Attributes:
        delivered: First and last perception step at which each injected trajectory was in the output so far, or None
            if it never was; in the order of `behaviour.trajectories`.
    """

    def __init__(
        self,
        world: World,
        behaviour: DetectorBehaviour,
        camera: Camera,
        *,
        seed: int,
        perception_steps: int,
        step_s: float,
        detects: Detects | None = None,
    ) -> None:
        self._world = world
        self._step_s = step_s
        self._injected_steps = step_s / PERCEPTION_STEP_S
        self._detects = detects
        self._objects = detects if isinstance(detects, ReportsObjects) else None
        self._behaviour = behaviour
        self.delivered: list[tuple[int, int] | None] = [None] * len(behaviour.trajectories)
        self._camera = camera
        self._station_m = 0.0
        weather = world.weather
        errors = generator(seed, Stream.LOCALISATION).normal(size=(perception_steps + 2, 3))
        keep = math.exp(-step_s / DRIFT_S)
        self._keep = keep
        self._fresh = weather.position_noise_m * math.sqrt(1.0 - keep * keep)
        self._errors: list[list[float]] = errors.tolist()
        self._along_bias_m = weather.position_bias_m * self._errors[-1][0]
        self._side_bias_m = weather.position_bias_m * self._errors[-1][1]
        self._along_m = weather.position_noise_m * self._errors[-2][0]
        self._side_m = weather.position_noise_m * self._errors[-2][1]
        self._yaw_rad = 0.0
        chances = generator(seed, Stream.LIGHT_DETECTION).random(size=perception_steps)
        self._light_chances: list[float] = chances.tolist()

    def localise(self, perception_step: int | None) -> EgoState:
        """Return the ego's state as estimated by localisation.

        Args:
            perception_step: Number of the perception step, at which errors change; None between perception steps.
        """
        if perception_step is not None:
            along, side, yaw = self._errors[perception_step]
            self._along_m = self._keep * self._along_m + self._fresh * along
            self._side_m = self._keep * self._side_m + self._fresh * side
            self._yaw_rad = self._keep * self._yaw_rad + self._fresh * YAW_ERROR_RAD_PER_M * yaw
        ego, line = self._world.ego, self._world.route.line
        yaw_rad = ego.yaw_rad + self._yaw_rad
        along_m, side_m = self._along_m + self._along_bias_m, self._side_m + self._side_bias_m
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        x_m = ego.x_m + along_m * cos_yaw - side_m * sin_yaw
        y_m = ego.y_m + along_m * sin_yaw + side_m * cos_yaw
        self._station_m, offset_m = line.project(x_m, y_m, self._station_m)
        return EgoState(
            x_m=x_m,
            y_m=y_m,
            yaw_rad=yaw_rad,
            speed_mps=ego.speed_mps,
            accel_mps2=ego.accel_mps2,
            station_m=self._station_m,
            offset_m=offset_m,
        )

    def light(self, perception_step: int, time_s: float) -> LightReading | None:
        """Return the traffic-light detector's report at a perception step."""
        world = self._world
        if world.signals is None:
            return None
        weather = world.weather
        bumper_m = self._station_m + 0.5 * world.ego.length_m
        for line_m in world.route.stop_line_stations_m:
            if not -1.0 < line_m - bumper_m < weather.light_range_m:
                continue
            chance = self._light_chances[perception_step]
            if chance < weather.light_miss_share:
                return None
            state = world.signals.main_at(time_s)
            if chance > 1.0 - weather.light_confusion_share:
                state = LightState.GREEN if state is not LightState.GREEN else LightState.RED
            return LightReading(state=state, stop_line_station_m=line_m)
        return None

    def boxes(self, perception_step: int) -> tuple[Box, ...]:
        """Return the obstacle detector's output at a perception step."""
        if self._detects is not None:
            return self._detects(perception_step * self._step_s)
        if self._behaviour.mode is BehaviourMode.ORACLE:
            return self.truth()
        boxes = []
        for index, trajectory in enumerate(self._behaviour.trajectories):
            box = trajectory.box_at(perception_step * self._injected_steps)
            if box is not None:
                boxes.append(box)
                since = self.delivered[index]
                self.delivered[index] = (since[0] if since else perception_step, perception_step)
        return tuple(boxes)

    def objects(self) -> tuple[ObjectReport, ...] | None:
        """Return the objects that were reported with the last boxes; None without a list of objects."""
        return None if self._objects is None else self._objects.objects

    def truth(self) -> tuple[Box, ...]:
        """Return the boxes of all bodies visible to the camera."""
        world = self._world
        ego = world.ego
        sights = self._camera.look(ego.x_m, ego.y_m, ego.yaw_rad, bodies_of(world), screens_of(world.road))
        return self._camera.all_tilted((sight.box for sight in sights), ego.pitch_rad)


STANDS_BELOW_MPS = 0.1


class Witness(Protocol):
    """Observes an episode to record what neither requirements nor traces record."""

    def see(self, sample: WorldSample, driving: Driving) -> None:
        """Observe a control step, after all road users have moved."""

    def violated(self, requirement: str) -> None:
        """Observe a violation in the step last seen; called in every step in which the requirement is violated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The outcome of an episode, apart from the requirements.

    Attributes:
        ended: ``goal``, ``collision`` or ``time``.
        last: The last sample.
        way_m: Distance that the ego covered along its route.
        least_front_gap_m: Smallest front gap, or None if there never was one.
        stood_s: How long the ego stood still.
        delivered: First and last perception step at which each injected trajectory was reported to the driving
            system, or None if it never was.
    """

    ended: str
    last: WorldSample
    way_m: float
    least_front_gap_m: float | None
    stood_s: float
    delivered: tuple[tuple[int, int] | None, ...]


def run_loop(
    world: World,
    driving: Driving,
    behaviour: DetectorBehaviour,
    requirements: Mapping[str, Requirement],
    *,
    engine: Engine,
    camera: Camera,
    seed: int,
    duration_s: float,
    recorder: Recorder | None,
    witness: Witness | None = None,
    detects: Detects | None = None,
    latency_s: float = LATENCY_S,
    perception_step_s: float = PERCEPTION_STEP_S,
    to_the_end: bool = False,
    facts: Facts | None = None,
) -> Outcome:
    """Run an episode until the goal, the ego's first collision, or the end of its duration.

    Args:
        world: The world at time 0; modified.
        driving: The system under test, new.
        behaviour: The obstacle detector's behaviour.
        requirements: New requirements by id; they observe every control step.
        engine: The physics engine, emptied before the world was made; receives the world's bodies.
        camera: The obstacle detector's camera.
        seed: The episode's seed.
        duration_s: Longest simulated time.
        recorder: Records the trace, if given.
        witness: Observes the episode, if given.
        detects: The obstacle detector, if it is used in place of `behaviour`.
        latency_s: Time from an image to the arrival of what was detected in it; rounded to control steps.
        perception_step_s: Time between images, a multiple of `CONTROL_STEP_S`.
        to_the_end: Continue after the goal and after collisions, to measure the cost of a full episode.
        facts: Measures the world in place of `Facts`.
    """
    last_step = round(duration_s / perception_step_s)
    sensing = Sensing(
        world,
        behaviour,
        camera,
        seed=seed,
        perception_steps=last_step + 1,
        step_s=perception_step_s,
        detects=detects,
    )
    facts = Facts(world, engine) if facts is None else facts
    loop = _Loop(
        world=world,
        driving=driving,
        sensing=sensing,
        facts=facts,
        requirements=requirements,
        recorder=recorder,
        witness=witness,
        sample=facts.measure(0.0),
        latency_steps=round(latency_s / CONTROL_STEP_S),
        control_per_perception=round(perception_step_s / CONTROL_STEP_S),
        processed=deque(),
    )
    for step in range(loop.control_per_perception * last_step):
        sample = loop.step(step)
        if (sample.collision is not None or sample.goal_reached) and not to_the_end:
            break
    loop.close((step + 1) * CONTROL_STEP_S)
    return loop.outcome()


@dataclass(slots=True, kw_only=True)
class _Loop:
    """The state of an episode between steps."""

    world: World
    driving: Driving
    sensing: Sensing
    facts: Facts
    requirements: Mapping[str, Requirement]
    recorder: Recorder | None
    witness: Witness | None
    sample: WorldSample
    latency_steps: int
    control_per_perception: int
    processed: deque[tuple[int, float, tuple[Box, ...], tuple[ObjectReport, ...] | None, LightReading | None]]
    light: LightReading | None = None
    least_front_m: float | None = None
    standing: int = 0

    def step(self, step: int) -> WorldSample:
        """Run one control step and return the facts after it."""
        command = self._decide(step)
        world = self.world
        ego = world.ego
        ego.set_grade(world.grade_at(self.sample.station_m))
        ego.drive(command.accel_mps2, command.steer_rad, EGO_STEPS)
        world.advance(step)
        self.sample = sample = self.facts.measure((step + 1) * CONTROL_STEP_S, emergency=command.emergency)
        recorder, witness = self.recorder, self.witness
        if witness is not None:
            witness.see(sample, self.driving)
        for name, requirement in self.requirements.items():
            robustness = requirement.observe(sample)
            if recorder is not None:
                recorder.judge(name, robustness)
            if witness is not None and robustness < 0:
                witness.violated(name)
        if recorder is not None:
            recorder.watch(sample)
        front_m = sample.front_gap_m
        if front_m is not None and (self.least_front_m is None or front_m < self.least_front_m):
            self.least_front_m = front_m
        if sample.speed_mps < STANDS_BELOW_MPS:
            self.standing += 1
        return sample

    def _decide(self, step: int) -> Command:
        """Give the driving system its observation and return its command."""
        time_s = step * CONTROL_STEP_S
        sensing = self.sensing
        perception_step, between = divmod(step, self.control_per_perception)
        if between:
            state = sensing.localise(None)
        else:
            boxes = sensing.boxes(perception_step)
            state = sensing.localise(perception_step)
            light = sensing.light(perception_step, time_s)
            self.processed.append((step + self.latency_steps, time_s, boxes, sensing.objects(), light))
        arrived, seen_s, objects = None, None, None
        if self.processed and self.processed[0][0] <= step:
            _, seen_s, arrived, reports, self.light = self.processed.popleft()
            if reports is not None:
                objects = seen_from(reports, self.world.ego, time_s - seen_s)
        command = self.driving.step(
            Observation(
                time_s=time_s, ego=state, boxes=arrived, light=self.light, seen_s=seen_s, objects=objects
            )
        )
        if self.recorder is not None and not between:
            shown = self.sample.light.value if self.sample.light is not None else ""
            self.recorder.sample(time_s, self.driving, sensing.truth(), boxes, shown)
        return command

    def close(self, time_s: float) -> None:
        """Record the final state, which may be a collision between two perception steps."""
        if self.recorder is not None:
            shown = self.sample.light.value if self.sample.light is not None else ""
            self.recorder.end(time_s, self.driving, shown)

    def outcome(self) -> Outcome:
        """Return the outcome of the episode."""
        sample = self.sample
        ended = "goal" if sample.goal_reached else "time"
        return Outcome(
            ended=ended if sample.collision is None else "collision",
            last=sample,
            way_m=sample.station_m,
            least_front_gap_m=self.least_front_m,
            stood_s=self.standing * CONTROL_STEP_S,
            delivered=tuple(self.sensing.delivered),
        )
