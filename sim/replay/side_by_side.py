"""Several episodes of the same place in one picture: a row each, the same moments in the columns.

Made for chains of perturbations: what each part does alone, what they do together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.sim.replay.errors import ReplayError
from brink.sim.replay.moments import tell
from brink.sim.replay.palette import HAIRLINE, INK, MUTED, PAPER, SEEN, VIOLATION, typeface
from brink.sim.replay.picture_view import PictureView, draw_key, threshold_of
from brink.sim.trace import Trace

MOMENTS_S: Final = (-1.5, -0.75, 0.0)
"""Columns: before and at the decisive moment of the last episode."""
MARGIN: Final = 16
WORDS_PX: Final = 250
TILE_PX: Final = (400, 225)
HEADER_PX: Final = 56
FOOTER_PX: Final = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One episode.

    Attributes:
        words: What is special about it.
        trace: The episode, with a film.
    """

    words: str
    trace: Trace


def side_by_side(rows: Sequence[Row], *, title: str = "") -> Image.Image:
    """Return the picture; the last row is the one that the moments are chosen by.

    Raises:
        ReplayError: There are no rows, or an episode has no pictures of a camera.
    """
    if not rows:
        raise ReplayError("there are no episodes to show side by side")
    story = tell(rows[-1].trace)
    decisive_s = float(rows[-1].trace.time_s[story.decisive])
    width = WORDS_PX + len(MOMENTS_S) * (TILE_PX[0] + MARGIN) + 2 * MARGIN
    height = HEADER_PX + len(rows) * (TILE_PX[1] + MARGIN) + FOOTER_PX
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN, 14), title, fill=INK, font=typeface(17, bold=True))
    for column, moment_s in enumerate(MOMENTS_S):
        left = _left(column)
        draw.text((left, 36), f"{max(0.0, decisive_s + moment_s):.1f} s", fill=MUTED, font=typeface(14))
    for index, row in enumerate(rows):
        top = HEADER_PX + index * (TILE_PX[1] + MARGIN)
        _draw_row(sheet, draw, row, top, decisive_s)
    draw_key(draw, (_left(0), height - FOOTER_PX / 2), 1.1)
    return sheet


def _left(column: int) -> int:
    return MARGIN + WORDS_PX + column * (TILE_PX[0] + MARGIN)


def _draw_row(sheet: Image.Image, draw: ImageDraw.ImageDraw, row: Row, top: int, decisive_s: float) -> None:
    film = row.trace.film
    if film is None:
        raise ReplayError("an episode has no pictures of a camera")
    story = tell(row.trace)
    _draw_words(draw, row.words, story.violated, story.title, top)
    view = PictureView(film, threshold=threshold_of(row.trace), size_px=TILE_PX)
    for column, moment_s in enumerate(MOMENTS_S):
        at_s = max(0.0, decisive_s + moment_s)
        left = _left(column)
        frame = (left - 1, top - 1, left + TILE_PX[0], top + TILE_PX[1])
        if at_s > float(row.trace.time_s[-1]) + 0.06:
            draw.rectangle(frame, outline=HAIRLINE)
            middle = (left + TILE_PX[0] / 2, top + TILE_PX[1] / 2)
            draw.text(middle, "it is over", fill=MUTED, font=typeface(14), anchor="mm")
            continue
        sample = int(np.abs(np.asarray(row.trace.time_s) - at_s).argmin())
        sheet.paste(view.draw(sample), (left, top))
        bad = story.violated and sample >= story.decisive
        draw.rectangle(frame, outline=VIOLATION if bad else HAIRLINE, width=4 if bad else 1)
        speed = f"{float(row.trace.ego[sample, 3]):.1f} m/s"
        place = (left + TILE_PX[0] - 8, top + TILE_PX[1] - 8)
        draw.text(
            place,
            speed,
            fill=PAPER,
            font=typeface(14, bold=True),
            anchor="rs",
            stroke_width=2,
            stroke_fill=INK,
        )


def _draw_words(draw: ImageDraw.ImageDraw, words: str, violated: bool, requirement: str, top: int) -> None:
    y = top + 4.0
    font = typeface(15, bold=True)
    for line in _wrapped(draw, words, WORDS_PX - MARGIN):
        draw.text((MARGIN, y), line, fill=INK, font=font)
        y += 20
    verdict = f"hazard: {requirement} violated" if violated else "safe"
    for line in _wrapped(draw, verdict, WORDS_PX - MARGIN):
        draw.text((MARGIN, y + 4), line, fill=VIOLATION if violated else SEEN, font=font)
        y += 20


def _wrapped(draw: ImageDraw.ImageDraw, words: str, width_px: float) -> list[str]:
    font = typeface(15, bold=True)
    lines = [""]
    for word in words.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and draw.textlength(longer, font=font) > width_px:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
