"""The curves of thresholds: how likely a drive is unsafe along one unit, with all simulations that say so."""

import math
import textwrap
from collections.abc import Sequence
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from brink.plots.style import (
    HAIRLINE,
    INK,
    MARGIN_PX,
    MUTED,
    SAFE,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    new_figure,
    show_message,
    show_percent,
    style_axes,
)
from brink.search.conclusions import Outcome
from brink.search.thresholds import HIGH, LOW
from brink.server.findings.thresholds.views import DotView, ThresholdsView, ThresholdView

MOST_PANELS: Final = 30
_COLUMNS: Final = 3
_TITLE_CHARACTERS: Final = 58
_TITLE_LINES: Final = 2
_ROW_PX, _TOP_PX, _BOTTOM_PX = 390, 180, 80
_MARGIN: Final = 3.0
"""What is shown on either side of a threshold, in units of its widest part."""
_DOT_PT2: Final = 16.0
_LABEL_SHARE: Final = 0.05
"""Room that a count takes, as a share of a panel's width."""
_COMPUTED: Final = (
    "Whether it is unsafe along one number while all else is held. "
    "Verdicts have no chance, so nothing is estimated."
)
_STATES: Final = {Outcome.CHANCY: "chancy: no threshold", Outcome.OPEN: "open: more simulations would tell"}


def figure_thresholds(view: ThresholdsView) -> Figure:
    """Plot the curves of a campaign, a panel for each line.

    Args:
        view: The thresholds; of more than `MOST_PANELS` lines, the first ones are drawn.
    """
    shown = view.thresholds[:MOST_PANELS]
    columns = min(_COLUMNS, max(1, len(shown)))
    rows = max(1, math.ceil(len(shown) / columns))
    height_px = _TOP_PX + rows * _ROW_PX + _BOTTOM_PX - 60
    figure = new_figure(
        height_px,
        f"Where exactly it turns: {view.name}",
        _COMPUTED
        if view.computed
        else "How likely a violation is along one number while all else is held. "
        "Each drive had its own random numbers.",
    )
    grid = figure.add_gridspec(
        rows,
        columns,
        left=(MARGIN_PX + 20) / WIDTH_PX,
        right=1 - 40 / WIDTH_PX,
        top=1 - (_TOP_PX + 40) / height_px,
        bottom=_BOTTOM_PX / height_px,
        hspace=0.62,
        wspace=0.16,
    )
    for place, one in enumerate(shown):
        axes = figure.add_subplot(grid[place // columns, place % columns])
        _panel(axes, one, computed=view.computed)
        if place % columns:
            axes.tick_params(labelleft=False)
    if not shown:
        show_message(figure.add_subplot(grid[0, 0]), view.sentence)
    add_legend(figure, _legend(view), 100)
    return figure


def _legend(view: ThresholdsView) -> list[Line2D]:
    dot = Line2D([], [], color=SAFE, marker="o", linewidth=0, markersize=8)
    if view.computed:
        turns = Line2D([], [], color=HAIRLINE, linewidth=9, label="turns between these")
        dot.set_label("safe at 0%, unsafe at 100%")
        return [turns, dot]
    dot.set_label("unsafe share of the drives there")
    return [
        Line2D([], [], color=UNSAFE, linewidth=2, label="probability, with its 90% interval"),
        Line2D([], [], color=INK, marker="o", linewidth=1.6, markersize=6, label="50% point, 90% interval"),
        Line2D([], [], color=HAIRLINE, linewidth=9, label="from 20 to 80%"),
        dot,
    ]


def _panel(axes: Axes, one: ThresholdView, *, computed: bool) -> None:
    style_axes(axes)
    low, high = _window(one)
    if one.log:
        axes.set_xscale("log")
    if one.outcome is Outcome.THRESHOLD and one.at_20 is not None and one.at_80 is not None:
        axes.axvspan(*sorted((one.at_20, one.at_80)), color=HAIRLINE, alpha=0.75, linewidth=0, zorder=0)
    curve = one.curve
    if not computed:
        axes.fill_between(curve.value, curve.low, curve.high, color=UNSAFE, alpha=0.14, linewidth=0)
        axes.plot(curve.value, curve.share, color=UNSAFE, linewidth=2)
        for level in (LOW, HIGH):
            axes.axhline(level, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    shown = [dot for dot in one.dots if low <= dot.value <= high]
    _dots(axes, shown, high - low)
    if one.outcome is Outcome.THRESHOLD and one.middle is not None and not computed:
        ends = [low if one.low is None else one.low, high if one.high is None else one.high]
        axes.plot(ends, [0.5, 0.5], color=INK, linewidth=1.8, solid_capstyle="butt", zorder=5)
        axes.plot([one.middle], [0.5], "o", color=INK, markersize=6, zorder=6)
    axes.set_xlim(low, high)
    axes.set_ylim(-0.06, 1.06)
    axes.set_yticks([0.0, LOW, 0.5, HIGH, 1.0])
    show_percent(axes.yaxis)
    axes.tick_params(labelsize=TICK_PT - 1)
    unit = f" ({one.unit})" if one.unit else ""
    parameter = one.parameter.partition(",")[0]  # the rest would run into the next panel
    axes.set_xlabel(f"{parameter}{unit}", fontsize=SMALL_PT, color=MUTED)
    found = f"turns {one.turns}" if computed else f"50% at {one.turns}, 20 to 80% within {one.within}"
    told = _STATES.get(one.outcome, found)
    _titles(axes, one, told, sum(dot.drives for dot in one.dots) - sum(dot.drives for dot in shown))


def _titles(axes: Axes, one: ThresholdView, told: str, further: int) -> None:
    """Write what changes, what came out, and how many drives are outside the panel."""
    lines = textwrap.wrap(f"{one.place}. {one.words}", _TITLE_CHARACTERS)
    if len(lines) > _TITLE_LINES:
        lines = [*lines[: _TITLE_LINES - 1], f"{lines[_TITLE_LINES - 1][: _TITLE_CHARACTERS - 2]} …"]
    title = axes.text(
        0.0, 1.17, "\n".join(lines), fontsize=TICK_PT, color=INK, fontweight="bold", va="bottom"
    )
    title.set_transform(axes.transAxes)
    if one.window:
        told += f"; {one.window}"
    axes.text(0.0, 1.05, told, transform=axes.transAxes, fontsize=SMALL_PT, color=MUTED, va="bottom")
    count = f"{one.drives:,} drives" + (f", {further:,} of them further out" if further else "")
    axes.text(
        0.99, -0.21, count, transform=axes.transAxes, fontsize=SMALL_PT, color=MUTED, ha="right", va="top"
    )


def _dots(axes: Axes, dots: Sequence[DotView], width: float) -> None:
    """Draw the drives at each place, with their counts where there is room."""
    last: dict[bool, float] = {}
    for dot in dots:
        share = dot.unsafe / dot.drives
        colour = SAFE if not dot.unsafe else UNSAFE if dot.unsafe == dot.drives else MUTED
        size = _DOT_PT2 * (1.0 + math.sqrt(dot.drives))
        axes.scatter([dot.value], [share], s=size, color=colour, edgecolors="white", linewidths=0.7, zorder=4)
        above = share < 0.5
        if dot.drives == 1 or dot.value - last.get(above, -math.inf) < _LABEL_SHARE * width:
            continue
        last[above] = dot.value
        axes.annotate(
            f"{dot.unsafe}/{dot.drives}",
            (dot.value, share),
            xytext=(0, 6 if above else -6),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=SMALL_PT - 2,
            color=MUTED,
        )


def _window(one: ThresholdView) -> tuple[float, float]:
    """Return the part of the line that is shown: near the threshold if there is one, all of it otherwise."""
    along, back = (math.log, math.exp) if one.log else (float, float)
    values = [along(value) for value in (*(dot.value for dot in one.dots), *one.curve.value)]
    low, high = min(values), max(values)
    marks = [along(mark) for mark in (one.at_20, one.at_80, one.low, one.high) if mark is not None]
    if one.outcome is Outcome.THRESHOLD and marks:
        width = max(max(marks) - min(marks), 4 * along(one.resolution))
        low, high = max(low, min(marks) - _MARGIN * width), min(high, max(marks) + _MARGIN * width)
    edge = 0.03 * (high - low or 1.0)
    return back(low - edge), back(high + edge)
