"""How well somebody foretells verdicts: discrimination, accuracy, calibration, and what alarms cost.

Source: Brier 1950; Hanley and McNeil 1982 (the area under the ROC curve is A12 of the two groups' probabilities).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.component import BoolArray, FloatArray
from brink.search.fitness import wilson_interval
from brink.search.statistics import a12

BINS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """Solutions with similar probabilities.

    Attributes:
        solutions: How many.
        foretold: Mean probability of unsafe.
        low: Mean lower limit of the intervals that were stated.
        high: Mean upper limit.
        observed: Unsafe share.
        observed_low: Lower limit of its own Wilson interval, for the few that they are.
        observed_high: Upper limit.
    """

    solutions: int
    foretold: float
    low: float
    high: float
    observed: float
    observed_low: float
    observed_high: float

    @property
    def within(self) -> bool:
        """Whether the unsafe share lies within the interval that was stated."""
        return self.low <= self.observed <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """What becomes of hazards and of safe solutions if everything from a probability on gives an alarm.

    Attributes:
        probability: From which on.
        missed: Share of the unsafe solutions that give none.
        false: Share of the safe solutions that give one.
    """

    probability: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """How well verdicts were foretold.

    Attributes:
        solutions: How many were judged.
        unsafe: Of them, unsafe.
        auroc: Probability that an unsafe one was given a larger probability than a safe one; .5 is guessing.
        brier: Mean squared error of the probabilities; less is better.
        bins: Calibration, ascending; about equally many solutions each.
    """

    solutions: int
    unsafe: int
    auroc: float
    brier: float
    bins: tuple[Bin, ...]


def judge(
    probability: FloatArray, unsafe: BoolArray, low: FloatArray | None = None, high: FloatArray | None = None
) -> Judgement:
    """Return how well probabilities foretold verdicts.

    Args:
        probability: Of unsafe, shape ``(n,)``.
        unsafe: What came, shape ``(n,)``; both verdicts must occur.
        low: Lower limits that were stated; the probability itself if none were.
        high: Upper limits.

    Raises:
        ValueError: The shapes differ, or only one verdict occurs.
    """
    if probability.shape != unsafe.shape or probability.ndim != 1:
        raise ValueError(
            f"expected a verdict for each probability, got {unsafe.shape} for {probability.shape}"
        )
    if unsafe.all() or not unsafe.any():
        raise ValueError("expected safe and unsafe solutions to judge by")
    low = probability if low is None else low
    high = probability if high is None else high
    order = np.argsort(probability, kind="stable")
    return Judgement(
        solutions=int(unsafe.size),
        unsafe=int(unsafe.sum()),
        auroc=a12(probability[unsafe].tolist(), probability[~unsafe].tolist()),
        brier=float(np.mean((probability - unsafe) ** 2)),
        bins=tuple(
            _bin(probability[part], unsafe[part], low[part], high[part])
            for part in np.array_split(order, min(BINS, unsafe.size))
        ),
    )


def _bin(probability: FloatArray, unsafe: BoolArray, low: FloatArray, high: FloatArray) -> Bin:
    observed_low, observed_high = wilson_interval(int(unsafe.sum()), int(unsafe.size))
    return Bin(
        solutions=int(unsafe.size), foretold=float(probability.mean()), low=float(low.mean()),
        high=float(high.mean()), observed=float(unsafe.mean()), observed_low=float(observed_low),
        observed_high=float(observed_high),
    )  # fmt: skip


def alarms(probability: FloatArray, unsafe: BoolArray, at: Sequence[float] | None = None) -> list[Alarm]:
    """Return the trade of missed hazards against false alarms.

    Args:
        probability: Of unsafe, shape ``(n,)``.
        unsafe: What came, shape ``(n,)``; both verdicts must occur.
        at: Probabilities from which on there is an alarm, any order; all that occur, descending, if left out.
    """
    levels = np.unique(probability)[::-1].tolist() if at is None else list(at)
    hazards, harmless = np.sort(probability[unsafe]), np.sort(probability[~unsafe])
    return [
        Alarm(
            probability=level,
            missed=float(np.searchsorted(hazards, level, side="left") / hazards.size),
            false=float(1 - np.searchsorted(harmless, level, side="left") / harmless.size),
        )
        for level in levels
    ]


def false_alarms_at(found: Sequence[Alarm], missed: float) -> Alarm:
    """Return the alarm with the fewest false ones among those that miss at most a share of the hazards.

    Raises:
        ValueError: None misses so few.
    """
    good = [alarm for alarm in found if alarm.missed <= missed]
    if not good:
        raise ValueError(f"no alarm misses at most {missed:g} of the hazards")
    return min(good, key=lambda alarm: (alarm.false, -alarm.probability))
