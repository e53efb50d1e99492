"""Kinematic roll-out of participants from their actions alone, and distances between solutions based on it.

Each action becomes up to three stretches of constant acceleration; lateral moves are smooth steps. Participants never
cross the outer edges of the road nor exceed their top speeds; an action that asks for more is cut off.

`trajectory_distances` and `encounter_distances` are TD and ED: as the paper has them, or of positions at equal times
(`Distance`). ED averages over all pairs of participants, so the ED of a solution to itself is not 0 if it has two or
more. Decisions about novelty therefore use `matched_distances`, which matches participants one to one.

Source: Tian et al., diversity of solutions.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np

from brink.search.space import BoolArray, FloatArray
from brink.search.traffic.constraint import KERB_ROOM_M
from brink.search.traffic.participants import (
    MAX_ACTIONS,
    MAX_SPEEDS_MPS,
    SIZES_M,
    Action,
    Gene,
    Kind,
    Participant,
    RoadLimits,
    Solution,
)

UNMATCHED_M: Final = 25.0
"""Distance charged for an unmatched participant: half the paper's start radius of 50 m."""

HORIZON_S: Final = 12.0
STEP_S: Final = 1.0
"""Time up to which trajectories are compared, and the time between the positions that are compared."""

_TIMES: Final = round(HORIZON_S / STEP_S) + 1
_BLOCK_ROWS: Final = 32
"""Solutions compared at a time, to keep temporary arrays small."""
_INSTANT_S: Final = 1e-9


class Distance(StrEnum):
    """How the distance between two trajectories is measured."""

    TIME = "time"
    """Mean distance between the positions at the same times, of what is driven within `HORIZON_S`."""
    PAPER = "paper"
    """Sum of the distances between the positions at the ends of the actions that both participants have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of motion with constant acceleration and one smooth lateral step.

    Attributes:
        gene: Position of the action that it belongs to.
        from_s: Start time.
        lasts_s: Duration.
        s_m: Station at the start.
        d_m: Offset at the start.
        heading_rad: Direction of travel without the lateral step: a multiple of pi/2.
        speed_mps: Speed at the start.
        accel_mps2: Acceleration.
        aside_m: Size of the lateral step, positive to its own left.
    """

    gene: int
    from_s: float
    lasts_s: float
    s_m: float
    d_m: float
    heading_rad: float
    speed_mps: float
    accel_mps2: float
    aside_m: float

    @property
    def end(self) -> tuple[float, float, float]:
        """Station, offset and speed at the end."""
        s_m, d_m = self.position(self.lasts_s)
        return s_m, d_m, max(0.0, self.speed_mps + self.accel_mps2 * self.lasts_s)

    def position(self, elapsed_s: float) -> tuple[float, float]:
        """Return station and offset at a time after the start of the stretch."""
        along_m = (self.speed_mps + 0.5 * self.accel_mps2 * elapsed_s) * elapsed_s
        left_m = self.aside_m * _smooth(elapsed_s / self.lasts_s)
        cos_yaw, sin_yaw = _direction(self.heading_rad)
        return (
            self.s_m + along_m * cos_yaw - left_m * sin_yaw,
            self.d_m + along_m * sin_yaw + left_m * cos_yaw,
        )


def _direction(heading_rad: float) -> tuple[float, float]:
    """Return the exact cosine and sine of a multiple of pi/2."""
    quarter = round(heading_rad / (0.5 * math.pi)) % 4
    return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]


def roll_out(participant: Participant, road: RoadLimits, until_s: float = 0.0) -> tuple[Stretch, ...]:
    """Return the motion of a participant.

    Args:
        participant: The participant; it complies with the road.
        road: The road.
        until_s: Time until which it keeps going at constant speed after its last action.
    """
    mover = _Mover(participant, road)
    for index, gene in enumerate(participant.genes):
        mover.act(index, gene)
    mover.coast(until_s)
    return tuple(mover.stretches)


class _Mover:
    """A participant during the roll-out. Mutable."""

    def __init__(self, participant: Participant, road: RoadLimits) -> None:
        self._kind = participant.kind
        self._road = road
        self._time_s = 0.0
        self._s_m, self._d_m = participant.ds_m, participant.dd_m
        self._along_rad = self._heading_rad = participant.dyaw_rad
        self._speed = participant.speed_mps
        self.stretches: list[Stretch] = []

    def act(self, index: int, gene: Gene) -> None:
        """Carry out one action."""
        magnitude, duration_s = gene.magnitude, gene.duration_s
        if not self._is_crossing:
            self._heading_rad = self._along_rad
        match gene.action:
            case Action.KEEP:
                self._move(index, duration_s, 0.0)
            case Action.ACCELERATE:
                self._move(index, duration_s, magnitude)
            case Action.DECELERATE | Action.BRAKE:
                self._move(index, duration_s, -magnitude)
            case Action.CHANGE_LEFT:
                self._move(index, duration_s, 0.0, magnitude * self._road.lane_width_m)
            case Action.CHANGE_RIGHT:
                self._move(index, duration_s, 0.0, -magnitude * self._road.lane_width_m)
            case Action.CUT_IN:
                cos_yaw, _ = _direction(self._heading_rad)
                self._move(index, duration_s, -magnitude, -self._d_m * cos_yaw)
            case Action.CROSS:
                self._cross(index, duration_s, magnitude)

    def coast(self, until_s: float) -> None:
        """Keep going at constant speed until a time; a pedestrian on the road finishes crossing."""
        if until_s - self._time_s > _INSTANT_S:
            self._move(self.stretches[-1].gene, until_s - self._time_s, 0.0)

    @property
    def _is_crossing(self) -> bool:
        """Whether this is a pedestrian on the carriageway, who always keeps walking to the other side."""
        return self._kind is Kind.PEDESTRIAN and self._road.on_carriageway(self._d_m)

    def _cross(self, index: int, duration_s: float, speed: float) -> None:
        """Walk to the other side of the road and wait there."""
        if not self._is_crossing:
            left = self._d_m > 0.5 * (self._road.left_kerb_m + self._road.right_kerb_m)
            self._heading_rad = -0.5 * math.pi if left else 0.5 * math.pi
        self._speed = speed
        self._move(index, duration_s, 0.0)

    def _move(self, index: int, duration_s: float, accel_mps2: float, aside_m: float = 0.0) -> None:
        """Add a stretch until the top speed or a standstill is reached, and another for the remaining time."""
        if aside_m:
            aside_m = self._limited_step(aside_m)
        fastest = MAX_SPEEDS_MPS[self._kind]
        changes_s = duration_s
        if accel_mps2 < 0:
            changes_s = min(duration_s, self._speed / -accel_mps2)
        elif accel_mps2 > 0:
            changes_s = min(duration_s, max(0.0, fastest - self._speed) / accel_mps2)
        self._stretch(index, changes_s, accel_mps2, aside_m * _smooth(changes_s / duration_s))
        rest_m = aside_m * (1.0 - _smooth(changes_s / duration_s))
        self._stretch(index, duration_s - changes_s, 0.0, rest_m)

    def _limited_step(self, aside_m: float) -> float:
        """Return the part of a lateral step that stays on the carriageway; 0 in a side street."""
        cos_yaw, sin_yaw = _direction(self._heading_rad)
        if sin_yaw:
            return 0.0
        half_m = 0.5 * SIZES_M[self._kind][1]
        low_m = -0.5 * self._road.lane_width_m + half_m
        high_m = 1.5 * self._road.lane_width_m - half_m
        target_m = min(max(self._d_m + aside_m * cos_yaw, low_m), high_m)
        return (target_m - self._d_m) * cos_yaw

    def _stretch(self, index: int, lasts_s: float, accel_mps2: float, aside_m: float) -> None:
        if lasts_s <= _INSTANT_S:
            return
        lasts_s, waits_s = self._until_edge(lasts_s, accel_mps2)
        if lasts_s > _INSTANT_S:
            self._append(index, lasts_s, self._speed, accel_mps2, aside_m)
        if waits_s > _INSTANT_S:
            self._append(index, waits_s, 0.0, 0.0, 0.0)

    def _until_edge(self, lasts_s: float, accel_mps2: float) -> tuple[float, float]:
        """Return how long a pedestrian walks to the far edge of the pavement, and how long they then wait there."""
        if self._kind is not Kind.PEDESTRIAN or not _direction(self._heading_rad)[1]:
            return lasts_s, 0.0
        road = self._road
        outer_m = road.pavement_m - KERB_ROOM_M
        edge_m = road.left_kerb_m + outer_m if self._heading_rad > 0 else road.right_kerb_m - outer_m
        walks_s = min(lasts_s, _travel_time_s(abs(edge_m - self._d_m), self._speed, accel_mps2))
        return walks_s, lasts_s - walks_s

    def _append(
        self, index: int, lasts_s: float, speed_mps: float, accel_mps2: float, aside_m: float
    ) -> None:
        stretch = Stretch(
            gene=index,
            from_s=self._time_s,
            lasts_s=lasts_s,
            s_m=self._s_m,
            d_m=self._d_m,
            heading_rad=self._heading_rad,
            speed_mps=speed_mps,
            accel_mps2=accel_mps2,
            aside_m=aside_m,
        )
        self.stretches.append(stretch)
        self._time_s = stretch.from_s + stretch.lasts_s
        self._s_m, self._d_m, self._speed = stretch.end


def _travel_time_s(distance_m: float, speed_mps: float, accel_mps2: float) -> float:
    """Return the time needed for a distance; infinite if it is never covered."""
    squared = speed_mps * speed_mps + 2.0 * accel_mps2 * distance_m
    arrives_mps = speed_mps + math.sqrt(squared) if squared >= 0 else 0.0
    return 2.0 * distance_m / arrives_mps if arrives_mps > 0 else math.inf


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


def waypoints(participant: Participant, road: RoadLimits) -> FloatArray:
    """Return a participant's position at the end of each action.

    Returns:
        Stations and offsets in m, shape ``(actions, 2)``.
    """
    ends = np.full((len(participant.genes), 2), np.nan)
    for stretch in roll_out(participant, road):
        ends[stretch.gene] = stretch.end[:2]
    return ends


def positions(participant: Participant, road: RoadLimits) -> FloatArray:
    """Return a participant's positions every `STEP_S` from the start until `HORIZON_S`.

    After its last action it keeps going, as it does in the simulator.

    Returns:
        Stations and offsets in m, shape ``(times, 2)``.
    """
    stretches = iter(roll_out(participant, road, HORIZON_S))
    current = next(stretches)
    sampled = []
    for step in range(_TIMES):
        time_s = step * STEP_S
        while time_s > current.from_s + current.lasts_s and (following := next(stretches, None)) is not None:
            current = following
        sampled.append(current.position(min(time_s - current.from_s, current.lasts_s)))
    return np.array(sampled)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rollouts:
    """Positions of n solutions with up to p participants at up to g points each.

    Attributes:
        measure: How distances are measured.
        points: Stations and offsets in m, at the ends of actions or at fixed times, NaN where there are none, shape
            ``(n, p, g, 2)``.
        counts: Numbers of points, 0 for a missing participant, shape ``(n, p)``.
    """

    measure: Distance
    points: FloatArray
    counts: FloatArray

    @classmethod
    def of(
        cls, solutions: Iterable[Solution], count: int, road: RoadLimits, measure: Distance = Distance.TIME
    ) -> "Rollouts":
        """Roll out solutions.

        Args:
            solutions: The participants of each solution.
            count: Largest number of participants in a solution (p).
            road: The road they are on.
            measure: How distances are measured.
        """
        points_of = positions if measure is Distance.TIME else waypoints
        listed = [[points_of(participant, road) for participant in solution] for solution in solutions]
        return cls.of_points(listed, count, measure)

    @classmethod
    def of_points(
        cls, solutions: Sequence[Sequence[Any]], count: int, measure: Distance = Distance.TIME
    ) -> "Rollouts":
        """Return the roll-outs of solutions whose positions are known.

        Args:
            solutions: The points of each participant of each solution, each of shape ``(points, 2)``.
            count: Largest number of participants in a solution (p).
            measure: How distances are measured.
        """
        most = _TIMES if measure is Distance.TIME else MAX_ACTIONS
        points = np.full((len(solutions), count, most, 2), np.nan)
        counts = np.zeros((len(solutions), count))
        for row, participants in enumerate(solutions):
            for column, known in enumerate(participants):
                points[row, column, : len(known)] = known
                counts[row, column] = len(known)
        return cls(measure=measure, points=points, counts=counts)

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: Any) -> "Rollouts":
        """Return the roll-outs of the given rows."""
        return Rollouts(measure=self.measure, points=self.points[rows], counts=self.counts[rows])


def _summed_distances(first: Rollouts, second: Rollouts) -> tuple[FloatArray, FloatArray]:
    """Return the sum of distances between the points that two participants share, and the number of these points."""
    apart = first.points[:, None, :, None] - second.points[None, :, None, :]
    distances = np.sqrt((apart * apart).sum(axis=-1))
    counts = np.minimum(first.counts[:, None, :, None], second.counts[None, :, None, :])
    return np.nansum(distances, axis=-1), counts


def trajectory_distances(first: Rollouts, second: Rollouts) -> tuple[FloatArray, BoolArray]:
    """Return the distance TD for all pairs of participants, and which pairs exist.

    Returns:
        Distances in m, 0 if a participant is missing, and whether neither is; both of shape ``(n, m, p, q)``.
    """
    sums, counts = _summed_distances(first, second)
    if first.measure is Distance.PAPER:
        return sums, counts > 0
    return sums / np.maximum(counts, 1.0), counts > 0


def encounter_distances(first: Rollouts, second: Rollouts) -> FloatArray:
    """Return the distance ED for all pairs of solutions: the mean of TD over all pairs of their participants.

    Returns:
        Distances in m, shape ``(n, m)``.
    """
    found = np.empty((len(first), len(second)))
    for rows, columns in _blocks(len(first), len(second)):
        distances, paired = trajectory_distances(first.take(rows), second.take(columns))
        found[rows, columns] = distances.sum(axis=(2, 3)) / paired.sum(axis=(2, 3))
    return found


def participant_distances(first: Rollouts, second: Rollouts) -> FloatArray:
    """Return the mean TD from each participant of `first` to all participants of `second`.

    Returns:
        Distances in m, NaN for a missing participant, shape ``(n, p)``.
    """
    totals, pairs = np.zeros(first.counts.shape), np.zeros(first.counts.shape)
    for rows, columns in _blocks(len(first), len(second)):
        distances, paired = trajectory_distances(first.take(rows), second.take(columns))
        totals[rows] += distances.sum(axis=(1, 3))
        pairs[rows] += paired.sum(axis=(1, 3))
    return np.where(pairs > 0, totals / np.maximum(pairs, 1.0), np.nan)


def _blocks(rows: int, columns: int) -> Iterator[tuple[slice, slice]]:
    for row in range(0, rows, _BLOCK_ROWS):
        for column in range(0, columns, _BLOCK_ROWS):
            yield slice(row, row + _BLOCK_ROWS), slice(column, column + _BLOCK_ROWS)


def matched_distance(first: Rollouts, second: Rollouts) -> float:
    """Return the distance between two solutions under the best one-to-one matching of their participants.

    The distance of a matched pair is its mean distance per point; an unmatched participant counts `UNMATCHED_M`.
    Identical solutions have the distance 0.

    Args:
        first: Roll-out of one solution.
        second: Roll-out of one solution.

    Returns:
        Mean over matched pairs and unmatched participants, in m.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    sums, counts = _summed_distances(first, second)
    here, there = int((first.counts[0] > 0).sum()), int((second.counts[0] > 0).sum())
    present = np.ix_(first.counts[0] > 0, second.counts[0] > 0)
    costs = sums[0, 0][present] / counts[0, 0][present]
    rows, columns = linear_sum_assignment(costs)
    unmatched = max(here, there) - len(rows)
    return float((costs[rows, columns].sum() + UNMATCHED_M * unmatched) / max(here, there))


def matched_distances(first: Rollouts, second: Rollouts) -> FloatArray:
    """Return `matched_distance` for all pairs of solutions, in m, shape ``(n, m)``."""
    return np.array(
        [
            [matched_distance(first.take([row]), second.take([column])) for column in range(len(second))]
            for row in range(len(first))
        ]
    ).reshape(len(first), len(second))
