"""The look of campaign figures: colours, type, frames, labels at the ends of lines.

Hues are Okabe and Ito's, which people with colour vision deficiencies can tell apart. Blue is safe, vermilion is
unsafe, ink is the boundary. Figures are made with matplotlib's object interface alone: nothing global is changed,
so that they can be drawn in any thread.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

SAFE: Final = "#0072b2"
UNSAFE: Final = "#d55e00"
INK: Final = "#1f252b"
MUTED: Final = "#68727b"
HAIRLINE: Final = "#d0d5d9"
PAPER: Final = "#ffffff"

DPI: Final = 100
WIDTH_PX: Final = 1600
TITLE_PT: Final = 19
SUBTITLE_PT: Final = 12.5
LABEL_PT: Final = 12
TICK_PT: Final = 11
SMALL_PT: Final = 10
MARGIN_PX: Final = 64


def new_figure(height_px: int, title: str, subtitle: str) -> Figure:
    """Return an empty figure with its title and what it shows in a sentence or two.

    Args:
        height_px: Height; all figures are equally wide.
        title: What it is about.
        subtitle: What it shows, a newline between lines.
    """
    figure = Figure(figsize=(WIDTH_PX / DPI, height_px / DPI), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    left = MARGIN_PX / WIDTH_PX
    figure.text(
        left, 1 - 26 / height_px, title, fontsize=TITLE_PT, fontweight="bold", color=INK, va="top", ha="left"
    )
    figure.text(
        left,
        1 - 62 / height_px,
        subtitle,
        fontsize=SUBTITLE_PT,
        color=MUTED,
        va="top",
        ha="left",
        linespacing=1.45,
    )
    return figure


def frame(axes: Axes, *, grid: str = "y") -> None:
    """Give axes the plain look: two thin spines, muted ticks, a faint grid.

    Args:
        axes: Which.
        grid: ``x``, ``y``, ``both``, or empty for none.
    """
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(HAIRLINE)
    axes.tick_params(colors=MUTED, labelsize=TICK_PT, length=4, color=HAIRLINE)
    if grid in ("x", "y", "both"):
        axes.grid(axis=grid, color=HAIRLINE, linewidth=0.7, alpha=0.6)  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_color(MUTED)
        label.set_fontsize(LABEL_PT)


class EndLabel(NamedTuple):
    """A word beside the end of a line."""

    value: float
    text: str
    colour: str


def label_ends(
    axes: Axes, labels: Sequence[EndLabel], *, apart: float = 0.062, fontsize: float = TICK_PT
) -> None:
    """Write words beside the ends of lines, at their heights but apart from each other.

    Args:
        axes: Their limits must be final.
        labels: In any order.
        apart: Least distance, as a share of the axes' height.
        fontsize: In points.
    """
    low, high = axes.get_ylim()
    wanted = sorted(labels, key=lambda label: label.value)
    heights = [(label.value - low) / max(high - low, 1e-12) for label in wanted]
    for place, label in zip(_spread(heights, apart), wanted, strict=True):
        axes.annotate(
            label.text, (1, place), xycoords="axes fraction", xytext=(8, 0), textcoords="offset points",
            va="center", ha="left", fontsize=fontsize, color=label.colour, annotation_clip=False,
        )  # fmt: skip


def _spread(heights: Sequence[float], apart: float) -> list[float]:
    """Return ascending heights moved as little as needed to be apart and, if that is possible, inside [0, 1]."""
    places: list[float] = []
    for height in heights:
        places.append(max(height, places[-1] + apart) if places else max(height, 0.0))
    ceiling = 1.0
    for index in range(len(places) - 1, -1, -1):
        places[index] = min(places[index], ceiling)
        ceiling = places[index] - apart
    return places


def say(axes: Axes, text: str) -> None:
    """Write a sentence in the middle of axes that have nothing to show."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=LABEL_PT, color=MUTED,
        linespacing=1.5,
    )  # fmt: skip


def share_text(value: float) -> str:
    """Return a share as a percentage with sensible digits."""
    if not np.isfinite(value):
        return "–"
    return f"{100 * value:.0f}%" if value >= 0.1 or value == 0 else f"{100 * value:.1f}%"
