"""Owns rounded strokes: what a limb, a branch or a pole between two round ends looks like in the picture."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.canvas import Mark, Rgb, Stroke
from brink.sim.rendering.scene import FloatArray
from brink.sim.rendering.view import NEAR_M, View, fixed_point

_CAP_POINTS: Final = 5
_SHADED_FROM_PX: Final = 2.0
_SHRINK_PX: Final = 0.35
"""OpenCV fills half a pixel beyond a polygon's edge: thin strokes would come out fat."""


def cut_at_near(seen: FloatArray) -> NDArray[np.bool_]:
    """Cut strokes between two points, shape ``(n, 2, 3)``, at the near plane, in place; return which are gone."""
    depth = seen[..., 0].copy()
    for end, other in ((0, 1), (1, 0)):
        cut = (depth[:, end] < NEAR_M) & (depth[:, other] >= NEAR_M)
        if cut.any():
            part = (NEAR_M - depth[cut, end]) / (depth[cut, other] - depth[cut, end])
            seen[cut, end] += part[:, None] * (seen[cut, other] - seen[cut, end])
    gone: NDArray[np.bool_] = np.asarray((depth < NEAR_M).all(axis=1))
    return gone


def radius_px(seen: FloatArray, radius_m: FloatArray, view: View) -> FloatArray:
    """Return radii at the ends of strokes in pixels, shape ``(n, 2)``."""
    radius: FloatArray = radius_m * view.focal_px / np.maximum(seen[..., 0], NEAR_M)
    return radius


def rounded(seen: FloatArray, radius: FloatArray, view: View) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return strokes as convex polygons, and narrower ones for the shade on their right.

    Args:
        seen: Both ends in camera coordinates, beyond the near plane, shape ``(n, 2, 3)``.
        radius: At both ends, in pixels, shape ``(n, 2)``.
        view: Whence they are seen.

    Returns:
        Two arrays of shape ``(n, 10, 2)``, in sixteenths of a pixel.
    """
    pixels = view.pixels(seen.reshape(-1, 3)).reshape(-1, 2, 2)
    along = pixels[:, 1] - pixels[:, 0]
    base = np.arctan2(along[:, 1], along[:, 0])[:, None]
    angles = np.linspace(-np.pi / 2, np.pi / 2, _CAP_POINTS)
    reach = np.maximum(radius - _SHRINK_PX, 0.15)
    points = np.empty((len(seen), 2 * _CAP_POINTS, 2))
    for end, turns, first in ((1, base + angles, 0), (0, base + np.pi + angles, _CAP_POINTS)):
        rows = slice(first, first + _CAP_POINTS)
        points[:, rows, 0] = pixels[:, end, 0, None] + reach[:, end, None] * np.cos(turns)
        points[:, rows, 1] = pixels[:, end, 1, None] + reach[:, end, None] * np.sin(turns)
    shade = points.copy()
    axis = _axis_column(pixels, points)
    shade[..., 0] = axis + (points[..., 0] - axis) * 0.5 + 0.46 * reach.mean(axis=1)[:, None]
    return fixed_point(points), fixed_point(shade)


def limb_marks(
    joints_m: FloatArray, radii_m: FloatArray, colours: list[Rgb], view: View, *, flat_feet: bool
) -> list[list[Mark]]:
    """Return each limb's strokes: one in its colour and, if it is wide enough, a darker one for its shade.

    Args:
        joints_m: Both ends in the world, shape ``(n, 2, 3)``.
        radii_m: At both ends, shape ``(n, 2)``.
        colours: Of each.
        view: Whence they are seen.
        flat_feet: Whether limbs end flat where they begin, on the ground.
    """
    if len(joints_m) == 0:
        return []
    seen = view.to_camera(joints_m.reshape(-1, 3)).reshape(-1, 2, 3)
    gone = cut_at_near(seen).tolist()
    radius = radius_px(seen, radii_m, view)
    polygons, shades = rounded(seen, radius, view)
    if flat_feet:
        foot = fixed_point(view.pixels(seen[:, 0]))[:, 1, None]
        polygons[..., 1] = np.minimum(polygons[..., 1], foot)
        shades[..., 1] = np.minimum(shades[..., 1], foot)
    wide = (radius.max(axis=1) > _SHADED_FROM_PX).tolist()
    marks: list[list[Mark]] = []
    for index, (red, green, blue) in enumerate(colours):
        mine: list[Mark] = []
        if not gone[index]:
            mine.append(Stroke(polygons[index], (red, green, blue), True))
            if wide[index]:
                mine.append(Stroke(shades[index], (0.72 * red, 0.72 * green, 0.74 * blue), False))
        marks.append(mine)
    return marks


def _axis_column(pixels: FloatArray, points: FloatArray) -> FloatArray:
    """Return the column of a stroke's axis beside each of its points; of its middle where it lies flat."""
    start, end = pixels[:, 0], pixels[:, 1]
    rise = end[:, 1] - start[:, 1]
    steep = np.abs(rise) > np.abs(end[:, 0] - start[:, 0]) * 0.5
    safe = np.where(steep, rise, 1.0)[:, None]
    part = np.clip((points[..., 1] - start[:, 1, None]) / safe, 0, 1)
    column = start[:, 0, None] + part * (end[:, 0] - start[:, 0])[:, None]
    axis: FloatArray = np.where(steep[:, None], column, points[..., 0])
    return axis
