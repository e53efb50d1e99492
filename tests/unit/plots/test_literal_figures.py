"""Figures draw names as they stand: no mathematics, and no warning about characters without a glyph."""

import ast
import logging
from io import BytesIO
from pathlib import Path

import pytest
from matplotlib.font_manager import findfont
from matplotlib.ft2font import FT2Font
from matplotlib.text import Text

import brink
from brink.pictures.figure import LAST_RESORT, LiteralFigure
from brink.plots.style import EndLabel, label_ends, new_figure, set_panel_title

BAD = r"$\bad{$ 100$ $x^2$ _a_"
PACKAGE = Path(brink.__file__).parent


def figure_of(name: str) -> LiteralFigure:
    """Return a figure with a name in every kind of text."""
    figure = new_figure(300, name, name)
    axes = figure.add_subplot()
    axes.bar([0, 1], [1, 2], label=name)
    axes.set_xticks([0, 1], [name, f"{name} 2"])
    axes.set_xlabel(name)
    set_panel_title(axes, name)
    label_ends(axes, [EndLabel(1.0, name, "black")])
    axes.legend(title=name)
    assert isinstance(figure, LiteralFigure)
    return figure


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_dollar_signs_are_no_mathematics(kind: str) -> None:
    figure = figure_of(BAD)
    figure.savefig(BytesIO(), format=kind)
    shown = [text for text in figure.findobj(Text) if isinstance(text, Text) and BAD in text.get_text()]
    assert len(shown) >= 8
    assert not any(text.get_parse_math() for text in shown)


def test_characters_without_a_glyph_are_boxes_and_named_once(caplog: pytest.LogCaptureFixture) -> None:
    nowhere = chr(0x10FFF0)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            figure = figure_of(f"a{nowhere}b\x1b")
            figure.savefig(BytesIO())  # a warning would be an error
    assert figure.texts[0].get_fontfamily()[-1] == LAST_RESORT
    (record,) = caplog.records
    assert "U+001B U+10FFF0" in record.getMessage()
    assert "/" not in record.getMessage()


def test_other_fonts_provide_what_the_own_font_lacks() -> None:
    own = set(FT2Font(str(findfont("DejaVu Sans"))).get_charmap())
    other = next(code for code in FT2Font(str(findfont("STIXGeneral"))).get_charmap() if code not in own)
    figure = figure_of(f"a{chr(other)}")
    figure.savefig(BytesIO())
    assert len(figure.texts[0].get_fontfamily()) >= 3


def test_no_other_figure_is_made() -> None:
    made = {
        path.relative_to(PACKAGE)
        for folder in (
            "plots",
            "report",
            "pictures",
            "cli",
            "guard",
            "python",
            "scenarios",
            "sim",
            "server",
            "search",
        )
        for path in (PACKAGE / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("Figure", "pyplot")
    }
    assert not made
