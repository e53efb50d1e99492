"""Colours, typeface and line styles of every replay.

The hues are Okabe and Ito's, which people with colour vision deficiencies can tell apart; red and green things also
differ in their lines. Blue is the ego, vermilion what was reported to the driving system, crimson a violation.
"""

import math
import re
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from PIL import ImageDraw, ImageFont

from brink.pictures.scene import PICTURE_COLOURS, Points

SUPERSAMPLING: Final = 2
"""Frames are drawn this much larger and then reduced, which smooths their edges."""

Rgb: TypeAlias = tuple[int, int, int]

PAPER: Final[Rgb] = (255, 255, 255)
PANEL: Final[Rgb] = (246, 247, 248)
INK: Final[Rgb] = (31, 37, 43)
MUTED: Final[Rgb] = (104, 114, 123)
HAIRLINE: Final[Rgb] = (208, 213, 217)

EGO: Final[Rgb] = (0, 114, 178)
EGO_TRAIL: Final[Rgb] = (86, 160, 205)
ROUTE: Final[Rgb] = (141, 190, 222)
GHOST: Final[Rgb] = (213, 94, 0)
SEEN: Final[Rgb] = (0, 145, 105)
VIOLATION: Final[Rgb] = (176, 0, 45)
SAFE_DRIVE: Final[Rgb] = (0, 114, 178)
UNSAFE_DRIVE: Final[Rgb] = (213, 94, 0)
OTHER_VIOLATED: Final[Rgb] = (160, 58, 125)
"""A drive that held the requirement and violated another one, as on the dashboard's map of solutions."""
VEHICLE: Final[Rgb] = (84, 94, 103)
PEDESTRIAN: Final[Rgb] = (120, 62, 145)
BLURRED_VEHICLE: Final[Rgb] = (146, 154, 162)
BLURRED_PEDESTRIAN: Final[Rgb] = (178, 150, 192)
GLASS: Final[Rgb] = (205, 216, 224)
BRAKE: Final[Rgb] = (226, 40, 40)

GROUND: Final[Rgb] = (233, 238, 228)
FILLS: Final[dict[str, Rgb]] = {
    "road": (196, 200, 204),
    "pavement": (224, 222, 216),
    "marking": (250, 250, 248),
    "building": (203, 193, 182),
    "parked-car": (161, 169, 176),
    "tree": (176, 201, 164),
    "unknown": (215, 215, 215),
}
"""Colours of surfaces, by paint."""
EDGES: Final[dict[str, Rgb]] = {
    "pavement": (205, 203, 196),
    "building": (168, 157, 145),
    "parked-car": (128, 136, 143),
    "tree": (146, 176, 134),
}
"""Colours of the outlines of surfaces that have one, by paint."""

SEEN_ON_PICTURE, FOUND_ON_PICTURE, REGION_ON_PICTURE = PICTURE_COLOURS.values()

SKY: Final[Rgb] = (226, 235, 243)

PLAN_MODES: Final[dict[str, Rgb]] = {
    "cruise": (203, 212, 219),
    "follow": (86, 180, 233),
    "stop": (70, 82, 94),
    "yield": (230, 159, 0),
    "nudge": (240, 228, 66),
    "overtake": (204, 121, 167),
}
UNKNOWN_MODE: Final[Rgb] = (150, 150, 150)
GUARD_DOES: Final[dict[str, Rgb]] = {"alarm": (176, 162, 246), "fallback": (92, 66, 190)}
"""What a guard and its fallback do."""
REFERENCE_DOES: Final[dict[str, Rgb]] = {
    "brakes": (70, 82, 94),
    "waits": (134, 145, 156),
    "drives": (203, 212, 219),
}
"""What a reference driver does: braking as a plan to stop."""
_UNCHANGED: Final[dict[str, Rgb]] = {"stands": (226, 228, 231), "keeps going": (182, 189, 195)}
_ACTION: Final[Rgb] = (199, 190, 217)


def action_colour(words: str) -> Rgb:
    """Return the colour of a scripted action: grey if it changes nothing, and never that of a drive."""
    return _UNCHANGED.get(words, _ACTION)


def lighter(colour: Rgb, share: float) -> Rgb:
    """Return a colour mixed with a share of white."""
    red, green, blue = (round(value + share * (255 - value)) for value in colour)
    return red, green, blue


LIGHTS: Final[dict[str, Rgb]] = {"red": (204, 32, 32), "amber": (240, 170, 20), "green": (0, 158, 105)}
LAMP_OFF: Final[Rgb] = (78, 84, 90)

TELLING: Final[tuple[Rgb, ...]] = (
    INK, EGO, EGO_TRAIL, ROUTE, GHOST, SEEN, VIOLATION, OTHER_VIOLATED, VEHICLE, PEDESTRIAN, BRAKE,
    *PICTURE_COLOURS.values(), *LIGHTS.values(), *PLAN_MODES.values(), *GUARD_DOES.values(), *FILLS.values(),
)  # fmt: skip
"""Colours that mean something, and so must not change in a film with few colours."""


def hexadecimal(colour: Rgb) -> str:
    """Return a colour in the hexadecimal form that matplotlib reads, such as ``#d55e00``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def readable_on(colour: Rgb) -> Rgb:
    """Return the ink or paper colour, whichever is more legible on a background of this colour."""
    red, green, blue = colour
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else PAPER


@cache
def typeface(size_px: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return DejaVu Sans, which ships with matplotlib, so that images look the same on every machine."""
    import matplotlib as mpl  # slow to import, so imported only when something is drawn

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), max(6, size_px))


def wrapped(
    draw: ImageDraw.ImageDraw, words: str, font: ImageFont.FreeTypeFont, width_px: float
) -> list[str]:
    """Split words into lines of at most a given width; a single word may be wider."""
    lines = [""]
    for word in filter(None, re.split(r"[ \n\t]+", words)):  # not at non-breaking spaces
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and draw.textlength(longer, font=font) > width_px:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def dashes(points: Points, dash: float, gap: float, *, closed: bool = False) -> list[Points]:
    """Split a line into dashes, each of shape ``(2, 2)``; dashes do not bend around corners.

    Args:
        points: Corners of the line, shape ``(k, 2)``.
        dash: Length of a dash, in the unit of the points.
        gap: Length of the space between two dashes.
        closed: Whether the line returns to its first corner.
    """
    corners = np.vstack([points, points[:1]]) if closed else points
    pieces: list[Points] = []
    for start, end in pairwise(corners):
        length = float(np.hypot(*(end - start)))
        if length < 1e-9:
            continue
        for at in np.arange(0.0, length, dash + gap):
            ends = np.array([at, min(at + dash, length)]) / length
            pieces.append(start + ends[:, None] * (end - start))
    return pieces


def draw_dashed(
    draw: ImageDraw.ImageDraw, corners: Points, colour: Rgb, *, dash: float, gap: float, width: int
) -> None:
    """Draw a closed dashed line.

    Args:
        draw: Where to draw.
        corners: Corners of the line in pixels, shape ``(k, 2)``.
        colour: Its colour.
        dash: Length of a dash in pixels.
        gap: Length of the space between two dashes in pixels.
        width: Width of the line in pixels.
    """
    for piece in dashes(corners, dash, gap, closed=True):
        draw.line(piece.ravel().tolist(), fill=colour, width=width)


def draw_banner(
    draw: ImageDraw.ImageDraw,
    centre: tuple[float, float],
    text: str,
    unit: float,
    colour: Rgb = VIOLATION,
    *,
    room: float = math.inf,
) -> None:
    """Draw white text on a filled rectangle with rounded corners.

    Args:
        draw: Where to draw.
        centre: Middle of the rectangle in pixels.
        text: The text.
        unit: Scale of text and lines, 1 in a frame of 540 px height.
        colour: Colour of the rectangle.
        room: Width in pixels that the rectangle may take; a longer text is written smaller.
    """
    size = round(14 * unit)
    while size > round(8 * unit) and draw.textlength(text, typeface(size, bold=True)) + 28 * unit > room:
        size -= 1
    font = typeface(size, bold=True)
    half = draw.textlength(text, font=font) / 2 + 12 * unit
    x, y = centre
    draw.rounded_rectangle((x - half, y - 13 * unit, x + half, y + 13 * unit), radius=5 * unit, fill=colour)
    draw.text(centre, text, fill=PAPER, font=font, anchor="mm")
