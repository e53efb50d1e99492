"""Plane geometry: rectangles seen from above, and the distance between convex outlines.

All are in metres and radians; headings are counter-clockwise from x. Distances are exact to rounding, and their last
bits are part of an episode's result: `signed_gap_m` of encounters and `clearance_m` of outlines round differently, so
that neither can replace the other.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol, Self, TypeAlias

Point: TypeAlias = tuple[float, float]


class Footprint(Protocol):
    """A body that stands on a rectangle."""

    @property
    def x_m(self) -> float:
        """Its centre."""

    @property
    def y_m(self) -> float:
        """Its centre."""

    @property
    def yaw_rad(self) -> float:
        """Its heading."""

    @property
    def length_m(self) -> float:
        """Its extent along the heading."""

    @property
    def width_m(self) -> float:
        """Its extent across the heading."""


class Rectangle(NamedTuple):
    """A body seen from above.

    Attributes:
        x_m: Centre.
        y_m: Centre.
        yaw_rad: Heading.
        half_length_m: Half of the extent along the heading.
        half_width_m: Half of the extent across it.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    half_length_m: float
    half_width_m: float

    @classmethod
    def of(cls, body: Footprint) -> Self:
        """Return the footprint of a body."""
        return cls(body.x_m, body.y_m, body.yaw_rad, 0.5 * body.length_m, 0.5 * body.width_m)

    def corners(self) -> list[Point]:
        """Return the corners, clockwise from the front left."""
        x_m, y_m, yaw_rad, half_length_m, half_width_m = self
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        along_x, along_y = half_length_m * cos_yaw, half_length_m * sin_yaw
        left_x, left_y = -half_width_m * sin_yaw, half_width_m * cos_yaw
        return [
            (x_m + along_x + left_x, y_m + along_y + left_y),
            (x_m + along_x - left_x, y_m + along_y - left_y),
            (x_m - along_x - left_x, y_m - along_y - left_y),
            (x_m - along_x + left_x, y_m - along_y + left_y),
        ]

    def polygon(self) -> list[Point]:
        """Return the corners counter-clockwise from the front left, as they are drawn."""
        front_left, *others = self.corners()
        return [front_left, *reversed(others)]

    def nearest_point(self, point: Point) -> Point:
        """Return the point of the rectangle that is nearest to a given point."""
        dx, dy = point[0] - self.x_m, point[1] - self.y_m
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        along = min(max(dx * cos_yaw + dy * sin_yaw, -self.half_length_m), self.half_length_m)
        across = min(max(dy * cos_yaw - dx * sin_yaw, -self.half_width_m), self.half_width_m)
        return self.x_m + along * cos_yaw - across * sin_yaw, self.y_m + along * sin_yaw + across * cos_yaw


def half_extents_m(length_m: float, width_m: float, turn_rad: float) -> tuple[float, float]:
    """Return half the length and width of the axis-aligned bounding box of a rotated rectangle."""
    cosine, sine = abs(math.cos(turn_rad)), abs(math.sin(turn_rad))
    return 0.5 * (length_m * cosine + width_m * sine), 0.5 * (length_m * sine + width_m * cosine)


def signed_gap_m(first: Rectangle, second: Rectangle) -> float:
    """Return the clearance between two rectangles, or minus the penetration depth if they overlap."""
    overlap_m = _penetration_m(first, second)
    if overlap_m > 0.0:
        return -overlap_m
    least = math.inf
    for one, other in ((first, second), (second, first)):
        for corner in one.corners():
            x_m, y_m = other.nearest_point(corner)
            least = min(least, math.hypot(corner[0] - x_m, corner[1] - y_m))
    return least


def _penetration_m(first: Rectangle, second: Rectangle) -> float:
    """Return the smallest overlap along the axes of both rectangles; zero or negative if they do not overlap."""
    dx, dy = second.x_m - first.x_m, second.y_m - first.y_m
    least = math.inf
    for axis_rad in (
        first.yaw_rad,
        first.yaw_rad + 0.5 * math.pi,
        second.yaw_rad,
        second.yaw_rad + 0.5 * math.pi,
    ):
        cos_axis, sin_axis = math.cos(axis_rad), math.sin(axis_rad)
        reach = 0.0
        for one in (first, second):
            turn = one.yaw_rad - axis_rad
            reach += one.half_length_m * abs(math.cos(turn)) + one.half_width_m * abs(math.sin(turn))
        least = min(least, reach - abs(dx * cos_axis + dy * sin_axis))
    return least


def clearance_m(one: Sequence[Point], other: Sequence[Point]) -> float:
    """Return the distance between two convex outlines, corners in order; 0 if they overlap."""
    if overlaps(one, other):
        return 0.0
    return min(approach[0] for pair in ((one, other), (other, one)) for approach in approaches(*pair))


def overlaps(one: Sequence[Point], other: Sequence[Point]) -> bool:
    """Return whether two convex outlines intersect."""
    return not (_separated(one, other) or _separated(other, one))


def _separated(polygon: Sequence[Point], other: Sequence[Point]) -> bool:
    """Return whether an edge of a polygon separates it from another."""
    for (x0, y0), (x1, y1) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        nx, ny = y1 - y0, x0 - x1
        own = [nx * x + ny * y for x, y in polygon]
        others = [nx * x + ny * y for x, y in other]
        if max(own) < min(others) or max(others) < min(own):
            return True
    return False


def approaches(one: Sequence[Point], other: Sequence[Point]) -> Iterator[tuple[float, Point, Point]]:
    """Yield the distance of each corner of an outline to each edge of another, the corner, and the edge's point."""
    for (x0, y0), (x1, y1) in zip(other, (*other[1:], other[0]), strict=True):
        dx, dy = x1 - x0, y1 - y0
        square = max(dx * dx + dy * dy, 1e-12)
        for x, y in one:
            share = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / square))
            apart_m = math.hypot(x - x0 - share * dx, y - y0 - share * dy)
            yield apart_m, (x, y), (x0 + share * dx, y0 + share * dy)
