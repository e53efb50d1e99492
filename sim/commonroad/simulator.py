"""The simulator `commonroad@1`: drives in recorded traffic, with errors of perception on the list of objects.

It is the loop of Brink's urban simulators in another world: same car, camera, errors, requirements and traces, and as
reproducible.
"""

import time
from typing import ClassVar, Final

from brink.sim.bullet.engine import Engine, EngineError, bullet_versions, discard_engine, process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.commonroad.recording import RecordingError
from brink.sim.commonroad.roads import place_in
from brink.sim.commonroad.specification import SIMULATOR_ID, RecordedScenario
from brink.sim.commonroad.world import RecordedFacts, RecordedWorld, make_recorded_world
from brink.sim.driving.camera import Camera
from brink.sim.driving_systems.command import OPTION as DRIVING
from brink.sim.driving_systems.option import DrivingOption
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.formula_requirement import with_margins
from brink.sim.provenance import provenance, trace_header
from brink.sim.requirements import features_of, verdicts_of
from brink.sim.trace import WORDS
from brink.sim.urban.detection_errors import errors_from_json
from brink.sim.urban.episode_loop import run_loop
from brink.sim.urban.options import DriveOptions
from brink.sim.urban.recorder import Recorder
from brink.sim.urban.simulator import DetectorWithErrors, outcome_features

MAX_DURATION_S: Final = 120.0
_OPTIONS: Final = ("latency_s", DRIVING)


class CommonRoadDrive:
    """Runs drives in recorded traffic. One instance serves a whole process and keeps no state between drives."""

    id: ClassVar[str] = SIMULATOR_ID

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one drive.

        Args:
            spec: The drive.
            record: Whether the result includes the trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The physics engine failed.
        """
        spec.check_for(self.id, MAX_DURATION_S)
        try:
            return self._run(spec, process_engine(), record=record)
        except EngineError as error:
            discard_engine()
            raise SimulationCrashed(f"the physics engine failed: {error}") from error

    def _run(self, spec: EpisodeSpec, engine: Engine, *, record: bool) -> EpisodeResult:
        cpu_s = time.process_time()
        options = DriveOptions.from_json(spec.options, _OPTIONS)
        scenario = RecordedScenario.from_json(spec.scenario)
        errors = errors_from_json(spec.behaviour, spec.duration_s)
        if "on" not in spec.behaviour:
            raise InvalidEpisode("behaviour.on: expected objects, on which errors act here")
        requirements = make_requirements(spec.requirements, spec.formulas)
        engine.reset()
        world, camera = _world(scenario), Camera()
        detector = DetectorWithErrors(errors, spec)
        driving = DrivingOption.of(spec.options)
        recorder = Recorder(world, spec.requirements, camera) if record else None
        outcome = run_loop(
            world,
            driving.start(world.route, world.ego.model, camera, spec.seed),
            detector.behaviour,
            requirements,
            engine=engine,
            camera=camera,
            seed=spec.seed,
            duration_s=spec.duration_s,
            recorder=recorder,
            detects=detector.start(world, camera),
            latency_s=options.latency_s,
            facts=RecordedFacts(world, engine),
        )
        verdicts, versions = verdicts_of(requirements), bullet_versions()
        trace = None
        if recorder is not None:
            words = " and ".join(error.words for error in errors) or "no error"
            header = {**trace_header(spec, verdicts, versions), WORDS: f"{scenario.words}; {words}"}
            trace = with_margins(recorder.trace(header), requirements).to_bytes()
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={
                **outcome_features(outcome),
                **detector.features(outcome),
                **features_of(requirements),
                "taken_out": len(world.taken_out),
            },
            provenance=provenance(
                self.id, cpu_s, versions, simulated_s=outcome.last.time_s, **driving.provenance()
            ),
            trace=trace,
        )


def _world(scenario: RecordedScenario) -> RecordedWorld:
    """Return the world of a drive.

    Raises:
        InvalidEpisode: The recording is none.
    """
    try:
        place = place_in(scenario.recording)
    except RecordingError as error:
        raise InvalidEpisode(f"scenario.recording: {error}") from None
    return make_recorded_world(place, speed_share=scenario.start_speed, reacting=scenario.reacting)
