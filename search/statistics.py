"""Statistics of repeated campaigns: mean with interval, Mann-Whitney U, Vargha-Delaney A12, Holm's correction.

Source: Sharifi et al. 2023, evaluation; Vargha and Delaney 2000; Holm 1979.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its statistics take half a second to load: at the first use


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
        scipy.stats.t.ppf(0.5 + confidence / 2, sample.size - 1) * sample.std(ddof=1) / np.sqrt(sample.size)
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
    p_value = float(scipy.stats.mannwhitneyu(first, second, alternative="two-sided").pvalue)
    return Comparison(a12=effect, u=u, p_value=p_value)


SIZES = ((0.71, "large"), (0.64, "medium"), (0.56, "small"))
"""Least A12 of an effect that is called so (Vargha and Delaney 2000), and 1 - A12 the other way round."""


def effect_size(effect: float) -> str:
    """Return an A12 in words: ``negligible``, ``small``, ``medium`` or ``large``, whichever way it goes.

    Raises:
        ValueError: It is not in [0, 1].
    """
    if not 0 <= effect <= 1:
        raise ValueError(f"a12: expected a number in [0, 1], got {effect!r}")
    # Rounded: 1 - 0.29 is a little less than 0.71.
    distance = round(max(effect, 1 - effect), 9)
    return next((word for least, word in SIZES if distance >= least), "negligible")


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for their number, in the same order, by Holm's step-down method.

    An adjusted value at or below a level alpha means: rejected, with a chance of at most alpha that any of all the
    rejections is wrong.

    Raises:
        ValueError: A p-value is not in [0, 1].
    """
    values = np.asarray(p_values, np.float64)
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError(f"p_values: expected numbers in [0, 1], got {list(p_values)}")
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate(values[order] * (values.size - np.arange(values.size)))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(stepped, 1.0)
    return [float(value) for value in adjusted]
