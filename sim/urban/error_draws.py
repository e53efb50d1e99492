"""Draws the errors of a process for one road user, and tracks the state and bin of the process.

Draws are addressed by the episode's seed, the road user and the perception step, so that they depend on nothing that
happened before. This module has no heavy imports: a fit uses the same states and bins.
"""

from typing import Final, NamedTuple

import numpy as np

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
    return sum(steps > limit for limit in _AGE_STEPS)


def bin_of(depth_m: float) -> int:
    """Return the bin of a distance."""
    return max(sum(depth_m >= edge_m for edge_m in EDGES_M) - 1, 0)


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
        self._chances = generator(seed, Stream.DETECTOR, index).random((steps, 2))
        noise = generator(seed, Stream.DETECTOR_NOISE, index)
        self._constant = noise.normal(size=len(ERRORS))
        self._noise = noise.normal(size=(steps, len(ERRORS)))
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
        kept, noise = process.kept[group], self._noise[step]
        if self._step == step - 1:
            keep = kept[: len(ERRORS)]
            self._changing = keep * self._changing + np.sqrt(1.0 - keep * keep) * noise
            self._go_on(step, process.shares[group, row].tolist())
        else:
            self._changing = noise
            self._begin(step, process.shares[group, row].tolist())
        self._step = step
        if not self._is_reported:
            return None
        wrong_share = _wrong_share(
            process.shares[group, row, WRONG_LABEL], kept[STAYS_WRONG], self._was_wrong
        )
        self._was_wrong = bool(self._chances[step, 1] < wrong_share)
        constant = kept[CONSTANT:]
        scores = np.sqrt(constant) * self._constant + np.sqrt(1.0 - constant) * self._changing
        far, right_m, size = (
            float(np.interp(score, SCORES, quantiles))
            for score, quantiles in zip(scores, process.errors[group, row], strict=True)
        )
        return Drawn(self._was_wrong, far, right_m, size)

    def _begin(self, step: int, shares: list[float]) -> None:
        """Draw the first image of a sighting."""
        is_first = step == 0
        self._was_wrong = None
        self._is_reported = bool(self._chances[step, 0] < shares[SEEN if is_first else AT_ONCE])
        self._was_found = is_first or self._is_reported
        self._since = -LONG_AGO if is_first else step

    def _go_on(self, step: int, shares: list[float]) -> None:
        """Draw another image of a sighting."""
        age = age_class(step - self._since)
        found = FOUND + age if self._was_found else FOUND_FIRST
        column = LOST + age if self._is_reported else found
        if self._chances[step, 0] < shares[column]:
            self._is_reported = not self._is_reported
            self._was_found = True
            self._since = step


def _wrong_share(share: float, stays: float, was_wrong: bool | None) -> float:
    """Return the probability of a wrong label, such that `share` of all labels are wrong."""
    if was_wrong is None or share >= 1.0:
        return share
    return stays if was_wrong else min(share * (1.0 - stays) / (1.0 - share), 1.0)
