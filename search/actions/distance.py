"""How far solutions of participants are apart, by the roll-outs of their actions.

``trajectory_distances`` and ``encounter_distances`` are the paper's TD and ED. ED of a solution with itself is not 0
as soon as it has two participants, because all pairs count; decisions about what is new therefore use
`matched_distances`: participants matched one to one, distance a waypoint.

Source: Tian et al., diversity of solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from brink.search.component import FloatArray

UNMATCHED_M: Final = 25.0
"""Distance of a participant that the other solution has no counterpart for: half the radius in which they start."""

_ROWS: Final = 32
"""Solutions measured at a time, so that the arrays between stay small."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RolledOut:
    """The roll-outs of solutions.

    Attributes:
        points: Stations and offsets at the ends of actions in m, NaN where there are none, shape ``(n, p, g, 2)``.
        actions: Numbers of actions, 0 where there is nobody, shape ``(n, p)``.
    """

    points: FloatArray
    actions: FloatArray

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: Any) -> "RolledOut":
        """Return some of them."""
        return RolledOut(points=self.points[rows], actions=self.actions[rows])

    def followed_by(self, other: "RolledOut") -> "RolledOut":
        """Return these and then the others."""
        return RolledOut(
            points=np.concatenate([self.points, other.points]),
            actions=np.concatenate([self.actions, other.actions]),
        )


def trajectory_distances(first: RolledOut, second: RolledOut) -> tuple[FloatArray, FloatArray]:
    """Return TD of all pairs of participants, and how many waypoints each is a sum of.

    TD is the sum, over the actions that both have, of the distance between where they end.

    Returns:
        Distances in m and numbers of waypoints (0 where one of the two is nobody), both shape ``(n, m, p, q)``.
    """
    apart = first.points[:, None, :, None] - second.points[None, :, None, :]
    distances = np.sqrt((apart * apart).sum(axis=-1))
    return np.nansum(distances, axis=-1), np.minimum(
        first.actions[:, None, :, None], second.actions[None, :, None, :]
    )


def encounter_distances(first: RolledOut, second: RolledOut) -> FloatArray:
    """Return ED of all pairs of solutions: the mean of TD over all pairs of their participants.

    Returns:
        Distances in m, shape ``(n, m)``.
    """
    found = np.empty((len(first), len(second)))
    for rows, columns in _blocks(len(first), len(second)):
        sums, shared = trajectory_distances(first.take(rows), second.take(columns))
        found[rows, columns] = sums.sum(axis=(2, 3)) / (shared > 0).sum(axis=(2, 3))
    return found


def participant_distances(first: RolledOut, second: RolledOut) -> FloatArray:
    """Return the mean TD of each participant to all participants of the second solutions.

    Returns:
        Distances in m, NaN where there is nobody, shape ``(n, p)``.
    """
    totals, pairs = np.zeros(first.actions.shape), np.zeros(first.actions.shape)
    for rows, columns in _blocks(len(first), len(second)):
        sums, shared = trajectory_distances(first.take(rows), second.take(columns))
        totals[rows] += sums.sum(axis=(1, 3))
        pairs[rows] += (shared > 0).sum(axis=(1, 3))
    return np.where(pairs > 0, totals / np.maximum(pairs, 1.0), np.nan)


def _blocks(rows: int, columns: int) -> Iterator[tuple[slice, slice]]:
    """Yield the blocks of a matrix of distances."""
    for row in range(0, rows, _ROWS):
        for column in range(0, columns, _ROWS):
            yield slice(row, row + _ROWS), slice(column, column + _ROWS)


def matched_distance(first: RolledOut, second: RolledOut) -> float:
    """Return the distance of two solutions, 0 for equal ones.

    Participants are matched one to one so that the total is least. A pair's distance is its mean a waypoint; one
    that is left over counts as `UNMATCHED_M`.

    Args:
        first: One solution.
        second: One solution.

    Returns:
        Mean over matched and left-over participants, in m.
    """
    sums, shared = trajectory_distances(first, second)
    here, there = int((first.actions[0] > 0).sum()), int((second.actions[0] > 0).sum())
    present = shared[0, 0][np.ix_(first.actions[0] > 0, second.actions[0] > 0)]
    costs = sums[0, 0][np.ix_(first.actions[0] > 0, second.actions[0] > 0)] / present
    rows, columns = linear_sum_assignment(costs)
    left_over = max(here, there) - len(rows)
    return float((costs[rows, columns].sum() + UNMATCHED_M * left_over) / max(here, there))


def matched_distances(first: RolledOut, second: RolledOut) -> FloatArray:
    """Return `matched_distance` of all pairs, shape ``(n, m)``."""
    return np.array(
        [
            [matched_distance(first.take([row]), second.take([column])) for column in range(len(second))]
            for row in range(len(first))
        ]
    ).reshape(len(first), len(second))
