"""The simulator `brink-drive@2`: runs a specification and returns the result.

The same specification gives the same verdicts and the same trace, bit for bit, in any process and after any other
episodes on the same class of processor: random draws come from streams addressed by position, all objects are created
anew, and the physics engine is emptied first.
"""

import json
import math
import platform
import time
from collections.abc import Mapping
from functools import cache, partial
from importlib.metadata import version

from brink import __version__
from brink.sim.bullet.engine import Engine, EngineError, discard_engine, engine_version, process_engine
from brink.sim.bullet.wheels import WheeledCar
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.system import ModularDriving
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject, Verdict, nearest
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.trace import VIOLATED_AT_S
from brink.sim.urban.behaviour import DELIVERED, BehaviourMode, DetectorBehaviour, delivered_to_json
from brink.sim.urban.episode_loop import Outcome, run_loop
from brink.sim.urban.recorder import Recorder
from brink.sim.world.ego import EgoCar, MakeEgo
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import make_world

SIMULATOR_ID = "brink-drive@2"
MAX_DURATION_S = 600.0
BICYCLE, WHEELS = "bicycle", "wheels"
FIDELITIES = (BICYCLE, WHEELS)
"""Motion model of the ego: single-track, or four wheels in the physics engine (about ten times slower)."""


class BrinkDrive:
    """Runs urban episodes. One instance serves a whole process and keeps no state between episodes."""

    def __init__(self) -> None:
        self._camera = Camera()

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The episode.
            record: Whether the result includes the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine failed.
        """
        scenario, behaviour = _read(spec)
        requirements = make_requirements(spec.requirements)
        try:
            return self._run(spec, scenario, behaviour, requirements, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error

    def _run(
        self,
        spec: EpisodeSpec,
        scenario: UrbanScenario,
        behaviour: DetectorBehaviour,
        requirements: Mapping[str, Requirement],
        *,
        record: bool,
    ) -> EpisodeResult:
        cpu_s = time.process_time()
        engine = process_engine()
        engine.reset()
        world = make_world(scenario, spec.seed, _ego_maker(spec, engine))
        recorder = Recorder(world, spec.requirements) if record else None
        outcome = run_loop(
            world,
            ModularDriving(world.route, camera=self._camera),
            behaviour,
            requirements,
            engine=engine,
            camera=self._camera,
            seed=spec.seed,
            duration_s=spec.duration_s,
            recorder=recorder,
        )
        verdicts = verdicts_of(requirements)
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={
                **outcome_features(outcome),
                **_injection_features(behaviour, outcome),
                **features_of(requirements),
            },
            provenance=provenance(SIMULATOR_ID, cpu_s, simulated_s=outcome.last.time_s),
            trace=None if recorder is None else recorder.trace(trace_header(spec, verdicts)).to_bytes(),
        )


def _read(spec: EpisodeSpec) -> tuple[UrbanScenario, DetectorBehaviour]:
    """Parse the scenario and behaviour of a specification.

    Raises:
        InvalidEpisode: The specification can never run.
    """
    spec.check_for(SIMULATOR_ID, MAX_DURATION_S)
    for name, value in spec.options.items():
        if name != "fidelity":
            raise InvalidEpisode(
                f"options: unknown field {name!r}{nearest(name, ('fidelity',))}; expected fidelity"
            )
        if not isinstance(value, str) or value not in FIDELITIES:
            raise InvalidEpisode(f"options.fidelity: expected one of {', '.join(FIDELITIES)}; got {value!r}")
    scenario = UrbanScenario.from_json(spec.scenario)
    return scenario, DetectorBehaviour.from_json(spec.behaviour, spec.duration_s)


def _ego_maker(spec: EpisodeSpec, engine: Engine) -> MakeEgo:
    if spec.options.get("fidelity", BICYCLE) == WHEELS:
        return partial(WheeledCar, engine)
    return EgoCar


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


def _injection_features(behaviour: DetectorBehaviour, outcome: Outcome) -> dict[str, Json]:
    """Return when each injected trajectory was delivered; nothing if the detector reports the ground truth."""
    if behaviour.mode is BehaviourMode.ORACLE:
        return {}
    return {DELIVERED: delivered_to_json(outcome.delivered)}


def trace_header(spec: EpisodeSpec, verdicts: Mapping[str, Verdict]) -> JsonObject:
    """Return what every trace says about its episode: what it was, and when requirements were first violated."""
    moments = {name: one.violated_at_s for name, one in verdicts.items() if one.violated_at_s is not None}
    # From the canonical text, so that the trace does not depend on the order of fields.
    return {
        "spec": json.loads(spec.canonical_json()),
        "versions": dict(versions()),
        VIOLATED_AT_S: dict(sorted(moments.items())),
    }


def provenance(simulator: str, cpu_s: float, **facts: Json) -> dict[str, Json]:
    """Return the provenance of a result.

    Args:
        simulator: Id of the simulator.
        cpu_s: CPU time of this process when the episode began.
        facts: Additional entries.
    """
    return {
        "simulator": simulator,
        **versions(),
        "instruction_set": instruction_set(),
        "cpu_s": time.process_time() - cpu_s,
        **facts,
    }


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of everything that determines an episode."""
    return {
        "brink": __version__,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "pybullet": version("pybullet"),
        "pybullet_api": engine_version(),
    }


@cache
def instruction_set() -> str:
    """Return the processor architecture with a fingerprint of its floating-point arithmetic.

    Machines with the same value give the same episodes. The fingerprint is made of the low bits of functions whose
    last digits may depend on the mathematics library and the processor.
    """
    probes = [math.sin(1e5 + 0.1 * i) * math.exp(0.37 * i) * math.atan2(i, 3.3) for i in range(1, 40)]
    digits = "".join(value.hex()[-8:] for value in probes)
    total = sum(ord(char) * (index + 1) for index, char in enumerate(digits))
    return f"{platform.machine()}-{total % 2**32:08x}"
