"""A recording of traffic: lanelets, road users over time, and where the ego begins and wants to go.

It is read from CommonRoad XML of the formats 2018b and 2020a (`brink.sim.commonroad.files`), and travels as a packed
document. Coordinates are relative to the ego's start, rounded to whole metres, so that files in the coordinates of a
country keep their precision. Positions are stored in millimetres and angles in tenths of milliradians: drives are
those of the packed document, not of the file.

References:
    Althoff, Koschi, Manzinger 2017, CommonRoad: Composable benchmarks for motion planning on roads.
"""

import base64
import binascii
import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.errors import SimulatorError

FloatArray: TypeAlias = NDArray[np.float64]

MAX_PACKED_CHARS: Final = 400_000
"""Maximum length of a packed recording: it is part of every job."""
MAX_UNPACKED_BYTES: Final = 16 * 1024**2
MAX_LANELETS: Final = 2_000
MAX_ROAD_USERS: Final = 300
MAX_POINTS: Final = 200_000
MAX_STEPS: Final = 36_000
MAX_M: Final = 20_000.0
"""Nothing is farther from the ego's start."""
MAX_MPS: Final = 100.0
KINDS: Final = (
    *("car", "truck", "bus", "motorcycle", "bicycle", "train", "taxi", "priorityVehicle", "parkedVehicle"),
    *("pedestrian", "constructionZone", "roadBoundary", "pillar", "median_strip", "unknown"),
)
"""Types of obstacles in the order of their codes; any other is unknown."""
NOT_VEHICLES: Final = frozenset({"constructionZone", "roadBoundary", "pillar", "median_strip"})
WALKWAYS: Final = frozenset({"crosswalk", "sidewalk"})
"""Types of lanelets that no car drives on."""
PER_M: Final = 1_000
PER_RAD: Final = 10_000
_VERSION: Final = 1


class RecordingError(SimulatorError):
    """A recording is not what it should be; the message says what was expected."""


class Neighbour(NamedTuple):
    """The lanelet beside another one, and whether it leads the same way."""

    id: int
    same_way: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lanelet:
    """A piece of a lane.

    Attributes:
        id: Unique in the recording.
        left: Its left edge in the direction of travel, shape ``(n, 2)``.
        right: Its right edge, of the same shape.
        successors: Lanelets that continue it.
        neighbours: The lanelets on its left and on its right.
        kind: Its type, such as ``urban`` or ``crosswalk``; empty if unknown.
        limit_mps: Speed limit that the file states; None without one.
    """

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...]
    neighbours: tuple[Neighbour | None, Neighbour | None]
    kind: str
    limit_mps: float | None

    @property
    def centre(self) -> FloatArray:
        """Its middle, shape ``(n, 2)``."""
        return 0.5 * (self.left + self.right)

    @property
    def polygon(self) -> FloatArray:
        """Its outline, counter-clockwise for a lane without folds, shape ``(2n, 2)``."""
        return np.concatenate((self.right, self.left[::-1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadUser:
    """A recorded road user, or something that stands.

    Attributes:
        id: Unique in the recording.
        kind: One of `KINDS`.
        length_m: Extent along its heading.
        width_m: Extent across it.
        first_step: Step of its first state.
        states: x_m, y_m, yaw_rad (unwrapped), speed_mps at successive steps, shape ``(n, 4)``.
        stands: Whether it always stands at its only state.
    """

    id: int
    kind: str
    length_m: float
    width_m: float
    first_step: int
    states: FloatArray
    stands: bool


class Interval(NamedTuple):
    """A closed interval; infinite ends for none."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Return whether a value lies in it."""
        return self.low <= value <= self.high


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Goal:
    """A state that the ego should reach.

    Attributes:
        areas: Polygons, one of which its centre should be in; none if any place will do.
        lanelets: The lanelets that the file names as areas.
        steps: When.
        speed_mps: How fast.
        yaw_rad: With which heading.
    """

    areas: tuple[FloatArray, ...]
    lanelets: tuple[int, ...]
    steps: Interval
    speed_mps: Interval
    yaw_rad: Interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A recording of traffic and a planning problem in it.

    Attributes:
        name: Its id in the file.
        step_s: Time between two states.
        start: x_m, y_m, yaw_rad, speed_mps of the ego.
        start_step: When the ego begins; everything before is left out of a drive.
        goals: What it wants to reach, in any order; none if the file states none.
        lanelets: By id.
        road_users: All others.
    """

    name: str
    step_s: float
    start: tuple[float, float, float, float]
    start_step: int
    goals: tuple[Goal, ...]
    lanelets: Mapping[int, Lanelet]
    road_users: tuple[RoadUser, ...]

    @property
    def duration_s(self) -> float:
        """How long a drive may take: until the last goal's time is over, or else until the recording ends."""
        ends = [goal.steps.high for goal in self.goals if math.isfinite(goal.steps.high)]
        if not ends:
            ends = [one.first_step + len(one.states) - 1 for one in self.road_users if not one.stands]
        return max((max(ends, default=0) - self.start_step) * self.step_s, 0.0)

    @classmethod
    def of(cls, document: Any) -> Self:
        """Return the recording that a document describes.

        Raises:
            RecordingError: It describes none.
        """
        try:
            return cls._of(document)
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise RecordingError(f"expected a recording: {type(error).__name__}: {error}") from None

    @classmethod
    def _of(cls, document: Any) -> Self:
        if document["version"] != _VERSION:
            raise RecordingError(f"expected a recording of version {_VERSION}, got {document['version']!r}")
        lanelets = {one.id: one for one in _lanelets(document["lanelets"])}
        users = tuple(_users(document["road_users"]))
        points = sum(2 * len(one.left) for one in lanelets.values()) + sum(len(one.states) for one in users)
        if points > MAX_POINTS:
            raise RecordingError(f"expected at most {MAX_POINTS:,} points and states, got {points:,}")
        step_s, start = float(document["step_s"]), _states([document["start"]])[0]
        if not 0.001 <= step_s <= 1.0:
            raise RecordingError(f"expected a time step in [0.001, 1] s, got {step_s:g}")
        if start[3] < 0.0:
            raise RecordingError("expected an ego that does not begin backwards")
        return cls(
            name=str(document["name"])[:100],
            step_s=step_s,
            start=(float(start[0]), float(start[1]), float(start[2]), float(start[3])),
            start_step=_count("start_step", document["start_step"], MAX_STEPS),
            goals=tuple(_goal(one, lanelets) for one in _listed("goals", document["goals"], 20)),
            lanelets=lanelets,
            road_users=users,
        )


def packed(document: Mapping[str, Any]) -> str:
    """Return the document of a recording as text for a job.

    Raises:
        RecordingError: It is too large.
    """
    text = json.dumps(document, sort_keys=True, separators=(",", ":")).encode()
    found = base64.b64encode(zlib.compress(text, 9)).decode()
    if len(found) > MAX_PACKED_CHARS or len(text) > MAX_UNPACKED_BYTES:
        raise RecordingError(
            f"expected a recording of at most {MAX_PACKED_CHARS:,} characters when packed, got {len(found):,}: cut it"
        )
    return found


def unpacked(text: str) -> Any:
    """Return the document of a packed recording.

    Raises:
        RecordingError: It is none, or too large.
    """
    if len(text) > MAX_PACKED_CHARS:
        raise RecordingError(f"expected at most {MAX_PACKED_CHARS:,} characters, got {len(text):,}")
    try:
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(base64.b64decode(text, validate=True), MAX_UNPACKED_BYTES)
        if not unpacker.eof:
            raise RecordingError(f"expected at most {MAX_UNPACKED_BYTES:,} bytes when unpacked")
        return json.loads(content)
    except (binascii.Error, zlib.error, ValueError, RecursionError) as error:
        raise RecordingError(f"expected a packed recording: {error}") from None


def delta_coded(numbers: Sequence[int]) -> list[int]:
    """Return the differences of successive integers, the first one from 0."""
    return [new - old for old, new in zip((0, *numbers), numbers, strict=False)]


def _listed(where: str, given: Any, most: int) -> list[Any]:
    if not isinstance(given, list) or len(given) > most:
        size = f"{len(given):,}" if isinstance(given, list) else repr(given)[:80]
        raise RecordingError(f"expected at most {most:,} {where}, got {size}")
    return given


def _count(where: str, given: Any, most: int) -> int:
    if type(given) is not int or not 0 <= given <= most:
        raise RecordingError(f"expected {where} in [0, {most:,}], got {given!r:.80}")
    return given


def _numbers(given: Any, scale: int, most: float) -> FloatArray:
    """Return delta-coded integers as numbers."""
    if not all(type(one) is int for one in given):
        raise RecordingError("expected integers")
    values = list(accumulate(given))
    if any(abs(one) > most * scale for one in values):
        raise RecordingError(f"expected numbers up to {most:g}")
    return np.array(values, dtype=np.float64) / scale


def _points(given: Any) -> FloatArray:
    """Return points given as delta-coded x and y, shape ``(n, 2)``."""
    x, y = given
    return np.stack((_numbers(x, PER_M, MAX_M), _numbers(y, PER_M, MAX_M)), axis=1)


def _states(rows: Any) -> FloatArray:
    """Return states given as rows of x, y, yaw and speed in integers, shape ``(n, 4)``."""
    columns = [
        _numbers([row[index] for row in rows], scale, most)
        for index, (scale, most) in enumerate(
            ((PER_M, MAX_M), (PER_M, MAX_M), (PER_RAD, 1e4), (PER_M, MAX_MPS))
        )
    ]
    return np.stack(columns, axis=1)


def _lanelets(given: Any) -> Iterator[Lanelet]:
    seen: set[int] = set()
    for one in _listed("lanelets", given, MAX_LANELETS):
        left, right = _points(one["left"]), _points(one["right"])
        if len(left) != len(right) or len(left) < 2:
            raise RecordingError(
                f"lanelet {one['id']}: expected edges with the same number of points, at least 2; got "
                f"{len(left)} and {len(right)}"
            )
        if one["id"] in seen:
            raise RecordingError(f"expected each lanelet once, got {one['id']} twice")
        seen.add(one["id"])
        limit = one.get("limit")
        yield Lanelet(
            id=int(one["id"]),
            left=left,
            right=right,
            successors=tuple(int(other) for other in one["next"]),
            neighbours=(_neighbour(one.get("beside_left")), _neighbour(one.get("beside_right"))),
            kind=str(one["kind"])[:40],
            limit_mps=None if limit is None else min(max(float(limit), 0.5), MAX_MPS),
        )


def _neighbour(given: Any) -> Neighbour | None:
    return None if given is None else Neighbour(int(given[0]), bool(given[1]))


def _users(given: Any) -> Iterator[RoadUser]:
    for one in _listed("road users", given, MAX_ROAD_USERS):
        states = _states(list(zip(*one["states"], strict=True)))
        length_m, width_m = float(one["length_m"]), float(one["width_m"])
        if not (0.05 <= length_m <= 200.0 and 0.05 <= width_m <= 200.0):
            raise RecordingError(
                f"obstacle {one['id']}: expected a size in [0.05, 200] m, got {length_m:g} x {width_m:g}"
            )
        if not len(states):
            raise RecordingError(f"obstacle {one['id']}: expected states")
        yield RoadUser(
            id=int(one["id"]),
            kind=KINDS[_count("kind", one["kind"], len(KINDS) - 1)],
            length_m=length_m,
            width_m=width_m,
            first_step=_count("first_step", one["first"], MAX_STEPS),
            states=states,
            stands=bool(one["stands"]),
        )


def _goal(given: Any, lanelets: Mapping[int, Lanelet]) -> Goal:
    ids = tuple(int(one) for one in _listed("lanelets of a goal", given["lanelets"], MAX_LANELETS))
    for one in ids:
        if one not in lanelets:
            raise RecordingError(f"goal: expected a lanelet of the file, got {one}")
    areas = [_points(one) for one in _listed("areas of a goal", given["areas"], 100)]
    if any(len(area) < 3 for area in areas):
        raise RecordingError("goal: expected areas with at least 3 corners")
    return Goal(
        areas=(*areas, *(lanelets[one].polygon for one in ids)),
        lanelets=ids,
        steps=_interval(given["steps"]),
        speed_mps=_interval(given["speed_mps"]),
        yaw_rad=_interval(given["yaw_rad"]),
    )


def _interval(given: Any) -> Interval:
    if given is None:
        return Interval(-math.inf, math.inf)
    low, high = (float(one) for one in given)
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise RecordingError(f"expected an interval, got {given!r:.80}")
    return Interval(low, high)


def contains_each(polygon: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Return whether a polygon contains points, by their crossing numbers.

    Args:
        polygon: Its corners in order, shape ``(k, 2)``.
        points: The points, shape ``(n, 2)``.
    """
    inside: NDArray[np.bool_] = ((points >= polygon.min(axis=0)) & (points <= polygon.max(axis=0))).all(
        axis=1
    )
    candidates = points[inside]
    if len(candidates):
        x0, y0 = polygon.T
        x1, y1 = np.concatenate((polygon[1:], polygon[:1])).T
        x, y = candidates[:, 0, None], candidates[:, 1, None]
        spans = (y0 > y) != (y1 > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at_x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
        inside[inside] = np.count_nonzero(spans & (at_x > x), axis=1) % 2 == 1
    return inside


def contains(polygon: FloatArray, x_m: float, y_m: float) -> bool:
    """Return whether a polygon contains a point."""
    return bool(contains_each(polygon, np.array([[x_m, y_m]]))[0])
