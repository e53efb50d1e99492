"""The kinematic roll-out: where participants are, by their actions alone, before anything is simulated.

Each action becomes one to three stretches of constant acceleration; lateral moves are smooth steps. Participants
never leave their side of the road's edges nor exceed their speeds: what an action asks beyond that is cut off.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.actions.participants import (
    FASTEST_MPS,
    MOST_ACTIONS,
    SIZES_M,
    Action,
    Gene,
    Kind,
    Participant,
)
from brink.search.actions.placing import KERB_ROOM_M
from brink.search.actions.road import RoadLimits
from brink.search.component import FloatArray

_INSTANT_S: Final = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Motion with a constant acceleration and one smooth lateral step.

    Attributes:
        gene: Position of the action that it belongs to.
        from_s: When it begins.
        lasts_s: How long it takes.
        s_m: Station at its beginning.
        d_m: Offset at its beginning.
        heading_rad: Direction of travel, but for the lateral step: a multiple of half of pi.
        speed_mps: Speed at its beginning.
        accel_mps2: Acceleration.
        aside_m: How far it goes to its own left meanwhile.
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
        """Station, offset and speed at its end."""
        t = self.lasts_s
        along_m = (self.speed_mps + 0.5 * self.accel_mps2 * t) * t
        cos_yaw, sin_yaw = _direction(self.heading_rad)
        return (
            self.s_m + along_m * cos_yaw - self.aside_m * sin_yaw,
            self.d_m + along_m * sin_yaw + self.aside_m * cos_yaw,
            max(0.0, self.speed_mps + self.accel_mps2 * t),
        )


def _direction(heading_rad: float) -> tuple[float, float]:
    """Return cosine and sine of a multiple of half of pi, exactly."""
    quarter = round(heading_rad / (0.5 * math.pi)) % 4
    return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]


def rolled_out(participant: Participant, road: RoadLimits, until_s: float = 0.0) -> tuple[Stretch, ...]:
    """Return the motion of a participant while its actions last, and on as it is until a time."""
    mover = _Mover(participant, road)
    for index, gene in enumerate(participant.genes):
        mover.act(index, gene)
    mover.go_on(until_s)
    return tuple(mover.stretches)


class _Mover:
    """A participant under way. Changes in place."""

    def __init__(self, participant: Participant, road: RoadLimits) -> None:
        self._kind = participant.kind
        self._road = road
        self._time_s = 0.0
        self._s_m, self._d_m = participant.ds_m, participant.dd_m
        self._along_rad = self._heading_rad = participant.dyaw_rad
        self._speed = participant.speed_mps
        self.stretches: list[Stretch] = []

    def act(self, index: int, gene: Gene) -> None:
        """Go on by one action."""
        magnitude, over_s = gene.magnitude, gene.duration_s
        if not self._crossing:
            self._heading_rad = self._along_rad
        match gene.action:
            case Action.KEEP:
                self._move(index, over_s, 0.0)
            case Action.ACCELERATE:
                self._move(index, over_s, magnitude)
            case Action.DECELERATE | Action.BRAKE:
                self._move(index, over_s, -magnitude)
            case Action.CHANGE_LEFT:
                self._move(index, over_s, 0.0, magnitude * self._road.lane_width_m)
            case Action.CHANGE_RIGHT:
                self._move(index, over_s, 0.0, -magnitude * self._road.lane_width_m)
            case Action.CUT_IN:
                cos_yaw, _ = _direction(self._heading_rad)
                self._move(index, over_s, -magnitude, -self._d_m * cos_yaw)
            case Action.CROSS:
                self._cross(index, over_s, magnitude)

    def go_on(self, until_s: float) -> None:
        """Go on as it is until a time; who is crossing the road finishes that."""
        if until_s - self._time_s > _INSTANT_S:
            self._move(self.stretches[-1].gene, until_s - self._time_s, 0.0)

    @property
    def _crossing(self) -> bool:
        """Whether it is a person on the carriageway, who walks on to the other side whatever else it does."""
        return self._kind is Kind.PEDESTRIAN and self._road.on_carriageway(self._d_m)

    def _cross(self, index: int, over_s: float, speed: float) -> None:
        """Walk to the other side of the road, and wait there."""
        if not self._crossing:
            left = self._d_m > 0.5 * (self._road.left_kerb_m + self._road.right_kerb_m)
            self._heading_rad = -0.5 * math.pi if left else 0.5 * math.pi
        self._speed = speed
        self._move(index, over_s, 0.0)

    def _move(self, index: int, over_s: float, accel_mps2: float, aside_m: float = 0.0) -> None:
        """Add stretches: while the acceleration lasts, then at the speed that it ends with."""
        if aside_m:
            aside_m = self._room_aside(aside_m)
        fastest = FASTEST_MPS[self._kind]
        changes_s = over_s
        if accel_mps2 < 0:
            changes_s = min(over_s, self._speed / -accel_mps2)
        elif accel_mps2 > 0:
            changes_s = min(over_s, max(0.0, fastest - self._speed) / accel_mps2)
        self._stretch(index, changes_s, accel_mps2, aside_m * _smooth(changes_s / over_s))
        rest_m = aside_m * (1.0 - _smooth(changes_s / over_s))
        self._stretch(index, over_s - changes_s, 0.0, rest_m)

    def _room_aside(self, aside_m: float) -> float:
        """Return how much of a step to its own left keeps it on the carriageway; nobody in a street steps aside."""
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
            stretch = Stretch(
                gene=index, from_s=self._time_s, lasts_s=lasts_s, s_m=self._s_m, d_m=self._d_m,
                heading_rad=self._heading_rad, speed_mps=self._speed, accel_mps2=accel_mps2, aside_m=aside_m,
            )  # fmt: skip
            self._append(stretch)
        if waits_s > _INSTANT_S:
            self._append(
                Stretch(
                    gene=index, from_s=self._time_s, lasts_s=waits_s, s_m=self._s_m, d_m=self._d_m,
                    heading_rad=self._heading_rad, speed_mps=0.0, accel_mps2=0.0, aside_m=0.0,
                )
            )  # fmt: skip

    def _until_edge(self, lasts_s: float, accel_mps2: float) -> tuple[float, float]:
        """Return how long a person walks before the far pavement ends, and how long it then waits."""
        if self._kind is not Kind.PEDESTRIAN or not _direction(self._heading_rad)[1]:
            return lasts_s, 0.0
        road = self._road
        outer_m = road.pavement_m - KERB_ROOM_M
        edge_m = road.left_kerb_m + outer_m if self._heading_rad > 0 else road.right_kerb_m - outer_m
        walks_s = min(lasts_s, _time_for(abs(edge_m - self._d_m), self._speed, accel_mps2))
        return walks_s, lasts_s - walks_s

    def _append(self, stretch: Stretch) -> None:
        self.stretches.append(stretch)
        self._time_s = stretch.from_s + stretch.lasts_s
        self._s_m, self._d_m, self._speed = stretch.end


def _time_for(way_m: float, speed_mps: float, accel_mps2: float) -> float:
    """Return how long a way takes; infinite if it is never done."""
    squared = speed_mps * speed_mps + 2.0 * accel_mps2 * way_m
    arrives_mps = speed_mps + math.sqrt(squared) if squared >= 0 else 0.0
    return 2.0 * way_m / arrives_mps if arrives_mps > 0 else math.inf


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


def waypoints(participant: Participant, road: RoadLimits) -> FloatArray:
    """Return where a participant is at the end of each of its actions.

    Returns:
        Stations and offsets in m, shape ``(actions, 2)``.
    """
    ends = np.full((len(participant.genes), 2), np.nan)
    for stretch in rolled_out(participant, road):
        ends[stretch.gene] = stretch.end[:2]
    return ends


def padded_waypoints(
    everybody: Iterable[Sequence[Participant]], count: int, road: RoadLimits
) -> tuple[FloatArray, FloatArray]:
    """Return the waypoints of many solutions as arrays.

    Args:
        everybody: The participants of each solution.
        count: Most participants that a solution has.
        road: Where they are.

    Returns:
        Waypoints, shape ``(n, count, MOST_ACTIONS, 2)``, NaN where there are none; and the numbers of actions, 0
        where there is nobody, shape ``(n, count)``.
    """
    solutions = list(everybody)
    points = np.full((len(solutions), count, MOST_ACTIONS, 2), np.nan)
    actions = np.zeros((len(solutions), count))
    for row, participants in enumerate(solutions):
        for column, participant in enumerate(participants):
            ends = waypoints(participant, road)
            points[row, column, : len(ends)] = ends
            actions[row, column] = len(ends)
    return points, actions
