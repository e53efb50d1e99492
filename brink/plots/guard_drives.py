"""The trade-off of a guard and its fallback: the reduction in violations, against the distance that is lost."""

from collections.abc import Sequence
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from brink.plots.style import (
    HAIRLINE,
    INK,
    MUTED,
    SAFE,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    new_figure,
    show_percent,
    style_axes,
)
from brink.search.analysis.guard_drives import Estimate, GuardWorth

HEIGHT_PX: Final = 820
AIM: Final = (0.05, 0.40)
"""Largest loss of mean distance in safe drives, and smallest fall of violations, that a guard should reach."""


def figure_guard_tradeoff(
    points: Sequence[tuple[float, GuardWorth]], *, fallback: str, requirements: Sequence[str]
) -> Figure:
    """Plot the reduction in violations against the distance lost, a point for each threshold of the alarm.

    Args:
        points: Thresholds with what the guard did, at least one.
        fallback: Id of the fallback.
        requirements: Ids of the requirements that count.
    """
    first = points[0][1]
    figure = new_figure(
        HEIGHT_PX,
        f"What a guard with the fallback {fallback} prevents and costs: {first.drives:,} drives",
        f"{first.violations_without:,} of the drives violate {' or '.join(requirements)} without the guard. Each "
        f"point is a threshold of the alarm; lines are 95% intervals.\n"
        f"Green: violations fall by at least {AIM[1]:.0%} at a loss of at most {AIM[0]:.0%} of the mean distance of "
        "drives that are safe without the guard.",
    )
    axes = figure.add_axes((96 / WIDTH_PX, 80 / HEIGHT_PX, 1 - 190 / WIDTH_PX, 1 - 270 / HEIGHT_PX))
    axes.axhline(0.0, color=HAIRLINE, linewidth=1.2)
    axes.axvline(0.0, color=HAIRLINE, linewidth=1.2)
    _plot(axes, [(threshold, worth.distance_lost, worth.reduction) for threshold, worth in points], MUTED)
    _plot(
        axes,
        [(threshold, worth.distance_lost_when_safe, worth.reduction) for threshold, worth in points],
        SAFE,
        named=True,
    )
    left, right = axes.get_xlim()
    low, high = axes.get_ylim()
    axes.set_xlim(min(left, -0.02), max(right, 2 * AIM[0]))
    axes.set_ylim(min(low, 0.0), max(high, AIM[1] + 0.1))
    axes.add_patch(
        Rectangle(
            (axes.get_xlim()[0], AIM[1]),
            AIM[0] - axes.get_xlim()[0],
            axes.get_ylim()[1] - AIM[1],
            color="#009e73",
            alpha=0.1,
            linewidth=0,
            zorder=0,
        )
    )
    axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10]))  # no ticks at 2.5%, which would be rounded
    show_percent(axes.xaxis, axes.yaxis)
    axes.set_xlabel("mean distance lost")
    axes.set_ylabel("violations fall by")
    style_axes(axes, grid="both")
    keys = [
        Line2D([], [], color=colour, linewidth=2.0, marker="o", label=label)
        for colour, label in ((SAFE, "drives that are safe without the guard"), (MUTED, "all drives"))
    ]
    keys.append(
        Line2D([], [], color=UNSAFE, linestyle="", marker="x", label="violations caused, of safe drives")
    )
    _plot_caused(axes, points)
    add_legend(figure, keys, 146)
    return figure


def _plot(
    axes: Axes, points: Sequence[tuple[float, Estimate, Estimate]], colour: str, *, named: bool = False
) -> None:
    known = [point for point in points if point[1].value is not None and point[2].value is not None]
    across = [lost.value or 0.0 for _, lost, _ in known]
    up = [falls.value or 0.0 for _, _, falls in known]
    axes.plot(across, up, color=colour, linewidth=1.2, marker="o", markersize=8 if named else 5, zorder=3)
    for threshold, lost, falls in known:
        x, y = lost.value or 0.0, falls.value or 0.0
        if lost.low is not None and lost.high is not None:
            axes.plot([lost.low, lost.high], [y, y], color=colour, linewidth=1.0, alpha=0.6)
        if falls.low is not None and falls.high is not None:
            axes.plot([x, x], [falls.low, falls.high], color=colour, linewidth=1.0, alpha=0.6)
        if named:
            axes.annotate(
                f"{threshold:.3g}",
                (x, y),
                xytext=(9, -16),
                textcoords="offset points",
                fontsize=SMALL_PT,
                color=INK,
            )


def _plot_caused(axes: Axes, points: Sequence[tuple[float, GuardWorth]]) -> None:
    """Mark, under each point, the share of safe drives that violate because of the fallback."""
    known = [
        (worth.distance_lost_when_safe.value, worth.caused_share.value)
        for _, worth in points
        if worth.distance_lost_when_safe.value is not None and worth.caused_share.value is not None
    ]
    axes.plot(
        [x for x, _ in known], [y for _, y in known], color=UNSAFE, linestyle="", marker="x", markersize=7
    )
