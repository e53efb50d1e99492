"""Figure: how the verdict depends on each parameter, a small panel each, strongest first.

A share is shown with its Wilson interval. The numbers of a sleeping block mean nothing and are left out of their
panels. What a search evaluated is no random sample, so this says where the unsafe solutions were found, not why.
"""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator, PercentFormatter

from brink.plots.inputs import CampaignFigures
from brink.plots.style import (
    INK,
    MUTED,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    frame,
    new_figure,
    say,
    share_text,
)
from brink.search.analysis.dependence import FEWEST_IN_BIN, Dependence, ParameterColumn, dependences
from brink.search.fitness import wilson_interval
from brink.search.space import Categorical

COLUMNS: Final = 5
PANEL_PX: Final = 250
TOP_PX, BOTTOM_PX = 150, 44


def figure_parameters(inputs: CampaignFigures) -> Figure:
    """Return the unsafe share over each parameter: by category, or by bins of equally many solutions.

    Args:
        inputs: The campaign.
    """
    found = dependences(inputs.space, inputs.archive)
    rows = -(-len(found) // COLUMNS)
    height_px = TOP_PX + BOTTOM_PX + rows * PANEL_PX
    archive = inputs.archive
    overall = float(archive.unsafe.mean()) if len(archive) else float("nan")
    figure = new_figure(
        height_px,
        f"{inputs.title}: unsafe share by parameter",
        "Share of unsafe solutions by value, with its 95% interval; numbers in bins of equally many solutions, "
        f"without those of trajectories that are null. Line: overall share, {share_text(overall)}.\n"
        "Strongest dependence first (Cramér's V). Grey: no more than chance. A search does not sample evenly: this "
        "shows where unsafe solutions were found.",
    )
    ceiling = _ceiling(found, overall)
    for index, dependence in enumerate(found):
        row, column = divmod(index, COLUMNS)
        width = (WIDTH_PX - 84 - 36) / COLUMNS
        axes = figure.add_axes(
            (
                (84 + column * width) / WIDTH_PX,
                1 - (TOP_PX + (row + 1) * PANEL_PX - 76) / height_px,
                (width - 34) / WIDTH_PX,
                (PANEL_PX - 116) / height_px,
            )
        )
        _plot(axes, dependence, overall, ceiling, detectable=dependence.detectable(len(found)))
        axes.tick_params(labelleft=column == 0)
    return figure


def _ceiling(found: list[Dependence], overall: float) -> float:
    """Return the top of all panels' axes: the highest upper limit of a group that is not tiny, as a round share."""
    highest = 0.0 if np.isnan(overall) else overall
    for dependence in found:
        large = dependence.counts >= FEWEST_IN_BIN
        if large.any():
            _, upper = wilson_interval(dependence.unsafe[large], dependence.counts[large])
            highest = max(highest, float(upper.max()))
    return min(1.0, max(0.1, float(np.ceil(highest * 10) / 10)))


def _plot(axes: Axes, dependence: Dependence, overall: float, ceiling: float, *, detectable: bool) -> None:
    column, filled = dependence.column, dependence.counts > 0
    colour = UNSAFE if detectable else MUTED
    if not np.isnan(overall):
        axes.axhline(overall, color=INK, linewidth=0.9, alpha=0.55)
    if filled.any():
        places, counts, unsafe = (
            dependence.places[filled],
            dependence.counts[filled],
            dependence.unsafe[filled],
        )
        lower, upper = wilson_interval(unsafe, counts)
        axes.vlines(places, lower, upper, color=colour, linewidth=2.2, alpha=0.45)
        axes.plot(
            places, unsafe / counts, color=colour, marker="o", markersize=5.5,
            linewidth=0 if dependence.labels else 1.2, gid="share",
        )  # fmt: skip
    else:
        say(axes, "null in every\nsolution so far")
    axes.set_ylim(-0.02 * ceiling, ceiling)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    frame(axes)
    _name(axes, column, dependence)
    _ticks(axes, column, dependence)


def _name(axes: Axes, column: ParameterColumn, dependence: Dependence) -> None:
    unit = "" if isinstance(column.parameter, Categorical) else column.parameter.unit
    name = column.parameter.name.replace("_", " ").replace(".", ": ").removesuffix(f" {unit}")
    facts = [unit, f"V = {dependence.strength:.2f}", f"n = {int(dependence.counts.sum()):,}"]
    # There is room for about forty letters; a long unit matters more than the component.
    if len("".join([column.component, *facts])) < 34:
        facts.insert(0, column.component)
    axes.text(
        0, 1.25, name, transform=axes.transAxes, fontsize=TICK_PT, fontweight="bold", color=INK, va="bottom"
    )
    axes.text(
        0, 1.07, "   ".join(filter(None, facts)), transform=axes.transAxes, fontsize=SMALL_PT - 0.5, color=MUTED,
        va="bottom",
    )  # fmt: skip


def _ticks(axes: Axes, column: ParameterColumn, dependence: Dependence) -> None:
    if dependence.labels:
        axes.set_xlim(dependence.places[0] - 0.6, dependence.places[-1] + 0.6)
        axes.xaxis.set_minor_locator(NullLocator())
        long = sum(map(len, dependence.labels)) > 26 or len(dependence.labels) > 8
        axes.xaxis.set_major_locator(FixedLocator(dependence.places.tolist()))
        axes.set_xticklabels(
            [label if len(label) <= 14 else label[:13] + "…" for label in dependence.labels],
            rotation=28 if long else 0, ha="right" if long else "center", rotation_mode="anchor",
        )  # fmt: skip
        axes.tick_params(axis="x", labelsize=SMALL_PT - 0.5, length=3)
    elif not isinstance(column.parameter, Categorical):
        low, high = column.parameter.low, column.parameter.high
        axes.set_xlim(low - 0.03 * (high - low), high + 0.03 * (high - low))
        axes.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 4, 5, 10]))
        axes.tick_params(axis="x", labelsize=SMALL_PT - 0.5, length=3)
