"""The time bar of a frame: plan modes, when injected boxes are there, when the requirement is violated, and now."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from brink.sim.replay.captions import report_word
from brink.sim.replay.layout import Layout
from brink.sim.replay.moments import Story
from brink.sim.replay.palette import (
    GHOST,
    HAIRLINE,
    INK,
    MUTED,
    PLAN_MODES,
    UNKNOWN_MODE,
    VIOLATION,
    readable_on,
    typeface,
)
from brink.sim.trace import Trace

Value = TypeVar("Value")
PERSON = 1


class TimeBar:
    """Draws the time bar of any sample of one episode onto a frame.

    Args:
        trace: The episode.
        story: What the replay is about.
        layout: Where the bar lies.
    """

    def __init__(self, trace: Trace, story: Story, layout: Layout) -> None:
        self._trace = trace
        self._story = story
        self._unit = layout.unit
        left, self._top, right, self._bottom = layout.time_bar
        self._left = left + round(70 * layout.unit)
        self._right = right - round(16 * layout.unit)
        self._font = typeface(round(10 * layout.unit))
        time_s = np.asarray(trace.time_s, dtype=np.float64)
        self._start_s = float(time_s[0])
        self._span_s = max(1e-6, float(time_s[-1] - time_s[0]))
        self._time_s = time_s

    def x_px(self, time_s: float) -> float:
        """Return the column of a simulated time."""
        return self._left + (time_s - self._start_s) / self._span_s * (self._right - self._left)

    def draw_still(self, frame: Image.Image) -> None:
        """Draw the rows and the time axis."""
        draw = ImageDraw.Draw(frame)
        unit = self._unit
        rows = [self._top + (6 + 13 * row) * unit for row in range(3)]
        reported = report_word(self._trace) if self._trace.film is None else "person seen"
        for name, y in zip(("plan", reported, "violated"), rows, strict=True):
            draw.text((self._left - 6 * unit, y + 5 * unit), name, fill=MUTED, font=self._font, anchor="rm")
            draw.rectangle((self._left, y, self._right, y + 10 * unit), fill=(238, 240, 242))
        for mode, first, last in runs(self._trace.plan_mode):
            self._draw_mode(draw, mode, first, last, rows[0])
        for count, first, last in runs(self._reported().tolist()):
            if count:
                self._draw_run(draw, first, last, rows[1], GHOST)
        below = np.asarray(self._trace.robustness[self._story.requirement]) < 0
        for violated, first, last in runs(below.tolist()):
            if violated:
                self._draw_run(draw, first, last, rows[2], VIOLATION)
        self._draw_axis(draw, self._top + 46 * unit)

    def _reported(self) -> NDArray[np.int64]:
        """Return how many boxes were reported at each sample; where a camera is in the loop, of people alone."""
        boxes = self._trace.given_boxes
        if self._trace.film is None:
            return np.asarray(np.diff(boxes.first), np.int64)
        sums = np.concatenate([[0], np.cumsum(boxes.rows[:, 0] == PERSON)])
        return np.asarray(np.diff(sums[boxes.first]), np.int64)

    def draw(self, frame: Image.Image, sample: int) -> None:
        """Draw where the sample is."""
        draw = ImageDraw.Draw(frame)
        unit = self._unit
        x = self.x_px(float(self._time_s[sample]))
        draw.line(
            (x, self._top + 2 * unit, x, self._top + 44 * unit), fill=INK, width=max(2, round(2 * unit))
        )
        tip = self._top + 2 * unit
        draw.polygon(
            (x - 5 * unit, tip - 3 * unit, x + 5 * unit, tip - 3 * unit, x, tip + 4 * unit), fill=INK
        )

    def _edges(self, first: int, last: int) -> tuple[float, float]:
        end = min(last + 1, len(self._time_s) - 1)
        left = self.x_px(float(self._time_s[first]))
        return left, max(left + 2, self.x_px(float(self._time_s[end])))

    def _draw_run(
        self, draw: ImageDraw.ImageDraw, first: int, last: int, y: float, colour: tuple[int, int, int]
    ) -> None:
        left, right = self._edges(first, last)
        draw.rectangle((left, y, right, y + 10 * self._unit), fill=colour)

    def _draw_mode(self, draw: ImageDraw.ImageDraw, mode: str, first: int, last: int, y: float) -> None:
        colour = PLAN_MODES.get(mode, UNKNOWN_MODE)
        self._draw_run(draw, first, last, y, colour)
        left, right = self._edges(first, last)
        if draw.textlength(mode, font=self._font) + 6 < right - left:
            draw.text(
                ((left + right) / 2, y + 5 * self._unit),
                mode,
                fill=readable_on(colour),
                font=self._font,
                anchor="mm",
            )

    def _draw_axis(self, draw: ImageDraw.ImageDraw, y: float) -> None:
        step_s = next(step for step in (1, 2, 5, 10, 30, 60, 600) if self._span_s / step <= 12 or step == 600)
        for tick in np.arange(
            np.ceil(self._start_s / step_s) * step_s, self._start_s + self._span_s + 1e-6, step_s
        ):
            x = self.x_px(float(tick))
            draw.line((x, y - 2 * self._unit, x, y), fill=HAIRLINE)
            draw.text((x, y + 5 * self._unit), f"{tick:g} s", fill=MUTED, font=self._font, anchor="mm")


def runs(values: Sequence[Value]) -> list[tuple[Value, int, int]]:
    """Return each run of equal values as value, first and last index."""
    found: list[tuple[Value, int, int]] = []
    for index, value in enumerate(values):
        if found and found[-1][0] == value:
            found[-1] = (value, found[-1][1], index)
        else:
            found.append((value, index, index))
    return found
