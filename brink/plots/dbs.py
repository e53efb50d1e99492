"""Figure: how the number of distinct boundary solutions (DBS) grew with the simulations spent."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from brink.plots.inputs import CampaignFigures
from brink.plots.style import (
    INK,
    LABEL_PT,
    MUTED,
    SMALL_PT,
    WIDTH_PX,
    EndLabel,
    frame,
    label_ends,
    new_figure,
    say,
)
from brink.search.analysis.boundary import BudgetPoint, dbs_by_budget
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS

FRACTIONS: Final = tuple(np.round(np.arange(0.05, 1.001, 0.05), 2).tolist())
RAMP: Final = ("#a6cbe3", "#6fb0d6", "#3a93c4", "#0072b2", "#00527f", "#10304a")
"""From the strictest t_b to the loosest; equal steps of lightness, so the order reads without the labels."""
HEIGHT_PX: Final = 620


def figure_dbs(inputs: CampaignFigures) -> Figure:
    """Return DBS over simulations: a panel for each d_th, a line for each t_b of the paper, strict DBS dashed.

    Args:
        inputs: The campaign.
    """
    archive = inputs.archive
    p_th = archive.neighbourhood.p_th
    figure = new_figure(
        HEIGHT_PX,
        f"{inputs.title}: distinct boundary solutions",
        "How many solutions lie within t_b of the hazard boundary and at least d_th apart, at each share of the "
        "simulations, scored with only what was known then.\n"
        f"Dashed: strict, interval contains p_th = {p_th:g}, and both verdicts occur among the neighbours.",
    )
    points = list(dbs_by_budget(archive, int(archive.numbers[-1]) + 1, FRACTIONS)) if len(archive) else []
    grid = figure.add_gridspec(
        1, len(PAPER_D_THS), left=88 / WIDTH_PX, right=1 - 96 / WIDTH_PX, top=0.755, bottom=0.115, wspace=0.34
    )
    for column, d_th in enumerate(PAPER_D_THS):
        axes = figure.add_subplot(grid[column])
        axes.set_title(
            f"at least {d_th:g} apart", loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold"
        )
        _plot(axes, points, column)
        axes.set_xlabel("simulations")
        if column == 0:
            axes.set_ylabel("distinct boundary solutions")
        frame(axes)
    _explain(figure)
    return figure


def _plot(axes: Axes, points: list[BudgetPoint], column: int) -> None:
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    if not points:
        axes.set_ylim(0, 1)
        say(axes, "no solution has been evaluated yet")
        return
    simulations = [0, *(point.simulations for point in points)]
    highest = 0
    for row, colour in enumerate(RAMP):
        plain = [0, *(int(point.grid.dbs[row, column]) for point in points)]
        strict = [0, *(int(point.grid.strict[row, column]) for point in points)]
        axes.plot(
            simulations, plain, color=colour, linewidth=2.2, label=f"t_b {PAPER_T_BS[row]:g}", clip_on=False
        )
        axes.plot(
            simulations,
            strict,
            color=colour,
            linewidth=1.5,
            linestyle=(0, (4, 2)),
            label=f"strict {PAPER_T_BS[row]:g}",
        )
        highest = max(highest, *plain)
    axes.set_xlim(0, simulations[-1])
    axes.set_ylim(0, max(highest * 1.06, 1))
    last = points[-1].grid.dbs[:, column].tolist()
    label_ends(
        axes,
        [
            EndLabel(count, f"{t_b:.2f}: {count}", colour)
            for count, t_b, colour in zip(last, PAPER_T_BS, RAMP, strict=True)
        ],
    )
    axes.annotate(
        "t_b: DBS", (1, 1), xycoords="axes fraction", xytext=(8, 9), textcoords="offset points", va="bottom",
        fontsize=SMALL_PT, color=MUTED,
    )  # fmt: skip
    if highest == 0:
        say(axes, "none: no neighbourhood is near\nthe boundary at any t_b up to 0.2")


def _explain(figure: Figure) -> None:
    keys = [
        Line2D([], [], color=RAMP[3], linewidth=2.2, label="DBS"),
        Line2D([], [], color=RAMP[3], linewidth=1.5, linestyle=(0, (4, 2)), label="strict DBS"),
    ]
    figure.legend(
        handles=keys, loc="upper right", bbox_to_anchor=(1 - 64 / WIDTH_PX, 1 - 16 / HEIGHT_PX), ncols=2,
        frameon=False, fontsize=LABEL_PT, labelcolor=INK, handlelength=2.6,
    )  # fmt: skip
