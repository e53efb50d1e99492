"""The figure of a pair whose solutions cannot be replayed: in the plane of two numbers, or by differing parameter."""

from dataclasses import dataclass
from textwrap import wrap
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from brink.plots.inputs import CampaignFigures
from brink.plots.style import (
    HAIRLINE,
    INK,
    LABEL_PT,
    MUTED,
    SAFE,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    new_figure,
    set_panel_title,
    style_axes,
)
from brink.search.parameters import Categorical, Number, Parameter
from brink.search.space import BoolArray, FloatArray

PLANE_HEIGHT_PX: Final = 860
_ROW_PX: Final = 74
_LINE_LETTERS: Final = 150
_TOP_PX, _BOTTOM_PX = 190, 60
_CLOSE_UP: Final = 4.0
"""Half the width of the close-up of a pair, in distances between its sides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFigure:
    """The contents of a pair's figure.

    Attributes:
        safe: Number of the safe solution.
        unsafe: Number of the unsafe one.
        change: The change between them, in words.
        facts: Further facts, one line each.
    """

    safe: int
    unsafe: int
    change: str
    facts: tuple[str, ...] = ()


def figure_pair(inputs: CampaignFigures, pair: PairFigure) -> Figure:
    """Plot a pair.

    A problem of two numbers is drawn in its own plane, to scale, with all solutions and a close-up of the pair. Any
    other problem has a row for each parameter in which the two solutions differ, if it was active in either episode.

    Args:
        inputs: The campaign.
        pair: The pair.

    Raises:
        ValueError: A solution of the pair is not in the archive.
    """
    rows = tuple(_vector(inputs, number) for number in (pair.safe, pair.unsafe))
    parameters = [one for component in inputs.space.components for one in component.parameters]
    if len(parameters) == 2 and all(isinstance(one, Number) for one in parameters):
        return _plane(inputs, pair, rows)
    return _by_parameter(inputs, pair, rows, parameters)


def _vector(inputs: CampaignFigures, number: int) -> FloatArray:
    found = np.flatnonzero(inputs.archive.numbers == number)
    if not found.size:
        raise ValueError(f"number: expected an evaluated solution of {inputs.title}, got {number}")
    row: FloatArray = inputs.archive.vectors[int(found[0])]
    return row


def _heading(inputs: CampaignFigures, pair: PairFigure, height_px: int) -> Figure:
    return new_figure(height_px, f"{inputs.title}: a pair across the boundary", "\n".join(_lines(pair)))


def _lines(pair: PairFigure) -> list[str]:
    """Return the change and the facts as lines that fit into the figure."""
    return [line for text in (pair.change, *pair.facts) for line in wrap(text, _LINE_LETTERS)]


def _plane(inputs: CampaignFigures, pair: PairFigure, rows: tuple[FloatArray, ...]) -> Figure:
    figure = _heading(inputs, pair, PLANE_HEIGHT_PX)
    top_px = 138 + 22 * len(_lines(pair))
    side = (PLANE_HEIGHT_PX - top_px - 70) / PLANE_HEIGHT_PX
    wide = side * PLANE_HEIGHT_PX / WIDTH_PX
    low, high = _limits(inputs)
    middle = (rows[0] + rows[1]) / 2
    spread = np.abs(rows[0] - rows[1]).max() * _CLOSE_UP
    titles = ("all solutions", "the pair, enlarged")
    for place, (title, left, right) in enumerate(
        [(titles[0], low, high), (titles[1], middle - spread, middle + spread)]
    ):
        axes = figure.add_axes((0.07 + place * 0.48, 70 / PLANE_HEIGHT_PX, wide, side))
        _plot_plane(axes, inputs, rows, enlarged=place == 1)
        axes.set_xlim(left[0], right[0])
        axes.set_ylim(left[1], right[1])
        axes.set_aspect("equal" if _to_scale(inputs) else "auto")
        set_panel_title(axes, title)
        if place == 0:
            box = Rectangle(
                (float(middle[0] - spread), float(middle[1] - spread)),
                float(2 * spread),
                float(2 * spread),
                fill=False,
                edgecolor=INK,
                linewidth=1.2,
                zorder=5,
            )
            axes.add_patch(box)
    add_legend(figure, _keys(pair), top_px - 66, handlelength=1.0)
    return figure


def _limits(inputs: CampaignFigures) -> tuple[FloatArray, FloatArray]:
    parameters = [one for component in inputs.space.components for one in component.parameters]
    ends = [(one.low, one.high) for one in parameters if isinstance(one, Number)]
    low, high = np.array(ends, dtype=np.float64).T
    return low, high


def _to_scale(inputs: CampaignFigures) -> bool:
    """Return whether both numbers have the same unit, so that a circle should look like one."""
    parameters = [one for component in inputs.space.components for one in component.parameters]
    return len({one.unit for one in parameters if isinstance(one, Number)}) == 1


def _keys(pair: PairFigure) -> list[Line2D]:
    return [
        Line2D(
            [], [], color=colour, marker="o", linestyle="", markersize=8, label=f"{name}: solution {number}"
        )
        for name, number, colour in (("safe", pair.safe, SAFE), ("unsafe", pair.unsafe, UNSAFE))
    ]


def _plot_plane(axes: Axes, inputs: CampaignFigures, rows: tuple[FloatArray, ...], *, enlarged: bool) -> None:
    vectors, unsafe = inputs.archive.vectors, inputs.archive.unsafe
    for colour, chosen in ((SAFE, ~unsafe), (UNSAFE, unsafe)):
        axes.scatter(
            vectors[chosen, 0],
            vectors[chosen, 1],
            s=60 if enlarged else 12,
            color=colour,
            alpha=0.35,
            linewidths=0,
        )
    axes.plot(*np.array(rows).T, color=INK, linewidth=1.2, zorder=3)
    for row, colour in zip(rows, (SAFE, UNSAFE), strict=True):
        axes.scatter(
            row[:1],
            row[1:],
            s=190 if enlarged else 40,
            color=colour,
            edgecolors=INK,
            linewidths=1.3,
            zorder=4,
        )
    across, up = (_plain(name, inputs) for name in inputs.space.column_names())
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    style_axes(axes, grid="both")


def _plain(name: str, inputs: CampaignFigures) -> str:
    """Return the name of a parameter, without its component if it is unambiguous."""
    component, _, parameter = name.partition(".")
    names = [one.partition(".")[2] for one in inputs.space.column_names()]
    return parameter if component == parameter or names.count(parameter) == 1 else name


def _by_parameter(
    inputs: CampaignFigures, pair: PairFigure, rows: tuple[FloatArray, ...], parameters: list[Parameter]
) -> Figure:
    different = rows[0] != rows[1]
    shown = different & _active(inputs, pair)
    differing = np.flatnonzero(shown).tolist()
    top_px = _TOP_PX + 22 * (len(_lines(pair)) - 1)
    height_px = top_px + _BOTTOM_PX + _ROW_PX * max(1, len(differing))
    figure = _heading(inputs, pair, height_px)
    axes = figure.add_axes(
        (0.26, _BOTTOM_PX / height_px, 0.66, (height_px - top_px - _BOTTOM_PX) / height_px)
    )
    axes.set_xlim(0, 1)
    axes.set_ylim(max(1, len(differing)) - 0.5, -0.5)
    axes.set_axis_off()
    titles = list(inputs.space.titles().values())
    for place, column in enumerate(differing):
        _plot_row(axes, place, titles[column], parameters[column], [float(row[column]) for row in rows])
    same = len(titles) - len(differing)
    hidden = int((different & ~shown).sum())
    words = f"The other {same} parameters are the same." if same > 1 else ""
    if hidden:
        differ = f"{'more ' if differing else ''}{'differs' if hidden == 1 else 'differ'}"
        words = f"{hidden} {differ} but were inactive in both episodes."
        words += f" The other {same - hidden} are the same." if same > hidden + 1 else ""
    axes.text(0, -0.02, words, transform=axes.transAxes, va="top", fontsize=TICK_PT, color=MUTED)
    add_legend(figure, _keys(pair), top_px - 56, handlelength=1.0)
    return figure


def _active(inputs: CampaignFigures, pair: PairFigure) -> BoolArray:
    """Return which parameters were active in either episode, shape ``(d,)``; all if that was not recorded."""
    if inputs.active is None:
        return np.ones(inputs.space.dimension, np.bool_)
    places = [int(np.flatnonzero(inputs.archive.numbers == number)[0]) for number in (pair.safe, pair.unsafe)]
    return np.asarray(inputs.active[places].any(axis=0), np.bool_)


def _plot_row(axes: Axes, place: int, title: str, parameter: Parameter, values: list[float]) -> None:
    """Plot both values of a parameter on its range."""
    axes.annotate(
        title,
        (0, place),
        xytext=(-16, 0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=LABEL_PT,
        color=INK,
    )
    axes.plot([0, 1], [place, place], color=HAIRLINE, linewidth=5, solid_capstyle="round", zorder=1)
    if isinstance(parameter, Categorical):
        spots = [value / max(1, len(parameter.choices) - 1) for value in values]
        words = [str(parameter.decode(value)).replace("_", " ") for value in values]
        ends = f"{len(parameter.choices)} choices"
    else:
        lowest = parameter.stored(parameter.low)
        spots = [(value - lowest) / parameter.range for value in values]
        words = [f"{_number(parameter.decode(value))} {parameter.unit}".strip() for value in values]
        ends = f"{parameter.low:g} to {parameter.high:g}"
    for (colour, spot, word), up in zip(zip((SAFE, UNSAFE), spots, words, strict=True), (1, -1), strict=True):
        axes.plot([spot], [place], marker="o", markersize=10, color=colour, zorder=3, clip_on=False)
        axes.annotate(
            word,
            (spot, place),
            xytext=(0, 11 * up),
            textcoords="offset points",
            ha="center",
            va="bottom" if up > 0 else "top",
            fontsize=TICK_PT,
            color=colour,
            fontweight="bold",
        )
    axes.annotate(
        ends,
        (1, place),
        xytext=(12, 0),
        textcoords="offset points",
        ha="left",
        va="center",
        fontsize=SMALL_PT,
        color=MUTED,
    )


def _number(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)
