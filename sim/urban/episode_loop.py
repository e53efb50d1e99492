"""Owns the loop of an episode: sense, decide, drive, let the others go on, measure, judge."""

from collections.abc import Mapping
from dataclasses import dataclass

from sim.bullet.engine import Engine
from sim.driving.camera import Camera
from sim.driving.interface import Box, DrivingSystem, LightReading, Observation
from sim.requirements.requirement import Requirement, WorldSample
from sim.urban.behaviour import PERCEPTION_STEP_S, DetectorBehaviour, last_perception_step
from sim.urban.facts import Facts
from sim.urban.recorder import Recorder
from sim.urban.sensing import Sensing
from sim.world.world import EGO_STEPS, STEP_S, UrbanWorld

CONTROL_PER_PERCEPTION = round(PERCEPTION_STEP_S / STEP_S)


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
    world: UrbanWorld,
    driving: DrivingSystem,
    behaviour: DetectorBehaviour,
    requirements: Mapping[str, Requirement],
    *,
    engine: Engine,
    camera: Camera,
    seed: int,
    duration_s: float,
    recorder: Recorder | None,
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
        to_the_end: Go on after the goal and after collisions, to measure what an episode costs.
    """
    steps = CONTROL_PER_PERCEPTION * last_perception_step(duration_s)
    facts = Facts(world, engine)
    sensing = Sensing(
        world,
        behaviour,
        camera,
        seed=seed,
        perception_steps=steps // CONTROL_PER_PERCEPTION + 1,
        step_s=PERCEPTION_STEP_S,
    )
    ego = world.ego
    observers = tuple(requirements.items())
    light: LightReading | None = None
    sample = facts.measure(0.0)
    least_front_m: float | None = None
    standing = 0
    ended = "time"
    for step in range(steps):
        time_s = step * STEP_S
        boxes: tuple[Box, ...] | None = None
        perception_step: int | None = None
        if step % CONTROL_PER_PERCEPTION == 0:
            perception_step = step // CONTROL_PER_PERCEPTION
            boxes = sensing.boxes(perception_step)
        state = sensing.localise(perception_step)
        if perception_step is not None:
            light = sensing.light(perception_step, time_s)
        command = driving.step(Observation(time_s=time_s, ego=state, boxes=boxes, light=light))
        if recorder is not None and boxes is not None:
            shown = sample.light.value if sample.light is not None else ""
            recorder.sample(time_s, driving, sensing.truth(), boxes, shown)
        ego.set_grade(world.grade_at(sample.station_m))
        ego.drive(command.accel_mps2, command.steer_rad, EGO_STEPS)
        world.advance(step)
        sample = facts.measure((step + 1) * STEP_S)
        for name, requirement in observers:
            robustness = requirement.observe(sample)
            if recorder is not None:
                recorder.judge(name, robustness)
        front_m = sample.front_gap_m
        if front_m is not None and (least_front_m is None or front_m < least_front_m):
            least_front_m = front_m
        if sample.speed_mps < 0.1:
            standing += 1
        if (sample.collision is not None or sample.goal_reached) and not to_the_end:
            if recorder is not None:
                recorder.watch(sample)
            ended = "goal" if sample.collision is None else "collision"
            break
    return Outcome(
        ended=ended,
        last=sample,
        way_m=sample.station_m,
        least_front_gap_m=least_front_m,
        stood_s=standing * STEP_S,
    )
