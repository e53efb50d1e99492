"""Evaluation of a safety monitor on fresh simulations, with classification metrics, compared with two baselines.

The metrics cover discrimination, accuracy, calibration and the cost of alarms. The baselines are the majority, which
predicts the overall unsafe share everywhere, and the other model, fitted to the same simulations: neighbours if the
monitor holds trees, and the reverse.

A monitor is also evaluated on pairs across the boundary: two nearly equal solutions, one safe and one unsafe.

Source: Brier 1950; Hanley and McNeil 1982 (the area under the ROC curve is the A12 of the two groups' probabilities).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from brink.search.analysis.choices import Model
from brink.search.analysis.monitor import Answer, Monitor
from brink.search.analysis.statistics import a12
from brink.search.errors import MissingExtra
from brink.search.fitness import wilson_interval
from brink.search.space import BoolArray, FloatArray

BINS: Final = 10
MONITOR, MAJORITY = "monitor", "majority"
OTHER: Final = {Model.TREES: "gradient-boosted trees", Model.NEIGHBOURS: "neighbours"}
"""Names of the models as baselines."""
MORE_LIKELY_THAN_NOT: Final = 0.5
ALARM_THRESHOLDS: Final = tuple(np.round(np.arange(0.0, 1.0001, 0.01), 2).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationBin:
    """Solutions with similar predicted probabilities.

    Attributes:
        solutions: Number of solutions.
        predicted: Mean predicted unsafe probability.
        low: Mean lower limit of the predicted intervals.
        high: Mean upper limit of the predicted intervals.
        observed: Unsafe share.
        observed_low: Lower limit of the Wilson interval of the unsafe share.
        observed_high: Upper limit of the Wilson interval of the unsafe share.
    """

    solutions: int
    predicted: float
    low: float
    high: float
    observed: float
    observed_low: float
    observed_high: float

    @property
    def within(self) -> bool:
        """Whether the unsafe share lies within the predicted interval."""
        return self.low <= self.observed <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """Error rates of an alarm that is raised if the probability is at least a threshold.

    Attributes:
        probability: The threshold.
        missed: Share of the unsafe solutions without an alarm.
        false: Share of the safe solutions with an alarm.
    """

    probability: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassificationMetrics:
    """Quality of predicted probabilities.

    Attributes:
        solutions: Number of solutions.
        unsafe: Number of unsafe solutions.
        auroc: Probability that an unsafe solution was given a higher probability than a safe one; 0.5 is guessing.
        brier: Mean squared error of the probabilities; smaller is better.
        bins: Calibration, ascending by probability, with about equally many solutions in each bin.
        calibration_error: Mean difference between predicted probability and unsafe share over the bins, each weighted
            by its number of solutions.
    """

    solutions: int
    unsafe: int
    auroc: float
    brier: float
    bins: tuple[CalibrationBin, ...]
    calibration_error: float


def classification_metrics(
    probability: FloatArray, unsafe: BoolArray, low: FloatArray | None = None, high: FloatArray | None = None
) -> ClassificationMetrics:
    """Compare predicted probabilities with verdicts.

    Args:
        probability: Predicted unsafe probability, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``; both must occur.
        low: Lower limits of the predicted intervals, shape ``(n,)``; None for the probabilities themselves.
        high: Upper limits of the predicted intervals, shape ``(n,)``; None for the probabilities themselves.

    Raises:
        ValueError: The shapes differ, or only one verdict occurs.
    """
    if probability.shape != unsafe.shape or probability.ndim != 1:
        raise ValueError(
            f"expected a verdict for each probability, got {unsafe.shape} for {probability.shape}"
        )
    if unsafe.all() or not unsafe.any():
        raise ValueError("expected both safe and unsafe solutions")
    low = probability if low is None else low
    high = probability if high is None else high
    order = np.argsort(probability, kind="stable")
    bins = tuple(
        _bin(probability[part], unsafe[part], low[part], high[part])
        for part in np.array_split(order, min(BINS, unsafe.size))
    )
    return ClassificationMetrics(
        solutions=int(unsafe.size),
        unsafe=int(unsafe.sum()),
        auroc=a12(probability[unsafe], probability[~unsafe]),
        brier=float(np.mean((probability - unsafe) ** 2)),
        bins=bins,
        calibration_error=sum(one.solutions * abs(one.predicted - one.observed) for one in bins)
        / unsafe.size,
    )


def _bin(probability: FloatArray, unsafe: BoolArray, low: FloatArray, high: FloatArray) -> CalibrationBin:
    observed_low, observed_high = wilson_interval(int(unsafe.sum()), int(unsafe.size))
    return CalibrationBin(
        solutions=int(unsafe.size),
        predicted=float(probability.mean()),
        low=float(low.mean()),
        high=float(high.mean()),
        observed=float(unsafe.mean()),
        observed_low=float(observed_low),
        observed_high=float(observed_high),
    )


def operating_points(
    probability: FloatArray, unsafe: BoolArray, at: Sequence[float] | None = None
) -> list[OperatingPoint]:
    """Return the trade-off between missed hazards and false alarms.

    Args:
        probability: Predicted unsafe probability, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``; both must occur.
        at: Thresholds, in any order; None for all predicted probabilities, descending.
    """
    thresholds = np.unique(probability)[::-1].tolist() if at is None else list(at)
    hazards, harmless = np.sort(probability[unsafe]), np.sort(probability[~unsafe])
    return [
        OperatingPoint(
            probability=threshold,
            missed=float(np.searchsorted(hazards, threshold, side="left") / hazards.size),
            false=float(1 - np.searchsorted(harmless, threshold, side="left") / harmless.size),
        )
        for threshold in thresholds
    ]


def fewest_false_alarms(points: Sequence[OperatingPoint], missed: float) -> OperatingPoint:
    """Return the point with the fewest false alarms among those that miss at most the given share of hazards.

    Raises:
        ValueError: Every point misses more.
    """
    good = [point for point in points if point.missed <= missed]
    if not good:
        raise ValueError(f"no threshold misses at most {missed:g} of the hazards")
    return min(good, key=lambda point: (point.false, -point.probability))


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictor:
    """A predictor, with its metrics and error rates.

    Attributes:
        name: Its name.
        metrics: Its classification metrics.
        operating_points: Its error rates at each alarm threshold.
    """

    name: str
    metrics: ClassificationMetrics
    operating_points: tuple[OperatingPoint, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerCount:
    """Number of solutions for which a monitor gave one of its answers, and how many of them were unsafe.

    Attributes:
        answer: The answer.
        solutions: Number of solutions with that answer.
        unsafe: Number of unsafe solutions among them.
    """

    answer: Answer
    solutions: int
    unsafe: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAccuracy:
    """How well a monitor tells the two sides of pairs apart.

    Attributes:
        pairs: Number of pairs.
        both_right: Pairs with a probability of at most one half for the safe side and above it for the unsafe side.
        ranked: Pairs whose unsafe side was given the higher probability.
        difference: Mean difference between the probabilities of the unsafe and the safe side.
    """

    pairs: int
    both_right: int
    ranked: int
    difference: float


def evaluate_pairs(monitor: Monitor, safe: FloatArray, unsafe: FloatArray) -> PairAccuracy:
    """Evaluate a monitor on pairs across the boundary.

    Args:
        monitor: The monitor.
        safe: Safe sides, shape ``(n, d)``, n >= 1.
        unsafe: Unsafe sides, in the same order, shape ``(n, d)``.

    Raises:
        SpaceError: A shape is wrong.
        ValueError: There are no pairs, or one side lacks some.
    """
    if len(safe) != len(unsafe) or not len(safe):
        raise ValueError(
            f"expected pairs of a safe and an unsafe solution, got {len(safe)} safe and {len(unsafe)} unsafe ones"
        )
    of_safe, of_unsafe = monitor.score(safe).probability, monitor.score(unsafe).probability
    right = (of_safe <= MORE_LIKELY_THAN_NOT) & (of_unsafe > MORE_LIKELY_THAN_NOT)
    return PairAccuracy(
        pairs=len(safe),
        both_right=int(right.sum()),
        ranked=int((of_unsafe > of_safe).sum()),
        difference=float(np.mean(of_unsafe - of_safe)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorEvaluation:
    """A monitor and its baselines on the same fresh simulations.

    Attributes:
        model: The monitor's model.
        learned: Number of solutions that they learned from.
        fresh: Number of solutions that they predicted.
        threshold: Threshold of the monitor's answers.
        predictors: The monitor, then its baselines.
        answers: How often the monitor gave each answer.
        unlike: Number of predicted solutions that are unlike anything simulated.
        left_out: Reasons why baselines are missing, by name.
        pairs: Accuracy on pairs across the boundary; None if none were given.
    """

    model: Model
    learned: int
    fresh: int
    threshold: float
    predictors: tuple[Predictor, ...]
    answers: tuple[AnswerCount, ...]
    unlike: int
    left_out: dict[str, str]
    pairs: PairAccuracy | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the evaluation as the JSON object of ``brink monitor judge --json``."""
        return {
            "model": str(self.model),
            "learned": self.learned,
            "fresh": self.fresh,
            "threshold": self.threshold,
            "witnesses": [
                {
                    "name": predictor.name,
                    "judgement": asdict(predictor.metrics)
                    | {"bins": [_bin_json(part) for part in predictor.metrics.bins]},
                    "alarms": [asdict(point) for point in predictor.operating_points],
                }
                for predictor in self.predictors
            ],
            "answers": [asdict(count) | {"answer": str(count.answer)} for count in self.answers],
            "unlike": self.unlike,
            "left_out": self.left_out,
            "pairs": None if self.pairs is None else asdict(self.pairs),
        }


def _bin_json(part: CalibrationBin) -> dict[str, Any]:
    # The published field names predate those of this class.
    return {{"predicted": "foretold"}.get(name, name): value for name, value in asdict(part).items()}


def evaluate_monitor(
    monitor: Monitor, vectors: FloatArray, unsafe: BoolArray, *, seed: int = 1
) -> MonitorEvaluation:
    """Evaluate a monitor and its baselines (the majority, the other model) on fresh simulations.

    Args:
        monitor: The monitor; the baselines learn from the same solutions.
        vectors: Fresh solutions, shape ``(n, d)``; those that the monitor has learned from are ignored.
        unsafe: Their verdicts, shape ``(n,)``.
        seed: Seed of the other model.

    Raises:
        ValueError: The fresh solutions do not have both verdicts.
    """
    known = {row.tobytes() for row in monitor.vectors}
    fresh = np.array([row.tobytes() not in known for row in np.asarray(vectors, np.float64)], np.bool_)
    rows, truth = np.asarray(vectors, np.float64)[fresh], unsafe[fresh]
    if truth.all() or not truth.any():
        raise ValueError(
            "expected both safe and unsafe solutions that the monitor was not fitted to, "
            f"got {int(truth.sum())} unsafe of {truth.size}"
        )
    risks = monitor.score(rows)
    answers = np.array(risks.answers(monitor.threshold))
    predictors = [
        _predictor(MONITOR, risks.probability, truth, risks.low, risks.high),
        _predictor(MAJORITY, np.full(len(rows), monitor.unsafe_share), truth),
    ]
    left_out = {}
    other = Model.NEIGHBOURS if monitor.model is Model.TREES else Model.TREES
    try:
        baseline = monitor.refitted(other, seed=seed).score(rows)
        predictors.append(_predictor(OTHER[other], baseline.probability, truth, baseline.low, baseline.high))
    except (MissingExtra, ValueError) as error:
        left_out[OTHER[other]] = str(error)
    return MonitorEvaluation(
        model=monitor.model,
        learned=len(monitor),
        fresh=len(rows),
        threshold=monitor.threshold,
        predictors=tuple(predictors),
        answers=tuple(
            AnswerCount(
                answer=answer,
                solutions=int((answers == answer).sum()),
                unsafe=int((truth & (answers == answer)).sum()),
            )
            for answer in Answer
        ),
        unlike=sum(map(bool, risks.unlike)),
        left_out=left_out,
    )


def _predictor(
    name: str,
    probability: FloatArray,
    unsafe: BoolArray,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
) -> Predictor:
    # The last threshold is above every probability and raises no alarm at all.
    thresholds = [*ALARM_THRESHOLDS, float(np.nextafter(probability.max(), np.inf))]
    return Predictor(
        name=name,
        metrics=classification_metrics(probability, unsafe, low, high),
        operating_points=tuple(operating_points(probability, unsafe, thresholds)),
    )
