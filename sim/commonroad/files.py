"""Reads CommonRoad XML of the formats 2018b and 2020a into the document of a recording.

A reader of our own: `commonroad-io` (BSD-3-Clause) needs protobuf 3.20, which conflicts with the extra ``osi``, and
six packages more. It reads lanelets, speed limits, obstacles with trajectories and the first planning problem. It
ignores what drives do not have: traffic lights, intersections, environment obstacles, signal states.

Sources: the format's documentation and XML schemas of 2018b and 2020a, https://commonroad.in.tum.de.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NoReturn
from xml.etree import ElementTree

from brink.sim.commonroad.recording import (
    KINDS,
    MAX_M,
    MAX_MPS,
    MAX_STEPS,
    PER_M,
    PER_RAD,
    Recording,
    RecordingError,
    delta_coded,
    packed,
)
from brink.sim.errors import DefinitionError
from brink.user_file import read_text

VERSIONS: Final = ("2018b", "2020a")
MAX_XML_BYTES: Final = 16 * 1024**2
_ROOT: Final = "commonRoad"
_UNSAFE: Final = ("<!DOCTYPE", "<!ENTITY")
_SPEED_SIGNS: Final = ("274", "R2-1", "274.1", "274.2")
"""Signs that limit the speed, in Germany (and most other countries in CommonRoad) and the United States; in m/s."""
_CIRCLE_CORNERS: Final = 16

MAX_FILES: Final = 200
SCENARIOS: Final = "scenarios"
"""Parameter of the problem that names the files."""

Element = ElementTree.Element


def read_files(params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the parameters in a campaign file with the recordings in place of their files.

    Args:
        params: The parameters; ``scenarios`` is a folder, a file or a list of these, or recordings by name.
        folder: Folder of the campaign file.

    Raises:
        DefinitionError: A file cannot be read, or is not what it should be.
    """
    given = params.get(SCENARIOS)
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list):
        return dict(params)
    paths = [path for name in names for path in _paths(folder / str(name))]
    stems = [path.stem for path in paths]
    if len(paths) > MAX_FILES or len(set(stems)) < len(stems):
        raise DefinitionError(
            SCENARIOS, f"expected at most {MAX_FILES} files with different names, got {', '.join(stems):.400}"
        )
    return {**params, SCENARIOS: {path.stem: _packed_file(path) for path in paths}}


def _paths(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.xml"))
    if not found:
        raise DefinitionError(SCENARIOS, f"expected CommonRoad files (*.xml) in {path}, got none")
    return found


def _packed_file(path: Path) -> str:
    try:
        return packed(document_of(read_text(path, MAX_XML_BYTES)))
    except RecordingError as error:
        raise DefinitionError(SCENARIOS, f"{path.name}: {error}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DefinitionError(SCENARIOS, f"{path} cannot be read: {reason}") from None


def document_of(text: str) -> dict[str, Any]:
    """Return the document of the recording in a CommonRoad file.

    Args:
        text: The file's content.

    Raises:
        RecordingError: It is none, or has something that drives cannot have.
    """
    document = _Reader(_root(text)).document()
    Recording.of(document)  # whatever was read stays within its bounds
    return document


def _root(text: str) -> Element:
    if len(text) > MAX_XML_BYTES:
        raise RecordingError(f"expected at most {MAX_XML_BYTES:,} characters of XML, got {len(text):,}")
    if any(mark in text for mark in _UNSAFE):
        raise RecordingError("expected XML without a document type and entities")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise RecordingError(f"expected CommonRoad XML: {error}") from None
    if root.tag != _ROOT:
        raise RecordingError(f"expected CommonRoad XML (<{_ROOT}>), got <{root.tag:.80}>")
    version = root.get("commonRoadVersion")
    if version not in VERSIONS:
        raise RecordingError(f"commonRoadVersion: expected {' or '.join(VERSIONS)}, got {version!r:.80}")
    return root


class _Reader:
    """Reads one file; coordinates are relative to the ego's start in whole metres."""

    def __init__(self, root: Element) -> None:
        self._root = root
        problem = root.find("planningProblem")
        if problem is None:
            raise RecordingError("expected a <planningProblem>, which says where the ego begins; got none")
        self._problem = problem
        start = problem.find("initialState")
        if start is None:
            _wrong("planningProblem", "an <initialState>")
        self._start = start
        self._origin = (0.0, 0.0)
        x, y = self._position(start, "planningProblem")
        self._origin = (float(round(x)), float(round(y)))

    def document(self) -> dict[str, Any]:
        where = "planningProblem/initialState"
        return {
            "version": 1,
            "name": self._root.get("benchmarkID") or "",
            "step_s": _number(self._root.get("timeStepSize"), "timeStepSize", 1.0),
            "start": self._state(self._start, where),
            "start_step": _step(self._start, where),
            "goals": [self._goal(one) for one in self._problem.findall("goalState")],
            "lanelets": list(self._lanelets()),
            "road_users": list(self._road_users()),
        }

    def _position(self, state: Element, where: str) -> tuple[float, float]:
        """Return the position of a state; the middle of an area if it is uncertain."""
        position = state.find("position")
        if position is None:
            _wrong(where, "a <position>")
        if (point := position.find("point")) is not None:
            return self._point(point, where)
        areas = list(self._shapes(position, where))
        if not areas:
            _wrong(where, "a position that is a point or an area")
        corners = [corner for area in areas for corner in area]
        return sum(x for x, _ in corners) / len(corners), sum(y for _, y in corners) / len(corners)

    def _point(self, element: Element, where: str) -> tuple[float, float]:
        x, y = (
            _number(element.findtext(name), f"{where}: {name}", 1e8) - origin
            for name, origin in zip("xy", self._origin, strict=True)
        )
        return x, y

    def _state(self, state: Element, where: str) -> list[int]:
        """Return x, y, yaw and speed of a state as integers."""
        x, y = self._position(state, where)
        yaw, speed = _value(state, "orientation", where), _value(state, "velocity", where, default=0.0)
        for name, value in (("x", x), ("y", y)):
            if abs(value) > MAX_M:
                _wrong(where, f"{name} within {MAX_M:g} m of the ego's start")
        if abs(speed) > MAX_MPS:
            _wrong(where, f"a velocity up to {MAX_MPS:g} m/s")
        return [round(PER_M * x), round(PER_M * y), round(PER_RAD * yaw), round(PER_M * speed)]

    def _edge(self, lanelet: Element, name: str, where: str) -> list[list[int]]:
        bound = lanelet.find(name)
        points = [] if bound is None else [self._point(one, where) for one in bound.findall("point")]
        if any(abs(value) > MAX_M for point in points for value in point):
            _wrong(where, f"points within {MAX_M:g} m of the ego's start")
        return [delta_coded([round(PER_M * point[axis]) for point in points]) for axis in (0, 1)]

    def _lanelets(self) -> Iterator[dict[str, Any]]:
        limits = self._speed_signs()
        for one in self._root.findall("lanelet"):
            number = _id(one)
            where = f"lanelet {number}"
            signs = [limits[ref] for sign in one.findall("trafficSignRef") if (ref := _ref(sign)) in limits]
            stated = [] if (text := one.findtext("speedLimit")) is None else [_number(text, where, MAX_MPS)]
            beside = {
                f"beside_{side}": [_ref(other), other.get("drivingDir") == "same"]
                for side, name in (("left", "adjacentLeft"), ("right", "adjacentRight"))
                if (other := one.find(name)) is not None
            }
            yield {
                "id": number,
                "left": self._edge(one, "leftBound", where),
                "right": self._edge(one, "rightBound", where),
                "next": [_ref(other) for other in one.findall("successor")],
                "kind": (one.findtext("laneletType") or "").strip(),
                **({"limit": min(signs + stated)} if signs or stated else {}),
                **beside,
            }

    def _speed_signs(self) -> dict[int, float]:
        """Return the speed limit of each sign that is one."""
        limits = {}
        for sign in self._root.findall("trafficSign"):
            for element in sign.findall("trafficSignElement"):
                value = element.findtext("additionalValue")
                if (element.findtext("trafficSignID") or "").strip() in _SPEED_SIGNS and value is not None:
                    limits[_id(sign)] = _number(value, f"trafficSign {_id(sign)}", MAX_MPS)
        return limits

    def _road_users(self) -> Iterator[dict[str, Any]]:
        for one in self._root:
            role = {"staticObstacle": "static", "dynamicObstacle": "dynamic"}.get(one.tag, "")
            if one.tag == "obstacle":  # 2018b
                role = (one.findtext("role") or "").strip()
            if role:
                yield self._road_user(one, role)

    def _road_user(self, one: Element, role: str) -> dict[str, Any]:
        number = _id(one)
        where = f"obstacle {number}"
        if role not in ("static", "dynamic"):
            _wrong(where, f"a role static or dynamic, not {role[:40]!r}")
        kind = (one.findtext("type") or "unknown").strip()
        start = one.find("initialState")
        if start is None:
            _wrong(where, "an <initialState>")
        states = [start]
        if role == "dynamic":
            trajectory = one.find("trajectory")
            if trajectory is None:
                _wrong(where, "a <trajectory>; occupancies are not supported")
            states += trajectory.findall("state")
        rows = {_step(state, where): self._state(state, where) for state in states}
        length_m, width_m, ahead_m = self._size(one, where)
        if ahead_m:
            for row in rows.values():
                row[0] += round(PER_M * ahead_m * math.cos(row[2] / PER_RAD))
                row[1] += round(PER_M * ahead_m * math.sin(row[2] / PER_RAD))
        steps = range(min(rows), max(rows) + 1)
        whole = [rows[step] for step in steps if step in rows]
        if len(whole) < len(steps):
            _wrong(where, f"a state at each step from {steps[0]} to {steps[-1]}")
        _unwrap(whole)
        return {
            "id": number,
            "kind": KINDS.index(kind if kind in KINDS else "unknown"),
            "length_m": length_m,
            "width_m": width_m,
            "first": steps[0],
            "stands": role == "static",
            "states": [delta_coded([row[column] for row in whole]) for column in range(4)],
        }

    def _size(self, one: Element, where: str) -> tuple[float, float, float]:
        """Return length and width of an obstacle, and how far ahead of its position its middle lies."""
        shape = one.find("shape")
        if shape is not None and len(shape) == 1:
            if (rectangle := shape.find("rectangle")) is not None and rectangle.find("center") is None:
                sides = [_number(rectangle.findtext(name), where, 200.0) for name in ("length", "width")]
                return sides[0], sides[1], 0.0
            if (circle := shape.find("circle")) is not None and circle.find("center") is None:
                across_m = 2.0 * _number(circle.findtext("radius"), where, 100.0)
                return across_m, across_m, 0.0
        if shape is None:
            _wrong(where, "a <shape>")
        origin, self._origin = self._origin, (0.0, 0.0)  # shapes are relative to their obstacle
        corners = [corner for area in self._shapes(shape, where) for corner in area]
        self._origin = origin
        if not corners:
            _wrong(where, "a shape of rectangles, circles and polygons")
        ahead, behind = max(x for x, _ in corners), min(x for x, _ in corners)
        aside_m = max(abs(y) for _, y in corners)
        return round(ahead - behind, 3), round(2.0 * aside_m, 3), 0.5 * (ahead + behind)

    def _shapes(self, parent: Element, where: str) -> Iterator[list[tuple[float, float]]]:
        """Yield the corners of each rectangle, circle and polygon."""
        for one in parent:
            centre = one.find("center")
            x, y = (-self._origin[0], -self._origin[1]) if centre is None else self._point(centre, where)
            if one.tag == "rectangle":
                text = one.findtext("orientation")
                yaw = 0.0 if text is None else _number(text, where, 100.0)
                along, across = (
                    0.5 * _number(one.findtext(name), where, 10_000.0) for name in ("length", "width")
                )
                yield [
                    (x + a * math.cos(yaw) - b * math.sin(yaw), y + a * math.sin(yaw) + b * math.cos(yaw))
                    for a, b in ((along, across), (-along, across), (-along, -across), (along, -across))
                ]
            elif one.tag == "circle":
                radius = _number(one.findtext("radius"), where, 10_000.0)
                turns = [2.0 * math.pi * index / _CIRCLE_CORNERS for index in range(_CIRCLE_CORNERS)]
                yield [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
            elif one.tag == "polygon":
                yield [self._point(point, where) for point in one.findall("point")]

    def _goal(self, goal: Element) -> dict[str, Any]:
        where = "goalState"
        position = goal.find("position")
        areas = [] if position is None else list(self._shapes(position, where))
        lanelets = [] if position is None else [_ref(one) for one in position.findall("lanelet")]
        if position is not None and not areas and not lanelets:
            _wrong(where, "a position of lanelets, rectangles, circles or polygons")
        return {
            "areas": [
                [delta_coded([round(PER_M * corner[axis]) for corner in area]) for axis in (0, 1)]
                for area in areas
            ],
            "lanelets": lanelets,
            "steps": _interval(goal, "time", where),
            "speed_mps": _interval(goal, "velocity", where),
            "yaw_rad": _interval(goal, "orientation", where),
        }


def _unwrap(rows: list[list[int]]) -> None:
    """Make headings continuous, in place."""
    whole = round(2.0 * math.pi * PER_RAD)
    for before, row in pairwise(rows):
        row[2] += round((before[2] - row[2]) / whole) * whole


def _interval(parent: Element, name: str, where: str) -> list[float] | None:
    element = parent.find(name)
    if element is None:
        return None
    if (exact := element.findtext("exact")) is not None:
        value = _number(exact, f"{where}: {name}", 1e6)
        return [value, value]
    return [
        _number(element.findtext(end), f"{where}: {name}", 1e6) for end in ("intervalStart", "intervalEnd")
    ]


def _value(state: Element, name: str, where: str, default: float | None = None) -> float:
    """Return a value of a state, the middle of an interval."""
    found = _interval(state, name, where)
    if found is None:
        if default is None:
            _wrong(where, f"<{name}>")
        return default
    return 0.5 * (found[0] + found[1])


def _step(state: Element, where: str) -> int:
    step = round(_value(state, "time", where, default=0.0))
    if not 0 <= step <= MAX_STEPS:
        _wrong(where, f"a time step in [0, {MAX_STEPS:,}]")
    return step


def _number(text: str | None, where: str, most: float) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not abs(value) <= most:
        _wrong(where, f"a number up to {most:g}, not {text!r:.40}")
    return value


def _id(element: Element) -> int:
    return _whole(element.get("id"), f"<{element.tag}> id")


def _ref(element: Element) -> int:
    return _whole(element.get("ref"), f"<{element.tag}> ref")


def _whole(text: str | None, where: str) -> int:
    try:
        return int(text or "")
    except ValueError:
        _wrong(where, f"an integer, not {text!r:.40}")


def _wrong(where: str, expected: str) -> NoReturn:
    raise RecordingError(f"{where}: expected {expected}")
