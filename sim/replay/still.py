"""The still picture of an episode: its decisive moment, a strip of moments that lead to it, plots over time."""

from typing import Final

from PIL import Image, ImageDraw

from brink.sim.replay.layout import Size, check_size
from brink.sim.replay.map_view import MapView
from brink.sim.replay.moments import Moment
from brink.sim.replay.palette import HAIRLINE, INK, MUTED, PAPER, VIOLATION, typeface
from brink.sim.replay.timeline import timeline_image
from brink.sim.replay.top_down import FramePainter, draw_banner
from brink.sim.trace import Trace

GAP: Final = 12
CLOSE_UP_M: Final = 30.0
"""Width of what a picture of the strip shows."""
CLOSE_UP_AHEAD_M: Final = 6.0


def still(trace: Trace, *, requirement: str | None = None, size: Size = (1280, 720)) -> Image.Image:
    """Return the still picture of an episode.

    Args:
        trace: The episode.
        requirement: Id of the requirement to judge; the front gap, or the first of the trace, if not given.
        size: Width and height of the frame at its top; the picture is as wide and nearly twice as high.

    Raises:
        ReplayError: The trace is empty, lacks the requirement, or the size is out of bounds.
    """
    check_size(size)
    painter = FramePainter(trace, requirement=requirement, size=size)
    frame = painter.frame(painter.story.decisive)
    if not painter.story.violated:
        unit = painter.layout.unit
        left, top, right, _ = painter.layout.camera if painter.filmed else painter.layout.map
        draw_banner(
            ImageDraw.Draw(frame), ((left + right) / 2, top + 22 * unit), painter.verdict(), unit, INK
        )
    strip = _strip(painter)
    plots = timeline_image(
        trace, requirement=painter.story.requirement, size=(size[0], round(size[0] * 0.38))
    )
    parts = [frame, strip, plots]
    whole = Image.new("RGB", (size[0], sum(part.height for part in parts)), PAPER)
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    return whole


def _strip(painter: FramePainter) -> Image.Image:
    """Return the moments of the story side by side, each a part of the map with the time and the reason."""
    unit = painter.layout.unit
    width, gap = painter.layout.size[0], round(GAP * unit)
    moments = painter.story.moments
    columns = max(4, len(moments))
    side = (width - gap * (columns + 1)) // columns
    high, words = round(side * (0.5625 if painter.filmed else 0.72)), round(38 * unit)
    strip = Image.new("RGB", (width, high + words + 2 * gap), PAPER)
    draw = ImageDraw.Draw(strip)
    draw.line((0, 0, width, 0), fill=HAIRLINE)
    close_up = MapView(
        painter.trace,
        painter.story,
        size_px=(side, high),
        px_per_m=side / CLOSE_UP_M,
        look_ahead_m=CLOSE_UP_AHEAD_M,
        font_px=round(10 * unit),
    )
    left = (width - len(moments) * (side + gap) + gap) // 2
    for moment in moments:
        picture = (
            painter.picture(moment.sample, (side, high)) if painter.filmed else close_up.draw(moment.sample)
        )
        strip.paste(picture, (left, gap))
        _frame_moment(strip, painter, moment, (left, gap, side, high))
        left += side + gap
    return strip


def _frame_moment(
    strip: Image.Image, painter: FramePainter, moment: Moment, place: tuple[int, int, int, int]
) -> None:
    left, top, wide, high = place
    unit = painter.layout.unit
    draw = ImageDraw.Draw(strip)
    decisive = moment.sample == painter.story.decisive
    bad = decisive and painter.story.violated
    edge = VIOLATION if bad else (INK if decisive else HAIRLINE)
    line = round((3 if decisive else 1) * unit)
    draw.rectangle((left, top, left + wide, top + high), outline=edge, width=max(1, line))
    text = f"{float(painter.trace.time_s[moment.sample]):.1f} s"
    ink = VIOLATION if bad else INK
    draw.text((left, top + high + 5 * unit), text, fill=ink, font=typeface(round(13 * unit), bold=True))
    draw.text(
        (left, top + high + 22 * unit),
        moment.reason,
        fill=ink if decisive else MUTED,
        font=typeface(round(11 * unit)),
    )
