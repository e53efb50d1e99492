"""Figures of sensitivity: the boundary of one archive scored otherwise, and searches with another setting."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from brink.plots.style import INK, LABEL_PT, MUTED, SAFE, UNSAFE, WIDTH_PX, frame, new_figure
from brink.search.analysis.boundary import Rescored
from brink.search.analysis.statistics import mean_interval

HEIGHT_PX: Final = 640
_TOP_PX: Final = 176
_KEYS: Final = (("distinct boundary solutions (DBS)", SAFE, "o"), ("strict DBS", UNSAFE, "s"))


def figure_rescored(
    radii: Sequence[Rescored],
    p_ths: Sequence[Rescored],
    *,
    own: tuple[float, float],
    t_b: float,
    d_th: float,
    title: str,
) -> Figure:
    """Return DBS and strict DBS of one archive by radius and by p_th.

    Args:
        radii: By radius, ascending.
        p_ths: By probability, ascending.
        own: Radius and probability of the campaign.
        t_b: Largest fitness.
        d_th: Least distance between two that count.
        title: What it is about.
    """
    figure = new_figure(
        HEIGHT_PX, title,
        f"The same evaluated solutions, scored with other settings (t_b {t_b:g}, d_th {d_th:g}). Dashed: the "
        "campaign's own, which steered\nthe search: its archive is densest where these put the boundary.",
    )  # fmt: skip
    left, right = _grid(figure)
    _lines(left, [one.radius for one in radii], [(one.dbs, one.strict_dbs) for one in radii])
    _lines(right, [one.p_th for one in p_ths], [(one.dbs, one.strict_dbs) for one in p_ths])
    for axes, value, name in (
        (left, own[0], "radius of a neighbourhood (delta)"),
        (right, own[1], "probability of unsafe on the boundary (p_th)"),
    ):
        axes.axvline(value, color=MUTED, linewidth=1.2, linestyle="--", zorder=0)
        _finish(axes, name)
    _keys(figure)
    return figure


def figure_rerun(
    found: Mapping[str, Mapping[str, Sequence[float]]], *, parameter: str, t_b: float, d_th: float, title: str
) -> Figure:
    """Return DBS and strict DBS of searches with other values of a setting: every seed, means, 95% intervals.

    Args:
        found: By value, the figures of the seeds: ``dbs`` and ``strict``.
        parameter: Which setting.
        t_b: Largest fitness.
        d_th: Least distance between two that count.
        title: What it is about.
    """
    seeds = max((len(one["dbs"]) for one in found.values()), default=0)
    figure = new_figure(
        HEIGHT_PX, title,
        f"Searches of their own with {seeds} seeds for each value (t_b {t_b:g}, d_th {d_th:g}). Small: single "
        "searches; large: means with 95% intervals.",
    )  # fmt: skip
    for axes, measure, (name, hue, marker) in zip(_grid(figure), ("dbs", "strict"), _KEYS, strict=True):
        places = np.arange(len(found))
        for place, one in zip(places, found.values(), strict=True):
            values = list(one[measure])
            span = mean_interval(values)
            axes.plot([place] * len(values), values, "o", markersize=4, color=hue, alpha=0.35, linestyle="")
            low = span.mean if span.low is None else max(0.0, span.low)
            high = span.mean if span.high is None else span.high
            axes.errorbar(
                [place], [span.mean], yerr=[[max(0.0, span.mean - low)], [max(0.0, high - span.mean)]], color=hue,
                marker=marker, markersize=8, capsize=4, elinewidth=1.6,
            )  # fmt: skip
        axes.set_xticks(places, list(found))
        axes.set_xlim(-0.6, len(found) - 0.4)
        axes.set_title(name, loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold")
        _finish(axes, parameter)
    return figure


def _grid(figure: Figure) -> tuple[Axes, Axes]:
    grid = figure.add_gridspec(
        1, 2, left=84 / WIDTH_PX, right=1 - 40 / WIDTH_PX, top=1 - _TOP_PX / HEIGHT_PX, bottom=70 / HEIGHT_PX,
        wspace=0.16,
    )  # fmt: skip
    return figure.add_subplot(grid[0]), figure.add_subplot(grid[1])


def _lines(axes: Axes, x: Sequence[float], counts: Sequence[tuple[int, int]]) -> None:
    for place, (_, hue, marker) in enumerate(_KEYS):
        axes.plot(x, [one[place] for one in counts], color=hue, marker=marker, markersize=6, linewidth=2.2)


def _finish(axes: Axes, name: str) -> None:
    axes.set_xlabel(name)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    frame(axes)


def _keys(figure: Figure) -> None:
    keys = [
        Line2D([], [], color=hue, marker=marker, markersize=6, linewidth=2.2, label=name)
        for name, hue, marker in _KEYS
    ]
    figure.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(64 / WIDTH_PX, 1 - 122 / HEIGHT_PX), ncols=2,
        frameon=False, fontsize=LABEL_PT, labelcolor=INK, handlelength=2.6, borderaxespad=0,
    )  # fmt: skip
