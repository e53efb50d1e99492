"""Figure: how near the boundary the search came, generation by generation, and how much of it was unsafe."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from brink.plots.inputs import CampaignFigures, by_generation
from brink.plots.style import (
    INK,
    MUTED,
    SAFE,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    EndLabel,
    frame,
    label_ends,
    new_figure,
    say,
    share_text,
)
from brink.search.space import IntArray

HEIGHT_PX: Final = 760


def figure_fitness(inputs: CampaignFigures) -> Figure:
    """Return fitness over generations (best, median, middle half of the archive) with the unsafe share.

    Args:
        inputs: The campaign.
    """
    figure = new_figure(
        HEIGHT_PX,
        f"{inputs.title}: progress of the search",
        "Fitness: how far the 95% interval of the unsafe share around a solution reaches away from "
        f"p_th = {inputs.archive.neighbourhood.p_th:g}; 0 is on the boundary.\n"
        "All solutions are scored anew after each generation, with only what was known then.",
    )
    grid = figure.add_gridspec(
        2,
        1,
        height_ratios=(3, 2),
        left=84 / WIDTH_PX,
        right=1 - 170 / WIDTH_PX,
        top=0.825,
        bottom=0.09,
        hspace=0.14,
    )
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    ends = np.array([end for end in inputs.generation_ends if end > 0], dtype=np.int64)
    if ends.size:
        _plot_fitness(upper, inputs, ends)
        _plot_unsafe(lower, inputs, ends)
        margin = max(0.01 * float(ends[-1] - ends[0]), 1.0 if ends.size == 1 else 0.0)
        upper.set_xlim(max(0.0, ends[0] - margin), ends[-1] + margin)
    else:
        for axes in (upper, lower):
            axes.set_ylim(0, 1)
            say(axes, "no generation is finished yet")
    lower.set_xlabel("solutions in the archive (a mark for each generation)")
    lower.xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True))
    upper.set_ylabel("fitness")
    lower.set_ylabel("unsafe")
    for axes in (upper, lower):
        frame(axes)
    upper.tick_params(labelbottom=False)
    return figure


def _plot_fitness(axes: Axes, inputs: CampaignFigures, ends: IntArray) -> None:
    quantiles = np.array(
        [
            np.quantile(archive.fitness, (0, 0.25, 0.5, 0.75))
            for archive in by_generation(inputs)
            if len(archive)
        ]
    )
    dots = {"marker": "o", "markersize": 3.5 if ends.size <= 80 else 0}
    axes.fill_between(ends, quantiles[:, 1], quantiles[:, 3], color=SAFE, alpha=0.13, linewidth=0)
    axes.plot(ends, quantiles[:, 2], color=SAFE, linewidth=2, label="median", **dots)  # type: ignore[arg-type]
    axes.plot(ends, quantiles[:, 0], color=INK, linewidth=2.2, label="best", **dots)  # type: ignore[arg-type]
    axes.axhline(inputs.t_b, color=MUTED, linewidth=1.1, linestyle=(0, (4, 3)))
    axes.set_ylim(0, max(float(quantiles.max()), inputs.t_b) * 1.06)
    best, quarter, median, three = quantiles[-1].tolist()
    label_ends(
        axes,
        [
            EndLabel(best, f"best {best:.3f}", INK),
            EndLabel(median, f"median {median:.2f}", SAFE),
            EndLabel((median + three) / 2 if three > median else quarter, "middle half", "#7fb2d6"),
            EndLabel(inputs.t_b, f"t_b = {inputs.t_b:g}", MUTED),
        ],
    )


def _plot_unsafe(axes: Axes, inputs: CampaignFigures, ends: IntArray) -> None:
    unsafe = np.concatenate([[0], np.cumsum(inputs.archive.unsafe)])
    starts = np.concatenate([[0], ends[:-1]])
    new = np.maximum(ends - starts, 1)
    share = (unsafe[ends] - unsafe[starts]) / new
    so_far = unsafe[ends] / ends
    axes.scatter(
        ends,
        share,
        s=np.clip(new, 8, 60),
        color=UNSAFE,
        alpha=0.45,
        linewidths=0,
        label="new in the generation",
    )
    axes.plot(ends, so_far, color=UNSAFE, linewidth=2.2, label="so far")
    p_th = inputs.archive.neighbourhood.p_th
    axes.axhline(p_th, color=MUTED, linewidth=1.1, linestyle=(0, (4, 3)))
    axes.set_ylim(0, min(1.02, max(float(share.max()) * 1.12, p_th * 1.6)))
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    label_ends(
        axes,
        [
            EndLabel(float(so_far[-1]), f"so far {share_text(float(so_far[-1]))}", UNSAFE),
            EndLabel(p_th, f"p_th = {p_th:g}", MUTED),
        ],
        apart=0.1,
    )
    axes.annotate(
        "dots: the new solutions of each generation", (0.995, 0.97), xycoords="axes fraction", ha="right", va="top",
        fontsize=SMALL_PT, color=UNSAFE, alpha=0.9,
    )  # fmt: skip
