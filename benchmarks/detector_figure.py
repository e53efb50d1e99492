"""The figure of `detector`: accuracy by distance, under perturbations, and over all thresholds."""

from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.detector import DetectorAccuracy, Step
from brink.plots.style import (
    HAIRLINE,
    INK,
    MUTED,
    TICK_PT,
    add_legend,
    new_figure,
    set_panel_title,
    style_axes,
)
from brink.sim.perception.detector import LABELS

HEIGHT_PX: Final = 720
_PANELS: Final = ((0.06, 0.285), (0.395, 0.665), (0.75, 0.975))
"""Left and right end of each panel, as shares of the width."""
_CLASS_COLOURS: Final = dict(zip(LABELS, ("#009e73", "#e69f00"), strict=True))
_STEP_COLOURS: Final = {Step.FIRST: "#9ecae1", Step.MIDDLE: "#4292c6", Step.HIGHEST: "#08306b"}


def figure_detector(found: DetectorAccuracy) -> Figure:
    """Plot recall by distance, mAP under each perturbation, and precision against recall."""
    figure = new_figure(
        HEIGHT_PX,
        f"What {found.detector.rpartition('/')[2]} sees",
        f"{found.images:,} fresh images. Left and right: as they are. Middle: each perturbation alone, at its first, "
        "middle and highest level;\nthe line is the mAP on clean images.",
    )
    low, high = 76 / HEIGHT_PX, 1 - 200 / HEIGHT_PX
    for plot, (left, right) in zip((_plot_distances, _plot_genes, _plot_thresholds), _PANELS, strict=True):
        plot(figure.add_axes((left, low, right - left, high - low)), found)
    keys = [
        Line2D([], [], color=colour, linewidth=2.2, label=name) for name, colour in _CLASS_COLOURS.items()
    ]
    keys += [
        Line2D([], [], color=colour, marker="o", markersize=7, linewidth=0, label=f"{step} level")
        for step, colour in _STEP_COLOURS.items()
    ]
    add_legend(figure, keys, 122, handlelength=2.0)
    return figure


def _plot_distances(axes: Axes, found: DetectorAccuracy) -> None:
    for name, colour in _CLASS_COLOURS.items():
        points = [
            (place, accuracy.classes[name].recall)
            for place, accuracy in enumerate(found.by_distance.values())
            if name in accuracy.classes
        ]
        axes.plot(
            [place for place, _ in points],
            [value for _, value in points],
            color=colour,
            marker="o",
            markersize=6,
            linewidth=2.2,
            clip_on=False,
        )
    names = [f"{one.low:g}–{one.high:g}" for one in found.by_distance]
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.3, len(names) - 0.7)
    axes.set_ylim(0, 1)
    axes.set_xlabel("distance (m)")
    axes.set_ylabel(f"recall at a score of {found.threshold:g}")
    set_panel_title(axes, "Distance")
    style_axes(axes)


def _plot_genes(axes: Axes, found: DetectorAccuracy) -> None:
    """Plot the mAP at three levels, the most harmful gene at the bottom."""
    genes = sorted(found.genes, key=lambda gene: found.genes[gene][Step.MIDDLE].map)
    for place, gene in enumerate(genes):
        values = [found.genes[gene][step].map for step in Step]
        axes.plot([min(values), max(values)], [place, place], color=HAIRLINE, linewidth=2.0, zorder=1)
        for step, value in zip(Step, values, strict=True):
            axes.plot(
                value,
                place,
                "o",
                color=_STEP_COLOURS[step],
                markersize=7,
                zorder=2 + list(Step).index(step),
                clip_on=False,
            )
    if found.clean.map is not None:
        axes.axvline(found.clean.map, color=INK, linewidth=1.2, zorder=0)
        axes.annotate(
            f"{found.clean.map:.2f}",
            (found.clean.map, 1),
            xycoords=("data", "axes fraction"),
            xytext=(4, 2),
            textcoords="offset points",
            fontsize=TICK_PT,
            color=INK,
            ha="left",
            va="bottom",
        )
    axes.set_yticks(range(len(genes)), [gene.replace("_", " ") for gene in genes])
    axes.set_xlim(0, 1)
    axes.set_ylim(-0.6, len(genes) - 0.4)
    axes.set_xlabel("mAP")
    set_panel_title(axes, "Perturbations")
    style_axes(axes, grid="x")


def _plot_thresholds(axes: Axes, found: DetectorAccuracy) -> None:
    for curve in found.curves:
        name = LABELS[curve.label]
        colour = _CLASS_COLOURS[name]
        axes.plot(curve.recall, curve.precision, color=colour, linewidth=2.2)
        accuracy = found.clean.classes[name]
        axes.plot(
            accuracy.recall,
            accuracy.precision,
            "o",
            color=colour,
            markersize=8,
            markeredgecolor=INK,
            clip_on=False,
            zorder=3,
        )
    axes.text(
        0.04,
        0.04,
        f"dots: at a score of {found.threshold:g}",
        transform=axes.transAxes,
        fontsize=TICK_PT,
        color=MUTED,
    )
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.set_xlabel("recall")
    axes.set_ylabel("precision")
    set_panel_title(axes, "Thresholds")
    style_axes(axes, grid="both")
