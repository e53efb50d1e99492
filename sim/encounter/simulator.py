"""The simulator `brink-encounter@1`: runs a specification and returns the result, bit for bit reproducible.

Its driving system receives the ground truth; `brink.sim.encounter.camera` replaces it with a camera and a detector.
"""

import math
import time
from collections.abc import Mapping
from typing import ClassVar, Final

from brink.sim.bullet.engine import EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import DrivingSystem
from brink.sim.driving.system import ModularDriving
from brink.sim.encounter.specification import EncounterScenario
from brink.sim.encounter.witness import EncounterWitness
from brink.sim.encounter.world import EncounterWorld, make_encounter
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, check_fields
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.provenance import provenance, trace_header
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.episode_loop import Detects, Outcome, run_loop
from brink.sim.urban.recorder import Recorder
from brink.sim.urban.simulator import outcome_features

MAX_DURATION_S: Final = 120.0
MAX_GAP_M: Final = 200.0
"""Upper bound of reported gaps, so that they are finite when no road user is present."""


class BrinkEncounter:
    """Runs encounters. Stateless between episodes; one instance per process is enough."""

    id: ClassVar[str] = "brink-encounter@1"

    def __init__(self) -> None:
        self._camera = Camera()

    def _check(self, behaviour: Mapping[str, Json]) -> None:
        """Check that this simulator supports the behaviour.

        Raises:
            InvalidEpisode: It does not.
        """
        check_fields("behaviour", behaviour, ("mode",))
        if behaviour["mode"] != BehaviourMode.ORACLE:
            raise InvalidEpisode(
                f"behaviour.mode: expected {BehaviourMode.ORACLE}, got {behaviour['mode']!r}"
            )

    def _detects(
        self, spec: EpisodeSpec, scenario: EncounterScenario, world: EncounterWorld
    ) -> Detects | None:
        """Return the detector of an episode, or None if the driving system receives the ground truth."""
        return None

    def _driving(self, spec: EpisodeSpec, world: EncounterWorld) -> DrivingSystem:
        """Return the driving system of an episode, new."""
        return ModularDriving(world.route, camera=self._camera)

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
        spec.check_for(self.id, MAX_DURATION_S)
        if spec.options:
            raise InvalidEpisode(f"options: expected none, got {next(iter(spec.options))!r}")
        scenario = EncounterScenario.from_json(spec.scenario)
        self._check(spec.behaviour)
        requirements = make_requirements(spec.requirements)
        try:
            return self._run(spec, scenario, requirements, cpu_s, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error

    def _run(
        self,
        spec: EpisodeSpec,
        scenario: EncounterScenario,
        requirements: Mapping[str, Requirement],
        cpu_s: float,
        *,
        record: bool,
    ) -> EpisodeResult:
        engine = process_engine()
        engine.reset()
        world = make_encounter(scenario, spec.seed)
        recorder = Recorder(world, spec.requirements) if record else None
        witness = EncounterWitness(world, recorder)
        outcome = run_loop(
            world,
            self._driving(spec, world),
            DetectorBehaviour(mode=BehaviourMode.ORACLE),
            requirements,
            engine=engine,
            camera=self._camera,
            seed=spec.seed,
            duration_s=spec.duration_s,
            recorder=recorder,
            witness=witness,
            detects=self._detects(spec, scenario, world),
        )
        verdicts = verdicts_of(requirements)
        gaps = {
            f"gap_{index}_m": min(gap_m, MAX_GAP_M) for index, gap_m in enumerate(witness.gaps_m, start=1)
        }
        versions = bullet_versions()
        return EpisodeResult(
            verdicts=verdicts,
            objectives={
                **{f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
                "criticality_m": min(witness.criticality_m, MAX_GAP_M),
                **gaps,
            },
            features={**_features(outcome, requirements), "violations": list(witness.violations)},
            provenance=provenance(self.id, cpu_s, versions, simulated_s=outcome.last.time_s),
            trace=None
            if recorder is None
            else recorder.trace(trace_header(spec, verdicts, versions)).to_bytes(),
        )


def _features(outcome: Outcome, requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    hit = outcome.last.collision
    return {
        **outcome_features(outcome),
        "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
        **{name: value for name, value in features_of(requirements).items() if _finite(value)},
    }


def _finite(value: Json) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
