"""The simulator `brink-aeb@2`: runs a specification and returns the result, bit for bit reproducible."""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict

from brink.sim.aeb.braking import EmergencyBrake
from brink.sim.aeb.episode import Episode, Outcome, WorldMonitor
from brink.sim.aeb.recorder import AebRecorder
from brink.sim.aeb.sight import CameraSight, InjectedSight, OracleSight, Sight
from brink.sim.aeb.specification import AebScenario, Behaviour, Options, SightMode, check_weights
from brink.sim.aeb.street import CRUISE_MPS, LANE_Y_M, Street, make_street
from brink.sim.bullet.engine import EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import SimulationCrashed
from brink.sim.perception.detector import find_detector
from brink.sim.provenance import provenance, trace_header
from brink.sim.rendering.scene import Light
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.world.ego import EgoCar
from brink.sim.world.weather import conditions

SIMULATOR_ID = "brink-aeb@2"
MAX_DURATION_S = 60.0


class BrinkAeb:
    """Runs emergency-braking episodes. Stateless between episodes; one instance per process is enough."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The specification.
            record: Whether to include the trace in the result.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine failed.
        """
        cpu_s = time.process_time()
        spec.check_for(SIMULATOR_ID, MAX_DURATION_S)
        scenario = AebScenario.from_json(spec.scenario)
        options = Options.from_json(spec.options)
        behaviour = Behaviour.from_json(spec.behaviour, spec.duration_s)
        requirements = make_requirements(spec.requirements)
        try:
            episode, recorder = _run(spec, scenario, options, behaviour, requirements, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error
        return _result(spec, episode, requirements, recorder, cpu_s)


def _run(
    spec: EpisodeSpec,
    scenario: AebScenario,
    options: Options,
    behaviour: Behaviour,
    requirements: Mapping[str, Requirement],
    *,
    record: bool,
) -> tuple[Episode, AebRecorder | None]:
    engine = process_engine()
    engine.reset()
    street = make_street(scenario, spec.seed)
    friction = conditions(scenario.time_of_day, scenario.weather).friction
    ego = EgoCar((0.0, LANE_Y_M, 0.0), CRUISE_MPS, friction=friction)
    recorder = AebRecorder(street, ego, options.size_px) if record else None
    episode = Episode(
        street=street,
        ego=ego,
        monitor=WorldMonitor(street, ego, engine),
        sight=_sight(spec, scenario, options, behaviour, street),
        brake=EmergencyBrake.for_picture(
            *options.size_px,
            hold_s=options.hold_s,
            enabled=options.braking,
            person_frames=options.person_frames,
        ),
        requirements=requirements,
        line_m=scenario.crossing_m,
        recorder=recorder,
    )
    episode.run(spec.duration_s)
    return episode, recorder


def _sight(
    spec: EpisodeSpec, scenario: AebScenario, options: Options, behaviour: Behaviour, street: Street
) -> Sight:
    check_weights(behaviour)
    if behaviour.mode is SightMode.INJECTED:
        return InjectedSight(*options.size_px, behaviour.trajectories)
    if behaviour.mode is not SightMode.DETECTOR:
        return OracleSight(*options.size_px, reported=behaviour.mode is SightMode.ORACLE)
    return CameraSight(
        street,
        Light(time_of_day=scenario.time_of_day, weather=scenario.weather),
        options.size_px,
        seed=spec.seed,
        detector=find_detector(behaviour.detector),
        threshold=behaviour.threshold,
        perturbations=behaviour.perturbations,
        mode=behaviour.fields,
    )


def _result(
    spec: EpisodeSpec,
    episode: Episode,
    requirements: Mapping[str, Requirement],
    recorder: AebRecorder | None,
    cpu_s: float,
) -> EpisodeResult:
    outcome, sight = episode.outcome, episode.sight
    verdicts = verdicts_of(requirements)
    objectives = {f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()}
    scores: dict[str, float] = {}
    if isinstance(sight, CameraSight):
        scores = {name: value for name, value in asdict(sight.scores()).items() if math.isfinite(value)}
    if "alpha" in scores:
        objectives["alpha"] = scores["alpha"]
    versions = bullet_versions()
    return EpisodeResult(
        verdicts=verdicts,
        objectives=objectives,
        features={**_features(outcome, requirements), **scores},
        provenance=provenance(SIMULATOR_ID, cpu_s, versions, simulated_s=outcome.time_s),
        trace=None if recorder is None else recorder.trace(trace_header(spec, verdicts, versions)).to_bytes(),
    )


def _features(outcome: Outcome, requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    hit = outcome.collision
    return {
        "ended": outcome.ended,
        "ended_at_s": outcome.time_s,
        "frames": outcome.frames,
        "collision": None if hit is None else hit.kind.value,
        "collided_with": None if hit is None else hit.counterpart,
        "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
        "person_first_detected_s": outcome.first_seen_s,
        "braked_at_s": outcome.braked_at_s,
        "stopped_at_s": outcome.stopped_at_s,
        "stopping_gap_m": outcome.stopping_gap_m,
        **features_of(requirements),
    }
