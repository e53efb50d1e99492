"""Owns the simulator `brink-aeb@1`: a specification in, a result out; bit for bit the same each time."""

import json
import math
import time
from collections.abc import Mapping

from sim.aeb.braking import HOLD_S, EmergencyBrake
from sim.aeb.episode import Episode, Outcome
from sim.aeb.facts import Facts
from sim.aeb.recorder import AebRecorder
from sim.aeb.scenario import AebScenario
from sim.aeb.sight import GroundTruth, Sight
from sim.aeb.street import CRUISE_MPS, LANE_Y_M, make_street
from sim.bullet.engine import EngineError, discard_engine, process_engine
from sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject
from sim.errors import InvalidEpisode, SimulationCrashed
from sim.requirements.registry import make_requirements
from sim.requirements.requirement import Requirement
from sim.urban.scenario import nearest
from sim.urban.simulator import instruction_set, versions
from sim.world.ego import EgoCar
from sim.world.weather import conditions

SIMULATOR_ID = "brink-aeb@1"
MAX_DURATION_S = 60.0
SIZE_PX = (640, 360)
MODES = ("oracle", "blind")
OPTIONS = ("width_px", "height_px", "hold_s", "braking")


class BrinkAeb:
    """Runs emergency-braking episodes. One a process is enough; it keeps nothing between episodes."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: What to run.
            record: Whether the result carries the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine broke down.
        """
        cpu_s = time.process_time()
        if spec.simulator != SIMULATOR_ID:
            raise InvalidEpisode(
                f"simulator: this is {SIMULATOR_ID}, the episode asks for {spec.simulator!r}"
            )
        if spec.duration_s > MAX_DURATION_S:
            raise InvalidEpisode(f"duration_s: expected at most {MAX_DURATION_S:g}, got {spec.duration_s!r}")
        scenario = AebScenario.from_json(spec.scenario)
        options = _Options.read(spec.options)
        sight = _sight(spec.behaviour, options)
        requirements = make_requirements(spec.requirements)
        try:
            outcome, recorder = _run(spec, scenario, options, sight, requirements, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine broke down: {error}") from error
        return _result(spec, outcome, requirements, recorder, cpu_s)


class _Options:
    """The options of a specification, checked."""

    __slots__ = ("braking", "hold_s", "size_px")

    def __init__(self, size_px: tuple[int, int], hold_s: float, *, braking: bool) -> None:
        self.size_px = size_px
        self.hold_s = hold_s
        self.braking = braking

    @classmethod
    def read(cls, options: Mapping[str, Json]) -> "_Options":
        for name in options:
            if name not in OPTIONS:
                raise InvalidEpisode(f"options: unknown field {name!r}{nearest(name, OPTIONS)}")
        width_px, height_px = (
            _number(options, name, default, 64, 4096)
            for name, default in zip(OPTIONS[:2], SIZE_PX, strict=True)
        )
        braking = options.get("braking", True)
        if not isinstance(braking, bool):
            raise InvalidEpisode(f"options.braking: expected true or false, got {braking!r}")
        return cls(
            (round(width_px), round(height_px)), _number(options, "hold_s", HOLD_S, 0, 10), braking=braking
        )


def _number(options: Mapping[str, Json], name: str, default: float, low: float, high: float) -> float:
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InvalidEpisode(f"options.{name}: expected a number in [{low:g}, {high:g}], got {value!r}")
    return float(value)


def _sight(behaviour: Mapping[str, Json], options: _Options) -> Sight:
    mode = behaviour.get("mode")
    if not isinstance(mode, str) or mode not in MODES:
        raise InvalidEpisode(f"behaviour.mode: expected one of {', '.join(MODES)}; got {mode!r}")
    for name in behaviour:
        if name != "mode":
            raise InvalidEpisode(f"behaviour: unknown field {name!r} for mode {mode}")
    return GroundTruth(*options.size_px, told=mode == "oracle")


def _run(
    spec: EpisodeSpec,
    scenario: AebScenario,
    options: _Options,
    sight: Sight,
    requirements: Mapping[str, Requirement],
    *,
    record: bool,
) -> tuple[Outcome, AebRecorder | None]:
    engine = process_engine()
    engine.reset()
    street = make_street(scenario, spec.seed)
    friction = conditions(scenario.time_of_day, scenario.weather).friction
    ego = EgoCar((0.0, LANE_Y_M, 0.0), CRUISE_MPS, friction=friction)
    recorder = AebRecorder(street, ego, options.size_px) if record else None
    episode = Episode(
        street=street,
        ego=ego,
        facts=Facts(street, ego, engine),
        sight=sight,
        brake=EmergencyBrake.for_picture(*options.size_px, hold_s=options.hold_s, enabled=options.braking),
        requirements=requirements,
        line_m=scenario.crossing_m,
        recorder=recorder,
    )
    return episode.run(spec.duration_s), recorder


def _result(
    spec: EpisodeSpec,
    outcome: Outcome,
    requirements: Mapping[str, Requirement],
    recorder: AebRecorder | None,
    cpu_s: float,
) -> EpisodeResult:
    verdicts = {name: requirement.verdict() for name, requirement in requirements.items()}
    for name, verdict in verdicts.items():
        if not math.isfinite(verdict.robustness):
            raise SimulationCrashed(f"{name}: expected a finite robustness, got {verdict.robustness}")
    trace = None
    if recorder is not None:
        about: JsonObject = {"spec": json.loads(spec.canonical_json()), "versions": dict(versions())}
        trace = recorder.trace(about).to_bytes()
    return EpisodeResult(
        verdicts=verdicts,
        objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
        features=_features(outcome, requirements),
        provenance={
            "simulator": SIMULATOR_ID,
            **versions(),
            "instruction_set": instruction_set(),
            "cpu_s": time.process_time() - cpu_s,
            "simulated_s": outcome.time_s,
        },
        trace=trace,
    )


def _features(outcome: Outcome, requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    hit = outcome.collision
    features: dict[str, Json] = {
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
    }
    for name, requirement in requirements.items():
        for key, value in requirement.features().items():
            features[f"{name}:{key}"] = value
    return features
