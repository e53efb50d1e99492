"""The simulators of urban episodes: `brink-drive@3`, and `brink-drive-errors@2` with errors relative to the truth.

The same specification gives the same verdicts and the same trace, bit for bit, in any process and after any other
episodes on the same class of processor: random draws come from streams addressed by position, all objects are created
anew, and the physics engine is emptied first.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

from brink.sim.bullet.engine import Engine, EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.bullet.wheels import WheeledCar
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import PERCEPTION_STEP_S, Driving
from brink.sim.driving_systems.option import DrivingOption
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import SimulationCrashed
from brink.sim.formula_requirement import with_margins
from brink.sim.guard.guarded import Guarded
from brink.sim.guard.option import GuardOption, option_of
from brink.sim.provenance import provenance, trace_header
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.urban.behaviour import DELIVERED, BehaviourMode, DetectorBehaviour, steps_to_json
from brink.sim.urban.detection_errors import ERROR_STEPS, DetectionError, errors_from_json
from brink.sim.urban.episode_loop import Detects, Outcome, run_loop
from brink.sim.urban.erroneous_detector import ErroneousDetector
from brink.sim.urban.erroneous_objects import ErroneousObjects
from brink.sim.urban.options import WHEELS, DriveOptions
from brink.sim.urban.range_sensor import known_conditions, range_sensor, scan_number
from brink.sim.urban.recorder import Recorder
from brink.sim.world.ego import EGO_CAR, CarModel, EgoCar, MakeEgo
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import World, make_world

SIMULATOR_ID = "brink-drive@3"
ERRORS_SIMULATOR_ID = "brink-drive-errors@2"
MAX_DURATION_S = 600.0


class BrinkDrive:
    """Runs urban episodes. One instance serves a whole process and keeps no state between episodes."""

    id = SIMULATOR_ID

    def _driving(self, spec: EpisodeSpec, world: World, camera: Camera) -> Driving:
        """Return the driving system under test, new.

        Raises:
            InvalidEpisode: The specification names none that is registered here.
        """
        return DrivingOption.of(spec.options).start(world.route, world.ego.model, camera, spec.seed)

    def _detector(self, spec: EpisodeSpec) -> "UrbanDetector":
        """Return the obstacle detector of an episode.

        Raises:
            InvalidEpisode: The specification describes none.
        """
        return _Injected(DetectorBehaviour.from_json(spec.behaviour, spec.duration_s))

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The episode.
            record: Whether the result includes the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine failed.
        """
        spec.check_for(self.id, MAX_DURATION_S)
        options = DriveOptions.from_json(spec.options)
        scenario = UrbanScenario.from_json(spec.scenario)
        guard = option_of(spec.options)
        detector = self._detector(spec)
        requirements = make_requirements(spec.requirements, spec.formulas)
        try:
            return self._run(spec, scenario, detector, requirements, options, guard=guard, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error

    def _run(
        self,
        spec: EpisodeSpec,
        scenario: UrbanScenario,
        detector: "UrbanDetector",
        requirements: Mapping[str, Requirement],
        options: DriveOptions,
        *,
        guard: GuardOption | None,
        record: bool,
    ) -> EpisodeResult:
        cpu_s = time.process_time()
        engine = process_engine()
        engine.reset()
        camera = Camera(least_visible=options.least_visible)
        world = make_world(scenario, spec.seed, _ego_maker(options, engine))
        recorder = Recorder(world, spec.requirements, camera) if record else None
        system = self._driving(spec, world, camera)
        guarded = None if guard is None else _with_guard(system, guard, world, scenario, spec)
        outcome = run_loop(
            world,
            system if guarded is None else guarded,
            detector.behaviour,
            requirements,
            engine=engine,
            camera=camera,
            seed=spec.seed,
            duration_s=spec.duration_s,
            recorder=recorder,
            detects=detector.start(world, camera),
            latency_s=options.latency_s,
        )
        verdicts = verdicts_of(requirements)
        versions = bullet_versions()
        trace = None
        if recorder is not None:
            trace = recorder.trace(trace_header(spec, verdicts, versions), guarded)
            trace = with_margins(trace, requirements)
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={
                **outcome_features(outcome),
                **detector.features(outcome),
                **features_of(requirements),
                **({} if guarded is None else guarded.account.features()),
            },
            provenance=provenance(
                self.id,
                cpu_s,
                versions,
                simulated_s=outcome.last.time_s,
                **DrivingOption.of(spec.options).provenance(),
            ),
            trace=None if trace is None else trace.to_bytes(),
        )


class BrinkDriveErrors(BrinkDrive):
    """Runs urban episodes in which the obstacle detector reports the truth with errors."""

    id = ERRORS_SIMULATOR_ID

    def _detector(self, spec: EpisodeSpec) -> "UrbanDetector":
        return DetectorWithErrors(errors_from_json(spec.behaviour, spec.duration_s), spec)


class UrbanDetector(Protocol):
    """The obstacle detector of one episode.

    Attributes:
        behaviour: What it reports, unless `start` returns a detector.
    """

    behaviour: DetectorBehaviour

    def start(self, world: World, camera: Camera) -> Detects | None:
        """Return the detector that replaces `behaviour`, for a new world."""

    def features(self, outcome: Outcome) -> dict[str, Json]:
        """Return the features that describe what the detector did."""


class _Injected:
    """Injected trajectories, or the ground truth."""

    def __init__(self, behaviour: DetectorBehaviour) -> None:
        self.behaviour = behaviour

    def start(self, world: World, camera: Camera) -> None:
        return None

    def features(self, outcome: Outcome) -> dict[str, Json]:
        """Return when each injected trajectory was delivered; nothing if the detector reports the ground truth."""
        if self.behaviour.mode is BehaviourMode.ORACLE:
            return {}
        return {DELIVERED: steps_to_json(outcome.delivered)}


class DetectorWithErrors:
    """The ground truth with errors."""

    def __init__(self, errors: Sequence[DetectionError], spec: EpisodeSpec) -> None:
        self.behaviour = DetectorBehaviour(mode=BehaviourMode.ORACLE)
        self._errors = errors
        self._spec = spec
        self._started: ErroneousDetector | ErroneousObjects | None = None

    def start(self, world: World, camera: Camera) -> Detects:
        """Return the detector for a new world."""
        if "on" in self._spec.behaviour:
            steps = round(self._spec.duration_s / PERCEPTION_STEP_S) + 1
            self._started = ErroneousObjects(world, camera, self._errors, seed=self._spec.seed, steps=steps)
        else:
            self._started = ErroneousDetector(world, camera, self._errors)
        return self._started

    def features(self, outcome: Outcome) -> dict[str, Json]:
        """Return when each error changed the output, and the greatest severity of those that did."""
        steps = [] if self._started is None else self._started.steps
        acted = [error.severity for error, at in zip(self._errors, steps, strict=True) if at is not None]
        return {ERROR_STEPS: steps_to_json(steps), "severity": max(acted, default=0.0)}


def _with_guard(
    system: Driving, guard: GuardOption, world: World, scenario: UrbanScenario, spec: EpisodeSpec
) -> Guarded:
    """Return the driving system of an episode with its guard and, if the guard needs one, a range sensor."""
    conditions = known_conditions(scenario)
    sensor = range_sensor(world, scenario, spec) if guard.needs_scan else None
    return guard.around(
        system,
        world.route,
        conditions,
        scan=None if sensor is None else lambda time_s: sensor.scan(scan_number(time_s)),
    )


def car_of(options: DriveOptions, car: CarModel = EGO_CAR) -> CarModel:
    """Return the ego's car, without pitch if the options say so."""
    return car if options.pitch else replace(car, pitch_rad_per_mps2=0.0)


def _ego_maker(options: DriveOptions, engine: Engine) -> MakeEgo:
    car = car_of(options)
    if options.fidelity == WHEELS:
        return partial(WheeledCar, engine, model=car)
    return partial(EgoCar, model=car)


def outcome_features(outcome: Outcome) -> dict[str, Json]:
    """Return the features of an episode that do not depend on its requirements."""
    last = outcome.last
    hit = last.collision
    return {
        "ended": outcome.ended,
        "ended_at_s": last.time_s,
        "way_m": outcome.way_m,
        "stood_s": outcome.stood_s,
        "least_front_gap_m": outcome.least_front_gap_m,
        "collision": None if hit is None else hit.kind.value,
        "collided_with": None if hit is None else hit.counterpart,
    }
