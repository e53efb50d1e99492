"""Distances between rectangles on the ground: who is how near to whom, and on which side."""

import math
from typing import NamedTuple, TypeAlias

Point: TypeAlias = tuple[float, float]


class Rectangle(NamedTuple):
    """A body from above.

    Attributes:
        x_m: Its middle.
        y_m: Its middle.
        yaw_rad: Its heading.
        half_length_m: Half of its extent along its heading.
        half_width_m: Half of its extent across it.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    half_length_m: float
    half_width_m: float

    def corners(self) -> list[Point]:
        """Return its corners, counter-clockwise from the front left."""
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return [
            (self.x_m + a * cos_yaw - b * sin_yaw, self.y_m + a * sin_yaw + b * cos_yaw)
            for a, b in (
                (self.half_length_m, self.half_width_m),
                (-self.half_length_m, self.half_width_m),
                (-self.half_length_m, -self.half_width_m),
                (self.half_length_m, -self.half_width_m),
            )
        ]

    def nearest(self, point: Point) -> Point:
        """Return the point of it that is nearest to another one."""
        dx, dy = point[0] - self.x_m, point[1] - self.y_m
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        along = min(max(dx * cos_yaw + dy * sin_yaw, -self.half_length_m), self.half_length_m)
        across = min(max(dy * cos_yaw - dx * sin_yaw, -self.half_width_m), self.half_width_m)
        return self.x_m + along * cos_yaw - across * sin_yaw, self.y_m + along * sin_yaw + across * cos_yaw


def _overlap(first: Rectangle, second: Rectangle) -> float:
    """Return the least overlap of their shadows on the axes of both; not positive if they do not overlap."""
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


def signed_gap_m(first: Rectangle, second: Rectangle) -> float:
    """Return the clearance between two rectangles; minus the depth to which they overlap, if they do."""
    overlap_m = _overlap(first, second)
    if overlap_m > 0.0:
        return -overlap_m
    least = math.inf
    for one, other in ((first, second), (second, first)):
        for corner in one.corners():
            x_m, y_m = other.nearest(corner)
            least = min(least, math.hypot(corner[0] - x_m, corner[1] - y_m))
    return least


def bearing_rad(ego: Rectangle, other: Rectangle) -> float:
    """Return in which direction another body is nearest, relative to the ego's heading and shape, in (-pi, pi].

    Directions are those of a square that the ego's body is squeezed into, so that its corners lie at 45 degrees.
    """
    near_x, near_y = other.nearest((ego.x_m, ego.y_m))
    at_x, at_y = ego.nearest((near_x, near_y))
    # Where they overlap the nearest point of the other one lies inside the ego: its own middle says where it is.
    x_m, y_m = (near_x, near_y) if math.hypot(near_x - at_x, near_y - at_y) > 1e-9 else (at_x, at_y)
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    dx, dy = x_m - ego.x_m, y_m - ego.y_m
    along = (dx * cos_yaw + dy * sin_yaw) / ego.half_length_m
    across = (dy * cos_yaw - dx * sin_yaw) / ego.half_width_m
    return math.atan2(across, along)
