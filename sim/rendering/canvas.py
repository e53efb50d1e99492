"""The image and the id mask while they are being painted, and the labels derived from them.

The same polygons are painted with smooth edges into the image and with hard edges into the mask, so both agree within
a pixel. The marks of each body are kept as its outline, so that the pixels of its silhouette can be counted
separately.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from brink.sim.rendering.scene import BodyKind, Coverage, Frame, IdMask, Mark, Outline, Picture, Stamp, Stroke
from brink.sim.rendering.view import SHIFT


@dataclass(slots=True, kw_only=True, eq=False)
class Canvas:
    """An image and its id mask while they are being painted."""

    image: Picture
    ids: IdMask

    def paint(self, marks: list[Mark], number: int) -> None:
        """Paint marks over the current content.

        Args:
            marks: Strokes and stamps, in order.
            number: Id written into the mask, 0 for objects without an id.
        """
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


def _silhouette(outline: Outline, width_px: int, height_px: int) -> tuple[int, int, Coverage] | None:
    """Return the top-left corner and the hard-edged mask of a body on its own, cropped to the image."""
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


class PixelBox(NamedTuple):
    """A box in integer pixel coordinates; the maxima are exclusive."""

    x_min_px: int
    y_min_px: int
    x_max_px: int
    y_max_px: int


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleBody:
    """A body that lies at least partly within the image.

    Attributes:
        id: Id of the body.
        kind: Kind of body.
        box: Tight box around its visible pixels; None if it is completely hidden.
        whole_box: Tight box around its unoccluded silhouette, cropped to the image.
        visible_px: Number of visible pixels.
        whole_px: Number of pixels of the unoccluded silhouette within the image, at least 1.
        depth_m: Depth of the nearest corner along the camera's axis; 0 if the body reaches behind the camera.
    """

    id: int
    kind: BodyKind
    box: PixelBox | None
    whole_box: PixelBox
    visible_px: int
    whole_px: int
    depth_m: float

    @property
    def visible_share(self) -> float:
        """Visible share of the unoccluded silhouette, in [0, 1]."""
        return self.visible_px / self.whole_px


def visible_bodies(frame: Frame) -> tuple[VisibleBody, ...]:
    """Return all bodies at least partly within the image, hidden ones included, sorted by id."""
    height_px, width_px = frame.ids.shape
    found = []
    for number in sorted(frame.outlines):
        outline = frame.outlines[number]
        alone = _silhouette(outline, width_px, height_px)
        if alone is None:
            continue
        left, top, mask = alone
        whole = _tight_box(mask, left, top)
        if whole is None:
            continue
        region = frame.ids[top : top + mask.shape[0], left : left + mask.shape[1]]
        seen = np.equal(region, number).view(np.uint8)
        visible_px = int(np.count_nonzero(seen))
        found.append(
            VisibleBody(
                id=number,
                kind=outline.kind,
                box=_tight_box(seen, left, top) if visible_px else None,
                whole_box=whole,
                visible_px=visible_px,
                whole_px=int(np.count_nonzero(mask)),
                depth_m=outline.depth_m,
            )
        )
    return tuple(found)


def _tight_box(mask: Coverage, left: int, top: int) -> PixelBox | None:
    """Return the tight box around the nonzero pixels of a mask at (left, top), or None if there are none."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return None
    return PixelBox(
        left + int(columns[0]), top + int(rows[0]), left + int(columns[-1]) + 1, top + int(rows[-1]) + 1
    )
