"""The curves of tolerances: the share of drives that violate because of an error, against its severity."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from brink.plots.style import (
    INK,
    MARGIN_PX,
    MUTED,
    SMALL_PT,
    TICK_PT,
    WIDTH_PX,
    add_legend,
    new_figure,
    set_panel_title,
    show_percent,
    style_axes,
)
from brink.server.findings.tolerances.views import CellView, ToleranceView

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f4f24", "#68727b")
MOST_CONDITIONS: Final = len(COLOURS)
MOST_PANELS: Final = 60
_COLUMNS: Final = 4
_TITLE_CHARACTERS: Final = 31
"""Characters in a line of a panel's title."""
_ROW_PX, _TOP_PX, _BOTTOM_PX = 250, 170, 70


def figure_tolerance(view: ToleranceView) -> Figure:
    """Plot the curves of a campaign: a panel for each combination of choices, a line for each condition.

    Args:
        view: The tolerances; of more than `MOST_CONDITIONS` conditions the first ones are drawn, and of more than
            `MOST_PANELS` panels, too.
    """
    panels: dict[tuple[str, ...], list[CellView]] = {}
    conditions = view.conditions[:MOST_CONDITIONS]
    for cell in view.cells:
        if cell.condition in conditions:
            panels.setdefault(tuple(cell.choices.values()), []).append(cell)
    shown = list(panels.values())[:MOST_PANELS]
    columns = min(_COLUMNS, max(len(shown), 1))
    rows = math.ceil(len(shown) / columns)
    height_px = _TOP_PX + rows * _ROW_PX + _BOTTOM_PX
    figure = new_figure(
        height_px,
        f"How severe an error may be: {view.name}",
        f"Share of drives that violate because of the error, with intervals of {view.confidence:.0%}. "
        f"Dots: where the limit of {view.limit:.0%} is reached.",
    )
    colours = dict(zip(conditions, COLOURS, strict=False))
    left, right = (MARGIN_PX + 30) / WIDTH_PX, 1 - 30 / WIDTH_PX
    grid = figure.add_gridspec(
        max(rows, 1),
        columns,
        left=left,
        right=right,
        top=1 - (_TOP_PX + 20) / height_px,
        bottom=_BOTTOM_PX / height_px,
        hspace=0.75,
        wspace=0.18,
    )
    highest = max((max(cell.curve.high) for cells in shown for cell in cells), default=1.0)
    for place, cells in enumerate(shown):
        axes = figure.add_subplot(grid[place // columns, place % columns])
        _panel(axes, cells, colours, view.limit)
        axes.set_ylim(0.0, min(1.0, 1.05 * max(highest, 2 * view.limit)))
        show_percent(axes.yaxis)
        if place % columns:
            axes.tick_params(labelleft=False)
    add_legend(
        figure, [Line2D([], [], color=colours[name], linewidth=2.2, label=name) for name in conditions], 96
    )
    return figure


def _panel(axes: Axes, cells: Sequence[CellView], colours: Mapping[str, str], limit: float) -> None:
    style_axes(axes)
    set_panel_title(axes, textwrap.fill(cells[0].error, _TITLE_CHARACTERS))
    for cell in cells:
        curve, colour = cell.curve, colours[cell.condition]
        across = curve.severity if curve.magnitude is None else curve.magnitude
        axes.fill_between(across, curve.low, curve.high, color=colour, alpha=0.12, linewidth=0)
        axes.plot(across, curve.share, color=colour, linewidth=1.8)
        value = cell.tolerated.value
        at = value.severity if curve.magnitude is None else value.magnitude
        if at is not None:
            axes.plot([at], [limit], "o", color=colour, markersize=6, markeredgecolor="white", zorder=4)
    axes.axhline(limit, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    first = cells[0]
    ends = first.curve.severity if first.curve.magnitude is None else first.curve.magnitude
    axes.set_xlim(ends[0], ends[-1])
    axes.set_xlabel(first.unit or "severity", fontsize=SMALL_PT, color=MUTED)
    axes.tick_params(labelsize=TICK_PT - 1)
