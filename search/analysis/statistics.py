"""Statistics of repeated campaigns: means with intervals, Mann-Whitney U, Vargha-Delaney A12, Holm's correction.

Sources: Sharifi et al. 2023, evaluation (U and A12, at a level of .01 without correction); Vargha and Delaney 2000;
Holm 1979.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.space import FloatArray

# scipy.stats takes half a second to import, so the functions below import it.


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanInterval:
    """A mean over repeats with its confidence interval.

    Attributes:
        mean: The mean.
        low: Lower limit of the interval, or None with a single value.
        high: Upper limit of the interval, or None with a single value.
        repeats: Number of values.
    """

    mean: float
    low: float | None
    high: float | None
    repeats: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Effect size and significance of the difference between two methods.

    Attributes:
        a12: Probability that a value of the first method exceeds one of the second, counting ties as one half.
        u: Mann-Whitney U of the first method.
        p_value: Two-sided p-value of U; None if all values of both are equal, which leaves nothing to test.
    """

    a12: float
    u: float
    p_value: float | None


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> MeanInterval:
    """Return the mean and its confidence interval by Student's t distribution.

    Raises:
        ValueError: There are no values, or the confidence level is not in (0, 1).
    """
    if not len(values) or not 0 < confidence < 1:
        raise ValueError(
            f"expected at least one value and a confidence level in (0, 1); "
            f"got {len(values)} values and confidence {confidence!r}"
        )
    sample = np.asarray(values, np.float64)
    mean = float(sample.mean())
    if sample.size == 1:
        return MeanInterval(mean=mean, low=None, high=None, repeats=1)
    from scipy import stats

    half = float(
        stats.t.ppf(0.5 + confidence / 2, sample.size - 1) * sample.std(ddof=1) / np.sqrt(sample.size)
    )
    return MeanInterval(mean=mean, low=mean - half, high=mean + half, repeats=int(sample.size))


def a12(first: Sequence[float] | FloatArray, second: Sequence[float] | FloatArray) -> float:
    """Return the probability that a value of the first sample exceeds one of the second, counting ties as one half.

    The values are ranked, so memory grows with their number and not with the number of pairs. Counts are exact.

    Raises:
        ValueError: A sample is empty, or a value is not a number.
    """
    if not len(first) or not len(second):
        raise ValueError("expected at least one value in each sample")
    a, b = np.asarray(first, np.float64), np.sort(np.asarray(second, np.float64))
    if np.isnan(a).any() or np.isnan(b[-1]):
        raise ValueError("expected numbers in each sample, got nan")
    below, up_to = np.searchsorted(b, a, side="left"), np.searchsorted(b, a, side="right")
    return int(below.sum() + up_to.sum()) / (2 * a.size * b.size)


def compared(first: Sequence[float], second: Sequence[float]) -> Comparison:
    """Return effect size and significance of the difference between two samples.

    Raises:
        ValueError: A sample is empty.
    """
    effect = a12(first, second)
    u = effect * len(first) * len(second)
    if np.unique([*first, *second]).size == 1:
        return Comparison(a12=effect, u=u, p_value=None)
    from scipy import stats

    p_value = float(stats.mannwhitneyu(first, second, alternative="two-sided").pvalue)
    return Comparison(a12=effect, u=u, p_value=p_value)


SIZES = ((0.71, "large"), (0.64, "medium"), (0.56, "small"))
"""Smallest A12 of each effect size (Vargha and Delaney 2000); 1 - A12 counts in the other direction."""


def effect_size(effect: float) -> str:
    """Return the effect size of an A12 in either direction: ``negligible``, ``small``, ``medium`` or ``large``.

    Raises:
        ValueError: It is not in [0, 1].
    """
    if not 0 <= effect <= 1:
        raise ValueError(f"a12: expected a number in [0, 1], got {effect!r}")
    # Rounded, because 1 - 0.29 is slightly less than 0.71.
    distance = round(max(effect, 1 - effect), 9)
    return next((word for least, word in SIZES if distance >= least), "negligible")


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values adjusted by Holm's step-down method, in the same order.

    Rejecting all hypotheses with an adjusted value of at most alpha gives a probability of at most alpha that any of
    the rejections is wrong. None, where there was nothing to test, stays None and needs no correction (Tarone 1990).

    Raises:
        ValueError: A p-value is not in [0, 1].
    """
    values = np.array([value for value in p_values if value is not None], np.float64)
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError(f"p_values: expected numbers in [0, 1], got {list(p_values)}")
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate(values[order] * (values.size - np.arange(values.size)))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(stepped, 1.0)
    tested = iter(adjusted.tolist())
    return [None if value is None else float(next(tested)) for value in p_values]
