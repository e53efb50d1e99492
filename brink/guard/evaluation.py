"""Evaluation of a guard on recorded drives: predicted violations against false alarms, beside baselines.

The unit is the drive. A *false alarm* is an alarm at any time in a drive without a violation. A violation is
*predicted* with a lead if the first alarm of its drive came at least that long before it. Violations that happen
sooner after the start than the lead cannot be predicted, and count as missed.

Predictors are compared with alarms in a fixed share of the safe drives. The threshold with which a drive is judged is
chosen on the others, none of which shares its scenario or its behaviour: it is the lowest with which at most that
share of those that are safe has an alarm. The guard's own threshold was set in fitting, and what its alarms do is
reported beside it.

Intervals of shares are those of `brink.search.analysis.intervals`, in which drives that share a scenario or a
behaviour depend on each other. That of a recall at a fixed share of false alarms includes how uncertain the threshold
for that share is.

The baselines are the time to collision on reported boxes (`ttc@1`), the same on the range sensor if the car has one
(`range-ttc@1`), an alarm in every drive from its start, and none at all. They compute what those guards compute in
the car. All predictors confirm an alarm over as many steps as the guard does: a single noisy step does not count.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.guard.choices import FALSE_ALARMS, Sensor
from brink.guard.drives import Drive
from brink.guard.model import GuardModel, feature_names
from brink.guard.monitor import Alarm
from brink.guard.time_to_collision import box_times_s, range_times_s
from brink.search.analysis.folds import Division, divisions
from brink.search.analysis.guard_training import DriveSeries, kinds_of_drives
from brink.search.analysis.intervals import share_interval
from brink.search.analysis.monitor_evaluation import classification_metrics
from brink.search.space import BoolArray, FloatArray, IntArray
from brink.server.errors import Conflict
from brink.sim.driving.interface import PERCEPTION_STEP_S

LEADS_S: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
LEAD_S: Final = 1.5
"""The lead time that counts."""
MORE_FALSE_ALARMS: Final = (0.1, 0.2)
"""Further such shares."""
FOLDS: Final = (10, 5, 3)
"""Numbers of parts of the drives, each judged with the threshold of the others; the first feasible one is used."""
RECENT_S: Final = 6.0
"""An alarm raised longer than this before a violation may have had another reason."""
POINTS: Final = 200
STEPS_APART: Final = 5
"""Every fifth step counts for the accuracy of probabilities: neighbouring ones are almost equal."""

GUARD, BOX_TTC, RANGE_TTC_NAME = "guard", "time to collision on boxes", "time to collision on ranges"
ALWAYS, NEVER = "always", "never"

Score: TypeAlias = Callable[[NDArray[np.float16]], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class WarningPoint:
    """Predicted violations and false alarms at one threshold.

    Attributes:
        threshold: The alarm is raised at this score or a higher one.
        false_alarms: Share of safe drives with an alarm.
        warned: Share of violations predicted at least each of `LEADS_S` ahead.
    """

    threshold: float
    false_alarms: float
    warned: tuple[float, ...]

    @property
    def recall(self) -> float:
        """Share of violations predicted at least `LEAD_S` ahead."""
        return self.warned[LEADS_S.index(LEAD_S)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictorResult:
    """How well a predictor warns.

    Attributes:
        name: Name of the predictor.
        points: Points at all thresholds, ascending by false alarms: the ROC curve of these drives.
        compared: What it does with thresholds that are chosen on other drives than those judged, for alarms in
            `FALSE_ALARMS` of the safe drives. Its threshold is the one that all drives together choose.
        interval: 95% interval of its recall.
        more: The same for alarms in each of `MORE_FALSE_ALARMS`.
    """

    name: str
    points: tuple[WarningPoint, ...]
    compared: WarningPoint
    interval: tuple[float, float]
    more: tuple[WarningPoint, ...]

    @property
    def shown(self) -> WarningPoint:
        """The point used for comparison; for the baselines that always or never raise an alarm, their only point."""
        places = {ALWAYS: -1, NEVER: 0}
        return self.points[places[self.name]] if self.name in places else self.compared


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnAlarms:
    """The effect of a guard's own alarms, at its own threshold.

    Attributes:
        point: Predicted violations and false alarms.
        interval: 95% interval of the recall.
        false_interval: 95% interval of the share of safe drives with an alarm.
        recent: Share of violations before which an alarm was raised between `LEAD_S` and `RECENT_S` ahead, or was
            still on `LEAD_S` ahead.
        median_lead_s: Median time from the first alarm to the violation, of violations with an alarm; None if there
            is none.
        false_per_hour: Number of alarms an hour of safe drives.
        on_share: Share of the time in safe drives in which an alarm is on.
    """

    point: WarningPoint
    interval: tuple[float, float]
    false_interval: tuple[float, float]
    recent: float
    median_lead_s: float | None
    false_per_hour: float
    on_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonAccuracy:
    """How accurate the probabilities of one horizon are, over steps.

    Attributes:
        horizon_s: The horizon.
        positive: Share of steps with a violation within it.
        auroc: Probability that a step with a violation ahead was given a higher probability than one without.
        brier: Mean squared error.
        calibration_error: Mean difference between predicted probability and observed share over ten bins.
    """

    horizon_s: float
    positive: float
    auroc: float
    brier: float
    calibration_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardEvaluation:
    """A guard and its baselines on recorded drives.

    Attributes:
        sensor: The sensors of the car.
        requirements: Ids of the requirements.
        drives: Number of drives.
        violations: Number of drives with a violation.
        too_early: Number of violations earlier after the start than `LEAD_S`.
        predictors: The guard, then its baselines.
        own: The guard's own alarms.
        horizons: Accuracy of its probabilities.
    """

    sensor: Sensor
    requirements: tuple[str, ...]
    drives: int
    violations: int
    too_early: int
    predictors: tuple[PredictorResult, ...]
    own: OwnAlarms
    horizons: tuple[HorizonAccuracy, ...]

    @property
    def guard(self) -> PredictorResult:
        """How well the guard warns."""
        return self.predictors[0]

    def to_json(self) -> dict[str, Any]:
        """Return the evaluation as the JSON object of ``brink guard judge --json``."""
        return {
            "sensor": str(self.sensor),
            "requirements": list(self.requirements),
            "drives": self.drives,
            "violations": self.violations,
            "too_early": self.too_early,
            "lead_s": LEAD_S,
            "leads_s": list(LEADS_S),
            "predictors": [asdict(one) for one in self.predictors],
            "own": asdict(self.own),
            "horizons": [asdict(one) for one in self.horizons],
        }


def evaluate(model: GuardModel, drives: Sequence[Drive]) -> GuardEvaluation:
    """Evaluate a guard and its baselines on drives that it was not fitted to.

    Args:
        model: The guard.
        drives: Recorded drives.

    Raises:
        Conflict: The drives lack a requirement of the guard, or too few violate or hold it.
    """
    watched = [_Watched.of(drive, model) for drive in drives]
    violations = sum(one.violated_at_s is not None for one in watched)
    if violations in (0, len(watched)):
        raise Conflict(
            f"expected drives with and without a violation, got {violations} of {len(watched)} with one"
        )
    judged = JudgedDrives.of([one.series for one in watched])
    probabilities = predict(model, [one.features for one in watched])
    deciding = [one[:, model.deciding] for one in probabilities]
    confirm = model.alarm.confirm_steps
    predictors = [_warnings(GUARD, watched, judged, deciding, confirm)]
    predictors += [
        _warnings(name, watched, judged, [score(one.features) for one in watched], confirm)
        for name, score in _baselines(model.sensor)
    ]
    return GuardEvaluation(
        sensor=model.sensor,
        requirements=model.requirements,
        drives=len(watched),
        violations=violations,
        too_early=sum(one.violated_at_s is not None and one.violated_at_s <= LEAD_S for one in watched),
        predictors=tuple(predictors),
        own=_own_alarms(model, watched, judged, deciding),
        horizons=tuple(_accuracies(model, watched, probabilities)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Watched:
    """A drive until its first violation.

    Attributes:
        series: What the guard sees.
        begins_s: Time of the first features.
        violated_at_s: When it was violated; None if it was not.
    """

    series: DriveSeries
    begins_s: float
    violated_at_s: float | None

    @property
    def features(self) -> NDArray[np.float16]:
        """Features of the guard, shape ``(steps, features)``."""
        return self.series.features

    @classmethod
    def of(cls, drive: Drive, model: GuardModel) -> "_Watched":
        series = drive.series(model.requirements, len(feature_names(model.sensor)))
        return cls(
            series=series, begins_s=drive.begins_s, violated_at_s=drive.first_violation_s(model.requirements)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedDrives:
    """Drives, each judged with a threshold chosen on dissimilar drives.

    Attributes:
        violated: Whether each is violated, shape ``(n,)``.
        kinds: By what they are alike.
        parts: Those that choose a threshold, with those that are judged with it.
    """

    violated: BoolArray
    kinds: Sequence[IntArray]
    parts: Sequence[Division]

    @classmethod
    def of(cls, drives: Sequence[DriveSeries]) -> Self:
        """Divide drives.

        Raises:
            Conflict: They are too few, or too much alike.
        """
        violated = np.array([one.violated for one in drives], np.bool_)
        kinds = kinds_of_drives(drives)
        parts = divisions(kinds, violated, np.random.default_rng(0), FOLDS) if kinds else []
        if not parts:
            raise Conflict(
                "expected drives with and without a violation from which a threshold can be chosen for others: at "
                f"least two of each, unlike in scenario and behaviour; got {int(violated.sum())} with a violation "
                f"of {len(drives)}"
            )
        return cls(violated=violated, kinds=kinds, parts=parts)

    def share(self, hits: BoolArray, counted: BoolArray) -> tuple[float, tuple[float, float]]:
        """Return the share of hits among the counted drives, with its interval; masks of shape ``(n,)``."""
        share = float(hits[counted].mean())
        influence = np.where(counted, hits - share, 0.0) / counted.sum()
        return share, share_interval(share, int(counted.sum()), influence, self.kinds)

    def warnings(
        self, strengths: FloatArray, false_alarms: float
    ) -> tuple[WarningPoint, tuple[float, float]]:
        """Return how well a predictor warns if it alarms in a share of safe drives, with the interval of its recall.

        Args:
            strengths: The highest confirmed score of each drive until each of `LEADS_S` before its violation; of a
                safe drive, until its end. Shape ``(n, leads)``.
            false_alarms: The share, in (0, 1).
        """
        harmless, lead = strengths[~self.violated, 0], LEADS_S.index(LEAD_S)
        raised = np.zeros(strengths.shape, np.bool_)
        for part in self.parts:
            threshold = threshold_at(strengths[part.fitted & ~self.violated, 0], false_alarms)
            raised[part.scored] = strengths[part.scored] >= threshold
        point = WarningPoint(
            threshold=threshold_at(harmless, false_alarms),
            false_alarms=float(raised[~self.violated, 0].mean()),
            warned=tuple(raised[self.violated].mean(axis=0).tolist()),
        )
        hazards, safe = int(self.violated.sum()), harmless.size
        steepness = _steepness(strengths[self.violated, lead], harmless, false_alarms)
        influence = np.where(
            self.violated,
            (raised[:, lead] - point.recall) / hazards,
            -steepness * (raised[:, 0] - point.false_alarms) / safe,
        )
        return point, share_interval(point.recall, hazards, influence, self.kinds)


def _steepness(hazards: FloatArray, harmless: FloatArray, false_alarms: float) -> float:
    """Return by how much the recall rises with the share of false alarms, over one standard error of that share."""
    error = np.sqrt(false_alarms * (1.0 - false_alarms) / harmless.size)
    rates = []
    for share in (max(false_alarms - error, 0.0), min(false_alarms + error, 1.0 - 1e-9)):
        threshold = threshold_at(harmless, share)
        rates.append(((hazards >= threshold).mean(), (harmless >= threshold).mean()))
    (recall, rate), (more, higher) = rates
    return float((more - recall) / (higher - rate)) if higher > rate else 0.0


def threshold_at(peaks: FloatArray, false_alarms: float) -> float:
    """Return the lowest threshold that at most a share of the safe drives reach.

    Args:
        peaks: Highest confirmed score in each safe drive, shape ``(n,)``, n >= 1.
        false_alarms: The share, in [0, 1).
    """
    allowed = int(np.floor(false_alarms * peaks.size + 1e-9))
    return float(np.nextafter(np.sort(peaks)[::-1][allowed], np.inf))


def predict(model: GuardModel, features: Sequence[NDArray[np.float16]]) -> list[FloatArray]:
    """Return the probabilities at each step of several drives, each of shape ``(steps, horizons)``."""
    if not features:
        return []
    ends = np.cumsum([len(one) for one in features])[:-1]
    found = model.probabilities(np.concatenate(features).astype(np.float32))
    return np.split(found, ends)


def confirmed(scores: FloatArray, steps: int) -> FloatArray:
    """Return, at each step, the highest threshold that the scores have reached for several steps in a row.

    Args:
        scores: Scores, shape ``(n,)``.
        steps: Number of steps, at least 1.

    Returns:
        The running minimum of the last `steps` scores, shape ``(n,)``; -inf before there are so many.
    """
    found = np.full(scores.size, -np.inf)
    if scores.size >= steps:
        windows = np.lib.stride_tricks.sliding_window_view(scores, steps)
        found[steps - 1 :] = windows.min(axis=1)
    return found


def peak(strengths: FloatArray, before_s: float = np.inf) -> float:
    """Return the highest confirmed score until a time after the first score; -inf if there is none."""
    last = strengths.size if np.isinf(before_s) else int(np.floor(before_s / PERCEPTION_STEP_S + 1e-6)) + 1
    return float(strengths[: max(last, 0)].max(initial=-np.inf))


def _baselines(sensor: Sensor) -> Iterator[tuple[str, Score]]:
    """Yield the name and score of each baseline."""
    yield BOX_TTC, lambda features: -box_times_s(features)
    if sensor is Sensor.RANGE:
        yield RANGE_TTC_NAME, lambda features: -range_times_s(features)
    yield ALWAYS, lambda features: np.ones(len(features))
    yield NEVER, lambda features: np.full(len(features), -np.inf)


def _warnings(
    name: str, watched: Sequence[_Watched], judged: JudgedDrives, scores: Sequence[FloatArray], confirm: int
) -> PredictorResult:
    strengths = np.empty((len(watched), len(LEADS_S)))
    for row, one, score in zip(strengths, watched, scores, strict=True):
        found = confirmed(score, confirm)
        end_s = np.inf if one.violated_at_s is None else one.violated_at_s - one.begins_s
        row[:] = [peak(found, end_s - lead_s) for lead_s in LEADS_S]
    harmless, hazards = np.sort(strengths[~judged.violated, 0]), np.sort(strengths[judged.violated], axis=0)
    points = [_point(threshold, harmless, hazards) for threshold in _thresholds(harmless, hazards)]
    compared, interval = judged.warnings(strengths, FALSE_ALARMS)
    return PredictorResult(
        name=name,
        points=tuple(points),
        compared=compared,
        interval=interval,
        more=tuple(judged.warnings(strengths, share)[0] for share in MORE_FALSE_ALARMS),
    )


def _thresholds(harmless: FloatArray, hazards: FloatArray) -> list[float]:
    """Return thresholds, descending, from above all scores to the lowest score."""
    finite = np.concatenate([harmless, hazards.ravel()])
    finite = np.unique(finite[np.isfinite(finite)])[::-1]
    if not finite.size:
        return [1.0]
    # Close together where there are few false alarms: that is where a guard works.
    rare = np.unique(harmless[np.isfinite(harmless)])[::-1][:POINTS]
    spread = finite[np.linspace(0, finite.size - 1, POINTS).astype(int)]
    # Just above each of the rare ones, too: there, a false alarm less costs nothing.
    kept = np.concatenate([np.nextafter(finite[:1], np.inf), np.nextafter(rare, np.inf), rare, spread])
    found: list[float] = np.unique(kept)[::-1].tolist()
    return found


def _point(threshold: float, harmless: FloatArray, hazards: FloatArray) -> WarningPoint:
    return WarningPoint(
        threshold=threshold,
        false_alarms=float(1 - np.searchsorted(harmless, threshold, side="left") / harmless.size),
        warned=tuple(
            float(1 - np.searchsorted(hazards[:, place], threshold, side="left") / len(hazards))
            for place in range(len(LEADS_S))
        ),
    )


def _own_alarms(
    model: GuardModel, watched: Sequence[_Watched], judged: JudgedDrives, deciding: Sequence[FloatArray]
) -> OwnAlarms:
    leads: list[float] = []
    recent = alarms = steps = on = 0
    raised = np.zeros((len(watched), len(LEADS_S)), np.bool_)
    for warned, one, scores in zip(raised, watched, deciding, strict=True):
        alarm = Alarm(model.alarm)
        states = np.array([alarm.step(score) for score in scores.tolist()], np.bool_)
        raised_at = np.flatnonzero(states & ~np.concatenate([[False], states[:-1]]))
        starts = one.begins_s + raised_at * PERCEPTION_STEP_S
        if one.violated_at_s is None:
            warned[:] = bool(starts.size)
            alarms += starts.size
            steps += states.size
            on += int(states.sum())
            continue
        if starts.size:
            leads.append(one.violated_at_s - float(starts[0]))
            warned[:] = [leads[-1] >= lead_s - 1e-9 for lead_s in LEADS_S]
        recent += _is_recent(one.violated_at_s - one.begins_s, starts - one.begins_s, states)
    violated = judged.violated
    false_alarms, false_interval = judged.share(raised[:, 0], ~violated)
    return OwnAlarms(
        point=WarningPoint(
            threshold=model.alarm.threshold,
            false_alarms=false_alarms,
            warned=tuple(raised[violated].mean(axis=0).tolist()),
        ),
        interval=judged.share(raised[:, LEADS_S.index(LEAD_S)], violated)[1],
        false_interval=false_interval,
        recent=recent / int(violated.sum()),
        median_lead_s=float(np.median(leads)) if leads else None,
        false_per_hour=alarms / (steps * PERCEPTION_STEP_S / 3600.0),
        on_share=on / steps,
    )


def _is_recent(violated_at_s: float, starts_s: NDArray[np.floating[Any]], states: BoolArray) -> bool:
    """Return whether an alarm was raised shortly before a violation, or was on `LEAD_S` before it.

    All times are relative to the first features.
    """
    ahead_s = violated_at_s - starts_s
    if ((ahead_s >= LEAD_S - 1e-9) & (ahead_s <= RECENT_S)).any():
        return True
    step = int(np.floor((violated_at_s - LEAD_S) / PERCEPTION_STEP_S + 1e-6))
    return 0 <= step < states.size and bool(states[step])


def _accuracies(
    model: GuardModel, watched: Sequence[_Watched], probabilities: Sequence[FloatArray]
) -> Iterator[HorizonAccuracy]:
    until_s = np.concatenate(
        [
            (np.inf if one.violated_at_s is None else one.violated_at_s - one.begins_s)
            - PERCEPTION_STEP_S * np.arange(len(one.features))
            for one in watched
        ]
    )[::STEPS_APART]
    predicted = np.concatenate(probabilities)[::STEPS_APART]
    for place, horizon_s in enumerate(model.horizons_s):
        labels = until_s <= horizon_s
        if labels.all() or not labels.any():
            continue
        metrics = classification_metrics(predicted[:, place], labels)
        yield HorizonAccuracy(
            horizon_s=horizon_s,
            positive=float(labels.mean()),
            auroc=metrics.auroc,
            brier=metrics.brier,
            calibration_error=metrics.calibration_error,
        )
