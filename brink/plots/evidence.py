"""Figures of the evidence for a boundary: repeated simulations, sensitivity to settings, and safety monitors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from brink.plots.experiment import interval_limits
from brink.plots.style import (
    HAIRLINE,
    INK,
    MUTED,
    PAPER,
    SAFE,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    add_panels,
    new_figure,
    set_panel_title,
    show_percent,
    style_axes,
    style_shares,
)
from brink.search.analysis.boundary import Rescored
from brink.search.analysis.monitor_evaluation import MAJORITY, MONITOR, MonitorEvaluation, Predictor
from brink.search.analysis.statistics import mean_interval
from brink.search.conclusions import Conclusion

MAX_POINTS: Final = 80
"""Maximum number of solutions drawn; a larger set is thinned evenly."""
_REPEATS_ROW_PX: Final = 15
_REPEATS_TOP_PX, _REPEATS_BOTTOM_PX = 178, 66


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedPoint:
    """The repeated simulations of one solution.

    Attributes:
        number: Number of the solution.
        probability: Unsafe share of its simulations.
        low: Lower limit of its interval.
        high: Upper limit of its interval.
        around: Unsafe share of its neighbourhood in the archive, and the limits of its interval; None if unknown.
        conclusion: What its simulations show.
    """

    number: int
    probability: float
    low: float
    high: float
    around: tuple[float, float, float] | None
    conclusion: Conclusion


_CONCLUSIONS: Final = {
    Conclusion.NEAR: (INK, "near {p_th:g}"),
    Conclusion.INCONCLUSIVE: (MUTED, "inconclusive: the interval contains {p_th:g}"),
    Conclusion.BELOW: (SAFE, "below: safer than reported"),
    Conclusion.ABOVE: (UNSAFE, "above"),
}
"""Colour and words of each conclusion."""


def figure_repeats(points: Sequence[RepeatedPoint], *, p_th: float, times: str, title: str) -> Figure:
    """Plot the estimated unsafe probability of each solution with its interval, in ascending order.

    Args:
        points: Solutions, at least one.
        p_th: Unsafe probability that defines the boundary.
        times: Number of simulations of each, in words.
        title: Title of the figure.
    """
    ordered = sorted(points, key=lambda point: (point.probability, point.number))
    if len(ordered) > MAX_POINTS:
        ordered = [
            ordered[place] for place in np.linspace(0, len(ordered) - 1, MAX_POINTS).round().astype(int)
        ]
    height = _REPEATS_TOP_PX + _REPEATS_BOTTOM_PX + _REPEATS_ROW_PX * max(len(ordered), 12)
    found = [point.conclusion for point in points]
    left_out = f" ({len(ordered)} of them shown)" if len(points) > len(ordered) else ""
    figure = new_figure(
        height,
        title,
        f"{len(points)} distinct boundary solutions{left_out}, each simulated {times} times with seeds "
        f"that the search did not use.\nLines are Wilson intervals. Dashed: p_th = {p_th:g}, the boundary.",
    )
    bottom, top = _REPEATS_BOTTOM_PX / height, _REPEATS_TOP_PX / height
    axes = figure.add_axes((96 / WIDTH_PX, bottom, 1 - (96 + 64) / WIDTH_PX, 1 - bottom - top))
    for row, point in enumerate(ordered):
        if point.around is not None:
            share, low, high = point.around
            axes.plot([low, high], [row, row], color=HAIRLINE, linewidth=7, solid_capstyle="butt", zorder=1)
            axes.plot([share], [row], marker="|", markersize=8, color=MUTED, zorder=2)
        hue, _ = _CONCLUSIONS[point.conclusion]
        axes.plot([point.low, point.high], [row, row], color=hue, linewidth=1.8, zorder=3)
        axes.plot(
            [point.probability],
            [row],
            marker="o",
            markersize=5,
            color=hue,
            markerfacecolor=_face(point.conclusion),
            zorder=4,
        )
    axes.axvline(p_th, color=MUTED, linewidth=1.2, linestyle="--", zorder=0)
    axes.set_xlim(-0.01, 1.01)
    axes.set_ylim(-0.8, max(len(ordered), 12) - 0.2)
    show_percent(axes.xaxis)
    axes.set_yticks(range(len(ordered)), [str(point.number) for point in ordered], fontsize=SMALL_PT)
    axes.set_xlabel("unsafe probability")
    axes.set_ylabel("solution")
    style_axes(axes, grid="x")
    axes.tick_params(axis="y", labelsize=SMALL_PT)
    keys = [
        Line2D(
            [],
            [],
            color=hue,
            linewidth=1.8,
            marker="o",
            markersize=5,
            markerfacecolor=_face(conclusion),
            label=f"{found.count(conclusion)} {words.format(p_th=p_th)}",
        )
        for conclusion, (hue, words) in _CONCLUSIONS.items()
    ]
    neighbourhood = Line2D([], [], color=HAIRLINE, linewidth=7, label="its neighbourhood in the archive")
    add_legend(figure, [*keys, neighbourhood], 122, handlelength=2.2)
    return figure


def _face(conclusion: Conclusion) -> str:
    """Return the fill of a dot: hollow without a verdict."""
    return PAPER if conclusion is Conclusion.INCONCLUSIVE else _CONCLUSIONS[conclusion][0]


SENSITIVITY_HEIGHT_PX: Final = 640
_MEASURES: Final = (("distinct boundary solutions (DBS)", SAFE, "o"), ("strict DBS", UNSAFE, "s"))


def figure_rescored(
    radii: Sequence[Rescored],
    p_ths: Sequence[Rescored],
    *,
    own: tuple[float, float],
    t_b: float,
    d_th: float,
    title: str,
) -> Figure:
    """Plot DBS and strict DBS of one archive against the radius and against p_th.

    Args:
        radii: Counts by radius, ascending.
        p_ths: Counts by p_th, ascending.
        own: The campaign's own radius and p_th.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between distinct boundary solutions.
        title: Title of the figure.
    """
    figure = new_figure(
        SENSITIVITY_HEIGHT_PX,
        title,
        f"The same evaluated solutions, scored with other settings (t_b {t_b:g}, d_th {d_th:g}). Dashed: the "
        "campaign's own,\nwhich guided the search: its archive is densest near the boundary that they define.",
    )
    left, right = _two_panels(figure)
    _plot_counts(left, [one.radius for one in radii], [(one.dbs, one.strict_dbs) for one in radii])
    _plot_counts(right, [one.p_th for one in p_ths], [(one.dbs, one.strict_dbs) for one in p_ths])
    for axes, value, name in (
        (left, own[0], "radius of a neighbourhood (delta)"),
        (right, own[1], "unsafe probability on the boundary (p_th)"),
    ):
        axes.axvline(value, color=MUTED, linewidth=1.2, linestyle="--", zorder=0)
        _finish_counts(axes, name)
    keys = [
        Line2D([], [], color=hue, marker=marker, markersize=6, linewidth=2.2, label=name)
        for name, hue, marker in _MEASURES
    ]
    add_legend(figure, keys, 122)
    return figure


def figure_rerun(
    found: Mapping[str, Mapping[str, Sequence[float]]], *, parameter: str, t_b: float, d_th: float, title: str
) -> Figure:
    """Plot DBS and strict DBS of searches with different values of a setting: all seeds, means, 95% intervals.

    Args:
        found: For each value, the counts ``dbs`` and ``strict`` of all seeds.
        parameter: Name of the setting.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between distinct boundary solutions.
        title: Title of the figure.
    """
    seeds = max((len(one["dbs"]) for one in found.values()), default=0)
    figure = new_figure(
        SENSITIVITY_HEIGHT_PX,
        title,
        f"Separate searches with {seeds} seeds for each value (t_b {t_b:g}, d_th {d_th:g}). Small: single "
        "searches; large: means with 95% intervals.",
    )
    for axes, measure, (name, hue, marker) in zip(
        _two_panels(figure), ("dbs", "strict"), _MEASURES, strict=True
    ):
        places = np.arange(len(found))
        for place, one in zip(places, found.values(), strict=True):
            values = list(one[measure])
            span = mean_interval(values)
            axes.plot([place] * len(values), values, "o", markersize=4, color=hue, alpha=0.35, linestyle="")
            low, high = interval_limits(span)
            axes.errorbar(
                [place],
                [span.mean],
                yerr=[[max(0.0, span.mean - low)], [max(0.0, high - span.mean)]],
                color=hue,
                marker=marker,
                markersize=8,
                capsize=4,
                elinewidth=1.6,
            )
        axes.set_xticks(places, list(found))
        axes.set_xlim(-0.6, len(found) - 0.4)
        set_panel_title(axes, name)
        _finish_counts(axes, parameter)
    return figure


def _two_panels(figure: Figure) -> list[Axes]:
    return add_panels(figure, 2, top_px=176, bottom_px=70, wspace=0.16)


def _plot_counts(axes: Axes, x: Sequence[float], counts: Sequence[tuple[int, int]]) -> None:
    for place, (_, hue, marker) in enumerate(_MEASURES):
        axes.plot(x, [one[place] for one in counts], color=hue, marker=marker, markersize=6, linewidth=2.2)


def _finish_counts(axes: Axes, name: str) -> None:
    axes.set_xlabel(name)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    style_axes(axes)


MONITOR_HEIGHT_PX: Final = 760
_PREDICTOR_COLOURS: Final = {MONITOR: SAFE, MAJORITY: MUTED}


def figure_monitor(evaluation: MonitorEvaluation) -> Figure:
    """Plot the calibration of a monitor, and missed hazards against false alarms, next to other predictors."""
    figure = new_figure(
        MONITOR_HEIGHT_PX,
        f"Monitor of {evaluation.learned:,} simulations ({evaluation.model})",
        f"Trained on {evaluation.learned:,} simulations, evaluated on {evaluation.fresh:,} independent ones.\n"
        "Left: the unsafe share of solutions with similar predictions, with its 95% interval; shaded, the monitor's "
        "own interval. Right: each point is an alarm threshold.",
    )
    left, right = add_panels(figure, 2, top_px=190, bottom_px=70, left_px=96)
    _plot_calibration(left, evaluation)
    _plot_alarms(right, evaluation)
    keys = [
        Line2D(
            [], [], color=_colour(predictor), linewidth=2.2, label=f"{predictor.name}: {_metrics(predictor)}"
        )
        for predictor in evaluation.predictors
    ]
    add_legend(figure, keys, 122, handlelength=2.2)
    return figure


def _metrics(predictor: Predictor) -> str:
    return f"AUROC {predictor.metrics.auroc:.3f}, Brier {predictor.metrics.brier:.3f}"


def _colour(predictor: Predictor) -> str:
    return _PREDICTOR_COLOURS.get(predictor.name, UNSAFE)


def _plot_calibration(axes: Axes, evaluation: MonitorEvaluation) -> None:
    axes.plot([0, 1], [0, 1], color=HAIRLINE, linewidth=1.2, zorder=0)
    for predictor in evaluation.predictors:
        if predictor.name == MAJORITY:
            continue
        bins = predictor.metrics.bins
        x = np.array([one.predicted for one in bins])
        y = np.array([one.observed for one in bins])
        if predictor.name == MONITOR:
            axes.fill_between(
                x,
                [one.low for one in bins],
                [one.high for one in bins],
                color=_colour(predictor),
                alpha=0.12,
                linewidth=0,
            )
        errors = np.array([[o.observed - o.observed_low, o.observed_high - o.observed] for o in bins]).T
        axes.errorbar(
            x,
            y,
            yerr=np.maximum(errors, 0.0),
            color=_colour(predictor),
            marker="o",
            markersize=5,
            linewidth=1.8,
            elinewidth=1.1,
            capsize=3,
        )
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    set_panel_title(axes, "Calibration")
    axes.set_xlabel("predicted unsafe probability")
    axes.set_ylabel("observed unsafe share")
    style_axes(axes, grid="both")


def _plot_alarms(axes: Axes, evaluation: MonitorEvaluation) -> None:
    for predictor in evaluation.predictors:
        axes.plot(
            [alarm.missed for alarm in predictor.operating_points],
            [alarm.false for alarm in predictor.operating_points],
            color=_colour(predictor),
            linewidth=2.2,
            linestyle="--" if predictor.name == MAJORITY else "-",
        )
    style_shares(
        axes, "Missed hazards and false alarms", x="missed hazards", y="false alarms among safe solutions"
    )
