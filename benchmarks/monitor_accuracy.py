"""Accuracy of safety monitors on random drives of the urban problem: both models, several training sets.

Each monitor is fitted to random drives with one seed. All are judged on the same fresh random drives, unseen by any
monitor, which took no part in the choice of settings. The drives are independent draws from the problem's space,
each with its own episode seed.
"""

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, at_most, silent
from benchmarks.trials import Records, code_fingerprint
from brink.search.analysis.choices import Model
from brink.search.analysis.monitor import Answer, Monitor
from brink.search.analysis.monitor_evaluation import (
    ClassificationMetrics,
    MonitorEvaluation,
    classification_metrics,
    evaluate_monitor,
)
from brink.search.space import BoolArray, FloatArray
from brink.search.streams import Stream, episode_seed, generator
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams

CODE: Final = ("sim",)
"""Code that determines the verdict on a drive."""
FRESH_SEED: Final = 1_001
P_TH: Final = 0.1
QUERIES: Final = 200
"""Number of queries whose time is measured."""
AUROC_TARGET, BRIER_TARGET, CALIBRATION_TARGET = 0.89, 0.115, 0.05
"""Targets for the means over the training sets of trees."""
QUERY_TARGET_MS: Final = 1.0
"""Target for a query to neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drives:
    """Random drives with their verdicts.

    Attributes:
        vectors: Complete solutions, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
    """

    vectors: FloatArray
    unsafe: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """A monitor fitted to one training set and judged on the fresh drives.

    Attributes:
        model: Its model.
        seed: Seed of the training drives.
        metrics: Its classification metrics.
        answers: Number of solutions with each answer, and the unsafe ones among them.
        unlike: Number of fresh drives that are unlike anything simulated.
        agreement: Share of the fresh drives where the interval contains the mean probability given by the monitors
            of the same model that were fitted to the other training sets; None with a single training set.
        fit_s: CPU time of fitting.
        query_ms: Mean CPU time of a query for one solution.
    """

    model: Model
    seed: int
    metrics: ClassificationMetrics
    answers: dict[Answer, tuple[int, int]]
    unlike: int
    agreement: float | None
    fit_s: float
    query_ms: float


class MonitorAccuracy:
    """Simulates the drives and judges the monitors.

    Args:
        folder: Where verdicts are kept, so that no drive is simulated twice by the same code.
        drives: Training drives for each monitor.
        fresh: Fresh drives.
        seeds: Seeds of the training sets.
        requirement: Id of the requirement that gives the verdict.
        processes: Number of processes.
        progress: Progress callback.
    """

    def __init__(
        self,
        folder: Path,
        *,
        drives: int,
        fresh: int,
        seeds: Sequence[int],
        requirement: str = "front-gap@1",
        processes: int = 2,
        progress: Progress = silent,
    ) -> None:
        self._problem = UrbanInjected(UrbanInjectedParams(requirement=requirement))
        self._file = folder / f"drives-{code_fingerprint(CODE)}.jsonl"
        self._drives, self._fresh, self._seeds = drives, fresh, tuple(seeds)
        self._processes, self._progress = processes, progress

    def measure(self) -> tuple[list[Accuracy], MonitorEvaluation]:
        """Return the accuracy of each model on each training set, and the evaluation of trees on the first set."""
        with contextlib.closing(Records(self._file, processes=self._processes)) as records:
            fresh = self._simulated(records, FRESH_SEED, self._fresh)
            training = {seed: self._simulated(records, seed, self._drives) for seed in self._seeds}
        found, fitted = [], dict[Model, list[Monitor]]()
        for model in Model:
            fitted[model], fit_s = [], []
            for done, (seed, drives) in enumerate(training.items(), start=1):
                start_s = time.process_time()
                fitted[model].append(
                    Monitor.fitted(
                        self._problem.space,
                        drives.vectors,
                        drives.unsafe,
                        threshold=P_TH,
                        seed=seed,
                        model=model,
                    )
                )
                fit_s.append(time.process_time() - start_s)
                self._progress(f"fitting {model}", done, len(training))
            found += _judged(fitted[model], self._seeds, fit_s, fresh)
        return found, evaluate_monitor(fitted[Model.TREES][0], fresh.vectors, fresh.unsafe)

    def _simulated(self, records: Records, seed: int, count: int) -> Drives:
        space = self._problem.space
        rows = np.array([space.join(space.sample(generator(seed, Stream.START, i))) for i in range(count)])
        specs = [self._problem.episode(space.split(row), episode_seed(seed, i)) for i, row in enumerate(rows)]
        outcomes = records.run(specs, f"drives with seed {seed}", self._progress)
        (requirement,) = self._problem.requirements
        robustness = np.array([one.robustness[requirement] for one in outcomes])
        return Drives(vectors=rows, unsafe=robustness < 0)


def _judged(
    monitors: Sequence[Monitor], seeds: Sequence[int], fit_s: Sequence[float], fresh: Drives
) -> list[Accuracy]:
    """Return the accuracy of monitors with the same model, fitted to different training sets."""
    risks = [monitor.score(fresh.vectors) for monitor in monitors]
    probabilities = np.array([one.probability for one in risks])
    found = []
    for place, (monitor, seed, risk) in enumerate(zip(monitors, seeds, risks, strict=True)):
        agreement = None
        if len(monitors) > 1:
            others = np.delete(probabilities, place, axis=0).mean(axis=0)
            agreement = float(np.mean((risk.low <= others) & (others <= risk.high)))
        answers = np.array(risk.answers(monitor.threshold))
        found.append(
            Accuracy(
                model=monitor.model,
                seed=seed,
                agreement=agreement,
                unlike=sum(map(bool, risk.unlike)),
                fit_s=fit_s[place],
                query_ms=_query_ms(monitor, fresh.vectors[:QUERIES]),
                metrics=classification_metrics(risk.probability, fresh.unsafe, risk.low, risk.high),
                answers={
                    answer: (int((answers == answer).sum()), int((fresh.unsafe & (answers == answer)).sum()))
                    for answer in Answer
                },
            )
        )
    return found


def _query_ms(monitor: Monitor, rows: FloatArray) -> float:
    queries = [monitor.space.decode(monitor.space.split(row)) for row in rows]
    start_s = time.process_time()
    for query in queries:
        monitor.ask(query)
    return 1e3 * (time.process_time() - start_s) / len(queries)


def mean_rows(found: Sequence[Accuracy]) -> list[Row]:
    """Return the means over the training sets, with their targets."""
    rows = []
    for model in Model:
        of_model = [one for one in found if one.model is model]
        metrics = [one.metrics for one in of_model]
        note = f"mean of {len(of_model)} training sets"
        figures = (
            ("AUROC", [one.auroc for one in metrics], at_least, Model.TREES, AUROC_TARGET),
            ("Brier score", [one.brier for one in metrics], at_most, Model.TREES, BRIER_TARGET),
            (
                "calibration error",
                [one.calibration_error for one in metrics],
                at_most,
                Model.TREES,
                CALIBRATION_TARGET,
            ),
            ("ms a query", [one.query_ms for one in of_model], at_most, Model.NEIGHBOURS, QUERY_TARGET_MS),
        )
        for what, values, bound, judged, target in figures:
            mean = float(np.mean(values))
            rows.append(bound(f"{model}: {what}", mean, target if model is judged else None, note))
    return rows
