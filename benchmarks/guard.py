"""How early guards warn on fresh drives of the urban problem: training sets, sensors, and unseen kinds of drives.

Every guard is fitted to the same number of drives: random ones, those of a campaign of MLCSHE, those of a campaign of
edge (with the pairs that it confirms), or a third of each. All are judged on the same fresh random drives, beside the
baselines. *Unseen roads* and *unseen behaviours* are judged apart: guards are fitted without a third of the roads, or
without drives in which persons are reported, and judged on the fresh drives with them, beside a guard that was fitted
to the same number of drives of every kind, with the same number of violations.

Recorded drives are kept in chunks, so that an interrupted measurement goes on where it stopped. A chunk is used only
if its digests are those of the episodes that are wanted: a search that has changed asks for other ones, and they run.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, at_most, silent, untargeted
from benchmarks.trials import code_fingerprint
from brink.guard.choices import FALSE_ALARMS, Sensor
from brink.guard.drives import Drive, Recorders, load_drives, random_specs, save_drives
from brink.guard.evaluation import LEAD_S, GuardEvaluation, evaluate
from brink.guard.fitting import fit
from brink.guard.model import GuardModel
from brink.guard.monitor import ModelGuard
from brink.search.algorithm import Scored, ask_all
from brink.search.streams import episode_seed
from brink.server.problems.catalogue import make_algorithm, make_params
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.episode import EpisodeSpec

CODE: Final = ("sim",)
"""Code that determines the outcome of an episode; the episodes themselves are compared by digest."""
FRESH_SEED: Final = 2_001
SEARCHES: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "MLCSHE": ("mlcshe@1", {"radius": 0.3, "p_th": 0.1}),
    "edge": ("edge@1", {"radius": 0.3, "p_th": 0.1, "eps": 0.02, "d_th": 0.2}),
}
RANDOM, MIXTURE = "random", "mixture"
SETS: Final = (RANDOM, *SEARCHES, MIXTURE)
CHUNK: Final = 100
RECALL_TARGET: Final = 0.6
STEP_TARGET_MS: Final = 1.0
TIMED_DRIVES: Final = 3

UNSEEN_ROAD: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A guard of one training set, judged on fresh drives.

    Attributes:
        trained_on: The training set.
        sensor: The sensors of the car.
        judged_on: Which of the fresh drives.
        drives: Number of training drives.
        violations: Number of training drives with a violation.
        evaluation: The evaluation.
        fit_s: CPU time of fitting.
    """

    trained_on: str
    sensor: Sensor
    judged_on: str
    drives: int
    violations: int
    evaluation: GuardEvaluation
    fit_s: float

    def to_json(self) -> dict[str, Any]:
        """Return this as a JSON object."""
        return {
            "trained_on": self.trained_on,
            "sensor": str(self.sensor),
            "judged_on": self.judged_on,
            "drives": self.drives,
            "violations": self.violations,
            "fit_s": self.fit_s,
            "evaluation": self.evaluation.to_json(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """The whole measurement.

    Attributes:
        judged: Every guard on all fresh drives.
        unseen: Guards on drives of a kind that they never saw, and guards that saw it, on the same drives, fitted to
            equally many drives.
        step_ms: Mean CPU time of a perception step of the guards of `RANDOM`, by sensor.
        bytes_per_drive: Mean size of the stored features and verdicts of a fresh drive.
    """

    judged: tuple[Judged, ...]
    unseen: tuple[Judged, ...]
    step_ms: Mapping[Sensor, float]
    bytes_per_drive: float

    def rows(self) -> Iterator[Row]:
        """Yield the figures with targets."""
        for one in self.judged:
            compared, note = one.evaluation.guard.compared, _note(one.evaluation)
            what = f"predicted {LEAD_S:g} s ahead: {one.trained_on}, {one.sensor}"
            yield at_least(what, compared.recall, RECALL_TARGET if one.trained_on == RANDOM else None, note)
            own = one.evaluation.own.point
            note = f"threshold {own.threshold:.3f}, set in fitting; alarms in {own.false_alarms:.1%} of safe drives"
            yield untargeted("  with its own threshold", own.recall, note)
        for sensor, step_ms in self.step_ms.items():
            note = "CPU time of features and model"
            yield at_most(f"ms a step: {sensor}", step_ms, STEP_TARGET_MS, note)

    def to_json(self) -> dict[str, Any]:
        """Return this as a JSON object."""
        return {
            "judged": [one.to_json() for one in self.judged],
            "unseen": [one.to_json() for one in self.unseen],
            "step_ms": {str(sensor): step_ms for sensor, step_ms in self.step_ms.items()},
            "bytes_per_drive": self.bytes_per_drive,
            "rows": [asdict(row) for row in self.rows()],
        }


def _note(evaluation: GuardEvaluation) -> str:
    low, high = evaluation.guard.interval
    return (
        f"{low:.2f} to {high:.2f}; alarms in {evaluation.guard.compared.false_alarms:.1%} of safe drives "
        f"(thresholds chosen on other drives for {FALSE_ALARMS:.0%}); "
        f"{evaluation.violations:,} violations in {evaluation.drives:,} drives"
    )


class GuardBench:
    """Records the drives, fits the guards and judges them.

    Args:
        folder: Where recorded drives are kept, so that no drive is simulated twice by the same code.
        training: Drives of each training set.
        fresh: Fresh drives.
        seed: Seed of the training sets.
        requirement: Id of the requirement.
        sets: Training sets.
        processes: Number of processes that simulate.
        progress: Progress callback.
    """

    def __init__(
        self,
        folder: Path,
        *,
        training: int,
        fresh: int,
        seed: int = 1,
        requirement: str = "front-gap@1",
        sets: Sequence[str] = SETS,
        processes: int = 2,
        progress: Progress = silent,
    ) -> None:
        self._problem = UrbanInjected(UrbanInjectedParams(requirement=requirement))
        self._folder = folder / f"drives-{code_fingerprint(CODE)}"
        self._training, self._fresh, self._seed = training, fresh, seed
        self._sets, self._processes, self._progress = tuple(sets), processes, progress

    def measure(self) -> Measured:
        """Return how early the guards warn, beside the baselines."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with Recorders(self._processes) as recorders:
            fresh = self._random(recorders, FRESH_SEED, self._fresh)
            training = self._training_sets(recorders)
        judged: list[Judged] = []
        unseen: list[Judged] = []
        step_ms: dict[Sensor, float] = {}
        tasks = [(name, sensor) for name in training for sensor in Sensor]
        for done, (name, sensor) in enumerate(tasks):
            self._progress("fitting and judging", done, len(tasks))
            model, fit_s = self._fitted(training[name], sensor)
            judged.append(_judged(model, name, "all", fresh, fit_s))
            if name == RANDOM:
                unseen += self._unseen(training[name], fresh, sensor)
                step_ms[sensor] = self._step_ms(model)
        self._progress("fitting and judging", len(tasks), len(tasks))
        return Measured(
            judged=tuple(judged),
            unseen=tuple(unseen),
            step_ms=step_ms,
            bytes_per_drive=self._bytes_per_drive(),
        )

    def _training_sets(self, recorders: Recorders) -> dict[str, list[Drive]]:
        """Return the drives of each training set."""
        wanted = {RANDOM, *SEARCHES} if MIXTURE in self._sets else {*self._sets}
        found: dict[str, list[Drive]] = {}
        for name in SETS:
            if name in wanted and name == RANDOM:
                found[name] = self._random(recorders, self._seed, self._training)
            elif name in wanted and name in SEARCHES:
                found[name] = self._searched(recorders, name)
        if MIXTURE in self._sets:
            rng = np.random.default_rng(self._seed)
            share = self._training // len(found)
            found[MIXTURE] = [
                drives[place]
                for drives in list(found.values())
                for place in np.sort(rng.permutation(len(drives))[:share]).tolist()
            ]
        return {name: drives for name, drives in found.items() if name in self._sets}

    def _random(self, recorders: Recorders, seed: int, count: int) -> list[Drive]:
        """Return random drives."""
        specs = random_specs(self._problem, count, seed)
        return self._kept(recorders, f"random-{seed}", specs, f"random drives, seed {seed}", 0, count)

    def _searched(self, recorders: Recorders, name: str) -> list[Drive]:
        """Return the drives of a search, which is run in this process."""
        algorithm_id, params = SEARCHES[name]
        algorithm = make_algorithm(algorithm_id)
        config = make_params(algorithm.config_type, params, "/algorithm/params")
        state = algorithm.start(self._problem.space, config, seed=self._seed, budget=self._training)
        drives: list[Drive] = []
        stem = f"{name.lower()}-{self._seed}-{self._training}-{self._problem.requirements[0]}"
        while not algorithm.finished(state):
            state, _ = ask_all(algorithm, state)
            pending = state.pending
            specs = [
                self._problem.episode(
                    one.vectors,
                    episode_seed(self._seed, one.number if one.seed_number is None else one.seed_number),
                )
                for one in pending
            ]
            found = self._kept(recorders, stem, specs, f"drives of {name}", len(drives), self._training)
            state = algorithm.tell(
                state, {one.number: self._scored(drive) for one, drive in zip(pending, found, strict=True)}
            )
            drives += found
        return drives[: self._training]  # a search may exceed its budget to complete a generation

    def _kept(
        self,
        recorders: Recorders,
        stem: str,
        specs: Sequence[EpisodeSpec],
        part: str,
        before: int,
        total: int,
    ) -> list[Drive]:
        """Return the drives of some episodes, in chunks that are kept.

        Args:
            recorders: Record what is not kept.
            stem: Beginning of the names of the files.
            specs: The episodes.
            part: Name of the part, for progress.
            before: Number of drives of the part that are complete.
            total: Total number of drives of the part.
        """
        drives: list[Drive] = []
        for first in range(0, len(specs), CHUNK):
            chunk = specs[first : first + CHUNK]
            done = before + first
            file = self._folder / f"{stem}-{done}-{len(chunk)}.npz"
            found = load_drives(file)
            if found is None or [one.digest for one in found] != [spec.digest() for spec in chunk]:
                found = recorders.record(chunk)
                save_drives(file, found)
            drives += found
            self._progress(part, before + len(drives), total)
        return drives

    def _scored(self, drive: Drive) -> Scored:
        robustness = min(drive.robustness[name] for name in self._problem.requirements)
        return Scored(
            unsafe=robustness < 0,
            robustness=robustness,
            objectives={f"{name}:robustness": value for name, value in drive.robustness.items()},
        )

    def _fitted(self, drives: Sequence[Drive], sensor: Sensor) -> tuple[GuardModel, float]:
        began_s = time.process_time()
        model = fit(drives, self._problem.requirements, sensor=sensor, seed=self._seed)
        return model, time.process_time() - began_s

    def _unseen(self, training: Sequence[Drive], fresh: Sequence[Drive], sensor: Sensor) -> Iterator[Judged]:
        """Yield guards that never saw a kind of drives, and guards that did, on the fresh drives of that kind.

        Both are fitted to the same number of drives, so that the difference is not one of the amount of data.
        """
        for what, is_unseen in (
            ("unseen roads", _on_unseen_road),
            ("unseen behaviours", _is_to_report_persons),
        ):
            seen = [drive for drive in training if not is_unseen(drive)]
            rest = [drive for drive in fresh if is_unseen(drive)]
            for name, drives in ((f"{RANDOM} without them", seen), (RANDOM, self._as_many(training, seen))):
                model, fit_s = self._fitted(drives, sensor)
                yield _judged(model, name, what, rest, fit_s)

    def _as_many(self, drives: Sequence[Drive], wanted: Sequence[Drive]) -> list[Drive]:
        """Return some of the drives, matching the numbers of violations and safe drives of the wanted ones."""
        rng = np.random.default_rng(self._seed)
        chosen: list[int] = []
        for violated in (False, True):
            places = [i for i, one in enumerate(drives) if self._violates(one) is violated]
            chosen += rng.permutation(places)[
                : sum(self._violates(one) is violated for one in wanted)
            ].tolist()
        return [drives[place] for place in sorted(chosen)]

    def _violates(self, drive: Drive) -> bool:
        return drive.first_violation_s(self._problem.requirements) is not None

    def _step_ms(self, model: GuardModel) -> float:
        """Return the mean CPU time of a perception step of a guard, without the range sensor's own computation."""
        from brink.guard.recorder import observe_drive  # loads the physics engine

        spent_s, steps = 0.0, 0
        for spec in random_specs(self._problem, TIMED_DRIVES, FRESH_SEED):
            observed = observe_drive(spec)
            guard = ModelGuard(model, observed.route, observed.conditions)
            moments = [one for one in observed.moments if one.observation.boxes is not None]
            began_s = time.process_time()
            for moment in moments:
                guard.step(*moment)
            spent_s += time.process_time() - began_s
            steps += len(moments)
        return 1e3 * spent_s / steps

    def _bytes_per_drive(self) -> float:
        sizes = [file.stat().st_size for file in self._folder.glob(f"random-{FRESH_SEED}-*.npz")]
        return sum(sizes) / self._fresh


def _judged(
    model: GuardModel, trained_on: str, judged_on: str, fresh: Sequence[Drive], fit_s: float
) -> Judged:
    return Judged(
        trained_on=trained_on,
        sensor=model.sensor,
        judged_on=judged_on,
        drives=model.about["drives"],
        violations=model.about["violations"],
        evaluation=evaluate(model, fresh),
        fit_s=fit_s,
    )


def _on_unseen_road(drive: Drive) -> bool:
    return bool(json.loads(drive.scenario)["road_id"] == UNSEEN_ROAD)


def _is_to_report_persons(drive: Drive) -> bool:
    """Return whether the behaviour reports a person, even if the drive ends before that."""
    return any(one["label"] == "person" for one in json.loads(drive.behaviour)["trajectories"])


def baseline_rows(evaluation: GuardEvaluation) -> Iterator[tuple[str, ...]]:
    """Yield a row for each baseline: its name, predicted violations and false alarms at the compared threshold.

    The last two cells are the violations predicted with alarms in 10% and 20% of the safe drives.
    """
    for one in evaluation.predictors[1:]:
        more = (f"{point.recall:.2f}" for point in one.more)
        yield (one.name, f"{one.shown.recall:.2f}", f"{one.shown.false_alarms:.1%}", *more)
