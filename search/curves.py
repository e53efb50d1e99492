"""Tolerance: how the probability of a violation grows with the severity of an error, and where it reaches a limit.

A *cell* is a combination of choices, such as a type of error and a target, under one *condition*, such as rain at
night. In each cell, drives are simulated with the error at several severities. A violation is *caused* by the error
if the same drive, under the same episode seed, does not violate without it. The curve of a cell is the share of
drives with a caused violation as a function of severity, and the *tolerated severity* is where it first reaches the
limit.

Where a grossest error is known, such as never reporting the target, every drive is *screened* with it first. Drives
that hold then are assumed to hold with any milder error, and only the *vulnerable* ones are simulated with those. The
curve is then the share of vulnerable drives times the curve among them. Audits simulate some of the others, too: what
they find is added.

The prior is a library of curves, drawn once: two steps of any height, place and steepness on top of each other, and
in some curves a fall after that. The results weight the curves of the library by their likelihood. Where so many
drives were simulated that few of these curves fit, the posterior is drawn from by Monte Carlo, beginning with them
(`brink.search.tempering`). Both hold whichever severities the search chose, because the choice depends on results
alone.

Source: ours; see docs/explanation/tolerance.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from brink.search.space import BoolArray, FloatArray, IntArray
from brink.search.streams import Stream, generator
from brink.search.tempering import effective_size, posterior_draws, resampled

LEVELS: Final = 32
"""Steps of severity between 0 and 1; errors are simulated at whole steps."""
BEYOND: Final = 1.1
"""Stands for severities beyond the scale in the width of an interval, so that "never" differs from "at its end"."""
LIBRARY: Final = 300_000
"""Curves of the library; a search uses fewer."""
FALLING: Final = 0.15
"""Share of the library's curves that fall somewhere."""
LEAST_FALL: Final = 0.02
"""A smaller fall of a curve does not count as one."""
DRAWS: Final = 2_000
"""Curves that stand for the posterior of a cell."""
LEAST_EFFECTIVE: Final = 1_000
"""Effective sample size of the library below which curves are drawn between its own."""
DIMENSION: Final = 10
"""Numbers that describe a curve."""
_MOST_AT_A_TIME: Final = 50_000
_CELLS_AT_A_TIME: Final = 12
_LIBRARY_SEED: Final = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """Simulated drives of all cells by level of severity.

    Attributes:
        drives: Drives with a verdict, shape ``(cells, LEVELS)``, for the levels 1 to `LEVELS`.
        caused: Those with a violation that the error caused, same shape.
    """

    drives: IntArray
    caused: IntArray

    @classmethod
    def empty(cls, cells: int) -> Self:
        """Return the counts of no drives."""
        return cls(drives=np.zeros((cells, LEVELS), np.int64), caused=np.zeros((cells, LEVELS), np.int64))


def severities() -> FloatArray:
    """Return the severities of all levels, with 0, shape ``(LEVELS + 1,)``."""
    return np.arange(LEVELS + 1) / LEVELS


def library(curves: int | None = None) -> NDArray[np.float32]:
    """Return the library of curves: shares of caused violations, shape ``(curves, LEVELS + 1)``.

    The first column is 0: severity 0 is no error. A curve at each place of the library is the same whatever its size.

    Args:
        curves: How many curves; `LIBRARY` by default.
    """
    return _library(LIBRARY if curves is None else curves)


@cache
def _library(curves: int) -> NDArray[np.float32]:
    drawn = np.empty((curves, LEVELS + 1), np.float32)
    for start in range(0, curves, _MOST_AT_A_TIME):
        part = curves_at(_library_points(start // _MOST_AT_A_TIME))
        drawn[start : start + len(part)] = part[: curves - start]
    drawn.flags.writeable = False
    return drawn


def _library_points(number: int) -> FloatArray:
    """Return the points of one part of the library, shape ``(_MOST_AT_A_TIME, DIMENSION)``."""
    rng = generator(_LIBRARY_SEED, Stream.TOLERANCE, 1, number)
    return np.stack([rng.random(_MOST_AT_A_TIME) for _ in range(DIMENSION)], axis=1)


def _points_at(places: IntArray) -> FloatArray:
    """Return the points of curves of the library, shape ``(n, DIMENSION)``."""
    points = np.empty((len(places), DIMENSION))
    parts = places // _MOST_AT_A_TIME
    for part in np.unique(parts).tolist():
        points[parts == part] = _library_points(part)[places[parts == part] % _MOST_AT_A_TIME]
    return points


def curves_at(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the curves at points of the unit cube, in which the prior is uniform, shape ``(n, LEVELS + 1)``.

    Args:
        points: Shape ``(n, DIMENSION)``: middle, height and steepness of two steps; then middle and depth of a fall,
            whether there is one, and its steepness.
    """
    columns = points.T[:, :, None]

    def between(column: int, low: float, high: float) -> NDArray[np.floating]:
        return np.asarray(low + (high - low) * columns[column])

    safe = np.ones((len(points), LEVELS + 1), points.dtype)
    for first in (0, 3):
        middle = between(first, 0.0, 1.2)
        height = np.exp(between(first + 1, math.log(0.001), 0.0))
        safe *= 1.0 - height * _step(middle, np.exp(between(first + 2, math.log(0.01), math.log(0.3))))
    middle = between(6, 0.05, 1.0)
    depth = between(7, 0.3, 1.0) * (columns[8] < FALLING)
    fall = depth * _step(middle, np.exp(between(9, math.log(0.02), math.log(0.2))))
    return np.asarray((1.0 - safe) * (1.0 - fall))


def _step(middle: NDArray[np.floating], scale: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return logistic steps that begin at 0, shape ``(n, LEVELS + 1)``."""
    at_zero = 1.0 / (1.0 + np.exp(np.minimum(middle / scale, 80.0)))
    at = severities().astype(middle.dtype)
    steps = 1.0 / (1.0 + np.exp(np.clip((middle - at) / scale, -50.0, 50.0)))
    return np.asarray((steps - at_zero) / (1.0 - at_zero))


def scaled(curves: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return curves that end at 1, for the most severe error in the drives that are vulnerable to it."""
    return np.asarray(np.minimum(curves / np.maximum(curves[:, -1:], 1e-6), 1.0))


def weights(counts: Counts, curves: NDArray[np.float32]) -> FloatArray:
    """Return the posterior probability of each curve of a library in each cell, shape ``(cells, curves)``.

    Args:
        counts: The results.
        curves: The library.
    """
    likely = _log_likelihoods(counts, curves)
    likelihood = np.exp(likely - likely.max(axis=1, keepdims=True))
    return np.asarray(likelihood / likelihood.sum(axis=1, keepdims=True))


def _log_likelihoods(counts: Counts, curves: NDArray[np.floating]) -> FloatArray:
    """Return the log-likelihood of each curve in each cell, shape ``(cells, curves)``."""
    parts = []
    drives, caused = counts.drives.astype(np.float64), counts.caused.astype(np.float64)
    for start in range(0, len(curves), _MOST_AT_A_TIME):
        shares = np.clip(curves[start : start + _MOST_AT_A_TIME, 1:].astype(np.float64), 1e-6, 1.0 - 1e-6)
        parts.append(caused @ np.log(shares).T + (drives - caused) @ np.log1p(-shares).T)
    return np.concatenate(parts, axis=1)


def severity_at(shares: NDArray[np.floating], limit: float) -> FloatArray:
    """Return the severity at which curves first reach a limit, infinite where they never do.

    Args:
        shares: Shares at all severities, shape ``(n, LEVELS + 1)``.
        limit: The limit, in (0, 1).
    """
    above = shares >= limit
    first = np.argmax(above, axis=1)
    rows = np.arange(len(shares))
    high = shares[rows, first].astype(np.float64)
    low = shares[rows, np.maximum(first - 1, 0)].astype(np.float64)
    part = np.clip((limit - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    return np.where(above.any(axis=1), (np.maximum(first - 1, 0) + part) / LEVELS, np.inf)


def quantiles_of_sorted(
    values: NDArray[np.floating], probability: FloatArray, at: tuple[float, ...]
) -> list[float]:
    """Return quantiles of weighted values.

    Args:
        values: Ascending, shape ``(n,)``, possibly infinite.
        probability: Their weights, shape ``(n,)``.
        at: The wanted quantiles.
    """
    sums = np.cumsum(probability)
    places = np.minimum(np.searchsorted(sums, np.array(at) * sums[-1]), len(values) - 1)
    return [float(value) for value in values[places]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """An estimate with an interval.

    Attributes:
        value: Median.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Width of an interval of severities; severities beyond the scale count as `BEYOND`."""
        return min(self.high, BEYOND) - min(self.low, BEYOND)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fall:
    """A range of severities over which a larger error is safer.

    Attributes:
        from_severity: Where the share is highest.
        to_severity: Where it is lowest after that.
        from_share: Share of caused violations there.
        to_share: The lower one.
    """

    from_severity: float
    to_severity: float
    from_share: float
    to_share: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """Estimates for one cell.

    Attributes:
        drives: Drives with a verdict by level, for the levels 1 to `LEVELS`, shape ``(LEVELS,)``.
        caused: Those with a violation that the error caused, same shape.
        median: Median share of caused violations at each severity, shape ``(LEVELS + 1,)``.
        low: Lower end of its interval, same shape.
        high: Upper end of its interval, same shape.
        tolerated: Severity at which the share reaches the limit; infinite where it probably never does.
        fall: Where a larger error is safer; None if it nowhere clearly is.
        draws: Curves drawn from the posterior, shape ``(DRAWS, LEVELS + 1)``.
    """

    drives: IntArray
    caused: IntArray
    median: FloatArray
    low: FloatArray
    high: FloatArray
    tolerated: Interval
    fall: Fall | None
    draws: NDArray[np.float32]

    def predicted(self, levels: IntArray, rng: np.random.Generator, confidence: float) -> tuple[int, int]:
        """Return the interval of the number of caused violations in fresh drives.

        Args:
            levels: Levels of severity of the drives, from 0.
            rng: Draws the numbers.
            confidence: Probability that the interval covers the number.
        """
        shares = self.draws[:, levels]
        numbers = (rng.random(shares.shape) < shares).sum(axis=1)
        tail = 0.5 * (1.0 - confidence)
        low, high = np.quantile(numbers, [tail, 1.0 - tail], method="inverted_cdf")
        return int(low), int(high)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveShares:
    """The share of drives with a violation caused by a detector's errors, estimated from some of its drives.

    Ends of intervals are those of Gaffke for the mean of a bounded quantity, whatever its distribution: as in a
    Bayesian bootstrap, with one more drive that surely violates (or surely does not). They are those of Clopper and
    Pearson where each drive either violates or does not, and never meet. What is uncertain of the curve is added.

    Source: Gaffke, Three test statistics for a nonparametric one-sided hypothesis on the mean of a nonnegative
    variable, 2005; Learned-Miller and Thomas, A new confidence interval for the mean of a bounded random variable,
    2020. No case is known in which they cover less often than they should; `python -m benchmarks coverage` has
    figures.

    Attributes:
        counts: How many drives have each of some severities, shape ``(n,)``.
        low: Their shares by draw, at the lower end, shape ``(draws, n)``.
        high: The same at the upper end.
    """

    counts: IntArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, curves: Sequence[Curve], severity: FloatArray, is_bound: BoolArray | None = None) -> Self:
        """Return the shares of drives.

        Args:
            curves: The curve of the error; several if it is not known which applies, so that the interval covers all.
            severity: How gross the error is in each drive, shape ``(n,)``, n >= 1. Between two levels the nearer one
                counts; of what is beyond the scale, nothing is known but that the scale's end is milder.
            is_bound: Which severities are lower bounds, so that anything grosser on the scale may be true, same
                shape; none by default.
        """
        beyond = severity > 1.0 + 0.5 / LEVELS
        levels = np.rint(np.clip(severity, 0.0, 1.0) * LEVELS).astype(np.int64)
        levels[beyond] = LEVELS + 1
        bounds = np.zeros(len(levels), bool) if is_bound is None else is_bound
        (present, bounded), counts = np.unique(np.stack([levels, bounds]), axis=1, return_counts=True)
        draws = np.stack([curve.draws.astype(np.float64) for curve in curves])
        lowest, highest = draws.min(axis=0), draws.max(axis=0)
        within = np.minimum(present, LEVELS)
        # The best and the worst from each level on.
        best = np.minimum.accumulate(lowest[:, ::-1], axis=1)[:, ::-1]
        worst = np.maximum.accumulate(highest[:, ::-1], axis=1)[:, ::-1]
        low = np.where(bounded, best[:, within], lowest[:, within])
        high = np.where(bounded, worst[:, within], highest[:, within])
        return cls(counts=counts, low=low, high=np.where(present > LEVELS, 1.0, high))

    def interval(self, rng: np.random.Generator, confidence: float, drives: int | None = None) -> Interval:
        """Return the share of drives that violate, with an interval.

        Args:
            rng: Draws the weights of the drives.
            confidence: Probability that the interval covers the share.
            drives: Number of drives to assume, with the same errors in the same proportions; as many as there are by
                default.
        """
        scale = 1.0 if drives is None else drives / float(self.counts.sum())
        weights = rng.standard_gamma(
            np.append(self.counts * scale, 1.0), (len(self.high), len(self.counts) + 1)
        )
        sums = weights.sum(axis=1)
        tail = 0.5 * (1.0 - confidence)
        known, rest = weights[:, :-1], weights[:, -1]
        lows = (known * self.low).sum(axis=1) / sums
        highs = ((known * self.high).sum(axis=1) + rest) / sums
        middles = (known * (0.5 * (self.low + self.high))).sum(axis=1) / known.sum(axis=1)
        return Interval(
            value=float(np.median(middles)),
            low=float(np.quantile(lows, tail)),
            high=float(np.quantile(highs, 1.0 - tail)),
        )

    def needed(self, rng: np.random.Generator, confidence: float, limit: float, most: int) -> int | None:
        """Return how many drives with such errors would show on which side of a limit the share is.

        Args:
            rng: Draws the weights of the drives.
            confidence: Of the interval.
            limit: The limit.
            most: Most drives to consider.

        Returns:
            The number of drives, correct to a tenth; None if `most` would not do.
        """

        def decides(drives: int) -> bool:
            interval = self.interval(rng, confidence, drives)
            return interval.high <= limit or interval.low > limit

        few = many = int(self.counts.sum())
        while not decides(many):
            few, many = many, 2 * many
            if few >= most:
                return None
        while many - few > max(few // 10, 1):
            middle = (few + many) // 2
            few, many = (few, middle) if decides(middle) else (middle, many)
        return many


def flawless_drives(limit: float, confidence: float) -> int:
    """Return how many drives without any error show that a share is at most a limit."""
    return math.ceil(math.log(0.5 * (1.0 - confidence)) / math.log1p(-limit))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screening:
    """How often the most severe error causes a violation, and how far that covers milder errors.

    Drives that hold with the most severe error *leak* if they violate with a milder one. Their share is assumed to
    grow in proportion to severity. It is estimated from the audits of the group alone, each weighted by its severity;
    without audits it is unknown.

    Attributes:
        vulnerable: Screened drives with a violation that the grossest error caused.
        screened: All screened drives.
        audits: Audited drives by level, for the levels 1 to `LEVELS`, shape ``(LEVELS,)``; None if the search audits
            nothing and assumes that no drive leaks.
        leaks: Those that violated, same shape; None likewise.
    """

    vulnerable: int
    screened: int
    audits: IntArray | None
    leaks: IntArray | None

    @property
    def audited(self) -> int:
        """All audited drives."""
        return 0 if self.audits is None else int(self.audits.sum())

    @property
    def leaked(self) -> int:
        """All audited drives that violated."""
        return 0 if self.leaks is None else int(self.leaks.sum())

    @property
    def exposure(self) -> float:
        """The sum of the severities of all audits, which is equivalent to that many audits at severity 1."""
        return 0.0 if self.audits is None else float(self.audits @ severities()[1:])

    @property
    def likeliest_leak(self) -> float:
        """The estimated share of the other drives that leak at severity 1; 0 without audits."""
        return min(self.leaked / self.exposure, 1.0) if self.exposure else 0.0

    def vulnerable_share(self, at: FloatArray) -> FloatArray:
        """Return quantiles of the share of vulnerable drives, shape ``(len(at),)``."""
        from scipy.stats import beta  # slow to import

        rest = self.screened - self.vulnerable
        share: FloatArray = beta.ppf(at, self.vulnerable + 0.5, rest + 0.5)
        return share

    def leak(self, at: FloatArray) -> FloatArray:
        """Return quantiles of the share of the other drives that leak at severity 1, shape ``(len(at),)``.

        The prior is Jeffreys' for a share.
        """
        if self.audits is None or self.leaks is None:
            return np.zeros(len(at))
        chances = _LEAK_SHARES[:, None] * severities()[1:]
        likely = np.log(chances) @ self.leaks + np.log1p(-chances) @ (self.audits - self.leaks)
        sums = np.cumsum(np.exp(likely - likely.max()))
        places = np.minimum(np.searchsorted(sums, at * sums[-1]), len(sums) - 1)
        return np.asarray(_LEAK_SHARES[places])

    def draw(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw the share of vulnerable drives, and that of the others that leak, shape ``(count,)`` each."""
        vulnerable = rng.beta(self.vulnerable + 0.5, self.screened - self.vulnerable + 0.5, count)
        return vulnerable, self.leak(rng.random(count))

    @staticmethod
    def all_drives(curves: NDArray[np.floating], vulnerable: FloatArray, leak: FloatArray) -> FloatArray:
        """Return the shares among all drives, shape ``(n, LEVELS + 1)``.

        Args:
            curves: The shares among vulnerable drives, shape ``(n, LEVELS + 1)``.
            vulnerable: Share of vulnerable drives, shape ``(n,)`` or ``(1,)``.
            leak: Share of the others that leak at severity 1, same shape.
        """
        return (
            vulnerable[:, None] * curves.astype(np.float64)
            + ((1.0 - vulnerable) * leak)[:, None] * severities()
        )


# Midpoints of equal shares of Jeffreys' prior.
_LEAK_SHARES: Final = np.sin(0.5 * np.pi * (np.arange(4_000) + 0.5) / 4_000) ** 2


def curves_of(
    counts: Counts,
    screenings: Sequence[Screening | None],
    grossest: Sequence[bool],
    *,
    limit: float,
    confidence: float,
) -> list[Curve]:
    """Return the curves of all cells, with intervals.

    Args:
        counts: The results; of screened cells, those of vulnerable drives alone.
        screenings: The screening of each cell; None if there is none.
        grossest: Whether each cell is that of the error with which drives are screened. All vulnerable drives violate
            at severity 1 of that one, which is not counted.
        limit: Share of caused violations whose severity is wanted.
        confidence: Probability that an interval covers the truth, in (0, 1).
    """
    estimated: list[Curve | None] = [None] * len(screenings)
    for is_grossest in (False, True):
        places = [place for place, flag in enumerate(grossest) if flag is is_grossest]
        if places:
            curves = scaled(library()) if is_grossest else library()
            for start in range(0, len(places), _CELLS_AT_A_TIME):
                some = places[start : start + _CELLS_AT_A_TIME]
                part = Counts(drives=counts.drives[some], caused=counts.caused[some])
                for place, likely in zip(some, _log_likelihoods(part, curves), strict=True):
                    draws = _posterior_draws(counts, place, curves, likely, is_grossest=is_grossest)
                    screening = screenings[place]
                    if screening is not None:
                        rng = generator(_LIBRARY_SEED, Stream.TOLERANCE, 5, place)
                        draws = screening.all_drives(draws, *screening.draw(DRAWS, rng))
                    estimated[place] = _curve(
                        counts.drives[place], counts.caused[place], draws, limit=limit, confidence=confidence
                    )
    return [curve for curve in estimated if curve is not None]


def _posterior_draws(
    counts: Counts, place: int, curves: NDArray[np.floating], likely: FloatArray, *, is_grossest: bool
) -> FloatArray:
    """Draw curves from the posterior of a cell, shape ``(DRAWS, LEVELS + 1)``.

    Args:
        counts: The results of all cells.
        place: Place of the cell.
        curves: The library, scaled if the cell is that of the grossest error.
        likely: Log-likelihood of each curve of it.
        is_grossest: Whether the cell is that of the grossest error.
    """
    if effective_size(likely) >= LEAST_EFFECTIVE:
        return curves[resampled(likely, DRAWS)].astype(np.float64)
    own = Counts(drives=counts.drives[[place]], caused=counts.caused[[place]])

    def at(points: FloatArray) -> NDArray[np.floating]:
        shares = curves_at(points.astype(np.float32))
        return scaled(shares) if is_grossest else shares

    rng = generator(_LIBRARY_SEED, Stream.TOLERANCE, 6, place)
    points = posterior_draws(
        _points_at, likely, lambda points: _log_likelihoods(own, at(points))[0], DRAWS, rng
    )
    return at(points).astype(np.float64)


def _curve(
    drives: IntArray, caused: IntArray, draws: FloatArray, *, limit: float, confidence: float
) -> Curve:
    tail = 0.5 * (1.0 - confidence)
    at = [0.5, tail, 1.0 - tail]
    median, low, high = np.quantile(draws, at, axis=0)
    middle, first, last = np.quantile(severity_at(draws, limit), at, method="inverted_cdf").tolist()
    return Curve(
        drives=drives,
        caused=caused,
        median=median,
        low=low,
        high=high,
        tolerated=Interval(value=middle, low=first, high=last),
        fall=_fall(draws, median, confidence),
        draws=draws.astype(np.float32),
    )


def _fall(drawn: FloatArray, median: FloatArray, confidence: float) -> Fall | None:
    """Return the largest fall of the median curve if nearly all curves of the posterior fall there, too."""
    to = int(np.argmax(np.maximum.accumulate(median) - median))
    since = int(np.argmax(median[: to + 1]))
    falls = drawn[:, since] - drawn[:, to]
    if float((falls >= LEAST_FALL).mean()) < confidence:
        return None
    return Fall(
        from_severity=since / LEVELS,
        to_severity=to / LEVELS,
        from_share=float(median[since]),
        to_share=float(median[to]),
    )
