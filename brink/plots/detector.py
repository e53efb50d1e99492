"""Whether a detector meets a requirement: shares of drives that violate because of its errors, against the limit."""

import math
import textwrap
from typing import Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from brink.plots.style import (
    INK,
    MUTED,
    OTHER,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    new_figure,
    style_axes,
)
from brink.server.findings.tolerances.views import DetectorView
from brink.server.states import CheckResult

MOST_ROWS: Final = 60
_ROW_PX, _TOP_PX, _BOTTOM_PX, _LEFT_PX, _RIGHT_PX = 34, 170, 70, 640, 240
_LABEL_CHARACTERS: Final = 74
_COLOURS: Final = {
    CheckResult.NOT_MET: UNSAFE,
    CheckResult.TOO_LITTLE: MUTED,
    CheckResult.MET: "#009e73",
    CheckResult.NO_DATA: OTHER,
}
_TICKS: Final = (0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0)


def figure_detector(view: DetectorView) -> Figure:
    """Plot a row with an interval for each cell with evidence, in the order of the view.

    Shares are drawn by their square root, so that small ones can be told apart.

    Args:
        view: The check; of more than `MOST_ROWS` cells the first ones are drawn.
    """
    cells = [cell for cell in view.cells if cell.share is not None][:MOST_ROWS]
    height_px = _TOP_PX + max(len(cells), 1) * _ROW_PX + _BOTTOM_PX
    figure = new_figure(
        height_px, f"Does {view.detector} meet the requirement?", textwrap.fill(f"{view.note}.", 150)
    )
    axes = figure.add_axes(
        (
            _LEFT_PX / WIDTH_PX,
            _BOTTOM_PX / height_px,
            1 - (_LEFT_PX + _RIGHT_PX) / WIDTH_PX,
            1 - (_TOP_PX + _BOTTOM_PX) / height_px,
        )
    )
    style_axes(axes, grid="x")
    for row, cell in enumerate(cells):
        colour = _COLOURS[cell.result]
        low, value, high = (math.sqrt(share or 0.0) for share in (cell.low, cell.share, cell.high))
        axes.plot([low, high], [row, row], color=colour, linewidth=7, alpha=0.4, solid_capstyle="butt")
        axes.plot([value], [row], "o", color=colour, markersize=7)
        axes.text(
            1.02,
            row,
            f"{cell.result.value}, {cell.drives:,} drives",
            color=colour,
            fontsize=SMALL_PT,
            va="center",
        )
    axes.axvline(math.sqrt(view.limit), color=INK, linewidth=1.2, linestyle=(0, (4, 3)))
    axes.set_yticks(
        range(len(cells)),
        [textwrap.shorten(f"{cell.condition}: {cell.error}", _LABEL_CHARACTERS) for cell in cells],
        fontsize=SMALL_PT,
    )
    axes.set_ylim(max(len(cells), 1) - 0.5, -0.5)
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks([math.sqrt(tick) for tick in _TICKS], [f"{tick:.0%}" for tick in _TICKS])
    axes.set_xlabel("share of drives that errors of this size make violate", fontsize=SMALL_PT, color=MUTED)
    lines = [
        Line2D([], [], color=_COLOURS[result], linewidth=5, label=result.value)
        for result in (CheckResult.NOT_MET, CheckResult.TOO_LITTLE, CheckResult.MET)
    ]
    lines.append(Line2D([], [], color=INK, linestyle=(0, (4, 3)), label=f"limit, {view.limit:.0%} of drives"))
    add_legend(figure, lines, 110)
    return figure
