"""The camera's picture of a frame, as a sketch: the flat scene in perspective, what is there, what was reported.

Green solid boxes are the ground truth, the component's input; vermilion dashed ones are what it was made to say.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from brink.sim.driving.camera import Camera
from brink.sim.replay.geometry import Points, dashes
from brink.sim.replay.palette import (
    BLURRED_PEDESTRIAN,
    BLURRED_VEHICLE,
    GHOST,
    GROUND,
    PAPER,
    SEEN,
    SKY,
    SURFACES,
    UNKNOWN_SURFACE,
    typeface,
)
from brink.sim.replay.scene import SUPERSAMPLING
from brink.sim.trace import Trace

DRAWN_FROM_M: Final = 0.4
DRAWN_TO_M: Final = 90.0
FAR_PX: Final = 4000.0
"""Points are drawn at most this far outside of the picture."""
UPRIGHT_M: Final = {"building": 6.0, "parked-car": 1.4, "tree": 4.5}
"""How high the sketch makes what stands up; the trace knows footprints only."""
LABELS: Final = ("vehicle", "person")


class _Area(NamedTuple):
    kind: str
    first: int
    last: int


class CameraView:
    """Draws the camera's picture of any sample of one episode.

    Args:
        trace: The episode.
        size_px: Width and height of the picture, four to three.
    """

    def __init__(self, trace: Trace, *, size_px: tuple[int, int]) -> None:
        self._trace = trace
        self._size = size_px
        self._camera = Camera()
        surfaces = [surface for surface in trace.scene if surface.closed and len(surface.points) > 2]
        ends = np.cumsum([0, *(len(surface.points) for surface in surfaces)]).tolist()
        self._areas = [_Area(s.kind, a, b) for s, a, b in zip(surfaces, ends[:-1], ends[1:], strict=True)]
        self._points = np.vstack([np.zeros((0, 2)), *(s.points.astype(np.float64) for s in surfaces)])
        self._scale = np.array(size_px) / (self._camera.width_px, self._camera.height_px)
        self._font = typeface(max(8, round(size_px[1] / 18)), bold=True)

    def draw(self, sample: int) -> Image.Image:
        """Return the picture at a sample, in RGB, of the view's size."""
        width, height = (side * SUPERSAMPLING for side in self._size)
        image = Image.new("RGB", (width, height), SKY)
        draw = ImageDraw.Draw(image)
        draw.rectangle((0, height / 2, width, height), fill=GROUND)
        self._draw_scene(draw, sample)
        self._draw_bodies(draw, sample)
        image = image.reduce(SUPERSAMPLING)
        self._draw_reported(ImageDraw.Draw(image), sample)
        return image

    def _draw_scene(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        if not self._areas:
            return
        x_m, y_m, yaw_rad = (float(value) for value in self._trace.ego[sample, :3])
        cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
        seen = (self._points - (x_m, y_m)) @ np.array([[cosine, -sine], [sine, cosine]])
        seen[:, 0] -= self._camera.forward_m
        ground = self._project(seen, 0.0)
        starts = [area.first for area in self._areas]
        nearest, farthest = np.minimum.reduceat(seen[:, 0], starts), np.maximum.reduceat(seen[:, 0], starts)
        beside = np.minimum.reduceat(np.abs(seen[:, 1]) - np.maximum(seen[:, 0], 0.0), starts) > 0
        sides = np.minimum.reduceat(seen[:, 1], starts) * np.maximum.reduceat(seen[:, 1], starts) > 0
        drawn = (farthest > DRAWN_FROM_M) & (nearest < DRAWN_TO_M) & ~(beside & sides & (nearest > 0))
        upright: list[tuple[float, str, Points]] = []
        for index in np.flatnonzero(drawn).tolist():
            kind, first, last = self._areas[index]
            if kind in UPRIGHT_M:
                upright.append((float(nearest[index] + farthest[index]), kind, seen[first:last]))
                continue
            whole = nearest[index] >= DRAWN_FROM_M
            corners = ground[first:last] if whole else self._project(_cut(seen[first:last]), 0.0)
            if len(corners) > 2:
                draw.polygon(corners.ravel().tolist(), fill=SURFACES.get(kind, UNKNOWN_SURFACE)[0])
        for _, kind, points in sorted(upright, key=lambda item: -item[0]):
            self._draw_upright(draw, kind, points)

    def _draw_upright(self, draw: ImageDraw.ImageDraw, kind: str, points: Points) -> None:
        """Draw the walls over a footprint, farthest first; those across the view lighter than those along it."""
        fill, edge = SURFACES[kind]
        corners = _cut(points)
        if len(corners) < 2:
            return
        foot, top = self._project(corners, 0.0), self._project(corners, UPRIGHT_M[kind])
        depth = corners[:, 0] + np.roll(corners[:, 0], 1)
        along = np.abs(np.diff(corners, axis=0, prepend=corners[-1:]))
        for index in np.argsort(-depth).tolist():
            wall = np.vstack([foot[index - 1], foot[index], top[index], top[index - 1]])
            shade = edge if edge is not None and along[index, 0] > along[index, 1] else fill
            draw.polygon(wall.ravel().tolist(), fill=shade)

    def _project(self, points: Points, height_m: float) -> NDArray[np.float64]:
        """Return (depth, left) at a height above the ground as supersampled pixels of the view."""
        camera = self._camera
        depth = np.maximum(points[:, 0], DRAWN_FROM_M)
        pixels = np.empty((len(points), 2))
        pixels[:, 0] = camera.centre_x_px - camera.focal_px * points[:, 1] / depth
        pixels[:, 1] = camera.horizon_px + camera.focal_px * (camera.height_m - height_m) / depth
        return np.clip(pixels, -FAR_PX, FAR_PX) * (self._scale * SUPERSAMPLING)

    def _draw_bodies(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        """Draw the ground truth: a silhouette and a solid box each, the nearest last."""
        rows = self._trace.seen_boxes.at(sample)
        for row in rows[np.argsort(rows[:, 4])]:
            box = self._corners(row) * SUPERSAMPLING
            colour = BLURRED_VEHICLE if row[0] == 0 else BLURRED_PEDESTRIAN
            draw.rectangle(box.ravel().tolist(), fill=colour, outline=SEEN, width=2 * SUPERSAMPLING)

    def _draw_reported(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        for row in self._trace.given_boxes.at(sample):
            (left, top), (right, bottom) = self._corners(row).tolist()
            corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
            for piece in dashes(corners, 7.0, 4.0, closed=True):
                draw.line(piece.ravel().tolist(), fill=GHOST, width=2)
            word = LABELS[int(row[0])] if int(row[0]) in (0, 1) else "obstacle"
            wide = draw.textlength(word, font=self._font)
            at = (min(left + 3, self._size[0] - wide - 3), max(2.0, top - self._font.size - 3))
            draw.text(at, word, fill=GHOST, font=self._font, stroke_width=2, stroke_fill=PAPER)

    def _corners(self, row: NDArray[np.float32]) -> Points:
        """Return top left and bottom right of an image box in pixels of the view, inside it."""
        corners = np.array([(row[1], row[3]), (row[2], row[4])], dtype=np.float64) * self._scale
        return np.clip(corners, 1.0, np.array(self._size) - 2.0)


def _cut(points: Points) -> Points:
    """Return the part of a polygon of (depth, left) beyond the nearest depth that is drawn."""
    if (points[:, 0] >= DRAWN_FROM_M).all():
        return points
    kept: list[Points] = []
    for index, here in enumerate(points):
        if here[0] >= DRAWN_FROM_M:
            kept.append(here)
        following = points[(index + 1) % len(points)]
        if (here[0] >= DRAWN_FROM_M) != (following[0] >= DRAWN_FROM_M):
            share = (DRAWN_FROM_M - here[0]) / (following[0] - here[0])
            kept.append(here + share * (following - here))
    return np.array(kept).reshape(-1, 2)
