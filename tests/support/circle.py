"""A function with a known boundary, in a module of its own: the processes that call it import nothing else for it."""

import numpy as np


def inside(x: float, y: float, side: str) -> float:
    """Return how far a point is outside a circle of radius 0.3, on the left, or 0.2, on the right."""
    radius = {"left": 0.3, "right": 0.2}[side]
    return float(np.hypot(x - 0.5, y - 0.5)) - radius
