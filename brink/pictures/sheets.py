"""Images composed of several frames: the still image of one episode, and several episodes side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.pictures.camera_view import FilmView, camera_view, draw_film_legend
from brink.pictures.frame import FramePainter, Size
from brink.pictures.map_view import MapView
from brink.pictures.scene import ReplayError
from brink.pictures.story import Judged, Moment, Story, story_of
from brink.pictures.style import HAIRLINE, INK, MUTED, PAPER, SEEN, VIOLATION, draw_banner, typeface, wrapped
from brink.pictures.timeline import timeline_image
from brink.sim.trace import Trace
from brink.sim.verdict import clock_words

GAP: Final = 12
CLOSE_UP_M: Final = 30.0
"""Width of the part of the map that each image of the strip shows."""
CLOSE_UP_AHEAD_M: Final = 6.0

MOMENTS_S: Final = (-1.5, -0.75, 0.0)
"""Times of the columns of episodes side by side, from the decisive moment of the last episode."""
MARGIN: Final = 16
WORDS_PX: Final = 250
TILE_PX: Final = (400, 225)
HEADER_PX: Final = 56
FOOTER_PX: Final = 40


def still(trace: Trace, *, requirement: Judged = None, size: Size = (1280, 720)) -> Image.Image:
    """Return the still image of an episode: its decisive moment, a strip of moments, and plots over time.

    Args:
        trace: The episode.
        requirement: Ids of the requirements to judge; for the default see `story_of`.
        size: Width and height of the frame at the top; the image is as wide and nearly twice as high.

    Raises:
        ReplayError: The trace is empty, lacks the requirement, or the size is out of bounds.
    """
    painter = FramePainter(trace, requirement=requirement, size=size)
    frame = painter.frame(painter.story.shown)
    unit = painter.layout.unit
    left, top, right, _ = painter.layout.camera if painter.filmed else painter.layout.map
    draw_banner(
        ImageDraw.Draw(frame),
        ((left + right) / 2, top + 22 * unit),
        painter.verdict(),
        unit,
        VIOLATION if painter.story.violations else INK,
        room=right - left,
    )
    plots_size = (size[0], round(size[0] * 0.38))
    plots = timeline_image(trace, requirement=painter.story.requirement, size=plots_size)
    parts = [frame, _strip(painter), plots]
    whole = Image.new("RGB", (size[0], sum(part.height for part in parts)), PAPER)
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    return whole


def _strip(painter: FramePainter) -> Image.Image:
    """Return the moments of the story side by side, each with its time and reason."""
    unit = painter.layout.unit
    width, gap = painter.layout.size[0], round(GAP * unit)
    moments = painter.story.moments
    columns = max(4, len(moments))
    side = (width - gap * (columns + 1)) // columns
    high, words = round(side * (0.5625 if painter.filmed else 0.72)), round(38 * unit)
    strip = Image.new("RGB", (width, high + words + 2 * gap), PAPER)
    draw = ImageDraw.Draw(strip)
    draw.line((0, 0, width, 0), fill=HAIRLINE)
    close_up = (
        camera_view(painter.trace, (side, high))
        if painter.filmed
        else MapView(
            painter.scene,
            size_px=(side, high),
            px_per_m=side / CLOSE_UP_M,
            look_ahead_m=CLOSE_UP_AHEAD_M,
            font_px=round(10 * unit),
        )
    )
    left = (width - len(moments) * (side + gap) + gap) // 2
    for moment in moments:
        strip.paste(close_up.draw(moment.sample), (left, gap))
        _frame_moment(strip, painter, moment, (left, gap, side, high))
        left += side + gap
    return strip


def _frame_moment(
    strip: Image.Image, painter: FramePainter, moment: Moment, place: tuple[int, int, int, int]
) -> None:
    left, top, wide, high = place
    unit = painter.layout.unit
    draw = ImageDraw.Draw(strip)
    decisive = moment.sample == painter.story.shown
    bad = moment.sample in {one.shown for one in painter.story.violations}
    edge = VIOLATION if bad else (INK if decisive else HAIRLINE)
    line = round((3 if decisive else 1) * unit)
    draw.rectangle((left, top, left + wide, top + high), outline=edge, width=max(1, line))
    sample_s = float(painter.trace.time_s[moment.sample])
    text = clock_words(sample_s if moment.time_s is None else moment.time_s)
    ink = VIOLATION if bad else INK
    draw.text((left, top + high + 5 * unit), text, fill=ink, font=typeface(round(13 * unit), bold=True))
    draw.text(
        (left, top + high + 22 * unit),
        moment.reason,
        fill=ink if decisive else MUTED,
        font=typeface(round(11 * unit)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One of several episodes side by side.

    Attributes:
        words: What distinguishes it, such as its chain of perturbations.
        trace: The episode, with recorded camera images.
    """

    words: str
    trace: Trace


def side_by_side(rows: Sequence[Row], *, title: str = "") -> Image.Image:
    """Return one image of several episodes at the same place: a row for each, with the same moments in the columns.

    Made for chains of perturbations: what each part does alone, and what they do together.

    Args:
        rows: The episodes; the columns show moments before and at the decisive moment of the last one.
        title: Heading of the image.

    Raises:
        ReplayError: There are no rows, or an episode has no recorded camera images.
    """
    if not rows:
        raise ReplayError("expected at least one episode to show side by side, got none")
    story = story_of(rows[-1].trace)
    decisive_s = float(rows[-1].trace.time_s[story.decisive])
    width = WORDS_PX + len(MOMENTS_S) * (TILE_PX[0] + MARGIN) + 2 * MARGIN
    height = HEADER_PX + len(rows) * (TILE_PX[1] + MARGIN) + FOOTER_PX
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN, 14), title, fill=INK, font=typeface(17, bold=True))
    for column, moment_s in enumerate(MOMENTS_S):
        clock = f"{max(0.0, decisive_s + moment_s):.1f} s"
        draw.text((_left(column), 36), clock, fill=MUTED, font=typeface(14))
    for index, row in enumerate(rows):
        _draw_row(sheet, draw, row, HEADER_PX + index * (TILE_PX[1] + MARGIN), decisive_s)
    draw_film_legend(draw, (_left(0), height - FOOTER_PX / 2), 1.1)
    return sheet


def _left(column: int) -> int:
    return MARGIN + WORDS_PX + column * (TILE_PX[0] + MARGIN)


def _draw_row(sheet: Image.Image, draw: ImageDraw.ImageDraw, row: Row, top: int, decisive_s: float) -> None:
    trace = row.trace
    if trace.film is None:
        raise ReplayError("expected recorded camera images in every episode, got an episode without any")
    story = story_of(trace)
    _draw_words(draw, row.words, story, top)
    view = FilmView(trace, trace.film, size_px=TILE_PX)
    for column, moment_s in enumerate(MOMENTS_S):
        at_s = max(0.0, decisive_s + moment_s)
        left = _left(column)
        frame = (left - 1, top - 1, left + TILE_PX[0], top + TILE_PX[1])
        if at_s > float(trace.time_s[-1]) + 0.06:
            draw.rectangle(frame, outline=HAIRLINE)
            middle = (left + TILE_PX[0] / 2, top + TILE_PX[1] / 2)
            draw.text(middle, "ended", fill=MUTED, font=typeface(14), anchor="mm")
            continue
        sample = int(np.abs(np.asarray(trace.time_s) - at_s).argmin())
        sheet.paste(view.draw(sample), (left, top))
        bad = any(sample >= one.shown for one in story.violations)
        draw.rectangle(frame, outline=VIOLATION if bad else HAIRLINE, width=4 if bad else 1)
        draw.text(
            (left + TILE_PX[0] - 8, top + TILE_PX[1] - 8),
            f"{float(trace.ego[sample, 3]):.1f} m/s",
            fill=PAPER,
            font=typeface(14, bold=True),
            anchor="rs",
            stroke_width=2,
            stroke_fill=INK,
        )


def _draw_words(draw: ImageDraw.ImageDraw, words: str, story: Story, top: int) -> None:
    y = top + 4.0
    for text, colour in ((words, INK), (story.words, VIOLATION if story.violations else SEEN)):
        for line in wrapped(draw, text, typeface(15, bold=True), WORDS_PX - MARGIN):
            draw.text((MARGIN, y), line, fill=colour, font=typeface(15, bold=True))
            y += 20
        y += 4
