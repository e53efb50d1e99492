"""A matplotlib figure that draws every text literally.

Names of campaigns, parameters and choices come from users and plug-ins. Matplotlib would read ``$…$`` in them as
mathematics, which may fail to parse after hours of simulation, and would warn about every character that its font
lacks with the path of one of our files.
"""

import logging
from collections.abc import Iterable
from functools import cache
from typing import Final

from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, fontManager
from matplotlib.ft2font import FT2Font
from matplotlib.text import Text

LAST_RESORT: Final = "Last Resort High-Efficiency"
"""A font that ships with matplotlib and has a box for every character. Named explicitly, it causes no warning."""

log = logging.getLogger(__name__)


class LiteralFigure(Figure):
    """A figure without mathtext, which falls back to other installed fonts for missing characters."""

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure."""
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                axis.get_ticklabels(which="both")  # creates the texts, which drawing would create otherwise
        for text in self.findobj(Text):
            assert isinstance(text, Text)
            text.set_parse_math(False)
            _use_known_characters(text)
        super().draw(renderer)


def _use_known_characters(text: Text) -> None:
    """Add fonts to a text for the characters that its own font lacks."""
    characters = set(text.get_text()) - {"\n"}
    own = _characters(str(findfont(text.get_fontproperties())))
    missing = frozenset(character for character in characters if ord(character) not in own)
    if missing:
        text.set_fontfamily([*text.get_fontfamily(), *_fallback(missing)])
        text.set_fontweight(
            "normal"
        )  # the other fonts need not have a bold face, about which matplotlib would warn


@cache
def _characters(font_file: str) -> frozenset[int]:
    return frozenset(FT2Font(font_file).get_charmap())


@cache
def _fallback(missing: frozenset[str]) -> list[str]:
    """Return the families of installed fonts that provide characters."""
    families: list[str] = []
    unknown = set(missing)
    for family, file in _installed():
        if found := {one for one in unknown if ord(one) in _characters(file)}:
            families.append(family)
            unknown -= found
        if not unknown:
            break
    if unknown:
        log.warning(
            "figures show boxes in place of characters that no installed font has: %s. Install a font that has them, "
            "such as Noto Sans CJK.",
            " ".join(f"U+{ord(one):04X}" for one in sorted(unknown)),
        )
    return [*families, LAST_RESORT]


def _installed() -> Iterable[tuple[str, str]]:
    """Return the families of all installed fonts and a file of each, those without serifs first."""
    files = {font.name: font.fname for font in fontManager.ttflist if font.name != LAST_RESORT}
    return sorted(files.items(), key=lambda one: ("Sans" not in one[0], one[0]))
