"""Figure of repeats: each boundary solution's own probability of unsafe, beside that of its neighbourhood."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from brink.plots.style import (
    HAIRLINE,
    INK,
    LABEL_PT,
    MUTED,
    SAFE,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    frame,
    new_figure,
)

MOST: Final = 80
"""Solutions that are drawn; of more, so many evenly spread over their order."""
_ROW_PX: Final = 15
_TOP_PX, _BOTTOM_PX = 178, 66


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedPoint:
    """What is drawn of one solution.

    Attributes:
        number: Which.
        probability: Unsafe share of its own simulations.
        low: Lower limit of its interval.
        high: Upper limit.
        around: Unsafe share of its neighbourhood in the archive and the limits of its interval; None if unknown.
    """

    number: int
    probability: float
    low: float
    high: float
    around: tuple[float, float, float] | None

    def side(self, p_th: float) -> int:
        """Return -1 if the interval lies below a probability, 1 if above, 0 if it contains it."""
        return -1 if self.high < p_th else 1 if self.low > p_th else 0


def figure_repeats(points: Sequence[RepeatedPoint], *, p_th: float, times: str, title: str) -> Figure:
    """Return each solution's own probability of unsafe with its interval, least first.

    Args:
        points: Solutions, at least one.
        p_th: Probability on the boundary that was sought.
        times: How often each was simulated, in words.
        title: What it is about.
    """
    ordered = sorted(points, key=lambda point: (point.probability, point.number))
    if len(ordered) > MOST:
        ordered = [ordered[place] for place in np.linspace(0, len(ordered) - 1, MOST).round().astype(int)]
    height = _TOP_PX + _BOTTOM_PX + _ROW_PX * max(len(ordered), 12)
    sides = [point.side(p_th) for point in points]
    left_out = f" (of {len(points)}, {len(ordered)} are drawn)" if len(points) > len(ordered) else ""
    figure = new_figure(
        height,
        title,
        f"{len(points)} distinct boundary solutions{left_out}, each simulated {times} times with seeds that the "
        f"search never used.\nLines are Wilson intervals. The boundary that was sought is where unsafe has "
        f"probability {p_th:g}.",
    )
    axes = figure.add_axes((
        96 / WIDTH_PX, _BOTTOM_PX / height, 1 - (96 + 64) / WIDTH_PX, 1 - (_TOP_PX + _BOTTOM_PX) / height,
    ))  # fmt: skip
    hues = {-1: SAFE, 0: INK, 1: UNSAFE}
    for row, point in enumerate(ordered):
        if point.around is not None:
            share, low, high = point.around
            axes.plot([low, high], [row, row], color=HAIRLINE, linewidth=7, solid_capstyle="butt", zorder=1)
            axes.plot([share], [row], marker="|", markersize=8, color=MUTED, zorder=2)
        hue = hues[point.side(p_th)]
        axes.plot([point.low, point.high], [row, row], color=hue, linewidth=1.8, zorder=3)
        axes.plot([point.probability], [row], marker="o", markersize=5, color=hue, zorder=4)
    axes.axvline(p_th, color=MUTED, linewidth=1.2, linestyle="--", zorder=0)
    axes.set_xlim(-0.01, 1.01)
    axes.set_ylim(-0.8, max(len(ordered), 12) - 0.2)
    axes.xaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    axes.set_yticks(range(len(ordered)), [str(point.number) for point in ordered], fontsize=SMALL_PT)
    axes.set_xlabel("probability of unsafe")
    axes.set_ylabel("solution")
    frame(axes, grid="x")
    axes.tick_params(axis="y", labelsize=SMALL_PT)
    words = {0: f"contains {p_th:g}", -1: "lies below: safer than reported", 1: "lies above"}
    keys = [
        Line2D([], [], color=hues[side], linewidth=1.8, marker="o", markersize=5,
               label=f"{sides.count(side)}: interval {words[side]}")
        for side in (0, -1, 1)
    ]  # fmt: skip
    around = Line2D([], [], color=HAIRLINE, linewidth=7, label="its neighbourhood in the archive")
    figure.legend(
        handles=[*keys, around], loc="upper left", bbox_to_anchor=(64 / WIDTH_PX, 1 - 122 / height),
        ncols=4, frameon=False, fontsize=LABEL_PT, labelcolor=INK, handlelength=2.2, borderaxespad=0,
    )  # fmt: skip
    return figure
