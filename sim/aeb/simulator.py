"""The simulator `brink-aeb@3`: runs a specification and returns the result, bit for bit reproducible.

The emergency brake drives on a street of its own (`brink.sim.aeb.street`), in the loop of urban episodes.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import ClassVar, Final

from brink.sim.aeb.braking import EmergencyBrake
from brink.sim.aeb.film import FilmRecorder
from brink.sim.aeb.sight import CameraSight
from brink.sim.aeb.specification import AebScenario, Behaviour, Options, SightMode, check_weights
from brink.sim.aeb.street import StreetWorld, make_street_world
from brink.sim.bullet.engine import EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import CONTROL_STEP_S, Box, Driving, PlanMode
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import SimulationCrashed
from brink.sim.perception.boxes import MIN_HEIGHT_SHARE, MIN_WIDTH_SHARE
from brink.sim.perception.detector import find_detector
from brink.sim.perturbations import Pipeline
from brink.sim.provenance import provenance, trace_header
from brink.sim.rendering.scene import Light
from brink.sim.requirements import Requirement, WorldSample, features_of, verdicts_of
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.episode_loop import Detects, run_loop
from brink.sim.urban.recorder import Recorder
from brink.sim.urban.simulator import outcome_features
from brink.sim.world.ego import EGO_CAR

SIMULATOR_ID: Final = "brink-aeb@3"
MAX_DURATION_S: Final = 60.0
STANDS_BELOW_MPS: Final = 0.05
CAMERA: Final = Camera(min_width_px=MIN_WIDTH_SHARE * 800, min_height_px=MIN_HEIGHT_SHARE * 450)
"""Boxes that are too small to count in an image of 16:9 are too small in the driving system's."""


class BrinkAeb:
    """Runs emergency-braking episodes. Stateless between episodes; one instance per process is enough."""

    id: ClassVar[str] = SIMULATOR_ID

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The specification.
            record: Whether to include the trace in the result.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine failed.
        """
        spec.check_for(self.id, MAX_DURATION_S)
        scenario = AebScenario.from_json(spec.scenario)
        options = Options.from_json(spec.options)
        behaviour = Behaviour.from_json(spec.behaviour, spec.duration_s)
        check_weights(behaviour)
        requirements = make_requirements(spec.requirements)
        try:
            return _run(spec, scenario, options, behaviour, requirements, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error


def _run(
    spec: EpisodeSpec,
    scenario: AebScenario,
    options: Options,
    behaviour: Behaviour,
    requirements: Mapping[str, Requirement],
    *,
    record: bool,
) -> EpisodeResult:
    cpu_s = time.process_time()
    engine = process_engine()
    engine.reset()
    car = EGO_CAR if options.pitch else replace(EGO_CAR, pitch_rad_per_mps2=0.0)
    world = make_street_world(scenario, spec.seed, car)
    brake = EmergencyBrake(
        hold_s=options.hold_s,
        enabled=options.braking,
        person_frames=options.person_frames,
        latency_s=options.latency_s,
        car=car,
    )
    recorder = Recorder(world, spec.requirements, CAMERA) if record else None
    film = FilmRecorder() if record else None
    sight = _sight(spec, scenario, options, behaviour, world, film)
    stop = _FirstStop()
    outcome = run_loop(
        world,
        brake,
        _boxes(behaviour),
        requirements,
        engine=engine,
        camera=CAMERA,
        seed=spec.seed,
        duration_s=spec.duration_s,
        recorder=recorder,
        witness=stop,
        detects=sight,
        latency_s=options.latency_s,
        perception_step_s=CONTROL_STEP_S,
    )
    verdicts = verdicts_of(requirements)
    objectives = {f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()}
    scores: dict[str, float] = {}
    if isinstance(sight, CameraSight):
        scores = {name: value for name, value in asdict(sight.scores()).items() if math.isfinite(value)}
    if "alpha" in scores:
        objectives["alpha"] = scores["alpha"]
    versions = bullet_versions()
    trace = None
    if recorder is not None and film is not None:
        trace = recorder.trace(trace_header(spec, verdicts, versions))
        trace = replace(trace, film=film.film(len(trace.time_s), options.size_px))
    hit = outcome.last.collision
    features: dict[str, Json] = {
        **outcome_features(outcome),
        "frames": round(outcome.last.time_s / CONTROL_STEP_S),
        "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
        "person_first_detected_s": brake.person_seen_s,
        "braked_at_s": brake.braked_at_s,
        "stopped_at_s": stop.time_s,
        "stopping_gap_m": stop.gap_m,
        **features_of(requirements),
        **scores,
    }
    return EpisodeResult(
        verdicts=verdicts,
        objectives=objectives,
        features=features,
        provenance=provenance(SIMULATOR_ID, cpu_s, versions, simulated_s=outcome.last.time_s),
        trace=None if trace is None else trace.to_bytes(),
    )


def _boxes(behaviour: Behaviour) -> DetectorBehaviour:
    """Return what the brake receives unless `_sight` returns a detector: injected boxes or the ground truth."""
    if behaviour.mode is SightMode.INJECTED:
        return DetectorBehaviour(mode=BehaviourMode.INJECTED, trajectories=behaviour.trajectories)
    return DetectorBehaviour(mode=BehaviourMode.ORACLE)


def _sight(
    spec: EpisodeSpec,
    scenario: AebScenario,
    options: Options,
    behaviour: Behaviour,
    world: StreetWorld,
    film: FilmRecorder | None,
) -> Detects | None:
    """Return the detector of an episode, or None if the brake receives injected boxes or the ground truth."""
    if behaviour.mode is SightMode.BLIND:
        return _nothing
    if behaviour.mode is not SightMode.DETECTOR:
        return None
    return CameraSight(
        world,
        Light(time_of_day=scenario.time_of_day, weather=scenario.weather),
        options.size_px,
        camera=CAMERA,
        seed=spec.seed,
        detector=find_detector(behaviour.detector),
        threshold=behaviour.threshold,
        pipeline=Pipeline(behaviour.perturbations, seed=spec.seed, mode=behaviour.fields),
        film=film,
    )


def _nothing(time_s: float) -> tuple[Box, ...]:
    return ()


@dataclass(slots=True)
class _FirstStop:
    """Observes when the brake first brings the ego to a standstill.

    Attributes:
        time_s: When it does; None if never.
        gap_m: Clearance at that time to the nearest person or to an obstacle ahead in the lane.
    """

    time_s: float | None = None
    gap_m: float | None = None

    def see(self, sample: WorldSample, driving: Driving) -> None:
        """Observe a control step."""
        stands = sample.speed_mps < STANDS_BELOW_MPS and driving.plan.mode is PlanMode.STOP
        if stands and self.time_s is None:
            self.time_s = sample.time_s
            ahead_m = [gap for gap in (sample.pedestrian_gap_m, sample.front_gap_m) if gap is not None]
            self.gap_m = min(ahead_m, default=None)

    def violated(self, requirement: str) -> None:
        """Ignore violations: the requirements record them."""
