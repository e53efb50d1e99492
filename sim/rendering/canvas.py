"""Owns the two sheets that are painted together: the picture and the id mask.

The picture is painted with smooth edges, the mask with hard ones, from the same polygons, so that they agree within
a pixel. What is painted for a body is kept as its outline: its silhouette can be counted later, alone.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.scene import BodyKind, IdMask, Picture
from brink.sim.rendering.view import SHIFT, IntArray

Rgb: TypeAlias = tuple[float, float, float]
Coverage: TypeAlias = NDArray[np.uint8]


class Stroke(NamedTuple):
    """One polygon of a body, convex: sixteenths of a pixel, its colour, and whether it adds to the silhouette."""

    points: IntArray
    rgb: Rgb
    solid: bool


class Stamp(NamedTuple):
    """A piece of texture of a body: where it lies in the picture, its pixels, and which of them count."""

    left_px: int
    top_px: int
    pixels: Picture
    coverage: Coverage


Mark: TypeAlias = Stroke | Stamp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """How a body was painted: what its silhouette is counted from.

    Attributes:
        kind: What it is.
        depth_m: Depth of its nearest corner along the camera's axis, at least 0.
        marks: What was painted, in order.
    """

    kind: BodyKind
    depth_m: float
    marks: tuple[Mark, ...]


@dataclass(slots=True, kw_only=True, eq=False)
class Canvas:
    """The picture and the mask while they are painted."""

    image: Picture
    ids: IdMask
    glows: list[tuple[float, float, float, Rgb]] = field(default_factory=list)

    def paint(self, marks: list[Mark], number: int) -> None:
        """Paint strokes and stamps over what is there; the mask gets `number`, 0 for what has no id."""
        image, ids = self.image, self.ids
        fill, smooth, hard = cv2.fillConvexPoly, cv2.LINE_AA, cv2.LINE_8
        for mark in marks:
            if isinstance(mark, Stroke):
                points, rgb, solid = mark
                if len(points) > 2:
                    fill(image, points, rgb, smooth, SHIFT)
                    if solid:
                        fill(ids, points, number, hard, SHIFT)
            else:
                self._stamp(mark, number)

    def _stamp(self, stamp: Stamp, number: int) -> None:
        height, width = stamp.coverage.shape
        rows = slice(stamp.top_px, stamp.top_px + height)
        columns = slice(stamp.left_px, stamp.left_px + width)
        cv2.copyTo(stamp.pixels, stamp.coverage, self.image[rows, columns])
        region = self.ids[rows, columns]
        cv2.copyTo(np.full((height, width), number, np.int32), stamp.coverage, region)


def silhouette(outline: Outline, width_px: int, height_px: int) -> tuple[int, int, Coverage] | None:
    """Return left, top and hard-edged silhouette of a body as if it were alone, cropped to the picture."""
    box = _bounds(outline.marks, width_px, height_px)
    if box is None:
        return None
    left, top, right, bottom = box
    mask = np.zeros((bottom - top, right - left), np.uint8)
    shift = np.array([left << SHIFT, top << SHIFT], np.int32)
    for mark in outline.marks:
        if isinstance(mark, Stamp):
            height, width = mark.coverage.shape
            row, column = mark.top_px - top, mark.left_px - left
            region = mask[row : row + height, column : column + width]
            np.maximum(region, mark.coverage, out=region)
        elif mark.solid and len(mark.points) > 2:
            cv2.fillConvexPoly(mask, mark.points - shift, 255, cv2.LINE_8, SHIFT)
    return left, top, mask


def _bounds(marks: tuple[Mark, ...], width_px: int, height_px: int) -> tuple[int, int, int, int] | None:
    corners = [
        mark.points for mark in marks if isinstance(mark, Stroke) and mark.solid and len(mark.points) > 2
    ]
    low = np.array([width_px, height_px])
    high = np.array([0, 0])
    if corners:
        points = np.concatenate(corners)
        low = np.minimum(low, (points.min(axis=0) >> SHIFT) - 1)
        high = np.maximum(high, (points.max(axis=0) >> SHIFT) + 3)
    for mark in marks:
        if isinstance(mark, Stamp):
            height, width = mark.coverage.shape
            low = np.minimum(low, (mark.left_px, mark.top_px))
            high = np.maximum(high, (mark.left_px + width, mark.top_px + height))
    left, top = max(int(low[0]), 0), max(int(low[1]), 0)
    right, bottom = min(int(high[0]), width_px), min(int(high[1]), height_px)
    if right <= left or bottom <= top:
        return None
    return left, top, right, bottom
