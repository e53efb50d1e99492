"""Whether drives with errors fitted to a detector violate as often as drives with the detector itself.

Drives with a camera are recorded, with the comparison of each image with the truth, and the errors fitted to them.
Drives of other seeds are driven with the fitted errors, with the truth, and, unless a campaign has done so, with the
detector itself. Recorded drives are kept in a folder and not driven again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.measurement import Progress
from benchmarks.trials import mapped, run_record, stored
from brink.recordings.fit_errors import fit_errors
from brink.report.errors import Violations
from brink.search.analysis.intervals import replicated_interval
from brink.search.streams import Stream, episode_seed, generator
from brink.server.problems.urban_camera import UrbanCamera, UrbanCameraParams, UrbanScenarios
from brink.server.problems.urban_fitted import UrbanFitted, UrbanFittedParams
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.episode import EpisodeSpec
from brink.sim.urban.camera import BrinkDriveCamera, InTheLoop
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_meter import ErrorMeter, Sample
from brink.sim.urban.error_process import FittedErrors

RECORDED_SEED: Final = 77
"""Seed of the recorded drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FitMeasurement:
    """The fit, and how often each kind of drive violates."""

    fitted: FittedErrors
    violations: tuple[Violations, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorsBench:
    """The measurement.

    Attributes:
        folder: Keeps recorded drives.
        recorded: Drives with the camera to fit to.
        drives: Drives with the fitted errors, and with the truth.
        camera: Drives with the camera to compare with.
        detector: Id of the detector.
        seed: Of the drives that are compared.
        processes: Number of processes.
        progress: Progress callback.
    """

    folder: Path
    recorded: int
    drives: int
    camera: int
    detector: str
    seed: int
    processes: int
    progress: Progress

    def measure(self) -> FitMeasurement:
        """Record drives, fit the errors, simulate drives with them, and count violations."""
        camera = UrbanCamera(UrbanCameraParams(detector=self.detector))
        folder = self.folder / f"{self.detector}-{RECORDED_SEED}".replace(":", "-").replace("/", "-")
        specs = random_specs(camera, self.recorded, RECORDED_SEED)
        tasks = [(spec, folder / f"{number:05d}.json.gz") for number, spec in enumerate(specs)]
        documents = self._mapped("recorded drives", record_drive, tasks)
        fitted = fit_errors([meter_of(document) for document in documents], self.detector)
        problem = UrbanFitted(UrbanFittedParams(errors=fitted.to_document()))
        found = [self._violations(problem, self.drives, "fitted errors")]
        if self.camera:
            found.append(self._violations(camera, self.camera, "the detector"))
        true = problem.with_truth()
        assert true is not None
        found.append(self._violations(true, self.drives, "the truth"))
        return FitMeasurement(fitted=fitted, violations=tuple(found))

    def _violations(self, problem: UrbanScenarios, drives: int, name: str) -> Violations:
        specs = random_specs(problem, drives, self.seed)
        tasks = [(spec, problem.requirements) for spec in specs]
        unsafe = np.array(self._mapped(f"drives with {name}", is_unsafe, tasks))
        number = [int(str(spec.behaviour.get("replicate", 0))) for spec in specs]
        of = np.bincount(number)
        low, high = replicated_interval(np.bincount(number, unsafe).round().astype(np.int64), of)
        return Violations(
            campaign="",
            name=name,
            problem=problem.id,
            unsafe=int(unsafe.sum()),
            drives=drives,
            replicates=int((of > 0).sum()),
            low=low,
            high=high,
        )

    def _mapped(self, part: str, run: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        return mapped(run, tasks, processes=self.processes, part=part, progress=self.progress)


def random_specs(problem: UrbanScenarios, count: int, seed: int) -> list[EpisodeSpec]:
    """Return episodes of random scenarios."""
    rng = generator(seed, Stream.START, 0)
    return [problem.episode(problem.space.sample(rng), episode_seed(seed, number)) for number in range(count)]


def is_unsafe(task: tuple[EpisodeSpec, Sequence[str]]) -> bool:
    """Drive an episode and return whether it violates one of some requirements."""
    robustness = run_record(task[0]).robustness
    return any(robustness[name] < 0 for name in task[1])


class _Recorded(BrinkDriveCamera):
    """Drives with a camera, and keeps the measurements."""

    def _detector(self, spec: EpisodeSpec) -> InTheLoop:
        self.eyes = InTheLoop(spec)
        return self.eyes


def record_drive(task: tuple[EpisodeSpec, Path]) -> dict[str, Any]:
    """Drive an episode with a camera, unless its file exists; return the measurements."""

    def driven() -> dict[str, Any]:
        simulator = _Recorded()
        simulator.run(task[0])
        meter = simulator.eyes.meter
        assert meter is not None
        return {
            "samples": [list(sample) for sample in meter.samples],
            "ghosts": [[time_s, sorted(labels)] for time_s, labels in meter.ghosts],
        }

    document: dict[str, Any] = stored(task[1], driven)
    return document


def meter_of(document: Mapping[str, Any]) -> ErrorMeter:
    """Return the error meter of a recorded drive."""
    meter = ErrorMeter(Camera())
    for time_s, track, kind, is_target, is_visible, label, *rest in document["samples"]:
        meter.samples.append(
            Sample(time_s, track, Target(kind), is_target, is_visible, ObstacleLabel(label), *rest)
        )
    meter.ghosts = [(time_s, frozenset(map(ObstacleLabel, labels))) for time_s, labels in document["ghosts"]]
    return meter
