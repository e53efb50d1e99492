"""The colours and the typeface of every replay.

Hues are Okabe and Ito's, which people with colour vision deficiencies can tell apart; what is drawn in red and in
green differs in its line too. Blue is the ego, vermilion is what the detector was made to say, crimson a violation.
"""

from functools import cache
from pathlib import Path
from typing import Final, TypeAlias

from PIL import ImageFont

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
VEHICLE: Final[Rgb] = (84, 94, 103)
PEDESTRIAN: Final[Rgb] = (120, 62, 145)
BLURRED_VEHICLE: Final[Rgb] = (146, 154, 162)
BLURRED_PEDESTRIAN: Final[Rgb] = (178, 150, 192)
GLASS: Final[Rgb] = (205, 216, 224)
BRAKE: Final[Rgb] = (226, 40, 40)

GROUND: Final[Rgb] = (233, 238, 228)
SURFACES: Final[dict[str, tuple[Rgb, Rgb | None]]] = {
    "road": ((196, 200, 204), None),
    "pavement": ((224, 222, 216), (205, 203, 196)),
    "marking": ((250, 250, 248), None),
    "crossing": ((250, 250, 248), None),
    "stop-line": ((250, 250, 248), None),
    "building": ((203, 193, 182), (168, 157, 145)),
    "parked-car": ((161, 169, 176), (128, 136, 143)),
    "tree": ((176, 201, 164), (146, 176, 134)),
}
"""Fill and outline of each kind of surface."""
UNKNOWN_SURFACE: Final[tuple[Rgb, Rgb | None]] = ((215, 215, 215), None)

SEEN_ON_PICTURE: Final[Rgb] = (64, 222, 128)
FOUND_ON_PICTURE: Final[Rgb] = (255, 52, 52)
REGION_ON_PICTURE: Final[Rgb] = (255, 214, 64)
"""Lines on a camera's picture, by day and night: what is there, what was detected, what brakes."""

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

LIGHTS: Final[dict[str, Rgb]] = {
    "red": (204, 32, 32),
    "amber": (240, 170, 20),
    "green": (0, 158, 105),
}
LAMP_OFF: Final[Rgb] = (78, 84, 90)


def hexadecimal(colour: Rgb) -> str:
    """Return a colour the way matplotlib reads it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def readable_on(colour: Rgb) -> Rgb:
    """Return ink or paper, whichever reads better on a background of this colour."""
    red, green, blue = colour
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else PAPER


@cache
def typeface(size_px: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return DejaVu Sans, which comes with matplotlib, so that pictures are the same on every machine."""
    import matplotlib as mpl  # not before something is drawn: it takes a while to load

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), max(6, size_px))
