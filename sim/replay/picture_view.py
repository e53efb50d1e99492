"""What the camera really saw: its picture, perturbed as the detector was shown it, with boxes and regions on it.

Green solid boxes are the ground truth, red ones what was detected surely enough to count; yellow lines are the
regions in which a detection brakes the car.
"""

import io
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.sim.replay.geometry import dashes
from brink.sim.replay.palette import (
    FOUND_ON_PICTURE,
    INK,
    PAPER,
    REGION_ON_PICTURE,
    SEEN_ON_PICTURE,
    Rgb,
    typeface,
)
from brink.sim.trace import Film, FloatArray, Trace

LABELS: Final = ("vehicle", "person")
PERSON: Final = 1


def threshold_of(trace: Trace) -> float:
    """Return the least score that counted in an episode; 0 if it does not say."""
    spec = trace.about.get("spec")
    behaviour = spec.get("behaviour") if isinstance(spec, dict) else None
    value = behaviour.get("threshold") if isinstance(behaviour, dict) else None
    return float(value) if isinstance(value, int | float) else 0.0


class PictureView:
    """Draws what the camera saw at any sample of one episode: the latest picture that was kept, and its boxes.

    Args:
        film: What the camera saw.
        threshold: Least score of a detection that is drawn.
        size_px: Width and height of the drawing; the picture is stretched to it.
    """

    def __init__(self, film: Film, *, threshold: float, size_px: tuple[int, int]) -> None:
        self._film = film
        self._threshold = threshold
        self._size = size_px
        self._scale = np.array(size_px) / np.array(film.size_px)
        self._font = typeface(max(9, round(size_px[1] / 28)), bold=True)

    def draw(self, sample: int) -> Image.Image:
        """Return the picture at a sample, in RGB, of the view's size."""
        film = self._film
        place = max(0, int(np.searchsorted(film.samples, sample, side="right")) - 1)
        with Image.open(io.BytesIO(film.pictures[place])) as picture:
            image = picture.convert("RGB").resize(self._size, Image.Resampling.BILINEAR)
        draw = ImageDraw.Draw(image)
        for name, corners in film.regions.items():
            self._draw_region(draw, corners, solid=name == "warning")
        shown = int(film.samples[place])
        for row in film.judged.at(shown):
            if not row[5]:
                self._draw_box(draw, row, SEEN_ON_PICTURE, 1)
        for row in film.found.at(shown)[::-1]:
            if row[5] >= self._threshold:
                self._draw_box(draw, row, FOUND_ON_PICTURE, 2)
                if row[0] == PERSON:
                    self._name(draw, row)
        return image

    def _draw_region(self, draw: ImageDraw.ImageDraw, corners: FloatArray, *, solid: bool) -> None:
        points = corners * self._scale
        points[:, 1] = np.minimum(points[:, 1], self._size[1] - 1)
        if solid:
            draw.line([*points.ravel().tolist(), *points[0].tolist()], fill=REGION_ON_PICTURE, width=2)
            return
        for piece in dashes(points, 6.0, 6.0, closed=True):
            draw.line(piece.ravel().tolist(), fill=REGION_ON_PICTURE, width=1)

    def _draw_box(self, draw: ImageDraw.ImageDraw, row: FloatArray, colour: Rgb, width: int) -> None:
        left, top, right, bottom = self._corners(row)
        draw.rectangle((left, top, right, bottom), outline=colour, width=width)

    def _name(self, draw: ImageDraw.ImageDraw, row: FloatArray) -> None:
        left, top, _, bottom = self._corners(row)
        text = f"{LABELS[int(row[0])]} {row[5]:.2f}".replace("0.", ".")
        high = self._font.size
        y = top - high - 3 if top > high + 4 else bottom + 1
        draw.text((left, y), text, fill=FOUND_ON_PICTURE, font=self._font, stroke_width=2, stroke_fill=PAPER)

    def _corners(self, row: FloatArray) -> tuple[float, float, float, float]:
        low = np.array([row[1], row[3]], np.float64) * self._scale
        high = np.array([row[2], row[4]], np.float64) * self._scale
        limit = np.array(self._size) - 1.0
        (left, top), (right, bottom) = np.clip(low, 0.0, limit), np.clip(high, 0.0, limit)
        return float(left), float(top), float(max(right, left)), float(max(bottom, top))


def draw_key(draw: ImageDraw.ImageDraw, at: tuple[float, float], unit: float) -> None:
    """Draw what the lines on a picture mean, in one row."""
    x, y = at
    font = typeface(round(11 * unit))
    for colour, text in (
        (SEEN_ON_PICTURE, "there"),
        (FOUND_ON_PICTURE, "detected"),
        (REGION_ON_PICTURE, "a person here brakes (dashed: a vehicle)"),
    ):
        box = (x, y - 6 * unit, x + 20 * unit, y + 6 * unit)
        draw.rectangle(box, fill=(70, 74, 78), outline=colour, width=2)
        draw.text((x + 26 * unit, y), text, fill=INK, font=font, anchor="lm")
        x += 26 * unit + draw.textlength(text, font=font) + 14 * unit
