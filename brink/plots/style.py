"""The style of all figures: colours, type, frames, legends, labels at the ends of lines.

Colours are Okabe and Ito's, which people with colour vision deficiencies can distinguish. Blue is safe, vermilion is
unsafe, ink is the boundary. Figures use only matplotlib's object interface and no global state, so they can be drawn
in any thread.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from brink.pictures.figure import LiteralFigure

SAFE: Final = "#0072b2"
UNSAFE: Final = "#d55e00"
OTHER: Final = "#b0468c"
"""Of solutions that hold the campaign's requirements and violate another one."""
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
    """Return an empty figure with a title and a subtitle.

    Args:
        height_px: Height; all figures have the same width.
        title: The title.
        subtitle: One or two sentences that explain the figure, with line breaks.
    """
    figure = LiteralFigure(figsize=(WIDTH_PX / DPI, height_px / DPI), dpi=DPI, facecolor=PAPER)
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


def add_panels(
    figure: Figure, columns: int, *, top_px: float, bottom_px: float, left_px: float = 84, wspace: float = 0.2
) -> list[Axes]:
    """Add a row of panels of the same width to a figure.

    Args:
        figure: The figure.
        columns: Number of panels.
        top_px: Distance from the top of the figure.
        bottom_px: Distance from its bottom.
        left_px: Distance from its left side.
        wspace: Gap between two panels as a share of a panel's width.
    """
    height_px = figure.get_figheight() * DPI
    grid = figure.add_gridspec(
        1,
        columns,
        left=left_px / WIDTH_PX,
        right=1 - 40 / WIDTH_PX,
        top=1 - top_px / height_px,
        bottom=bottom_px / height_px,
        wspace=wspace,
    )
    return [figure.add_subplot(grid[column]) for column in range(columns)]


def style_axes(axes: Axes, *, grid: str = "y") -> None:
    """Style axes: two thin spines, muted ticks, a faint grid along ``x``, ``y`` or ``both``."""
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
    """A label at the end of a line."""

    value: float
    text: str
    colour: str


def label_ends(axes: Axes, labels: Sequence[EndLabel], *, apart: float = 0.062) -> None:
    """Write labels at the ends of lines, moved apart where they would overlap.

    Args:
        axes: Axes with final limits.
        labels: The labels, in any order.
        apart: Minimum distance as a share of the height of the axes.
    """
    low, high = axes.get_ylim()
    wanted = sorted(labels, key=lambda label: label.value)
    heights = [(label.value - low) / max(high - low, 1e-12) for label in wanted]
    for place, label in zip(_spread(heights, apart), wanted, strict=True):
        axes.annotate(
            label.text,
            (1, place),
            xycoords="axes fraction",
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            ha="left",
            fontsize=TICK_PT,
            color=label.colour,
            annotation_clip=False,
        )


def _spread(heights: Sequence[float], apart: float) -> list[float]:
    """Move ascending heights as little as possible to be at least `apart` apart and, given room, within [0, 1]."""
    places: list[float] = []
    for height in heights:
        places.append(max(height, places[-1] + apart) if places else max(height, 0.0))
    ceiling = 1.0
    for index in range(len(places) - 1, -1, -1):
        places[index] = min(places[index], ceiling)
        ceiling = places[index] - apart
    return places


def show_message(axes: Axes, text: str) -> None:
    """Write a message in the middle of empty axes."""
    axes.text(
        0.5,
        0.5,
        text,
        transform=axes.transAxes,
        ha="center",
        va="center",
        fontsize=LABEL_PT,
        color=MUTED,
        linespacing=1.5,
    )


def set_panel_title(axes: Axes, title: str) -> None:
    """Set the title of one of several axes."""
    axes.set_title(title, loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold")


def show_percent(*axes: Axis) -> None:
    """Format axis tick labels as whole percentages."""
    for axis in axes:
        axis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))


def style_shares(axes: Axes, title: str, *, x: str, y: str) -> None:
    """Style a panel in which two shares, each in [0, 1], are plotted against each other.

    Args:
        axes: The axes.
        title: Title of the panel.
        x: Name of the share on the horizontal axis.
        y: Name of the other.
    """
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    show_percent(axes.xaxis, axes.yaxis)
    set_panel_title(axes, title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    style_axes(axes, grid="both")


def add_legend(figure: Figure, lines: Sequence[Line2D], top_px: float, handlelength: float = 2.6) -> None:
    """Add a one-line legend below the subtitle of a figure.

    Args:
        figure: The figure.
        lines: Labelled lines.
        top_px: Distance from the top of the figure.
        handlelength: Length of the lines, in font sizes.
    """
    top = 1 - top_px / (figure.get_figheight() * DPI)
    figure.legend(
        handles=lines,
        loc="upper left",
        bbox_to_anchor=(MARGIN_PX / WIDTH_PX, top),
        ncols=len(lines) or 1,
        frameon=False,
        fontsize=LABEL_PT,
        labelcolor=INK,
        handlelength=handlelength,
        borderaxespad=0,
    )


def share_text(value: float) -> str:
    """Format a share as a percentage, with one decimal if it is small."""
    if not np.isfinite(value):
        return "–"
    return f"{100 * value:.0f}%" if value >= 0.1 or value == 0 else f"{100 * value:.1f}%"
