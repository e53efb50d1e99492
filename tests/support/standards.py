"""Small readers of OpenDRIVE and OpenSCENARIO, written for the tests alone, and the schemas of both standards.

They share no code with what they check: geometry is evaluated from the attributes in the files.
"""

import cmath
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import files
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Points = NDArray[np.float64]


@cache
def schema(name: str) -> Any:
    """Return a schema of the standards: the library that writes the files ships them."""
    (file,) = [one for one in files("scenariogeneration") or () if one.name == name]
    return etree.XMLSchema(etree.parse(str(file.locate())))


def schema_errors(file: Path, name: str) -> list[str]:
    """Return what a schema has against a file."""
    found = schema(name)
    found.validate(etree.parse(str(file)))
    return [str(error) for error in found.error_log]


def number(element: ET.Element, name: str) -> float:
    """Return a numeric attribute."""
    return float(element.attrib[name])


class RoadReader:
    """A road of an OpenDRIVE file."""

    def __init__(self, element: ET.Element) -> None:
        self.element = element
        self.id = element.attrib["id"]
        self.length_m = number(element, "length")
        self.in_junction = element.attrib["junction"] != "-1"
        (section,) = element.iterfind("lanes/laneSection")
        lanes = {int(lane.attrib["id"]): lane for lane in section.iter("lane")}
        self.lanes = {lane: one for lane, one in lanes.items() if lane != 0}
        self._records = [self._record(one) for one in element.iterfind("planView/geometry")]

    @staticmethod
    def _record(one: ET.Element) -> tuple[float, float, complex, float, float]:
        arc = one.find("arc")
        assert arc is not None or one.find("line") is not None
        return (
            number(one, "s"),
            number(one, "length"),
            complex(number(one, "x"), number(one, "y")),
            number(one, "hdg"),
            0.0 if arc is None else number(arc, "curvature"),
        )

    def reference(self, s_m: float) -> tuple[complex, float]:
        """Return the point of the reference line at s, and the heading."""
        from_m, length_m, start, heading, curvature = [
            record for record in self._records if record[0] <= s_m + 1e-9
        ][-1]
        along_m = s_m - from_m
        assert along_m <= length_m + 1e-6
        # The chord of an arc points along the mean of the headings at its ends.
        half_turn = 0.5 * curvature * along_m
        chord_m = along_m * (math.sin(half_turn) / half_turn if half_turn else 1.0)
        return start + cmath.rect(chord_m, heading + half_turn), heading + 2.0 * half_turn

    def point(self, s_m: float, t_m: float) -> tuple[complex, float]:
        """Return the point at s and t, and the heading of the road there."""
        point, heading = self.reference(s_m)
        return point + cmath.rect(t_m, heading + 0.5 * math.pi), heading

    def height_m(self, s_m: float) -> float:
        """Return the height of the reference line at s."""
        record = [r for r in self.element.iterfind("elevationProfile/elevation") if number(r, "s") <= s_m][-1]
        ds = s_m - number(record, "s")
        a, b, c, d = (number(record, name) for name in "abcd")
        return a + b * ds + c * ds**2 + d * ds**3

    def width_m(self, lane: int) -> float:
        (width,) = self.lanes[lane].iterfind("width")
        assert all(number(width, name) == 0.0 for name in ("sOffset", "b", "c", "d"))
        return number(width, "a")

    def edge_m(self, lane: int) -> float:
        """Return t of a lane's outer edge; that of lane 0 is the middle."""
        side = 1 if lane > 0 else -1
        return side * sum(self.width_m(side * index) for index in range(1, abs(lane) + 1))

    def centre_m(self, lane: int) -> float:
        """Return t of a lane's middle."""
        return self.edge_m(lane) - math.copysign(0.5 * self.width_m(lane), lane)

    def lane_kind(self, lane: int) -> str:
        return self.lanes[lane].attrib["type"]

    def link(self, name: str) -> tuple[str, str] | None:
        """Return id and contact point of the predecessor or successor; None without one."""
        found = self.element.find(f"link/{name}")
        return None if found is None else (found.attrib["elementId"], found.attrib.get("contactPoint", ""))

    def objects(self, kind: str) -> list[ET.Element]:
        return [one for one in self.element.iterfind("objects/object") if one.attrib["type"] == kind]


@dataclass(frozen=True)
class OnLane:
    """A point of a lane's middle near some place.

    Attributes:
        road: The lane's road.
        s_m: Where on the road.
        across_m: Distance of the place from the lane's middle, across it.
        half_width_m: Half the lane's width.
    """

    road: RoadReader
    s_m: float
    across_m: float
    half_width_m: float


class NetworkReader:
    """An OpenDRIVE file."""

    SAMPLE_M = 0.25

    def __init__(self, root: ET.Element) -> None:
        self.root = root
        self.roads = {road.id: road for road in map(RoadReader, root.iterfind("road"))}
        self._lanes = [(road, lane) for road in self.roads.values() for lane in road.lanes]
        self._trees: dict[tuple[str, ...], tuple[cKDTree, Points]] = {}

    def _sampled(self, kinds: tuple[str, ...]) -> tuple[cKDTree, Points]:
        """Return the sampled middles of lanes of some types: a tree of points, and lane, s and heading of each."""
        if kinds not in self._trees:
            points, about = [], []
            for index, (road, lane) in enumerate(self._lanes):
                if road.lane_kind(lane) not in kinds:
                    continue
                t_m, turned = road.centre_m(lane), math.pi if lane > 0 else 0.0
                count = max(1, math.ceil(road.length_m / self.SAMPLE_M))
                for step in range(count + 1):
                    s_m = road.length_m * step / count
                    point, heading = road.point(s_m, t_m)
                    points.append((point.real, point.imag))
                    about.append((index, s_m, heading + turned))
            self._trees[kinds] = cKDTree(points), np.array(about)
        return self._trees[kinds]

    def lanes_at(
        self, x_m: float, y_m: float, yaw_rad: float | None = None, *, kinds: tuple[str, ...] = ("driving",)
    ) -> list[OnLane]:
        """Return the lanes that pass within 5 m of a place, the nearest first.

        Args:
            x_m: The place.
            y_m: The place.
            yaw_rad: Considers only lanes with traffic in about this direction.
            kinds: Types of lanes.
        """
        tree, about = self._sampled(kinds)
        found: dict[int, OnLane] = {}
        near = sorted(
            tree.query_ball_point((x_m, y_m), 5.0), key=lambda row: math.hypot(*(tree.data[row] - (x_m, y_m)))
        )
        for row in near:
            lane, s_m, heading = int(about[row, 0]), float(about[row, 1]), float(about[row, 2])
            if lane in found or (yaw_rad is not None and math.cos(yaw_rad - heading) < 0.95):
                continue
            dx, dy = (x_m, y_m) - tree.data[row]
            if abs(dx * math.cos(heading) + dy * math.sin(heading)) < self.SAMPLE_M:
                road, number_ = self._lanes[lane]
                across_m = abs(float(dy * math.cos(heading) - dx * math.sin(heading)))
                found[lane] = OnLane(road, s_m, across_m, 0.5 * road.width_m(number_))
        return sorted(found.values(), key=lambda one: one.across_m)


@dataclass(frozen=True)
class TrajectoryReader:
    """A trajectory of an OpenSCENARIO file: its times, and x, y, z, h, p of its vertices."""

    time_s: Points
    places: Points


class ScenarioReader:
    """An OpenSCENARIO file."""

    def __init__(self, root: ET.Element) -> None:
        self.root = root

    def entities(self) -> Mapping[str, ET.Element]:
        """Return vehicles, pedestrians and objects by name."""
        return {one.attrib["name"]: one[0] for one in self.root.iterfind("Entities/ScenarioObject")}

    def centre_m(self, name: str) -> float:
        """Return the distance from an entity's reference point forward to the middle of its body."""
        centre = self.entities()[name].find("BoundingBox/Center")
        assert centre is not None
        return number(centre, "x")

    def events(self, name: str) -> list[ET.Element]:
        """Return the events of an entity, in order."""
        return [
            event
            for group in self.root.iter("ManeuverGroup")
            if [one.attrib["entityRef"] for one in group.iterfind("Actors/EntityRef")] == [name]
            for event in group.iter("Event")
        ]

    def trajectories(self, name: str) -> list[TrajectoryReader]:
        """Return the trajectories of an entity, in order."""
        return [
            TrajectoryReader(
                np.array([number(vertex, "time") for vertex in one.iter("Vertex")]),
                np.array([place(vertex) for vertex in one.iter("Vertex")]),
            )
            for event in self.events(name)
            for one in event.iter("Trajectory")
        ]

    def bodies(self, name: str) -> Points:
        """Return x and y of the middle of an entity's body along its only trajectory, shape ``(n, 2)``."""
        (trajectory,) = self.trajectories(name)
        headings = trajectory.places[:, 3]
        ahead_m = self.centre_m(name) * np.column_stack([np.cos(headings), np.sin(headings)])
        found: Points = trajectory.places[:, :2] + ahead_m
        return found

    def start(self, name: str) -> tuple[float, ...] | None:
        """Return where an entity is at the start; None if it is absent then."""
        found = self.root.find(f".//Init//Private[@entityRef='{name}']//TeleportAction")
        return None if found is None else place(found)

    def parameter(self, name: str) -> float:
        found = self.root.find(f"ParameterDeclarations/ParameterDeclaration[@name='{name}']")
        assert found is not None
        return number(found, "value")

    def lamps_at(self, signal: str, time_s: float) -> str:
        """Return what a traffic light shows at a time."""
        for controller in self.root.iter("TrafficSignalController"):
            phases = list(controller.iterfind("Phase"))
            left_s = time_s % sum(number(phase, "duration") for phase in phases)
            for phase in phases:
                shown = phase.find(f"TrafficSignalState[@trafficSignalId='{signal}']")
                if shown is not None and left_s < number(phase, "duration"):
                    return shown.attrib["state"]
                left_s -= number(phase, "duration")
        raise LookupError(signal)


def place(holder: ET.Element) -> tuple[float, ...]:
    """Return x, y, z, h and p of the position in an element."""
    found = next(holder.iter("WorldPosition"))
    return tuple(number(found, name) for name in "xyzhp")
