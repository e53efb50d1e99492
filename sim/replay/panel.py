"""The panel of a frame: speed, what the requirement says, plan mode, traffic light, and the legend."""

from collections.abc import Callable
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.sim.replay.captions import with_unit
from brink.sim.replay.geometry import dashes
from brink.sim.replay.layout import Layout
from brink.sim.replay.moments import Story
from brink.sim.replay.palette import (
    EGO,
    EGO_TRAIL,
    GHOST,
    HAIRLINE,
    INK,
    LAMP_OFF,
    LIGHTS,
    MUTED,
    PANEL,
    PAPER,
    PEDESTRIAN,
    PLAN_MODES,
    ROUTE,
    SEEN,
    UNKNOWN_MODE,
    VEHICLE,
    VIOLATION,
    Rgb,
    readable_on,
    typeface,
)
from brink.sim.trace import Trace

SPEED_BAR_TO_MPS: Final = 14.0
LAMPS: Final = ("red", "amber", "green")


class Panel:
    """Draws the panel of any sample of one episode onto a frame.

    Args:
        trace: The episode.
        story: What the replay is about.
        layout: Where the panel lies.
    """

    def __init__(self, trace: Trace, story: Story, layout: Layout) -> None:
        self._trace = trace
        self._story = story
        self._unit = layout.unit
        self._left, self._top, self._right, self._bottom = layout.panel
        self._small = typeface(round(11 * layout.unit))
        self._word = typeface(round(12 * layout.unit), bold=True)
        self._number = typeface(round(17 * layout.unit), bold=True)
        self._fastest = max(SPEED_BAR_TO_MPS, float(trace.ego[:, 3].max()))

    def draw_still(self, frame: Image.Image) -> None:
        """Draw what is the same in every frame: captions and the legend."""
        draw = ImageDraw.Draw(frame)
        unit, left = self._unit, self._left
        middle = (left + self._right) / 2
        draw.text((left, self._top), "speed", fill=MUTED, font=self._small)
        draw.text((middle, self._top), self._story.title, fill=MUTED, font=self._small)
        draw.text((left, self._top + 52 * unit), "plan", fill=MUTED, font=self._small)
        draw.text((middle, self._top + 52 * unit), "traffic light", fill=MUTED, font=self._small)
        line = self._top + round(100 * unit)
        draw.line((left, line, self._right, line), fill=HAIRLINE)
        self._draw_legend(draw, line + round(8 * unit))

    def draw(self, frame: Image.Image, sample: int) -> None:
        """Draw what changes."""
        draw = ImageDraw.Draw(frame)
        self._draw_speed(draw, sample)
        self._draw_requirement(draw, sample)
        self._draw_plan(draw, self._trace.plan_mode[sample])
        self._draw_light(draw, self._trace.lights[sample])

    def _draw_speed(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        unit, left, top = self._unit, self._left, self._top + 14 * self._unit
        speed, target = float(self._trace.ego[sample, 3]), float(self._trace.target_speed_mps[sample])
        draw.text((left, top), f"{speed:.1f} m/s", fill=INK, font=self._number)
        right = left + 120 * unit
        bar = top + 24 * unit
        draw.rectangle((left, bar, right, bar + 5 * unit), fill=HAIRLINE)
        full = (right - left) / self._fastest
        draw.rectangle((left, bar, left + max(0.0, speed) * full, bar + 5 * unit), fill=EGO)
        at = left + min(max(0.0, target), self._fastest) * full
        draw.line((at, bar - 2 * unit, at, bar + 7 * unit), fill=INK, width=max(2, round(2 * unit)))

    def _draw_requirement(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        middle = (self._left + self._right) / 2
        value = float(self._trace.robustness[self._story.requirement][sample])
        top = self._top + 14 * self._unit
        finite = np.isfinite(value)
        text = with_unit(value, self._story.requirement) if finite else "not concerned"
        colour = VIOLATION if value < 0 else INK
        draw.text((middle, top), text, fill=colour, font=self._number if finite else self._word)
        word = "violated" if value < 0 else ("to spare" if finite else "")
        draw.text(
            (middle, top + 21 * self._unit), word, fill=colour if value < 0 else MUTED, font=self._small
        )

    def _draw_plan(self, draw: ImageDraw.ImageDraw, mode: str) -> None:
        unit = self._unit
        colour = PLAN_MODES.get(mode, UNKNOWN_MODE)
        left, top = self._left, self._top + 67 * unit
        box = (left, top, left + 100 * unit, top + 21 * unit)
        draw.rounded_rectangle(box, radius=4 * unit, fill=colour)
        draw.text(
            ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2),
            mode,
            fill=readable_on(colour),
            font=self._word,
            anchor="mm",
        )

    def _draw_light(self, draw: ImageDraw.ImageDraw, state: str) -> None:
        unit = self._unit
        left, top = (self._left + self._right) / 2, self._top + 67 * unit
        if not state:
            draw.text((left, top + 10 * unit), "none", fill=MUTED, font=self._small, anchor="lm")
            return
        draw.rounded_rectangle((left, top, left + 62 * unit, top + 21 * unit), radius=5 * unit, fill=INK)
        for index, lamp in enumerate(LAMPS):
            x, y, radius = left + (12 + 19 * index) * unit, top + 10.5 * unit, 7 * unit
            colour = LIGHTS[lamp] if lamp == state else LAMP_OFF
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
        draw.text((left + 69 * unit, top + 10.5 * unit), state, fill=INK, font=self._small, anchor="lm")

    def _draw_legend(self, draw: ImageDraw.ImageDraw, top: float) -> None:
        unit = self._unit
        entries: list[tuple[str, Callable[[ImageDraw.ImageDraw, float, float], None]]] = [
            ("ego, its trail", self._key_car(EGO, EGO_TRAIL)),
            ("its route", self._key_line(ROUTE)),
            ("vehicle", self._key_car(VEHICLE, None)),
            ("pedestrian", self._key_dot(PEDESTRIAN)),
            ("ghost: perceived, not there", self._key_ghost),
            ("camera: what is there", self._key_box(SEEN)),
            ("camera: what was reported", self._key_dashed_box),
        ]
        if self._trace.film is not None:
            entries = entries[:4]  # the lines on the picture are explained below it
        spots = [(0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (0, 3), (0, 4)]
        for (text, key), (column, row) in zip(entries, spots, strict=False):
            x = self._left + column * (self._right - self._left) / 2
            y = top + (9 + 20 * row) * unit
            if y + 8 * unit > self._bottom:
                continue
            key(draw, x, y)
            draw.text((x + 32 * unit, y), text, fill=INK, font=self._small, anchor="lm")

    def _key_car(self, colour: Rgb, trail: Rgb | None) -> Callable[[ImageDraw.ImageDraw, float, float], None]:
        unit = self._unit

        def key(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
            if trail is not None:
                draw.line((x, y, x + 8 * unit, y), fill=trail, width=max(2, round(2 * unit)))
            box = (x + 5 * unit, y - 4.5 * unit, x + 25 * unit, y + 4.5 * unit)
            draw.rounded_rectangle(box, radius=3 * unit, fill=colour)

        return key

    def _key_line(self, colour: Rgb) -> Callable[[ImageDraw.ImageDraw, float, float], None]:
        unit = self._unit

        def key(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
            draw.line((x + 2 * unit, y, x + 25 * unit, y), fill=colour, width=max(2, round(3 * unit)))

        return key

    def _key_dot(self, colour: Rgb) -> Callable[[ImageDraw.ImageDraw, float, float], None]:
        unit = self._unit

        def key(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
            draw.ellipse((x + 11 * unit, y - 4 * unit, x + 19 * unit, y + 4 * unit), fill=colour)

        return key

    def _key_box(self, colour: Rgb) -> Callable[[ImageDraw.ImageDraw, float, float], None]:
        unit = self._unit

        def key(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
            draw.rectangle((x + 5 * unit, y - 6 * unit, x + 25 * unit, y + 6 * unit), outline=colour, width=2)

        return key

    def _key_dashed_box(self, draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
        unit = self._unit
        corners = np.array([(x + 5 * unit, y - 6 * unit), (x + 25 * unit, y - 6 * unit)])
        box = np.vstack([corners, corners[::-1] + np.array([0, 12 * unit])])
        for piece in dashes(box, 4 * unit, 3 * unit, closed=True):
            draw.line(piece.ravel().tolist(), fill=GHOST, width=2)

    def _key_ghost(self, draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
        unit = self._unit
        self._key_dashed_box(draw, x, y)
        left, top, right, bottom = x + 5 * unit, y - 6 * unit, x + 25 * unit, y + 6 * unit
        draw.line((left, top, right, bottom), fill=GHOST)
        draw.line((left, bottom, right, top), fill=GHOST)


def paint_grounds(frame: Image.Image, layout: Layout) -> None:
    """Fill the grounds of header, panel and time bar, and frame the camera's picture."""
    draw = ImageDraw.Draw(frame)
    width, height = layout.size
    draw.rectangle((0, 0, width, height), fill=PANEL)
    draw.rectangle(layout.header, fill=PAPER)
    draw.rectangle(layout.time_bar, fill=PAPER)
    for y in (layout.header[3] - 1, layout.time_bar[1]):
        draw.line((0, y, width, y), fill=HAIRLINE)
