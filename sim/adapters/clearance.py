"""Distances between the outlines of road users."""

import math
from typing import TypeAlias

from brink.sim.adapters.recording import Pose

Corners: TypeAlias = tuple[tuple[float, float], ...]


def corners(pose: Pose, length_m: float, width_m: float) -> Corners:
    """Return the outline of a body: front left, front right, rear right, rear left."""
    along_x, along_y = 0.5 * length_m * math.cos(pose.yaw_rad), 0.5 * length_m * math.sin(pose.yaw_rad)
    left_x, left_y = -0.5 * width_m * math.sin(pose.yaw_rad), 0.5 * width_m * math.cos(pose.yaw_rad)
    return tuple(
        (pose.x_m + a * along_x + b * left_x, pose.y_m + a * along_y + b * left_y)
        for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    )


def clearance_m(one: Corners, other: Corners) -> float:
    """Return the distance between two convex outlines; 0 if they overlap."""
    if not (_separated(one, other) or _separated(other, one)):
        return 0.0
    return min(_corner_to_edge_m(one, other), _corner_to_edge_m(other, one))


def _separated(polygon: Corners, other: Corners) -> bool:
    """Return whether an edge of a polygon separates it from another."""
    for (x0, y0), (x1, y1) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        nx, ny = y1 - y0, x0 - x1
        own = [nx * x + ny * y for x, y in polygon]
        others = [nx * x + ny * y for x, y in other]
        if max(own) < min(others) or max(others) < min(own):
            return True
    return False


def _corner_to_edge_m(polygon: Corners, other: Corners) -> float:
    least = math.inf
    for (x0, y0), (x1, y1) in zip(other, (*other[1:], other[0]), strict=True):
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        for x, y in polygon:
            share = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / square))
            least = min(least, math.hypot(x - x0 - share * dx, y - y0 - share * dy))
    return least
