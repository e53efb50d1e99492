"""Statistics of repeated campaigns: mean with interval, Mann-Whitney U, Vargha-Delaney A12.

Source: Sharifi et al. 2023, evaluation; Vargha and Delaney 2000.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanInterval:
    """A mean over repeats.

    Attributes:
        mean: Of the values.
        low: Lower limit of the confidence interval, or None with a single value.
        high: Upper limit, or None with a single value.
        repeats: How many values.
    """

    mean: float
    low: float | None
    high: float | None
    repeats: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Whether one method gives larger values than another.

    Attributes:
        a12: Probability that a value of the first exceeds one of the second, ties counted half, in [0, 1].
        u: Mann-Whitney U of the first.
        p_value: Two-sided p-value of U.
    """

    a12: float
    u: float
    p_value: float


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> MeanInterval:
    """Return the mean and its Student interval.

    Raises:
        ValueError: There is no value, or the confidence is not in (0, 1).
    """
    if not len(values) or not 0 < confidence < 1:
        raise ValueError(f"expected values and a confidence in (0, 1), got {len(values)} and {confidence!r}")
    sample = np.asarray(values, np.float64)
    mean = float(sample.mean())
    if sample.size == 1:
        return MeanInterval(mean=mean, low=None, high=None, repeats=1)
    half = float(
        stats.t.ppf(0.5 + confidence / 2, sample.size - 1) * sample.std(ddof=1) / np.sqrt(sample.size)
    )
    return MeanInterval(mean=mean, low=mean - half, high=mean + half, repeats=int(sample.size))


def a12(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the probability that a value of the first exceeds one of the second, ties counted half.

    Raises:
        ValueError: One of them is empty.
    """
    if not len(first) or not len(second):
        raise ValueError("expected at least one value on each side")
    a, b = np.asarray(first, np.float64)[:, None], np.asarray(second, np.float64)[None]
    return float((np.count_nonzero(a > b) + 0.5 * np.count_nonzero(a == b)) / (a.size * b.size))


def compared(first: Sequence[float], second: Sequence[float]) -> Comparison:
    """Return effect size and significance of the difference between two methods.

    Raises:
        ValueError: One of them is empty.
    """
    effect = a12(first, second)
    u = effect * len(first) * len(second)
    if np.unique([*first, *second]).size == 1:
        return Comparison(a12=effect, u=u, p_value=1.0)
    p_value = float(stats.mannwhitneyu(first, second, alternative="two-sided").pvalue)
    return Comparison(a12=effect, u=u, p_value=p_value)
