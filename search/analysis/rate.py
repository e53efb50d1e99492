"""What draws from operation say of the rate of unsafe solutions: estimate, intervals, claim, strata, exposure.

A simulation without a verdict counts as safe for the lower end of an interval and as unsafe for the upper one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.algorithm import Draws
from brink.search.analysis.intervals import ratio_interval, replicated_interval
from brink.search.conclusions import Decision
from brink.search.deadline import check_time
from brink.search.rates import Wealth, best_growth, betting_bounds, fixed_interval, log_wealth
from brink.search.space import BoolArray, FloatArray

Interval = tuple[float, float]
_LOOKS: Final = 24
_FIRST_LOOK: Final = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """A rate with its intervals.

    Attributes:
        simulations: Draws, those without a verdict included.
        unsafe: Unsafe ones among them.
        failed: Those without a verdict.
        rate: The estimate.
        interval: Interval that holds at every number of simulations at once.
        fixed: Interval that holds if the number of simulations was fixed beforehand.
        effective: Number of plain simulations with the same variance; the number of simulations if nothing is unsafe.
    """

    simulations: int
    unsafe: int
    failed: int
    rate: float
    interval: Interval
    fixed: Interval
    effective: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """The rate as it was after some simulations."""

    simulations: int
    rate: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A claim that the rate is at most a limit, and what became of it.

    Attributes:
        at_most: The limit.
        confidence: Confidence.
        decision: Whether it is shown, refuted, or not shown.
        after: Number of simulations that this took.
        high: The upper end of the one-sided interval with the confidence.
        low: The lower end of that on the other side.
        more: About how many more simulations would show it if the rate is as estimated; None if that is not below it.
    """

    at_most: float
    confidence: float
    decision: Decision
    after: int
    high: float
    low: float
    more: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """A ratio of two expectations, with an interval for a number of simulations that was fixed beforehand."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stratum:
    """A part of operation.

    Attributes:
        words: What it is.
        simulations: Draws in it.
        unsafe: Unsafe ones among them.
        share: Its share of operation.
        part: Its share of all that is unsafe; None if nothing is.
        rate: The rate in it; None without an interval, which takes two simulations.
    """

    words: str
    simulations: int
    unsafe: int
    share: float
    part: float | None
    rate: Ratio | None


def rate_of(draws: Draws, confidence: float) -> Rate:
    """Return the rate that draws estimate; without draws, an interval from 0 to 1.

    Args:
        draws: The draws.
        confidence: Confidence of the intervals, in (0, 1).
    """
    least, most = draws.terms(), draws.terms(failed=True)
    error = (1 - confidence) / 2
    low = betting_bounds(least, low_error=error, high_error=error)[0]
    high = betting_bounds(most, low_error=error, high_error=error)[1]
    fixed = fixed_interval(least, confidence)[0], fixed_interval(most, confidence)[1]
    scored = draws.some(~draws.failed).terms()
    # Control variates may take the mean out of what is possible.
    rate = min(max(scored.mean(), low), high) if len(scored) else 0.0
    variance = scored.variance() if len(scored) else 0.0
    plain = rate * (1.0 - rate)
    return Rate(
        simulations=len(least),
        unsafe=int(draws.unsafe.sum()),
        failed=int(draws.failed.sum()),
        rate=rate,
        interval=(low, high),
        fixed=fixed,
        effective=plain / variance if variance > 0 and plain > 0 else float(len(scored)),
    )


def looks(draws: Draws, confidence: float) -> list[Look]:
    """Return the rate and the interval that holds at every look, after more and more simulations."""
    count = len(draws.numbers)
    if not count:
        return []
    steps = np.unique(np.geomspace(min(_FIRST_LOOK, count), count, _LOOKS).round().astype(np.int64))
    found = []
    for step in steps.tolist():
        check_time()
        one = rate_of(draws.some(slice(step)), confidence)
        found.append(Look(simulations=step, rate=one.rate, low=one.interval[0], high=one.interval[1]))
    return found


def claim_of(draws: Draws, at_most: float, confidence: float) -> Claim:
    """Return what draws say of a claim that the rate is at most a limit.

    Args:
        draws: The draws.
        at_most: The limit, in (0, 1).
        confidence: Confidence, in (0, 1).
    """
    least, most = draws.terms(), draws.terms(failed=True)
    wealth = Wealth.of(at_most, confidence).after(most, least)
    error = 1 - confidence
    low = betting_bounds(least, low_error=error, high_error=error)[0]
    high = betting_bounds(most, low_error=error, high_error=error)[1]
    more = None
    if wealth.decided.decision is Decision.NOT_SHOWN and len(least) and least.mean() < at_most:
        growth = best_growth(least, np.full(len(least), 1 / len(least)), at_most, below=True)
        missing = -math.log(error) - float(log_wealth(wealth.below, below=True))
        more = math.ceil(missing / growth) if growth > 0 else None
    return Claim(
        at_most=at_most,
        confidence=confidence,
        decision=wealth.decided.decision,
        after=wealth.decided.after,
        high=high,
        low=low,
        more=more,
    )


def ratio_of(draws: Draws, below: FloatArray, confidence: float) -> Ratio | None:
    """Return unsafe simulations per amount of something, such as a kilometre; None if fewer than two have any.

    Args:
        draws: The draws.
        below: The amount in each simulation, NaN where it was not recorded, shape ``(n,)``.
        confidence: Confidence of the interval, in (0, 1).
    """
    known = ~np.isnan(below) & ~draws.failed
    above, amount = draws.unsafe_values()[known], (draws.weights * np.nan_to_num(below))[known]
    if not amount.any():
        return None
    step = float(draws.bounds[known].max())
    interval = ratio_interval(above, amount, step=step, confidence=confidence)
    if interval is None:
        return None
    return Ratio(value=float(above.sum() / amount.sum()), low=interval[0], high=interval[1])


def replicated_rate(draws: Draws, replicates: FloatArray, confidence: float) -> Ratio | None:
    """Return the rate with an interval that also covers how uncertain a fitted model is; None with one replicate.

    Draws count as as many plain simulations as have the same variance. See `replicated_interval`.

    Args:
        draws: The draws.
        replicates: The replicate of the model that each was simulated with, NaN if unknown, shape ``(n,)``.
        confidence: Confidence of the interval, in (0, 1).
    """
    known = draws.some(~np.isnan(replicates) & ~draws.failed)
    numbers, of = np.unique(replicates[~np.isnan(replicates) & ~draws.failed], return_counts=True)
    if len(numbers) < 2:
        return None
    _, labels = np.unique(replicates[~np.isnan(replicates) & ~draws.failed], return_inverse=True)
    terms = known.terms()
    means = np.bincount(labels, terms.pace * terms.values) / np.bincount(labels, terms.pace)
    overall = rate_of(known, confidence)
    trials = of * overall.effective / overall.simulations
    low, high = replicated_interval(np.clip(means, 0.0, 1.0) * trials, trials, confidence)
    return Ratio(value=overall.rate, low=min(low, overall.rate), high=max(high, overall.rate))


def strata_of(draws: Draws, members: Mapping[str, BoolArray], confidence: float) -> list[Stratum]:
    """Return the rates in parts of operation.

    Args:
        draws: The draws.
        members: Which draws are in each part, by what it is, shape ``(n,)`` each.
        confidence: Confidence of the intervals, in (0, 1).
    """
    total, unsafe = float(draws.weights[~draws.failed].sum()), float(draws.unsafe_values().sum())
    found = []
    for words, inside in members.items():
        mine = inside & ~draws.failed
        part = float(draws.unsafe_values()[inside].sum())
        found.append(
            Stratum(
                words=words,
                simulations=int(inside.sum()),
                unsafe=int((draws.unsafe & inside).sum()),
                share=float(draws.weights[mine].sum()) / total if total else 0.0,
                part=part / unsafe if unsafe else None,
                rate=_capped(ratio_of(draws, np.where(inside, 1.0, np.nan), confidence)),
            )
        )
    return found


def _capped(ratio: Ratio | None) -> Ratio | None:
    return (
        None
        if ratio is None
        else Ratio(value=min(ratio.value, 1.0), low=ratio.low, high=min(ratio.high, 1.0))
    )
