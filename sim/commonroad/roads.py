"""The road of a recording: the ego's route through its lanelets, and where the road ends at the side.

The route is the cheapest chain of lanelets from the ego's start to a goal; a change of lane costs as much as
`CHANGE_COST_M`. Its line is the smoothed middle of these lanelets as arcs that join without a kink, so that driving
systems get the same kind of route as everywhere.

References:
    Bolton 1975, Biarc curves.
"""

import heapq
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.commonroad.recording import (
    WALKWAYS,
    FloatArray,
    Goal,
    Lanelet,
    Recording,
    RecordingError,
    contains,
    contains_each,
    unpacked,
)
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.trace import Surface
from brink.sim.world.ego import EGO_CAR
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import LaneRoute, Road, RoadStyle, Scenery
from brink.sim.world.scenario import RoadCurve

CHANGE_COST_M: Final = 30.0
BEYOND_M: Final = 60.0
"""Without a place as goal, the route is this much longer than the ego could drive."""
DEFAULT_LIMITS_MPS: Final = {"highway": 36.1, "interstate": 36.1, "country": 27.8, "urban": 13.9}
OTHER_LIMIT_MPS: Final = 13.9
"""Speed limit where the file states none; see `DEFAULT_LIMITS_MPS`."""
LANE_WIDTHS_M: Final = (2.2, 6.0)
_FACING_RAD: Final = math.radians(60.0)
_WINDOWS: Final = (31, 21, 11)
"""Points, a metre apart, over which the line is smoothed (Savitzky and Golay 1964, of third order)."""
_ASIDE_M: Final = 0.12
"""The widest window that moves no point by more than this is used, or else the narrowest."""
_SHORTEST_M: Final = 5.0
_NODES_M: Final = 4.0
_CHANGE_S: Final = 4.0
_CHANGE_M: Final = (25.0, 90.0)
GAP_M: Final = 2.0
"""Narrower gaps between lanelets count as road: maps of crossroads leave some."""
_BEYOND_M: Final = np.array([0.3, 0.7, 1.3, GAP_M])
_NEAR_M: Final = 30.0
FAR_M: Final = 15.0
_ROUNDING_M: Final = 1e-6
_EDGE_PIECE_M: Final = 2.0
_MARKING_M: Final = 0.12


@dataclass(frozen=True, slots=True, eq=False)
class RoadEdges:
    """Where the road ends at the side: the edges of lanelets beyond which no other lanelet lies within `GAP_M`.

    Attributes:
        polygons: Outlines of the lanelets that cars may drive on.
        boxes: The lowest and highest x and y of each, shape ``(k, 2, 2)``.
        starts: Starts of the segments of all side edges, shape ``(n, 2)``.
        ends: Their ends, shape ``(n, 2)``.
        is_edge: Whether the road ends there, shape ``(n,)``.
    """

    polygons: tuple[FloatArray, ...]
    boxes: FloatArray
    starts: FloatArray
    ends: FloatArray
    is_edge: NDArray[np.bool_]

    def gap_m(self, body: Rectangle) -> float | None:
        """Return how far a body is inside the road, negative if a corner has left it; None without edges.

        Args:
            body: The body. Distances of more than `FAR_M` from its middle count as that.
        """
        if not self.is_edge.any():
            return None
        centre = np.array([body.x_m, body.y_m])
        near = (np.abs(self.starts - centre) < FAR_M).all(axis=1)
        is_edge = self.is_edge[near]
        if not is_edge.any():
            return FAR_M
        corners = np.array(body.corners())
        starts = self.starts[near]
        along = self.ends[near] - starts
        to_corner = corners[:, None, :] - starts
        share = np.clip((to_corner * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
        apart = to_corner - share[:, :, None] * along
        distances = np.sqrt((apart * apart).sum(axis=2))
        to_edge = distances[:, is_edge].min(axis=1)
        around = ((self.boxes[:, 0] <= centre + FAR_M) & (self.boxes[:, 1] >= centre - FAR_M)).all(axis=1)
        on_lane = np.zeros(len(corners), dtype=np.bool_)
        for index in np.flatnonzero(around).tolist():
            if not on_lane.all():
                on_lane |= contains_each(self.polygons[index], corners)
        in_gap = distances.min(axis=1) < to_edge - _ROUNDING_M
        return float(np.where(on_lane | in_gap, to_edge, -to_edge).min())


@dataclass(frozen=True, eq=False)
class Place:
    """The road of a recording. Immutable; shared by all drives there.

    Attributes:
        recording: The recording.
        route: The ego's route; station 0 is where it begins.
    """

    recording: Recording
    route: LaneRoute

    @cached_property
    def road(self) -> Road:
        """The road as the world, the camera and the recorder know it: nothing stands beside it."""
        line = self.route.line
        return Road(
            curve=RoadCurve.STRAIGHT,
            style=RoadStyle(0.0, 0.0, self.route.lane_width_m, parking=False, main_stream=0, pace=1.0),
            length_m=line.length_m,
            centre=line,
            forward=line,
            backward=line.backwards(),
            junctions=(),
            crossing_m=0.0,
            scenery=Scenery(fixtures=(), surfaces=tuple(_surfaces(self.recording))),
        )

    @cached_property
    def edges(self) -> RoadEdges:
        """Where the road ends at the side."""
        line = self.route.line
        stations = np.arange(0.0, line.length_m + 5.0, 5.0).tolist()
        route = np.array([line.pose_at(one)[:2] for one in stations])
        return _road_edges(_drivable(self.recording.lanelets), route)


@lru_cache(maxsize=64)
def place_in(packed: str) -> Place:
    """Return the road of a packed recording; see `place_of`."""
    return place_of(Recording.of(unpacked(packed)))


def place_of(recording: Recording) -> Place:
    """Return the road of a recording with the ego's route.

    Raises:
        RecordingError: The ego begins on no lane or inside of somebody, or cannot reach its goal.
    """
    _check_start(recording)
    lanelets = _drivable(recording.lanelets)
    x_m, y_m, yaw_rad, speed_mps = recording.start
    starts = _facing(lanelets, x_m, y_m, yaw_rad)
    if not starts:
        raise RecordingError(
            "planningProblem: expected an initial state on a lanelet that cars drive on, in its direction"
        )
    chains = _chains_to_goals(recording, lanelets, starts)
    limit_mps = max(OTHER_LIMIT_MPS, speed_mps)
    reach_m = max(limit_mps, speed_mps) * recording.duration_s + BEYOND_M
    chain = _extended(lanelets, chains, reach_m)
    limits = [_limit_mps(lanelets[one]) for one in chain]
    points, oncoming = _middle(lanelets, chain, recording)
    line = _line(points)
    widths = np.concatenate([np.hypot(*(lanelets[one].left - lanelets[one].right).T) for one in chain])
    return Place(
        recording,
        LaneRoute(
            line=line,
            lane_width_m=float(np.clip(np.median(widths), *LANE_WIDTHS_M)),
            speed_limit_mps=min(limits),
            oncoming=oncoming,
        ),
    )


def _check_start(recording: Recording) -> None:
    x_m, y_m, yaw_rad, _ = recording.start
    ego = Rectangle(x_m, y_m, yaw_rad, 0.5 * EGO_CAR.length_m, 0.5 * EGO_CAR.width_m)
    for one in recording.road_users:
        step = 0 if one.stands else recording.start_step - one.first_step
        if 0 <= step < len(one.states):
            x, y, yaw, _ = one.states[step].tolist()
            if signed_gap_m(ego, Rectangle(x, y, yaw, 0.5 * one.length_m, 0.5 * one.width_m)) < 0.0:
                raise RecordingError(
                    f"planningProblem: expected an ego ({EGO_CAR.length_m:g} x {EGO_CAR.width_m:g} m) that begins "
                    f"with room around it; obstacle {one.id} is there"
                )


def _drivable(lanelets: Mapping[int, Lanelet]) -> dict[int, Lanelet]:
    return {number: one for number, one in lanelets.items() if one.kind not in WALKWAYS}


def _limit_mps(lanelet: Lanelet) -> float:
    if lanelet.limit_mps is not None:
        return lanelet.limit_mps
    return DEFAULT_LIMITS_MPS.get(lanelet.kind, OTHER_LIMIT_MPS)


def _turn(angle_rad: float) -> float:
    return abs((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)


def _facing(lanelets: Mapping[int, Lanelet], x_m: float, y_m: float, yaw_rad: float) -> dict[int, float]:
    """Return the lanelets at a point that lead its way, each with its angle to the heading."""
    found = {}
    for number, one in lanelets.items():
        if contains(one.polygon, x_m, y_m):
            centre = one.centre
            nearest = min(int(np.hypot(*(centre - (x_m, y_m)).T).argmin()), len(centre) - 2)
            dx, dy = centre[nearest + 1] - centre[nearest]
            turn = _turn(math.atan2(dy, dx) - yaw_rad)
            if turn < _FACING_RAD:
                found[number] = turn
    return found


def _length_m(points: FloatArray) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _chains_to_goals(
    recording: Recording, lanelets: Mapping[int, Lanelet], starts: Mapping[int, float]
) -> tuple[int, ...]:
    """Return the cheapest chain of lanelets from the start to a goal with a place; the start alone without one.

    Raises:
        RecordingError: No goal can be reached.
    """
    targets: set[int] = set()
    placed = [goal for goal in recording.goals if goal.areas]
    for goal in placed:
        targets.update(_lanelets_of(goal, lanelets))
    if not placed:
        return (min(starts, key=lambda number: (starts[number], number)),)
    if not targets:
        raise RecordingError("goalState: expected a place on a lanelet that cars drive on; it is on none")
    queue: list[tuple[float, tuple[int, ...]]] = [(10.0 * turn, (number,)) for number, turn in starts.items()]
    heapq.heapify(queue)
    done: set[int] = set()
    while queue:
        cost_m, chain = heapq.heappop(queue)
        number = chain[-1]
        if number in targets and not _lies_behind(recording, lanelets, chain, placed):
            return chain
        if number in done:
            continue
        done.add(number)
        one = lanelets[number]
        ways = [(_length_m(one.centre), other) for other in one.successors]
        ways += [(CHANGE_COST_M, beside.id) for beside in one.neighbours if beside and beside.same_way]
        for more_m, other in ways:
            if other in lanelets and other not in done:
                heapq.heappush(queue, (cost_m + more_m, (*chain, other)))
    raise RecordingError(
        f"goalState: expected a goal that a chain of lanelets leads to; none leads from "
        f"{' or '.join(map(str, sorted(starts)))} to {' or '.join(map(str, sorted(targets)))}"
    )


def _lies_behind(
    recording: Recording, lanelets: Mapping[int, Lanelet], chain: Sequence[int], goals: Sequence[Goal]
) -> bool:
    """Return whether all goals on the lanelet where the ego begins lie behind it."""
    if any(other in lanelets[one].successors for one, other in pairwise(chain)):
        return False
    x_m, y_m, yaw_rad, _ = recording.start
    ahead = [
        (point[0] - x_m) * math.cos(yaw_rad) + (point[1] - y_m) * math.sin(yaw_rad)
        for goal in goals
        for area in goal.areas
        for point in area
    ]
    return bool(max(ahead) < 0.0)


def _lanelets_of(goal: Goal, lanelets: Mapping[int, Lanelet]) -> set[int]:
    """Return the lanelets on which a goal lies."""
    if goal.lanelets:
        return set(goal.lanelets) & set(lanelets)
    found: set[int] = set()
    for area in goal.areas:
        x_m, y_m = area.mean(axis=0).tolist()
        found.update(number for number, one in lanelets.items() if contains(one.polygon, x_m, y_m))
    return found


def _extended(lanelets: Mapping[int, Lanelet], chain: tuple[int, ...], reach_m: float) -> tuple[int, ...]:
    """Return a chain that goes on until it is long enough or the map ends, straight on wherever it can."""
    length_m = sum(_length_m(lanelets[one].centre) for one in chain)
    while length_m < reach_m:
        last = lanelets[chain[-1]]
        following = [one for one in last.successors if one in lanelets and one not in chain]
        if not following:
            break
        begins = _heading(last.centre[-2:])
        chosen = min(
            following, key=lambda one: (_turn(_heading(lanelets[one].centre[[0, -1]]) - begins), one)
        )
        chain = (*chain, chosen)
        length_m += _length_m(lanelets[chosen].centre)
    return chain


def _heading(points: FloatArray) -> float:
    dx, dy = points[-1] - points[0]
    return math.atan2(dy, dx)


def _at_shares(points: FloatArray, shares: FloatArray) -> FloatArray:
    """Return the points at shares of the length of a polyline, shape ``(n, 2)``."""
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    at_m = shares * lengths[-1]
    return np.stack([np.interp(at_m, lengths, points[:, axis]) for axis in (0, 1)], axis=1)


def _middle(
    lanelets: Mapping[int, Lanelet], chain: Sequence[int], recording: Recording
) -> tuple[FloatArray, tuple[tuple[float, float], ...]]:
    """Return the middle of a chain of lanelets from the start on, and where an oncoming lane lies on its left.

    Successive lanelets that lie side by side are one section, along which the line moves from the first to the last.
    """
    sections: list[list[int]] = [[chain[0]]]
    for before, number in pairwise(chain):
        if number in lanelets[before].successors:
            sections.append([number])
        else:
            sections[-1].append(number)
    x_m, y_m, _, speed_mps = recording.start
    parts: list[FloatArray] = []
    oncoming: list[tuple[float, float]] = []
    length_m = 0.0
    for index, section in enumerate(sections):
        first, last = lanelets[section[0]].centre, lanelets[section[-1]].centre
        whole_m = max(_length_m(first), 0.1)
        begins = 0.0
        if index == 0:
            dense = _at_shares(first, np.linspace(0.0, 1.0, 400))
            begins = float(np.hypot(*(dense - (x_m, y_m)).T).argmin()) / 399.0
        shares = np.linspace(begins, 1.0, max(math.ceil((1.0 - begins) * whole_m), 2))
        points = _at_shares(first, shares)
        if len(section) > 1:
            change_m = (len(section) - 1) * float(np.clip(_CHANGE_S * speed_mps, *_CHANGE_M))
            change = min(change_m / whole_m, 0.95 * (1.0 - begins))
            done = np.clip((shares - begins) / max(change, 1e-6), 0.0, 1.0)
            weight = (done * done * (3.0 - 2.0 * done))[:, None]
            points = (1.0 - weight) * points + weight * _at_shares(last, shares)
        parts.append(points)
        left = lanelets[section[0]].neighbours[0]
        ends_m = length_m + _length_m(points)
        if len(section) == 1 and left is not None and not left.same_way and left.id in lanelets:
            oncoming.append((length_m, ends_m))
        length_m = ends_m
    return np.concatenate(parts), tuple(oncoming)


def _line(points: FloatArray) -> ReferenceLine:
    """Return a smooth line of arcs along points."""
    from scipy.signal import savgol_filter  # slow to import, and every simulation process imports this module

    length_m = _length_m(points)
    if length_m < _SHORTEST_M:
        raise RecordingError(f"expected a route of at least {_SHORTEST_M:g} m ahead of the ego")
    dense = _at_shares(points, np.linspace(0.0, 1.0, max(math.ceil(length_m), _WINDOWS[0]) + 1))
    step_m = length_m / (len(dense) - 1)
    for window in _WINDOWS:
        smooth, slopes = (
            savgol_filter(dense, window, 3, deriv=order, delta=step_m, axis=0, mode="interp")
            for order in (0, 1)
        )
        if window < len(dense) and np.hypot(*(smooth - dense).T).max() < _ASIDE_M:
            break
    count = max(math.ceil(length_m / _NODES_M), 1)
    at = np.linspace(0, len(dense) - 1, count + 1).round().astype(int)
    nodes = smooth[at]
    tangents = slopes[at] / np.maximum(np.hypot(*slopes[at].T), 1e-9)[:, None]
    pieces = [
        piece
        for index in range(count)
        for piece in _biarc(nodes[index], tangents[index], nodes[index + 1], tangents[index + 1])
    ]
    x_m, y_m = nodes[0].tolist()
    return ReferenceLine(x_m, y_m, math.atan2(tangents[0][1], tangents[0][0]), pieces)


def _biarc(start: FloatArray, leaves: FloatArray, end: FloatArray, arrives: FloatArray) -> Iterator[Piece]:
    """Yield the two arcs of equal tangent lengths from a point and direction to another."""
    chord, both = end - start, leaves + arrives
    spread, straight = 2.0 * (1.0 - float(leaves @ arrives)), float(chord @ both)
    square = float(chord @ chord)
    reach = (
        (math.sqrt(straight * straight + spread * square) - straight) / spread
        if spread > 1e-9
        else square / (2.0 * straight)
    )
    joint = 0.5 * (start + end + reach * (leaves - arrives))
    heading = leaves
    for origin, target in ((start, joint), (joint, end)):
        way = target - origin
        length_m = float(np.hypot(*way))
        if length_m < 1e-6:
            continue
        half = math.atan2(float(heading[0] * way[1] - heading[1] * way[0]), float(heading @ way))
        if abs(half) < 1e-7:
            yield Piece(length_m)
            continue
        curvature = 2.0 * math.sin(half) / length_m
        yield Piece(2.0 * half / curvature, curvature)
        turned = 2.0 * half
        heading = np.array(
            [
                heading[0] * math.cos(turned) - heading[1] * math.sin(turned),
                heading[0] * math.sin(turned) + heading[1] * math.cos(turned),
            ]
        )


def _road_edges(lanelets: Mapping[int, Lanelet], route: FloatArray) -> RoadEdges:
    """Return the side edges of the lanelets near a route.

    Args:
        lanelets: The lanelets.
        route: Points along the route, shape ``(n, 2)``.
    """
    polygons, starts, ends, outward = [], [], [], []
    for one in lanelets.values():
        polygon = one.polygon
        low, high = polygon.min(axis=0) - _NEAR_M, polygon.max(axis=0) + _NEAR_M
        if not ((route >= low) & (route <= high)).all(axis=1).any():
            continue
        polygons.append(polygon)
        for edge, side in ((one.left, 1.0), (one.right, -1.0)):
            count = max(math.ceil(_length_m(edge) / _EDGE_PIECE_M), 1)
            points = _at_shares(edge, np.linspace(0.0, 1.0, count + 1))
            way = np.diff(points, axis=0)
            lengths = np.hypot(*way.T)
            kept = lengths > 1e-3
            starts.append(points[:-1][kept])
            ends.append(points[1:][kept])
            outward.append(side * np.stack((-way[:, 1], way[:, 0]), axis=1)[kept] / lengths[kept, None])
    if not polygons:
        none = np.zeros((0, 2))
        return RoadEdges((), none.reshape(0, 2, 1), none, none, np.zeros(0, dtype=np.bool_))
    all_starts, all_ends = np.concatenate(starts), np.concatenate(ends)
    beyond = 0.5 * (all_starts + all_ends) + np.concatenate(outward) * _BEYOND_M[:, None, None]
    is_road: NDArray[np.bool_] = np.zeros(beyond.shape[:2], dtype=np.bool_)
    for polygon in polygons:
        is_road |= contains_each(polygon, beyond.reshape(-1, 2)).reshape(is_road.shape)
    boxes = np.array([(polygon.min(axis=0), polygon.max(axis=0)) for polygon in polygons])
    return RoadEdges(tuple(polygons), boxes, all_starts, all_ends, is_road.sum(axis=0) == 0)


def _surfaces(recording: Recording) -> Iterator[Surface]:
    """Yield the lanelets as seen from above, then their edges and the goals."""
    as_points: Callable[[FloatArray], np.ndarray] = lambda points: points.astype(np.float32)  # noqa: E731
    for one in recording.lanelets.values():
        kind = {"crosswalk": "crossing", "sidewalk": "pavement"}.get(one.kind, "road")
        if kind != "crossing":
            yield Surface(kind=kind, points=as_points(one.polygon), closed=True, width_m=0.0)
    for one in recording.lanelets.values():
        for edge in (one.left, one.right):
            yield Surface(kind="marking", points=as_points(edge), closed=False, width_m=_MARKING_M)
    for goal in recording.goals:
        for area in goal.areas[: len(goal.areas) - len(goal.lanelets)]:
            outline = np.concatenate((area, area[:1]))
            yield Surface(kind="stop-line", points=as_points(outline), closed=False, width_m=_MARKING_M)
