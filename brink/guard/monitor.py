"""The stepwise guard: features, model and alarm of one drive."""

from collections import deque
from dataclasses import replace
from pathlib import Path

from brink.guard.choices import Sensor
from brink.guard.features import FeatureExtractor
from brink.guard.model import AlarmRule, GuardModel
from brink.sim.driving.interface import PERCEPTION_STEP_S, Command, Observation, PlanState, Route
from brink.sim.guard.interface import Guard, GuardReading, KnownConditions, RangeScan


class Alarm:
    """The alarm of one drive: raised while a probability stays high, and held until it has stayed low for a while.

    Args:
        rule: The rule of the alarm.

    Attributes:
        is_on: Whether the alarm is on.
        peak: The highest threshold that would have raised an alarm so far; 0 if none would have.
    """

    __slots__ = ("_above", "_below", "_hold_steps", "_recent", "_rule", "is_on", "peak")

    def __init__(self, rule: AlarmRule) -> None:
        self._rule = rule
        self._above = self._below = 0
        self._hold_steps = round(rule.hold_s / PERCEPTION_STEP_S)
        self._recent: deque[float] = deque(maxlen=rule.confirm_steps)
        self.is_on = False
        self.peak = 0.0

    def step(self, probability: float) -> bool:
        """Process the probability of one perception step and return whether the alarm is on."""
        rule = self._rule
        self._recent.append(probability)
        if len(self._recent) == rule.confirm_steps:
            self.peak = max(self.peak, min(self._recent))
        self._above = self._above + 1 if probability >= rule.threshold else 0
        self._below = self._below + 1 if probability < rule.release else 0
        if self._above >= rule.confirm_steps:
            self.is_on = True
        elif self.is_on and self._below > self._hold_steps:
            self.is_on = False
        return self.is_on


class ModelGuard:
    """Implements `brink.sim.guard.interface.Guard` with a fitted model. Create a new one for each drive.

    Args:
        model: The model.
        route: The route of the drive.
        conditions: Time of day and weather. They must be known, as they were in all drives that it was fitted to.

    Raises:
        ValueError: Some of the conditions are unknown.
    """

    def __init__(self, model: GuardModel, route: Route, conditions: KnownConditions) -> None:
        if min(conditions) < 0.0:
            raise ValueError(
                f"expected rain, wetness and darkness in [0, 1], got {tuple(conditions)}: a fitted guard was "
                "never trained with unknown conditions"
            )
        self._model = model
        self._extractor = FeatureExtractor(route, conditions, ranges=model.sensor is Sensor.RANGE)
        self._alarm = Alarm(model.alarm)
        self._reading = GuardReading(probabilities=(0.0,) * len(model.horizons_s), alarm=False)

    @property
    def peak(self) -> float:
        """The highest threshold that would have raised an alarm so far; 0 if none would have."""
        return self._alarm.peak

    @property
    def horizons_s(self) -> tuple[float, ...]:
        """The horizons of the probabilities in seconds, ascending."""
        return self._model.horizons_s

    def step(
        self,
        observation: Observation,
        command: Command,
        plan: PlanState | None = None,
        scan: RangeScan | None = None,
    ) -> GuardReading:
        """Process one control step and return the current reading, which changes at perception steps.

        Args:
            observation: What the driving system received in this step.
            command: What it commanded, before any fallback changed it.
            plan: The planner's decision in this step, if known.
            scan: The range sensor's scan, at perception steps of a car that has one.
        """
        if observation.boxes is not None:
            features = self._extractor.step(observation, command, plan, scan)
            probabilities = self._model.probabilities(features[None])[0].tolist()
            self._reading = GuardReading(
                probabilities=tuple(probabilities),
                alarm=self._alarm.step(probabilities[self._model.deciding]),
            )
        return self._reading


class FittedGuards:
    """Makes guards of a fitted model: a `brink.sim.guard.option.MakeGuard`."""

    def __init__(self, model: GuardModel) -> None:
        self._model = model
        self.needs_scan = model.sensor is Sensor.RANGE
        self.own_threshold = model.alarm.threshold

    def __call__(self, route: Route, conditions: KnownConditions, threshold: float | None) -> Guard:
        """Return a new guard with an alarm threshold."""
        model, rule = self._model, self._model.alarm
        if threshold is not None:
            release = threshold * rule.release / rule.threshold if rule.threshold > 0.0 else 0.0
            model = replace(model, alarm=replace(rule, threshold=threshold, release=min(release, threshold)))
        return ModelGuard(model, route, conditions)


def guards_in(file: Path) -> FittedGuards:
    """Return the factory of the guard in a file.

    Raises:
        GuardFileError: The file is not a guard.
    """
    return FittedGuards(GuardModel.load(file))
