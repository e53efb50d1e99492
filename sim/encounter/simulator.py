"""The simulator `brink-encounter@2`: runs a specification and returns the result, bit for bit reproducible.

Its driving system receives the ground truth; `brink.sim.encounter.camera` replaces it with a camera and a detector.
With the option `reference`, an episode that violates a requirement is followed by drives of the reference drivers
(`brink.sim.encounter.reference`) among the same scripted road users, and each violation says who would have avoided
it.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

from brink.sim.bullet.engine import EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, Driving
from brink.sim.driving_systems.command import OPTION as DRIVING
from brink.sim.driving_systems.option import DrivingOption
from brink.sim.encounter.reference import AFTERWARDS_S, NOBODY, Driver, ReferenceDriving, avoidance, avoids
from brink.sim.encounter.specification import REFERENCE, EncounterScenario
from brink.sim.encounter.witness import EncounterWitness
from brink.sim.encounter.world import EncounterWorld, make_encounter
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject, check_fields, parse_choice
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.provenance import provenance, trace_header
from brink.sim.requirements import Requirement, features_of, verdicts_of
from brink.sim.trace import AVOIDABLE, Trace
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.episode_loop import Detects, Outcome, run_loop
from brink.sim.urban.options import CAMERA_OPTIONS, DriveOptions
from brink.sim.urban.recorder import Recorder
from brink.sim.urban.simulator import car_of, outcome_features
from brink.sim.world.ego import EGO_CAR, PROMPT_CAR

MAX_DURATION_S: Final = 120.0
AVOIDED_BY: Final = "avoided_by"
"""Fact about a violation that a reference driver avoids: how, as `Avoidance`."""
MAX_GAP_M: Final = 200.0
"""Upper bound of reported gaps, so that they are finite when no road user is present."""
_OPTIONS: Final = (REFERENCE, *CAMERA_OPTIONS, DRIVING)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drive:
    """One drive of the system or of a reference driver.

    Attributes:
        result: Its result, without the trace.
        violations: Circumstances of its violations.
        contact_at_s: When another road user first touched the ego, even a standing one; None if none did.
        brakes_at_s: When the driver first braked for a road user or a light; None if never.
        trace: Its trace, if it was recorded.
    """

    result: EpisodeResult
    violations: Sequence[JsonObject]
    contact_at_s: float | None
    brakes_at_s: float | None
    trace: Trace | None

    @property
    def facts(self) -> JsonObject:
        """When each requirement was first violated, a road user touched the ego, and the driver first braked."""
        violated: JsonObject = {
            name: one.violated_at_s for name, one in self.result.verdicts.items() if one.violated
        }
        return {"violated_at_s": violated, "contact_at_s": self.contact_at_s, "brakes_at_s": self.brakes_at_s}


class BrinkEncounter:
    """Runs encounters. Stateless between episodes; one instance per process is enough."""

    id: ClassVar[str] = "brink-encounter@2"

    def _check(self, behaviour: Mapping[str, Json]) -> None:
        """Check that this simulator supports the behaviour.

        Raises:
            InvalidEpisode: It does not.
        """
        if behaviour.get("mode") == REFERENCE:
            check_fields("behaviour", behaviour, ("mode", "driver"))
            parse_choice("behaviour.driver", behaviour["driver"], Driver)
            return
        check_fields("behaviour", behaviour, ("mode",))
        if behaviour["mode"] != BehaviourMode.ORACLE:
            raise InvalidEpisode(
                f"behaviour.mode: expected {BehaviourMode.ORACLE} or {REFERENCE}, got {behaviour['mode']!r}"
            )

    def _detects(
        self, spec: EpisodeSpec, scenario: EncounterScenario, world: EncounterWorld, camera: Camera
    ) -> Detects | None:
        """Return the detector of an episode, or None if the driving system receives the ground truth."""
        return None

    def _boxes(
        self,
        spec: EpisodeSpec,
        scenario: EncounterScenario,
        world: EncounterWorld,
        camera: Camera,
        *,
        record: bool,
    ) -> Detects | None:
        """Return the detector of a drive. Reference drivers need none, and replays show the ground truth."""
        if spec.behaviour["mode"] != REFERENCE:
            return self._detects(spec, scenario, world, camera)
        return None if record else _nothing

    def _driving(self, spec: EpisodeSpec, world: EncounterWorld, camera: Camera) -> Driving:
        """Return the driving system of an episode, new."""
        if spec.behaviour["mode"] == REFERENCE:
            return ReferenceDriving(world, Driver(str(spec.behaviour["driver"])))
        return DrivingOption.of(spec.options).start(world.route, world.ego.model, camera, spec.seed)

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
        compares = _compares(spec.options)
        scenario = EncounterScenario.from_json(spec.scenario)
        self._check(spec.behaviour)
        make_requirements(spec.requirements)
        try:
            drive = self._drive(spec, scenario, record=record)
            if not (compares and drive.violations):
                trace = None if drive.trace is None else drive.trace.to_bytes()
                return replace(drive.result, trace=trace)
            return self._compared(spec, scenario, drive, record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error

    def _drive(self, spec: EpisodeSpec, scenario: EncounterScenario, *, record: bool) -> _Drive:
        """Run one drive.

        Args:
            spec: What is driven, by the system or by a reference driver.
            scenario: Its scenario.
            record: Whether to record the trace.
        """
        cpu_s = time.process_time()
        options = DriveOptions.from_json(spec.options, _OPTIONS)
        requirements = make_requirements(spec.requirements)
        engine = process_engine()
        engine.reset()
        camera = Camera(least_visible=options.least_visible)
        car = car_of(options, PROMPT_CAR if spec.behaviour["mode"] == REFERENCE else EGO_CAR)
        world = make_encounter(scenario, spec.seed, car)
        recorder = Recorder(world, spec.requirements, camera) if record else None
        witness = EncounterWitness(world, recorder)
        outcome = run_loop(
            world,
            self._driving(spec, world, camera),
            DetectorBehaviour(mode=BehaviourMode.ORACLE),
            requirements,
            engine=engine,
            camera=camera,
            seed=spec.seed,
            duration_s=spec.duration_s,
            recorder=recorder,
            witness=witness,
            detects=self._boxes(spec, scenario, world, camera, record=record),
            latency_s=options.latency_s,
        )
        verdicts = verdicts_of(requirements)
        gaps = {
            f"gap_{index}_m": min(gap_m, MAX_GAP_M) for index, gap_m in enumerate(witness.gaps_m, start=1)
        }
        versions = bullet_versions()
        result = EpisodeResult(
            verdicts=verdicts,
            objectives={
                **{f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
                "criticality_m": min(witness.criticality_m, MAX_GAP_M),
                "moving_criticality_m": min(witness.moving_gap_m, MAX_GAP_M),
                **gaps,
            },
            features={
                **_features(outcome, requirements),
                "violations": list(witness.violations),
                "closest": witness.closest,
                "closest_moving": witness.closest_moving,
            },
            provenance=provenance(
                self.id,
                cpu_s,
                versions,
                simulated_s=outcome.last.time_s,
                **DrivingOption.of(spec.options).provenance(),
            ),
        )
        trace = None if recorder is None else recorder.trace(trace_header(spec, verdicts, versions))
        return _Drive(
            result=result,
            violations=witness.violations,
            contact_at_s=witness.contact_at_s,
            brakes_at_s=witness.brakes_at_s,
            trace=trace,
        )

    def _compared(
        self, spec: EpisodeSpec, scenario: EncounterScenario, drive: _Drive, *, record: bool
    ) -> EpisodeResult:
        """Repeat the drive with the reference drivers, and record in each violation who avoids it and how.

        The trace includes the drive of the first driver who avoids any of them, or else that of the careful one.

        Args:
            spec: The specification.
            scenario: Its scenario.
            drive: The system's drive, with violations.
            record: Whether to record traces.
        """
        began_s = time.process_time()
        moments = {str(one["requirement"]): float(str(one["time_s"])) for one in drive.violations}
        avoided_by: dict[str, Driver] = {}
        drives: dict[Driver, _Drive] = {}
        for driver in Driver:
            its = _with_driver(spec, driver, max(moments.values()) + AFTERWARDS_S)
            drives[driver] = its_drive = self._drive(its, scenario, record=record)
            verdicts, contact_at_s = its_drive.result.verdicts, its_drive.contact_at_s
            for name, moment_s in moments.items():
                if name not in avoided_by and avoids(name, moment_s, verdicts, contact_at_s):
                    avoided_by[name] = driver
            if len(avoided_by) == len(moments):
                break
        shown = min(avoided_by.values(), key=list(Driver).index, default=Driver.CAREFUL)
        reference: dict[str, Json] = {driver.value: one.facts for driver, one in drives.items()}
        avoidable: dict[str, Json] = {name: str(avoided_by.get(name, NOBODY)) for name in moments}
        violations: list[Json] = []
        for one in drive.violations:
            name = str(one["requirement"])
            told: JsonObject = {**one, AVOIDABLE: avoidable[name]}
            if name in avoided_by:
                told[AVOIDED_BY] = avoidance(moments[name], drives[avoided_by[name]].brakes_at_s).value
            violations.append(told)
        result = drive.result
        trace = drive.trace
        if trace is not None:
            about = {**trace.about, AVOIDABLE: avoidable}
            trace = replace(trace, reference=drives[shown].trace, about=about)
        return replace(
            result,
            features={**result.features, "violations": violations, "reference": reference},
            provenance={**result.provenance, "reference_cpu_s": time.process_time() - began_s},
            trace=None if trace is None else trace.to_bytes(),
        )


def _compares(options: Mapping[str, Json]) -> bool:
    """Return whether violations are compared with reference drivers.

    Raises:
        InvalidEpisode: The option has a wrong value.
    """
    compares = options.get(REFERENCE, False)
    if not isinstance(compares, bool):
        raise InvalidEpisode(f"options.{REFERENCE}: expected true or false, got {compares!r:.80}")
    return compares


def _with_driver(spec: EpisodeSpec, driver: Driver, duration_s: float) -> EpisodeSpec:
    """Return a specification with a reference driver in the system's place.

    Args:
        spec: The system's episode.
        driver: The driver.
        duration_s: How long the driver drives, unless the system's episode would be shorter.
    """
    return replace(
        spec,
        simulator=BrinkEncounter.id,
        behaviour={"mode": REFERENCE, "driver": driver.value},
        duration_s=min(spec.duration_s, duration_s),
        options={name: value for name, value in spec.options.items() if name not in (REFERENCE, DRIVING)},
    )


def _nothing(time_s: float) -> tuple[Box, ...]:
    """Detect nothing: reference drivers need no boxes."""
    return ()


def _features(outcome: Outcome, requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    hit = outcome.last.collision
    return {
        **outcome_features(outcome),
        "impact_speed_mps": None if hit is None else hit.impact_speed_mps,
        **{name: value for name, value in features_of(requirements).items() if _finite(value)},
    }


def _finite(value: Json) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
