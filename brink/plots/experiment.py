"""Figures of an experiment: thresholds and pairs of each method, and DBS against d_th and the share of the budget.

They show means over the seeds with 95% Student intervals; controls are dashed. Those of DBS are Figs. 5 and 6 of
Sharifi et al. 2023; those of thresholds and pairs are ours.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator

from brink.plots.style import (
    INK,
    LABEL_PT,
    MUTED,
    WIDTH_PX,
    add_legend,
    new_figure,
    set_panel_title,
    show_message,
    show_percent,
    style_axes,
)
from brink.search.analysis.comparison import Line, Repeat, lines_of
from brink.search.analysis.count_comparison import CountMeasure, FoundRepeat, ProblemMeasure, by_method
from brink.search.analysis.paper import D_THS, PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Figures
from brink.search.analysis.statistics import MeanInterval, mean_interval
from brink.search.space import FloatArray

METHOD_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#68727b")
"""Colours of the methods in their order, repeated from the eighth on."""
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
PANEL_PX: Final = 330
COLUMNS: Final = 3
MOST_KEYS: Final = 6
"""Entries that fit into one line of a legend."""
NAMES: Final = {Measure.DBS: "distinct boundary solutions (DBS)", Measure.STRICT: "strict DBS"}


def figure_by_distance(repeats: Sequence[Repeat], problem: str, measure: Measure) -> Figure:
    """Plot DBS against d_th, a panel per t_b (Fig. 5).

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        measure: DBS or strict DBS.
    """
    figure, panels = _panels(
        repeats,
        problem,
        f"{problem}: {NAMES[measure]} by the minimum distance between them",
        "Means over the seeds for the whole budget, with 95% intervals. Dashed: controls, whose verdicts ignore the "
        "component's behaviour.",
    )
    lines = _lines(repeats, problem)
    for i, axes in enumerate(panels):
        axes.xaxis.set_major_locator(FixedLocator(list(D_THS)))
        for place, (line, values) in enumerate(lines.items()):
            # Shifted slightly, so that intervals do not overlap.
            shift = 0.004 * (place - (len(lines) - 1) / 2)
            spans = [
                mean_interval([float(measure.of(one)[-1, i, j]) for one in values]) for j in range(len(D_THS))
            ]
            means = np.array([span.mean for span in spans])
            low, high = np.abs(np.array([interval_limits(span) for span in spans]).T - means)
            axes.errorbar(
                np.array(D_THS) + shift,
                means,
                yerr=np.stack([low, high]),
                capsize=3,
                elinewidth=1.1,
                **_style_of(line, repeats),
            )
        axes.set_xlim(min(D_THS) - 0.04, max(D_THS) + 0.04)
        _finish(axes, i, "d_th")
    return figure


def figure_by_budget(repeats: Sequence[Repeat], problem: str, measure: Measure, d_th: float = 0.2) -> Figure:
    """Plot DBS against the share of the budget spent, a panel per t_b (Fig. 6).

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        measure: DBS or strict DBS.
        d_th: Minimum distance; one of `D_THS`.
    """
    figure, panels = _panels(
        repeats,
        problem,
        f"{problem}: {NAMES[measure]} by share of the budget, at least {d_th:g} apart",
        "Means over the seeds with 95% intervals, scored with the results known at that time. Dashed: "
        "controls, whose verdicts ignore the component's behaviour.",
    )
    j = D_THS.index(d_th)
    for i, axes in enumerate(panels):
        show_percent(axes.xaxis)
        for line, values in _lines(repeats, problem).items():
            spans = [
                mean_interval([float(measure.of(one)[k, i, j]) for one in values])
                for k in range(len(PAPER_FRACTIONS))
            ]
            means = [span.mean for span in spans]
            style = _style_of(line, repeats)
            if not line.control:
                low, high = np.array([interval_limits(span) for span in spans]).T
                axes.fill_between(
                    PAPER_FRACTIONS, low, high, color=str(style["color"]), alpha=0.14, linewidth=0
                )
            axes.plot(PAPER_FRACTIONS, means, **style)
        axes.set_xlim(0, 1.02)
        _finish(axes, i, "share of the budget")
    return figure


def figure_found(repeats: Sequence[FoundRepeat], problem: str) -> Figure:
    """Plot what each campaign on a problem found: a strip for each method, with means and intervals.

    Args:
        repeats: Finished campaigns, of which at least one is on the problem.
        problem: Name of the problem.
    """
    ours = [one for one in repeats if one.problem == problem]
    compared, things = ProblemMeasure.of(ours), f"{ours[0].NOUN}s"
    confirmed = compared.measure is CountMeasure.CONFIRMED
    return _strips(
        f"{problem}: {'confirmed ' if confirmed else ''}distinct {things} of each method",
        f"Rings: all distinct {things}, confirmed or not." if confirmed else compared.says,
        f"{things} in one campaign",
        {
            method: [(one.counted(compared.measure), one.distinct) for one in each]
            for method, each in by_method(ours).items()
        },
        ringed=confirmed,
    )


def _strips(
    title: str, note: str, label: str, methods: Mapping[str, Sequence[tuple[int, int]]], *, ringed: bool
) -> Figure:
    """Plot what each campaign found: a strip for each method, with means and intervals.

    Args:
        title: Title of the figure.
        note: What is counted.
        label: Label of the axis.
        methods: The measure of each campaign, and all that it found, by method.
        ringed: Whether rings show all that was found.
    """
    height = 190 + 112 * len(methods)
    figure = new_figure(
        height, title, f"Each dot is a campaign; bars are means over the seeds with 95% intervals. {note}"
    )
    axes = figure.add_axes((220 / WIDTH_PX, 62 / height, 1 - 480 / WIDTH_PX, 1 - (62 + 108) / height))
    highest = 0.0
    for place, ours in enumerate(methods.values()):
        colour = METHOD_COLOURS[place % len(METHOD_COLOURS)]
        values, found = [value for value, _ in ours], [all_found for _, all_found in ours]
        if ringed:
            axes.plot(
                found,
                place + 0.3 + 0.5 * _stacked(found),
                "o",
                markersize=6,
                markerfacecolor="none",
                markeredgecolor=MUTED,
                markeredgewidth=1.1,
            )
        axes.plot(
            values, place + _stacked(values), "o", markersize=7.5, color=colour, alpha=0.6, markeredgewidth=0
        )
        span = mean_interval([float(value) for value in values])
        low, high = interval_limits(span)
        highest = max(highest, high)
        axes.plot([low, high], [place - 0.33] * 2, color=colour, linewidth=2.2)
        axes.plot([span.mean], [place - 0.33], "|", color=colour, markersize=13, markeredgewidth=2.6)
        limits = "" if span.low is None else f"  [{low:.1f}, {high:.1f}]"
        axes.annotate(
            f"{span.mean:.1f}{limits}",
            (1, place),
            xycoords=("axes fraction", "data"),
            xytext=(10, 0),
            textcoords="offset points",
            va="center",
            ha="left",
            fontsize=LABEL_PT,
            color=colour,
            fontweight="bold",
            annotation_clip=False,
        )
    axes.set_yticks(range(len(methods)), list(methods))
    axes.set_ylim(len(methods) - 0.45, -0.6)
    most = max(1.0, highest, *(found for ours in methods.values() for _, found in ours))
    axes.set_xlim(-0.02 * most, 1.04 * most)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, integer=True))
    axes.set_xlabel(label)
    style_axes(axes, grid="x")
    axes.tick_params(axis="y", labelsize=LABEL_PT, length=0, labelcolor=INK)
    return figure


def _stacked(values: Sequence[int]) -> FloatArray:
    """Return small shifts that keep dots with the same value apart."""
    seen: dict[int, int] = {}
    shifts = []
    for value in values:
        count = seen[value] = seen.get(value, -1) + 1
        shifts.append(0.045 * ((count + 1) // 2) * (-1) ** count)
    found: FloatArray = np.clip(np.array(shifts, np.float64), -0.22, 0.22)
    return found


def interval_limits(span: MeanInterval) -> tuple[float, float]:
    """Return the limits of a mean count's interval, clipped at 0; the mean itself for a single value."""
    low, high = span.low, span.high
    return span.mean if low is None else max(0.0, low), span.mean if high is None else high


EXPERIMENT_FIGURES: Final[dict[str, Callable[[Sequence[Repeat], str, Measure], Figure]]] = {
    **{f"by-budget-{d_th:g}": partial(figure_by_budget, d_th=d_th) for d_th in PAPER_D_THS},
    "by-distance": figure_by_distance,
}
"""The figures of a measure, by what distinguishes their file names."""


def _panels(repeats: Sequence[Repeat], problem: str, title: str, subtitle: str) -> tuple[Figure, list[Axes]]:
    rows = -(-len(PAPER_T_BS) // COLUMNS)
    height = 150 + rows * PANEL_PX
    figure = new_figure(height, title, subtitle)
    grid = figure.add_gridspec(
        rows,
        COLUMNS,
        left=84 / WIDTH_PX,
        right=1 - 40 / WIDTH_PX,
        top=1 - 160 / height,
        bottom=60 / height,
        wspace=0.2,
        hspace=0.38,
    )
    add_legend(figure, _keys(repeats, problem), 88)
    return figure, [figure.add_subplot(grid[divmod(i, COLUMNS)]) for i in range(len(PAPER_T_BS))]


def _keys(repeats: Sequence[Repeat], problem: str) -> list[Line2D]:
    """Return the entries of the legend; with too many for one line, the methods and one entry for all controls."""
    lines = list(_lines(repeats, problem))
    if len(lines) <= MOST_KEYS:
        return [Line2D([], [], label=line.label, **_style_of(line, repeats)) for line in lines]
    keys = [
        Line2D([], [], label=line.label, **_style_of(line, repeats)) for line in lines if not line.control
    ]
    if len(keys) < len(lines):
        keys.append(Line2D([], [], label="controls", color=MUTED, linewidth=1.4, linestyle=(0, (4, 2))))
    return keys


def _lines(repeats: Sequence[Repeat], problem: str) -> dict[Line, list[Figures]]:
    return {
        line: [figures for _, figures in values]
        for line, values in lines_of(repeats).items()
        if line.problem == problem
    }


def _style_of(line: Line, repeats: Sequence[Repeat]) -> dict[str, Any]:
    methods = list(dict.fromkeys(repeat.method for repeat in repeats if repeat.problem == line.problem))
    place = methods.index(line.method)
    return {
        "color": METHOD_COLOURS[place % len(METHOD_COLOURS)],
        "marker": "" if line.control else MARKERS[place % len(MARKERS)],
        "markersize": 5.5,
        "linewidth": 1.4 if line.control else 2.2,
        "linestyle": (0, (4, 2)) if line.control else "-",
    }


def _finish(axes: Axes, place: int, x_label: str) -> None:
    set_panel_title(axes, f"t_b {PAPER_T_BS[place]:g}")
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    high = max((float(np.nanmax(line.get_ydata())) for line in axes.get_lines()), default=0.0)
    if high <= 0:
        axes.set_ylim(0, 1)
        show_message(axes, "none")
    else:
        axes.set_ylim(bottom=0)
    if place >= len(PAPER_T_BS) - COLUMNS:
        axes.set_xlabel(x_label)
    style_axes(axes)
