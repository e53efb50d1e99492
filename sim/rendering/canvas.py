"""The image and the id mask while they are being painted, and the labels derived from them.

The same polygons are painted with smooth edges into the image and with hard edges into the mask, so both agree within
a pixel. The marks of each body are kept as its outline, so that the pixels of its silhouette can be counted
separately.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from brink.sim.rendering.scene import (
    BodyKind,
    Coverage,
    Frame,
    IdMask,
    IntArray,
    Mark,
    Outline,
    Picture,
    Stamp,
    Stroke,
)
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


def _solid_parts(outline: Outline) -> tuple[list[IntArray], IntArray, list[Stamp]]:
    """Return the polygons of a silhouette, all their points, and its stamps."""
    strokes: list[IntArray] = []
    stamps: list[Stamp] = []
    for mark in outline.marks:
        if isinstance(mark, Stamp):
            stamps.append(mark)
        elif mark.solid and len(mark.points) > 2:
            strokes.append(mark.points)
    return strokes, np.concatenate(strokes) if strokes else np.empty((0, 2), np.int32), stamps


def _silhouette(outline: Outline, width_px: int, height_px: int) -> tuple[int, int, Coverage] | None:
    """Return the top-left corner and the hard-edged mask of a body on its own, cropped to the image."""
    strokes, points, stamps = _solid_parts(outline)
    box = _bounds(points, stamps, width_px, height_px)
    return None if box is None else (box[0], box[1], _painted(strokes, points, stamps, box))


def _painted(
    strokes: list[IntArray], points: IntArray, stamps: list[Stamp], box: tuple[int, int, int, int]
) -> Coverage:
    """Return the hard-edged mask of a silhouette within a box of left, top, right and bottom edge."""
    left, top, right, bottom = box
    mask = np.zeros((bottom - top, right - left), np.uint8)
    points = points - np.array([left << SHIFT, top << SHIFT], np.int32)
    fill, hard, first = cv2.fillConvexPoly, cv2.LINE_8, 0
    for stroke in strokes:
        last = first + len(stroke)
        fill(mask, points[first:last], 255, hard, SHIFT)
        first = last
    for stamp in stamps:
        height, width = stamp.coverage.shape
        row, column = stamp.top_px - top, stamp.left_px - left
        region = mask[row : row + height, column : column + width]
        np.maximum(region, stamp.coverage, out=region)
    return mask


def _bounds(
    points: IntArray, stamps: list[Stamp], width_px: int, height_px: int
) -> tuple[int, int, int, int] | None:
    left, top, right, bottom = width_px, height_px, 0, 0
    if len(points):
        low_x, low_y, wide, high = cv2.boundingRect(points)
        left, top = min(left, (low_x >> SHIFT) - 1), min(top, (low_y >> SHIFT) - 1)
        right, bottom = ((low_x + wide - 1) >> SHIFT) + 3, ((low_y + high - 1) >> SHIFT) + 3
    for stamp in stamps:
        height, width = stamp.coverage.shape
        left, top = min(left, stamp.left_px), min(top, stamp.top_px)
        right, bottom = max(right, stamp.left_px + width), max(bottom, stamp.top_px + height)
    left, top = max(left, 0), max(top, 0)
    right, bottom = min(right, width_px), min(bottom, height_px)
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
    seen = _seen_boxes(frame.ids)
    found = []
    for number in sorted(frame.outlines):
        outline = frame.outlines[number]
        alone = _silhouette(outline, width_px, height_px)
        if alone is None:
            continue
        left, top, mask = alone
        column, row, wide, high = cv2.boundingRect(mask)
        if wide == 0:
            continue
        visible_px, box = seen.get(number, (0, None))
        found.append(
            VisibleBody(
                id=number,
                kind=outline.kind,
                box=box,
                whole_box=PixelBox(left + column, top + row, left + column + wide, top + row + high),
                visible_px=visible_px,
                whole_px=cv2.countNonZero(mask),
                depth_m=outline.depth_m,
            )
        )
    return tuple(found)


class SeenBody(NamedTuple):
    """A body with visible pixels.

    Attributes:
        id: Id of the body.
        kind: Kind of body.
        box: Tight box around its visible pixels.
        clear: Whether the box is large enough and enough of the silhouette is visible.
    """

    id: int
    kind: BodyKind
    box: PixelBox
    clear: bool


def seen_bodies(frame: Frame, *, least_px: tuple[float, float], least_share: float) -> tuple[SeenBody, ...]:
    """Return all bodies with visible pixels, sorted by id, in a fraction of the time of `visible_bodies`.

    Args:
        frame: A rendered image.
        least_px: Width and height of the box from which a body may be clear.
        least_share: Visible share of the silhouette from which a body may be clear.
    """
    found = []
    for number, (visible_px, box) in _seen_boxes(frame.ids).items():
        outline = frame.outlines[number]
        large = box.x_max_px - box.x_min_px >= least_px[0] and box.y_max_px - box.y_min_px >= least_px[1]
        clear = large and _shows(outline, visible_px, least_share, frame.ids.shape)
        found.append(SeenBody(number, outline.kind, box, clear))
    return tuple(found)


def _shows(outline: Outline, visible_px: int, least_share: float, shape: tuple[int, ...]) -> bool:
    """Return whether the visible share of a silhouette is large enough."""
    height_px, width_px = shape
    strokes, points, stamps = _solid_parts(outline)
    box = _bounds(points, stamps, width_px, height_px)
    if box is None:
        return False
    left, top, right, bottom = box
    # No silhouette is larger than its bounds, so most bodies need not be painted again.
    if visible_px >= least_share * (right - left) * (bottom - top):
        return True
    return visible_px / cv2.countNonZero(_painted(strokes, points, stamps, box)) >= least_share


def _seen_boxes(ids: IdMask) -> dict[int, tuple[int, PixelBox]]:
    """Return the number of pixels of each id in a mask and their tight box, by ascending id, in one pass."""
    width = ids.shape[1]
    flat = ids.ravel()
    # Runs of equal pixels within a row are far fewer than pixels.
    begins = np.ones(len(flat), np.bool_)
    np.not_equal(flat[1:], flat[:-1], out=begins[1:])
    begins[::width] = True
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(flat)) - 1
    numbers = flat[first]
    taken = np.flatnonzero(numbers)
    if len(taken) == 0:
        return {}
    # Sorting is stable, so the first and last run of each id are in its first and last row.
    taken = taken[np.argsort(numbers[taken], kind="stable")]
    first, last, numbers = first[taken], last[taken], numbers[taken]
    starts = np.concatenate(([0], np.flatnonzero(np.diff(numbers)) + 1))
    ends = np.append(starts[1:], len(numbers))
    rows = first // width
    edges = zip(
        numbers[starts].tolist(),
        np.add.reduceat(last - first + 1, starts).tolist(),
        np.minimum.reduceat(first - rows * width, starts).tolist(),
        rows[starts].tolist(),
        np.maximum.reduceat(last - rows * width, starts).tolist(),
        rows[ends - 1].tolist(),
        strict=True,
    )
    return {
        number: (count, PixelBox(left, top, right + 1, bottom + 1))
        for number, count, left, top, right, bottom in edges
    }
