"""Draws the errors of a process for one road user, and tracks the state and bin of the process.

Draws are addressed by the episode's seed, the road user and the perception step, so that they depend on nothing that
happened before. This module has no heavy imports: a fit uses the same states and bins.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Final, NamedTuple

from brink.sim.driving.interface import PERCEPTION_STEP_S, ObstacleLabel
from brink.sim.urban.error_process import (
    AGES_S,
    AT_ONCE,
    CONSTANT,
    EDGES_M,
    ERRORS,
    FOUND,
    FOUND_FIRST,
    GROUPS,
    LOST,
    SCORES,
    SEEN,
    STAYS_WRONG,
    WRONG_LABEL,
    ErrorProcess,
)
from brink.sim.world.streams import Stream, generator

LONG_AGO: Final = 10**6
"""Age in images of a state that began before the drive did."""
_AGE_STEPS: Final = tuple(round(age_s / PERCEPTION_STEP_S) for age_s in AGES_S)


def age_class(steps: int) -> int:
    """Return the class of the age of a state, 0 to 2.

    Args:
        steps: Images since the state began, at least 1.
    """
    return bisect_left(_AGE_STEPS, steps)


def bin_of(depth_m: float) -> int:
    """Return the bin of a distance."""
    return max(bisect_right(EDGES_M, depth_m) - 1, 0)


def group_of(label: ObstacleLabel, *, is_target: bool) -> int:
    """Return the group of a road user.

    Args:
        label: What it is.
        is_target: Whether it is the nearest vehicle in the ego's lane.
    """
    if label is ObstacleLabel.PERSON:
        return GROUPS.index("pedestrian")
    return GROUPS.index("lead" if is_target else "vehicle")


class Drawn(NamedTuple):
    """How a road user is reported: whether its label is wrong, and its `ERRORS`."""

    is_wrong: bool
    far: float
    right_m: float
    size: float


class RoadUserErrors:
    """Draws the errors of one road user in an episode.

    Args:
        process: The process.
        seed: The episode's seed.
        index: Number of the road user.
        steps: Number of perception steps.
    """

    def __init__(self, process: ErrorProcess, *, seed: int, index: int, steps: int) -> None:
        self._process = process
        # Lists: for three numbers at a time, they are several times faster than arrays.
        self._chances: list[list[float]] = generator(seed, Stream.DETECTOR, index).random((steps, 2)).tolist()
        noise = generator(seed, Stream.DETECTOR_NOISE, index)
        self._constant: list[float] = noise.normal(size=len(ERRORS)).tolist()
        self._noise: list[list[float]] = noise.normal(size=(steps, len(ERRORS))).tolist()
        self._changing = self._noise[0]
        self._step = -2
        self._since = 0
        self._is_reported = False
        self._was_found = False
        self._was_wrong: bool | None = None

    def at(self, step: int, group: int, depth_m: float) -> Drawn | None:
        """Return how the road user is reported at a perception step at which it is in sight; None if it is not.

        Args:
            step: The perception step, later than before.
            group: Its group.
            depth_m: Its distance.
        """
        row, process = bin_of(depth_m), self._process
        kept: list[float] = process.kept[group].tolist()
        shares: list[float] = process.shares[group, row].tolist()
        noise = self._noise[step]
        if self._step == step - 1:
            self._changing = [
                keep * before + math.sqrt(1.0 - keep * keep) * new
                for keep, before, new in zip(kept, self._changing, noise, strict=False)
            ]
            self._go_on(step, shares)
        else:
            self._changing = noise
            self._begin(step, shares)
        self._step = step
        if not self._is_reported:
            return None
        wrong_share = _wrong_share(shares[WRONG_LABEL], kept[STAYS_WRONG], self._was_wrong)
        self._was_wrong = self._chances[step][1] < wrong_share
        quantiles: list[list[float]] = process.errors[group, row].tolist()
        far, right_m, size = (
            _between(math.sqrt(share) * constant + math.sqrt(1.0 - share) * changing, values)
            for share, constant, changing, values in zip(
                kept[CONSTANT:], self._constant, self._changing, quantiles, strict=True
            )
        )
        return Drawn(self._was_wrong, far, right_m, size)

    def _begin(self, step: int, shares: list[float]) -> None:
        """Draw the first image of a sighting."""
        is_first = step == 0
        self._was_wrong = None
        self._is_reported = self._chances[step][0] < shares[SEEN if is_first else AT_ONCE]
        self._was_found = is_first or self._is_reported
        self._since = -LONG_AGO if is_first else step

    def _go_on(self, step: int, shares: list[float]) -> None:
        """Draw another image of a sighting."""
        age = age_class(step - self._since)
        found = FOUND + age if self._was_found else FOUND_FIRST
        column = LOST + age if self._is_reported else found
        if self._chances[step][0] < shares[column]:
            self._is_reported = not self._is_reported
            self._was_found = True
            self._since = step


def _between(score: float, quantiles: Sequence[float]) -> float:
    """Return the error at a standard score, linear between the quantiles at `SCORES` and constant beyond them."""
    index = bisect_right(SCORES, score) - 1
    if index < 0:
        return quantiles[0]
    if index >= len(SCORES) - 1:
        return quantiles[-1]
    slope = (quantiles[index + 1] - quantiles[index]) / (SCORES[index + 1] - SCORES[index])
    return slope * (score - SCORES[index]) + quantiles[index]


def _wrong_share(share: float, stays: float, was_wrong: bool | None) -> float:
    """Return the probability of a wrong label, such that `share` of all labels are wrong."""
    if was_wrong is None or share >= 1.0:
        return share
    return stays if was_wrong else min(share * (1.0 - stays) / (1.0 - share), 1.0)
