"""The effect of a guard and its fallback: the same drives without and with them, compared with intervals.

The drives are independent draws, whatever seed they were drawn with: the unit of every interval is the drive. A share
of drives has Wilson's interval, a ratio of two sums over drives a gamma interval (`brink.search.analysis.intervals`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np

from brink.search.analysis.intervals import CONFIDENCE, ratio_interval
from brink.search.fitness import wilson_interval
from brink.search.space import BoolArray, FloatArray, IntArray

_HOUR_S: Final = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GuardedDrives:
    """Drives without and with a guard; arrays have one entry for each drive, shape ``(n,)``.

    Attributes:
        seed: Seed that the drive's scenario, behaviour and chance were drawn with.
        violated_without: Whether a requirement that counts is violated without the guard.
        violated_with: The same with the guard.
        other_with: Whether another requirement is violated with the guard that is not violated without it.
        held_with: Whether no requirement at all is violated with the guard.
        way_without_m: Distance driven without the guard.
        way_with_m: The same with it.
        time_with_s: Duration of the drive with the guard.
        alarms: Number of alarms.
        intervention_s: How long the fallback intervened.
    """

    seed: IntArray
    violated_without: BoolArray
    violated_with: BoolArray
    other_with: BoolArray
    held_with: BoolArray
    way_without_m: FloatArray
    way_with_m: FloatArray
    time_with_s: FloatArray
    alarms: IntArray
    intervention_s: FloatArray

    def __len__(self) -> int:
        return len(self.seed)

    def of(self, chosen: BoolArray) -> "GuardedDrives":
        """Return some of the drives, by a mask of shape ``(n,)``."""
        return GuardedDrives(**{name: getattr(self, name)[chosen] for name in self.__slots__})


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure with its interval.

    Attributes:
        value: The figure; None if there is nothing to divide by.
        low: Lower limit of the interval; None if a single drive says something of it, or none.
        high: Upper limit of the interval; None in the same cases.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardWorth:
    """The effect of a guard and its fallback on drives; shares are in [0, 1].

    Attributes:
        drives: Number of drives.
        seeds: Number of seeds.
        violations_without: Number of drives with a violation without the guard.
        violations_with: The same with the guard.
        prevented: Number of drives with a violation without the guard alone.
        prevented_entirely: Number of those in which no other requirement is violated with the guard, either.
        caused: Number of drives with a violation with the guard alone.
        share_without: Share of drives with a violation without the guard.
        share_with: The same with the guard.
        reduction: By what share the violations fall, prevented minus caused; negative if there are more.
        prevented_share: Share of the violations without the guard that are prevented.
        caused_share: Share of the safe drives that violate a requirement because of the fallback.
        other_share: Share of the safe drives that violate a requirement that does not count because of the fallback.
        distance_lost: By what share the mean distance falls; negative if it grows.
        distance_lost_when_safe: The same over the drives that are safe without the guard.
        false_alarms_per_h: Alarms in an hour of driving, over the drives that are safe without the guard.
        alarmed_when_safe: Share of those drives with an alarm.
        intervention_share: Share of the time during which the fallback intervenes.
    """

    drives: int
    seeds: int
    violations_without: int
    violations_with: int
    prevented: int
    prevented_entirely: int
    caused: int
    share_without: Estimate
    share_with: Estimate
    reduction: Estimate
    prevented_share: Estimate
    caused_share: Estimate
    other_share: Estimate
    distance_lost: Estimate
    distance_lost_when_safe: Estimate
    false_alarms_per_h: Estimate
    alarmed_when_safe: Estimate
    intervention_share: Estimate


def guard_worth(drives: GuardedDrives, *, confidence: float = CONFIDENCE) -> GuardWorth:
    """Return the effect of a guard and its fallback on some drives.

    Args:
        drives: The drives, at least one.
        confidence: Level of the intervals, in (0, 1).

    Raises:
        ValueError: There are no drives.
    """
    if not len(drives):
        raise ValueError("expected at least one drive, got none")
    before, after = drives.violated_without, drives.violated_with
    return GuardWorth(
        drives=len(drives),
        seeds=int(np.unique(drives.seed).size),
        violations_without=int(before.sum()),
        violations_with=int(after.sum()),
        prevented=int((before & ~after).sum()),
        prevented_entirely=int((before & ~after & drives.held_with).sum()),
        caused=int((~before & after).sum()),
        **{name: _estimate(name, *terms, confidence) for name, terms in _ratios(drives).items()},
    )


def _estimate(name: str, above: FloatArray, below: FloatArray, step: float, confidence: float) -> Estimate:
    total, divisor = float(above.sum()), float(below.sum())
    if divisor == 0.0:
        return Estimate(value=None, low=None, high=None)
    sign, offset = (-1.0, 1.0) if name in _FALLS else (1.0, 0.0)
    value = offset + sign * total / divisor
    if name in _SHARES:
        quantile = NormalDist().inv_cdf(0.5 * (1.0 + confidence))
        low, high = wilson_interval(round(total), round(divisor), quantile)
        return Estimate(value=value, low=float(low), high=float(high))
    limits = ratio_interval(above, below, step=step, confidence=confidence)
    if limits is None:
        return Estimate(value=value, low=None, high=None)
    least, most = sorted(offset + sign * limit for limit in limits)
    return Estimate(value=value, low=least, high=most)


_FALLS: Final = frozenset({"reduction", "distance_lost", "distance_lost_when_safe"})
"""Figures that are one minus their ratio: by how much something falls."""
_SHARES: Final = frozenset(
    {"share_without", "share_with", "prevented_share", "caused_share", "other_share", "alarmed_when_safe"}
)
"""Figures that are plain shares of drives."""


def _ratios(drives: GuardedDrives) -> Mapping[str, tuple[FloatArray, FloatArray, float]]:
    """Return the terms of both sums of each figure, shape ``(n,)`` each, and the largest step of the upper one."""
    unweighted = np.ones(len(drives))
    before, after = drives.violated_without.astype(float), drives.violated_with.astype(float)
    safe = 1.0 - before
    alarms = safe * drives.alarms
    longest_s = float(drives.intervention_s.max() or drives.time_with_s.mean())
    return {
        "share_without": (before, unweighted, 1.0),
        "share_with": (after, unweighted, 1.0),
        "reduction": (after, before, 1.0),
        "prevented_share": (before * (1.0 - after), before, 1.0),
        "caused_share": (safe * after, safe, 1.0),
        "other_share": (safe * drives.other_with, safe, 1.0),
        "distance_lost": (drives.way_with_m, drives.way_without_m, 0.0),
        "distance_lost_when_safe": (safe * drives.way_with_m, safe * drives.way_without_m, 0.0),
        "false_alarms_per_h": (alarms, safe * drives.time_with_s / _HOUR_S, max(float(alarms.max()), 1.0)),
        "alarmed_when_safe": (safe * (drives.alarms > 0), safe, 1.0),
        "intervention_share": (drives.intervention_s, drives.time_with_s, longest_s),
    }
