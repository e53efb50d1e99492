"""Owns the loop of an episode: sense, decide, drive, let the others go on, measure, judge."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from brink.sim.bullet.engine import Engine
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Command, DrivingSystem, LightReading, Observation
from brink.sim.requirements import Requirement, WorldSample
from brink.sim.urban.behaviour import PERCEPTION_STEP_S, DetectorBehaviour, last_perception_step
from brink.sim.urban.facts import Facts
from brink.sim.urban.recorder import Recorder
from brink.sim.urban.sensing import Detects, Sensing
from brink.sim.world.world import EGO_STEPS, STEP_S, World

CONTROL_PER_PERCEPTION = round(PERCEPTION_STEP_S / STEP_S)
STANDS_BELOW_MPS = 0.1


class Witness(Protocol):
    """Watches an episode for more than requirements and traces keep."""

    def see(self, sample: WorldSample, driving: DrivingSystem) -> None:
        """Take note of a control step, after everybody has moved."""
        ...

    def violated(self, requirement: str) -> None:
        """Take note that a requirement is violated in the step last seen, for the first time or again."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How an episode went, besides what its requirements know.

    Attributes:
        ended: ``goal``, ``collision`` or ``time``.
        last: What was true at its end.
        way_m: How far along its route the ego came.
        least_front_gap_m: Smallest front gap, or None if there never was one.
        stood_s: How long the ego stood.
    """

    ended: str
    last: WorldSample
    way_m: float
    least_front_gap_m: float | None
    stood_s: float


def run_loop(
    world: World,
    driving: DrivingSystem,
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
    to_the_end: bool = False,
) -> Outcome:
    """Run an episode to its end: the goal, the ego's first collision, or the end of its time.

    Args:
        world: At time 0; is changed.
        driving: The system under test, new.
        behaviour: What its obstacle detector says.
        requirements: By id, new; they observe every control step.
        engine: Emptied before the world was made; gets its bodies.
        camera: What the obstacle detector sees with.
        seed: The episode's seed.
        duration_s: Its time.
        recorder: Takes the trace, if there is one.
        witness: Watches, if there is one.
        detects: The obstacle detector, if it is not the behaviour's matter.
        to_the_end: Go on after the goal and after collisions, to measure what an episode costs.
    """
    last_step = last_perception_step(duration_s)
    sensing = Sensing(
        world,
        behaviour,
        camera,
        seed=seed,
        perception_steps=last_step + 1,
        step_s=PERCEPTION_STEP_S,
        detects=detects,
    )
    loop = _Loop(world, driving, sensing, Facts(world, engine), requirements, recorder, witness)
    for step in range(CONTROL_PER_PERCEPTION * last_step):
        sample = loop.step(step)
        if (sample.collision is not None or sample.goal_reached) and not to_the_end:
            break
    loop.close((step + 1) * STEP_S)
    return loop.outcome()


class _Loop:
    """What an episode carries from step to step."""

    __slots__ = (
        "_driving",
        "_facts",
        "_least_front_m",
        "_light",
        "_observers",
        "_recorder",
        "_sample",
        "_sensing",
        "_standing",
        "_witness",
        "_world",
    )

    def __init__(
        self,
        world: World,
        driving: DrivingSystem,
        sensing: Sensing,
        facts: Facts,
        requirements: Mapping[str, Requirement],
        recorder: Recorder | None,
        witness: Witness | None,
    ) -> None:
        self._world = world
        self._witness = witness
        self._driving = driving
        self._sensing = sensing
        self._facts = facts
        self._observers = tuple(requirements.items())
        self._recorder = recorder
        self._light: LightReading | None = None
        self._sample = facts.measure(0.0)
        self._least_front_m: float | None = None
        self._standing = 0

    def step(self, step: int) -> WorldSample:
        """Take one control step and return what is true after it."""
        command = self._decide(step)
        world = self._world
        ego = world.ego
        ego.set_grade(world.grade_at(self._sample.station_m))
        ego.drive(command.accel_mps2, command.steer_rad, EGO_STEPS)
        world.advance(step)
        self._sample = sample = self._facts.measure((step + 1) * STEP_S)
        recorder, witness = self._recorder, self._witness
        if witness is not None:
            witness.see(sample, self._driving)
        for name, requirement in self._observers:
            robustness = requirement.observe(sample)
            if recorder is not None:
                recorder.judge(name, robustness)
            if witness is not None and robustness < 0:
                witness.violated(name)
        if recorder is not None:
            recorder.watch(sample)
        front_m = sample.front_gap_m
        if front_m is not None and (self._least_front_m is None or front_m < self._least_front_m):
            self._least_front_m = front_m
        if sample.speed_mps < STANDS_BELOW_MPS:
            self._standing += 1
        return sample

    def _decide(self, step: int) -> Command:
        """Let the driving system sense and decide."""
        time_s = step * STEP_S
        sensing = self._sensing
        if step % CONTROL_PER_PERCEPTION:
            state = sensing.localise(None)
            return self._driving.step(Observation(time_s=time_s, ego=state, boxes=None, light=self._light))
        perception_step = step // CONTROL_PER_PERCEPTION
        boxes = sensing.boxes(perception_step)
        state = sensing.localise(perception_step)
        self._light = light = sensing.light(perception_step, time_s)
        command = self._driving.step(Observation(time_s=time_s, ego=state, boxes=boxes, light=light))
        if self._recorder is not None:
            shown = self._sample.light.value if self._sample.light is not None else ""
            self._recorder.sample(time_s, self._driving, sensing.truth(), boxes, shown)
        return command

    def close(self, time_s: float) -> None:
        """Record where everybody is at the end, which may be a collision between two perception steps."""
        if self._recorder is not None:
            shown = self._sample.light.value if self._sample.light is not None else ""
            self._recorder.end(time_s, self._driving, shown)

    def outcome(self) -> Outcome:
        """Return how it went."""
        sample = self._sample
        ended = "goal" if sample.goal_reached else "time"
        return Outcome(
            ended=ended if sample.collision is None else "collision",
            last=sample,
            way_m=sample.station_m,
            least_front_gap_m=self._least_front_m,
            stood_s=self._standing * STEP_S,
        )
