"""The shapes of road users on the map, for all samples of an episode at once.

Shapes are given in half lengths and half widths, ahead and to the left of the centre, and placed at every pose with
one matrix product, so that a frame only has to shift them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.replay.viewport import Viewport
from brink.sim.trace import FloatArray

CAR: Final = np.array(
    [
        # Body, with cut corners.
        (1.0, 0.62), (0.9, 0.94), (0.72, 1.0), (-0.8, 1.0), (-0.95, 0.92), (-1.0, 0.7),
        (-1.0, -0.7), (-0.95, -0.92), (-0.8, -1.0), (0.72, -1.0), (0.9, -0.94), (1.0, -0.62),
        # Windscreen.
        (0.42, 0.8), (0.42, -0.8), (0.12, -0.68), (0.12, 0.68),
        # Rear window.
        (-0.58, 0.66), (-0.58, -0.66), (-0.76, -0.74), (-0.76, 0.74),
        # Brake lights.
        (-0.9, 0.9), (-0.9, 0.42), (-1.0, 0.42), (-1.0, 0.8),
        (-0.9, -0.9), (-0.9, -0.42), (-1.0, -0.42), (-1.0, -0.8),
    ]
)  # fmt: skip
BODY: Final = slice(0, 12)
WINDSCREEN: Final = slice(12, 16)
REAR_WINDOW: Final = slice(16, 20)
BRAKE_LIGHTS: Final = (slice(20, 24), slice(24, 28))

WALKER: Final = np.array([(0.0, 0.0), (1.6, 0.0)])
"""Centre and nose of a pedestrian."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A shape at every sample.

    Attributes:
        corners_px: In pixels of the canvas, shape ``(n, k, 2)``; NaN where it is not there.
        present: Whether it is there, shape ``(n,)``.
    """

    corners_px: NDArray[np.float64]
    present: NDArray[np.bool_]


def shape_over_time(
    template: NDArray[np.float64], poses: FloatArray, length_m: float, width_m: float, viewport: Viewport
) -> Shape:
    """Return a shape placed at every pose.

    Args:
        template: Corners in half lengths and half widths, shape ``(k, 2)``.
        poses: x_m, y_m, yaw_rad in the first columns, shape ``(n, 3 or more)``.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
        viewport: Where the canvas is.
    """
    places = np.asarray(poses[:, :3], dtype=np.float64)
    local = template * (length_m / 2, width_m / 2)
    cosine, sine = np.cos(places[:, 2]), np.sin(places[:, 2])
    turn = np.stack([np.stack([cosine, sine], axis=1), np.stack([-sine, cosine], axis=1)], axis=1)
    world = local @ turn + places[:, None, :2]
    flat = viewport.to_px(world.reshape(-1, 2))
    return Shape(corners_px=flat.reshape(world.shape), present=np.isfinite(places.sum(axis=1)))
