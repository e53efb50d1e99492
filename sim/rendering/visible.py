"""Owns the labels of a picture: where each body is seen, how much of it, and where it would be if it were alone."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from brink.sim.rendering.canvas import Coverage, silhouette
from brink.sim.rendering.scene import BodyKind, Frame


class PixelBox(NamedTuple):
    """A box of whole pixels; the maxima lie just beyond it."""

    x_min_px: int
    y_min_px: int
    x_max_px: int
    y_max_px: int


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleBody:
    """A body within the picture.

    Attributes:
        id: Whose.
        kind: What it is.
        box: Tight around its visible pixels; None if it is hidden altogether.
        whole_box: Tight around its silhouette if it were alone, cropped to the picture.
        visible_px: Visible pixels.
        whole_px: Pixels of its silhouette within the picture if it were alone, at least 1.
        depth_m: Depth of its nearest corner along the camera's axis; 0 where it reaches behind the camera.
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
        """Visible pixels per pixel of the silhouette alone, 0 to 1."""
        return self.visible_px / self.whole_px


def visible_bodies(frame: Frame) -> tuple[VisibleBody, ...]:
    """Return every body of which something lies within the picture, hidden or not, by id."""
    height_px, width_px = frame.ids.shape
    found = []
    for number in sorted(frame.outlines):
        outline = frame.outlines[number]
        alone = silhouette(outline, width_px, height_px)
        if alone is None:
            continue
        left, top, mask = alone
        whole = _tight(mask, left, top)
        if whole is None:
            continue
        region = frame.ids[top : top + mask.shape[0], left : left + mask.shape[1]]
        seen = np.equal(region, number).view(np.uint8)
        visible_px = int(np.count_nonzero(seen))
        found.append(
            VisibleBody(
                id=number,
                kind=outline.kind,
                box=_tight(seen, left, top) if visible_px else None,
                whole_box=whole,
                visible_px=visible_px,
                whole_px=int(np.count_nonzero(mask)),
                depth_m=outline.depth_m,
            )
        )
    return tuple(found)


def _tight(mask: Coverage, left: int, top: int) -> PixelBox | None:
    """Return the tight box around what is not 0."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return None
    return PixelBox(
        left + int(columns[0]), top + int(rows[0]), left + int(columns[-1]) + 1, top + int(rows[-1]) + 1
    )
