"""Figures of an experiment: DBS by d_th and by share of the budget, as in Figs. 5 and 6 of the MLCSHE paper.

Source: Sharifi et al. 2023. Means over the repeats with 95% Student intervals; controls dashed.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator, PercentFormatter

from brink.plots.style import INK, LABEL_PT, WIDTH_PX, frame, new_figure, say
from brink.search.analysis.comparison import Line, Repeat, lines_of
from brink.search.analysis.paper import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Figures
from brink.search.analysis.statistics import mean_interval

HUES: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#68727b")
"""Of methods, in their order; the eighth begins again."""
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
PANEL_PX: Final = 330
COLUMNS: Final = 3
NAMES: Final = {Measure.DBS: "distinct boundary solutions (DBS)", Measure.STRICT: "strict DBS"}


def figure_by_distance(repeats: Sequence[Repeat], problem: str, measure: Measure) -> Figure:
    """Return the figure of DBS by d_th, a panel for each t_b (Fig. 5).

    Args:
        repeats: Finished campaigns.
        problem: Whose.
        measure: What is counted.
    """
    figure, panels = _panels(
        repeats, problem,
        f"{problem}: {NAMES[measure]} by the distance that makes two of them distinct",
        "Means over the seeds at the whole budget, with 95% intervals. Dashed: controls, whose verdicts ignore the "
        "component's behaviour.",
    )  # fmt: skip
    lines = _lines(repeats, problem)
    for i, axes in enumerate(panels):
        axes.xaxis.set_major_locator(FixedLocator(list(PAPER_D_THS)))
        for place, (line, values) in enumerate(lines.items()):
            # A little apart, so that intervals do not hide each other.
            shift = 0.004 * (place - (len(lines) - 1) / 2)
            spans = [
                mean_interval([float(measure.of(one)[-1, i, j]) for one in values])
                for j in range(len(PAPER_D_THS))
            ]
            means = np.array([span.mean for span in spans])
            low = means - np.array([span.mean if span.low is None else max(0.0, span.low) for span in spans])
            high = np.array([span.mean if span.high is None else span.high for span in spans]) - means
            axes.errorbar(
                np.array(PAPER_D_THS) + shift, means, yerr=np.stack([np.maximum(low, 0.0), high]),
                capsize=3, elinewidth=1.1, **_looks(line, repeats),
            )  # fmt: skip
        axes.set_xlim(min(PAPER_D_THS) - 0.04, max(PAPER_D_THS) + 0.04)
        _finish(axes, i, "d_th")
    return figure


def figure_by_budget(repeats: Sequence[Repeat], problem: str, measure: Measure, d_th: float = 0.2) -> Figure:
    """Return the figure of DBS by share of the budget, a panel for each t_b (Fig. 6).

    Args:
        repeats: Finished campaigns.
        problem: Whose.
        measure: What is counted.
        d_th: One of the paper's thresholds.
    """
    figure, panels = _panels(
        repeats, problem,
        f"{problem}: {NAMES[measure]} by share of the budget, at least {d_th:g} apart",
        "Means over the seeds with 95% intervals, at each share scored with only what was known then. Dashed: "
        "controls, whose verdicts ignore the component's behaviour.",
    )  # fmt: skip
    j = PAPER_D_THS.index(d_th)
    for i, axes in enumerate(panels):
        axes.xaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
        for line, values in _lines(repeats, problem).items():
            spans = [
                mean_interval([float(measure.of(one)[k, i, j]) for one in values])
                for k in range(len(PAPER_FRACTIONS))
            ]
            means = [span.mean for span in spans]
            looks = _looks(line, repeats)
            if not line.control:
                axes.fill_between(
                    PAPER_FRACTIONS,
                    [span.mean if span.low is None else max(0.0, span.low) for span in spans],
                    [span.mean if span.high is None else span.high for span in spans],
                    color=str(looks["color"]), alpha=0.14, linewidth=0,
                )  # fmt: skip
            axes.plot(PAPER_FRACTIONS, means, **looks)
        axes.set_xlim(0, 1.02)
        _finish(axes, i, "share of the budget")
    return figure


EXPERIMENT_FIGURES: Final[dict[str, Callable[[Sequence[Repeat], str, Measure], Figure]]] = {
    "by-distance": figure_by_distance,
    "by-budget": figure_by_budget,
}


def _panels(repeats: Sequence[Repeat], problem: str, title: str, subtitle: str) -> tuple[Figure, list[Axes]]:
    rows = -(-len(PAPER_T_BS) // COLUMNS)
    height = 150 + rows * PANEL_PX
    figure = new_figure(height, title, subtitle)
    grid = figure.add_gridspec(
        rows, COLUMNS, left=84 / WIDTH_PX, right=1 - 40 / WIDTH_PX, top=1 - 160 / height, bottom=60 / height,
        wspace=0.2, hspace=0.38,
    )  # fmt: skip
    keys = [Line2D([], [], label=line.label, **_looks(line, repeats)) for line in _lines(repeats, problem)]
    figure.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(64 / WIDTH_PX, 1 - 88 / height), ncols=len(keys) or 1,
        frameon=False, fontsize=LABEL_PT, labelcolor=INK, handlelength=2.6, borderaxespad=0,
    )  # fmt: skip
    return figure, [figure.add_subplot(grid[divmod(i, COLUMNS)]) for i in range(len(PAPER_T_BS))]


def _lines(repeats: Sequence[Repeat], problem: str) -> dict[Line, list[Figures]]:
    return {
        line: [figures for _, figures in values]
        for line, values in lines_of(repeats).items()
        if line.problem == problem
    }


def _looks(line: Line, repeats: Sequence[Repeat]) -> dict[str, Any]:
    methods = list(dict.fromkeys(repeat.method for repeat in repeats if repeat.problem == line.problem))
    place = methods.index(line.method)
    return {
        "color": HUES[place % len(HUES)],
        "marker": "" if line.control else MARKERS[place % len(MARKERS)],
        "markersize": 5.5,
        "linewidth": 1.4 if line.control else 2.2,
        "linestyle": (0, (4, 2)) if line.control else "-",
    }


def _finish(axes: Axes, place: int, x_label: str) -> None:
    axes.set_title(f"t_b {PAPER_T_BS[place]:g}", loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold")
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    high = max((float(np.nanmax(line.get_ydata())) for line in axes.get_lines()), default=0.0)
    if high <= 0:
        axes.set_ylim(0, 1)
        say(axes, "none")
    else:
        axes.set_ylim(bottom=0)
    if place >= len(PAPER_T_BS) - COLUMNS:
        axes.set_xlabel(x_label)
    frame(axes)
