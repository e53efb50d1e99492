"""The simulator `highway-env@1`: runs a specification and returns the result, bit for bit reproducible.

The other vehicles and the roads are highway-env's. The ego drives on what it perceives
(`brink.sim.adapters.highway.perception`), while the world, and the verdict, stay true.

References:
    Leurent, highway-env, https://github.com/Farama-Foundation/HighwayEnv (MIT).
"""

import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, ClassVar, Final

from brink.sim.adapters.highway.perception import CAR_M, Perception, distance_m
from brink.sim.adapters.highway.specification import (
    MAX_DURATION_S,
    RANGE_M,
    SIMULATOR_ID,
    STEPS_PER_S,
    HighwayScenario,
    PerceptionError,
    errors_from_json,
    words_of_errors,
)
from brink.sim.adapters.recording import Perceived, TopDownRecorder
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import ExtraMissing, InvalidEpisode
from brink.sim.formula_requirement import with_margins
from brink.sim.provenance import provenance, trace_header, versions_with
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.trace import WORDS
from brink.sim.urban.behaviour import steps_to_json
from brink.sim.urban.detection_errors import ERROR_STEPS

if TYPE_CHECKING:
    from brink.sim.adapters.highway.world import HighwayWorld

if find_spec("highway_env") is None:
    raise ExtraMissing(f"{SIMULATOR_ID} needs highway-env: install the extra highway")

_CAR_HEIGHT_M: Final = 1.5


class HighwayEnvSimulator:
    """Runs highway-env episodes. Stateless between episodes; one instance per process is enough."""

    id: ClassVar[str] = SIMULATOR_ID

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The specification.
            record: Whether to include the trace in the result.

        Raises:
            InvalidEpisode: The specification can never run.
        """
        cpu_s = time.process_time()
        spec.check_for(self.id, MAX_DURATION_S)
        if spec.options:
            raise InvalidEpisode(f"options: expected none, got {next(iter(spec.options))!r}")
        scenario = HighwayScenario.from_json(spec.scenario)
        errors = errors_from_json(spec.behaviour, spec.duration_s)
        requirements = make_requirements(spec.requirements, spec.formulas)
        episode = _Episode(spec, scenario, errors, requirements, record=record)
        episode.run()
        return episode.result(cpu_s)


class _Episode:
    """One episode: the world, the ego's perception, and what is recorded."""

    def __init__(
        self,
        spec: EpisodeSpec,
        scenario: HighwayScenario,
        errors: tuple[PerceptionError, ...],
        requirements: Mapping[str, Requirement],
        *,
        record: bool,
    ) -> None:
        from brink.sim.adapters.highway.world import HighwayWorld  # highway-env takes two seconds to import

        self._spec, self._errors, self._requirements = spec, errors, requirements
        self._words = f"{scenario.words}; {words_of_errors(errors)}"
        self._world: HighwayWorld = HighwayWorld(scenario, spec.seed)
        self._perception = Perception(errors, spec.seed)
        self._time_s, self._ended = 0.0, "duration"
        self._way_m = 0.0
        self._collided: str | None = None
        self._recorder = None
        if record:
            self._recorder = TopDownRecorder(
                spec.requirements,
                ego_size_m=self._world.ego_size_m,
                scene=self._world.scene(spec.duration_s),
                route=self._world.route,
            )

    def run(self) -> None:
        """Run until the end of the episode: a collision, the goal, or its duration."""
        world = self._world
        for step in range(round(self._spec.duration_s * STEPS_PER_S) + 1):
            if step > 0:
                world.step()
            self._time_s = time_s = step / STEPS_PER_S
            sample = world.measure(time_s)
            robustness = {name: one.observe(sample) for name, one in self._requirements.items()}
            self._way_m = sample.station_m
            perceived = self._perception.perceive(step, time_s, world.pose, world.bodies())
            plan = world.decide(perceived)
            self._record(perceived, plan, robustness)
            if sample.collision is not None:
                hit = sample.collision
                self._ended, self._collided = "collision", hit.counterpart
                self._event("collision", f"the ego hits {hit.counterpart} at {hit.impact_speed_mps:.1f} m/s")
                return
            if sample.goal_reached:
                self._ended = "goal"
                self._event("goal", "the ego reaches the end of its route")
                return

    def _record(self, perceived: list[Perceived], plan: str, robustness: Mapping[str, float]) -> None:
        if self._recorder is None:
            return
        world = self._world
        actors = world.actors()
        truth = [
            Perceived(track=0, pose=pose, length_m=actor.length_m, width_m=actor.width_m)
            for actor, pose in actors.values()
            if distance_m(world.pose, pose) <= RANGE_M
        ]
        self._recorder.sample(
            self._time_s,
            world.pose,
            world.accel_mps2,
            actors,
            perceived=perceived,
            plan=plan,
            target_speed_mps=world.target_speed_mps,
            robustness=robustness,
            seen=_boxes(world, truth),
            given=_boxes(world, perceived),
        )

    def _event(self, kind: str, text: str) -> None:
        if self._recorder is not None:
            self._recorder.event(self._time_s, kind, text)

    def _record_errors(self) -> None:
        """Record when each error first changed what the ego perceives."""
        for error, steps in zip(self._errors, self._perception.steps, strict=True):
            if self._recorder is not None and steps is not None:
                self._recorder.event(steps[0] / STEPS_PER_S, "error", error.words)

    def result(self, cpu_s: float) -> EpisodeResult:
        """Return the result of the episode."""
        spec, verdicts = self._spec, verdicts_of(self._requirements)
        versions = versions_with("highway-env", "gymnasium")
        steps = self._perception.steps
        acted = [error.severity for error, at in zip(self._errors, steps, strict=True) if at is not None]
        trace = None
        if self._recorder is not None:
            self._record_errors()
            header = {**trace_header(spec, verdicts, versions), WORDS: self._words}
            trace = with_margins(self._recorder.trace(header), self._requirements).to_bytes()
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={
                "ended": self._ended,
                "ended_at_s": self._time_s,
                "way_m": self._way_m,
                "collided_with": self._collided,
                ERROR_STEPS: steps_to_json(steps),
                "severity": max(acted, default=0.0),
                **features_of(self._requirements),
            },
            provenance=provenance(SIMULATOR_ID, cpu_s, versions, simulated_s=self._time_s),
            trace=trace,
        )


def _boxes(world: "HighwayWorld", vehicles: list[Perceived]) -> list[Box]:
    """Return vehicles as boxes in the image of a camera, in which replays compare perception and truth."""
    camera, ego = Camera(), world.pose
    length_m, width_m = CAR_M
    found = []
    for one in vehicles:
        pose = one.pose
        body = Solid(
            ObstacleLabel.VEHICLE, pose.x_m, pose.y_m, pose.yaw_rad, length_m, width_m, _CAR_HEIGHT_M
        )
        seen = camera.project(ego.x_m, ego.y_m, ego.yaw_rad, body)
        if seen is not None:
            found.append(seen[0])
    return found
