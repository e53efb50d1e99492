"""A road network as OpenDRIVE sees one: roads with reference lines and lanes, junctions, signals and objects.

Reference lines are those of the driving world, straights and arcs, so nothing is approximated. On each road, s runs
along the reference line from 0, t to its left, and lanes are listed from the middle outwards.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise
from typing import Protocol

from brink.sim.world.line import Piece, ReferenceLine


class LaneKind(StrEnum):
    """Type of a lane, in OpenDRIVE's words."""

    DRIVING = "driving"
    PARKING = "parking"
    BORDER = "border"
    """The parking strip where it passes a junction: no vehicle parks there."""
    SIDEWALK = "sidewalk"


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane of constant width."""

    kind: LaneKind
    width_m: float


class Contact(StrEnum):
    """End of a road at which another one begins."""

    START = "start"
    END = "end"


@dataclass(frozen=True, slots=True)
class Link:
    """The successor of a road: an end of another road or, without a contact, a junction."""

    id: int
    contact: Contact | None = None


@dataclass(frozen=True, slots=True)
class Elevation:
    """Height of a reference line from a station on: a cubic polynomial of the distance from there.

    Attributes:
        from_m: Where it begins.
        a: Height there.
        b: Slope there.
        c: Coefficient of the square.
        d: Coefficient of the cube.
    """

    from_m: float = 0.0
    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0

    @classmethod
    def between(
        cls, from_m: float, length_m: float, start: tuple[float, float], end: tuple[float, float]
    ) -> "Elevation":
        """Return the elevation that meets a height and a slope at either end.

        Args:
            from_m: Where it begins.
            length_m: Its length.
            start: Height and slope at its start.
            end: Height and slope at its end.
        """
        (a, b), (end_m, end_slope) = start, end
        mean = (end_m - a) / length_m
        c = (3.0 * mean - 2.0 * b - end_slope) / length_m
        d = (b + end_slope - 2.0 * mean) / length_m**2
        return cls(from_m, a, b, c, d)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dashes:
    """A broken line in the middle of the road.

    Attributes:
        width_m: Width of the line.
        dash_m: Length of a dash, and of the gap to the next.
        first_m: Where the first dash begins, from the start of the road.
    """

    width_m: float
    dash_m: float
    first_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadObject:
    """A rectangular or round object that never moves.

    Attributes:
        kind: Type in OpenDRIVE's words: ``building``, ``tree``, ``crosswalk``, ``roadMark`` or ``streetLamp``.
        name: Name for people.
        s_m: Middle of its footprint.
        t_m: Middle of its footprint.
        heading_rad: Heading relative to the road.
        length_m: Extent along its heading.
        width_m: Extent across its heading; 0 if it is round, with its length as the diameter.
        height_m: Height; 0 for paint.
    """

    kind: str
    name: str
    s_m: float
    t_m: float
    heading_rad: float
    length_m: float
    width_m: float
    height_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficLight:
    """A traffic light beside its stop line.

    Attributes:
        id: Unique in the network.
        name: Name for people.
        s_m: Where vehicles stop.
        t_m: Where it stands across the road.
        along: Whether it is for traffic in the direction of s; otherwise for that against it.
    """

    id: int
    name: str
    s_m: float
    t_m: float
    along: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadPart:
    """A road of the network.

    Attributes:
        id: Unique in the network.
        name: Name for people.
        line: Reference line.
        left: Lanes on the left, from the middle outwards.
        right: Lanes on the right, from the middle outwards.
        elevations: Height of the reference line, in order.
        junction: Junction that it is part of; None outside junctions.
        predecessor: What its start leads to.
        successor: What its end leads to.
        lane_signs: Inside a junction: sign of the lanes that its lanes come from, and of those that they lead to.
        middle: Marking of its middle.
        lane_edge_m: Width of the solid line between a driving lane and the parking strip; 0 without.
        objects: Objects on and beside it.
        lights: Traffic lights beside it.
        speed_limit_mps: Speed limit; None if there is none.
    """

    id: int
    name: str
    line: ReferenceLine
    left: tuple[Lane, ...]
    right: tuple[Lane, ...]
    elevations: tuple[Elevation, ...] = (Elevation(),)
    junction: int | None = None
    predecessor: Link | None = None
    successor: Link | None = None
    lane_signs: tuple[int, int] | None = None
    middle: Dashes | None = None
    lane_edge_m: float = 0.0
    objects: tuple[RoadObject, ...] = ()
    lights: tuple[TrafficLight, ...] = ()
    speed_limit_mps: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class JunctionPart:
    """A junction: its connecting roads, each entered at its start.

    Attributes:
        id: Unique in the network.
        name: Name for people.
        connections: Incoming road, connecting road, and sign of the incoming road's lanes.
        signal_groups: Ids of the groups of lights that control it.
    """

    id: int
    name: str
    connections: tuple[tuple[int, int, int], ...]
    signal_groups: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalGroup:
    """Traffic lights that always show the same state."""

    id: int
    name: str
    lights: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadNetwork:
    """All roads, junctions and groups of traffic lights."""

    name: str
    roads: tuple[RoadPart, ...]
    junctions: tuple[JunctionPart, ...] = ()
    signal_groups: tuple[SignalGroup, ...] = ()


class Ground(Protocol):
    """The height of the ground."""

    def at(self, x_m: float, y_m: float, yaw_rad: float, *, on_foot: bool) -> tuple[float, float]:
        """Return the height under a road user, and the slope along its heading, positive uphill."""


class FlatGround:
    """Level ground at height 0."""

    def at(self, x_m: float, y_m: float, yaw_rad: float, *, on_foot: bool) -> tuple[float, float]:
        """Return height and slope, both 0."""
        return 0.0, 0.0


def stretch(line: ReferenceLine, from_m: float, to_m: float) -> ReferenceLine:
    """Return a part of a line, which may extend straight beyond its ends.

    Args:
        line: The line.
        from_m: Station at which the part begins.
        to_m: Station at which it ends.
    """
    edges = [-math.inf, 0.0, *accumulate(piece.length_m for piece in line.pieces), math.inf]
    bends = [0.0, *(piece.curvature_1pm for piece in line.pieces), 0.0]
    pieces = [
        Piece(min(end_m, to_m) - max(start_m, from_m), bend)
        for (start_m, end_m), bend in zip(pairwise(edges), bends, strict=True)
        if min(end_m, to_m) > max(start_m, from_m)
    ]
    return ReferenceLine(*line.pose_at(from_m), _merged(pieces))


def _merged(pieces: Sequence[Piece]) -> list[Piece]:
    """Return pieces in which no two neighbours have the same curvature."""
    merged: list[Piece] = []
    for piece in pieces:
        if merged and merged[-1].curvature_1pm == piece.curvature_1pm:
            piece = Piece(merged.pop().length_m + piece.length_m, piece.curvature_1pm)
        merged.append(piece)
    return merged


def quarter_turn(radius_m: float, *, right: bool) -> Piece:
    """Return a quarter circle."""
    return Piece(0.5 * math.pi * radius_m, (-1.0 if right else 1.0) / radius_m)
