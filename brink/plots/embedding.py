"""The map of a campaign: a dot for each solution, similar ones close together, with rings around its results."""

import textwrap
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from brink.plots.inputs import CampaignFigures
from brink.plots.style import (
    HAIRLINE,
    INK,
    LABEL_PT,
    MUTED,
    OTHER,
    PAPER,
    SAFE,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    new_figure,
    share_text,
    show_message,
)
from brink.search.analysis.boundary import IndexArray, distinct_boundary
from brink.search.analysis.dependence import AxisMeaning, axis_meanings
from brink.search.analysis.ground import ground_of
from brink.search.analysis.similarity import Plane, embedded, own_plane
from brink.search.space import FloatArray

HEIGHT_PX: Final = 1060
MAP_LEFT_PX, MAP_RIGHT_PX, MAP_TOP_PX, MAP_BOTTOM_PX = 76, 1170, 140, 64
TEXT_LEFT_PX: Final = 1212
KEY_LETTERS: Final = 40
"""Letters of a line of the key, which would otherwise run off the figure."""
GRID_CELLS: Final = 170
"""Number of background cells along the longer side."""
SMOOTHING: Final = 0.02
"""Width of the background's smoothing kernel, as a share of the longer side."""
MAX_NUMBERED: Final = 40
MAX_LISTED: Final = 14

UNKNOWN: Final = "#f1f3f4"
UNKNOWN_LINES: Final = "#d9dde0"
_BACKGROUND = LinearSegmentedColormap.from_list(
    "safe-to-unsafe", ["#9cc8e6", "#cfe3f1", "#ffffff", "#fbe3d0", "#f3b98d"], N=256
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Map:
    """Positions of the solutions and rings on the map, and its axes.

    The rings are around pairs if the campaign searched for them, or around distinct boundary solutions if it searched
    for these; otherwise there are none.
    """

    points: FloatArray
    rings: FloatArray
    explained: float
    meanings: tuple[AxisMeaning | None, AxisMeaning | None]
    near: IndexArray
    distinct: IndexArray
    strict: int
    plane: Plane | None


def figure_embedding(inputs: CampaignFigures) -> Figure:
    """Plot the map of the archive: verdicts as colours, boundary solutions marked, distinct ones or pairs ringed."""
    parts = " + ".join(part.name.replace("_", " ") for part in inputs.space.components)
    if inputs.pairs is None:
        dot = f"complete solution ({parts}), evaluated once"
        result = "distinct solutions on the hazard boundary, between safe and unsafe."
        result = f"\nThe rings are the result: {result}" if inputs.searched_boundary else ""
    else:  # a search for pairs evaluates some solutions again, with other seeds
        dot = f"evaluation of a complete solution ({parts})"
        result = (
            "\nThe rings are the result: pairs of neighbouring solutions, one on either side of the boundary."
        )
    figure = new_figure(
        HEIGHT_PX,
        f"{inputs.title}: map of the search",
        f"Each dot is one {dot}. {_placement(inputs)}{result}",
    )
    axes = figure.add_axes(
        (
            MAP_LEFT_PX / WIDTH_PX,
            MAP_BOTTOM_PX / HEIGHT_PX,
            (MAP_RIGHT_PX - MAP_LEFT_PX) / WIDTH_PX,
            1 - (MAP_TOP_PX + MAP_BOTTOM_PX) / HEIGHT_PX,
        )
    )
    for spine in axes.spines.values():
        spine.set_color(HAIRLINE)
    axes.set_xticks([])
    axes.set_yticks([])
    if len(inputs.archive) == 0:
        show_message(axes, "no solutions evaluated yet")
        return figure
    drawn = _embed(inputs)
    _limit(axes, drawn)
    _draw_background(axes, inputs, drawn)
    _draw_dots(axes, inputs, drawn)
    _draw_rings(axes, drawn)
    _name_axes(axes, drawn)
    _write_key(figure, inputs, drawn)
    return figure


def _placement(inputs: CampaignFigures) -> str:
    if own_plane(inputs.space) is None:
        return "Similar solutions lie close together."
    return "The axes are the two parameters of the problem."


def _embed(inputs: CampaignFigures) -> _Map:
    archive, plane = inputs.archive, own_plane(inputs.space)
    meanings: tuple[AxisMeaning | None, AxisMeaning | None] = None, None
    if plane is not None:
        points, explained = plane.placed(archive.vectors), 1.0
    else:
        embedding = embedded(archive)
        points, explained = np.asarray(embedding.points), embedding.explained
        meanings = axis_meanings(inputs.space, archive.vectors, points)
    distinct = distinct_boundary(archive, inputs.t_b, inputs.d_th)
    near = np.flatnonzero(archive.fitness <= inputs.t_b)
    rings = points[distinct]
    if inputs.pairs is not None:
        sides = np.searchsorted(archive.numbers, np.array(inputs.pairs, dtype=np.int64).reshape(-1, 2))
        rings, near = points[sides].mean(axis=1), near[:0]
    elif not inputs.searched_boundary:
        rings, near, distinct = rings[:0], near[:0], distinct[:0]
    return _Map(
        points=points,
        rings=rings,
        explained=explained,
        meanings=meanings,
        near=near,
        distinct=distinct,
        strict=int(distinct_boundary(archive, inputs.t_b, inputs.d_th, strict=True).size),
        plane=plane,
    )


def _limit(axes: Axes, drawn: _Map) -> None:
    """Set limits that contain the points or the whole plane, with equal scales, and fill the canvas."""
    low, high = drawn.points.min(axis=0), drawn.points.max(axis=0)
    if drawn.plane is not None:
        low, high = np.zeros(2), drawn.plane.extent
    width = (MAP_RIGHT_PX - MAP_LEFT_PX) / (HEIGHT_PX - MAP_TOP_PX - MAP_BOTTOM_PX)
    extent = np.maximum(high - low, 1e-3) * 1.1
    side = max(extent[0] / width, extent[1])
    centre = (low + high) / 2
    axes.set_xlim(centre[0] - side * width / 2, centre[0] + side * width / 2)
    axes.set_ylim(centre[1] - side / 2, centre[1] + side / 2)


def _draw_background(axes: Axes, inputs: CampaignFigures, drawn: _Map) -> None:
    """Colour the background by the unsafe share of nearby neighbourhoods; hatched where too little is known."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    ground = ground_of(
        inputs.archive,
        np.arange(len(inputs.archive)),
        drawn.points,
        low=np.array([left, bottom]),
        high=np.array([right, top]),
        cells=GRID_CELLS,
        width=SMOOTHING * (right - left),
    )
    colours = _BACKGROUND(ground.tint)
    colours[..., 3] = ground.clarity
    image = axes.imshow(
        colours,
        extent=(left, right, bottom, top),
        origin="lower",
        aspect="auto",
        interpolation="bilinear",
        zorder=0,
    )
    if drawn.plane is None:
        _hatch(axes, left, bottom, right - left, top - bottom)
        return
    width, height = drawn.plane.extent.tolist()
    _hatch(axes, 0, 0, width, height)
    image.set_clip_path(
        Rectangle((0, 0), width, height, transform=axes.transData)
    )  # the search space ends here


def _hatch(axes: Axes, left: float, bottom: float, width: float, height: float) -> None:
    """Hatch an area without data."""
    area = Rectangle(
        (left, bottom),
        width,
        height,
        facecolor=UNKNOWN,
        edgecolor=UNKNOWN_LINES,
        hatch="//",
        linewidth=0,
        zorder=-1,
    )
    axes.add_patch(area)


def _draw_dots(axes: Axes, inputs: CampaignFigures, drawn: _Map) -> None:
    archive = inputs.archive
    size = float(np.clip(26_000 / len(archive), 14, 60))
    # In the order of evaluation, so that neither colour always covers the other.
    axes.scatter(
        drawn.points[:, 0],
        drawn.points[:, 1],
        s=size,
        c=_colours(inputs),
        alpha=0.72,
        linewidths=0.4,
        edgecolors=PAPER,
        zorder=2,
        gid="solutions",
    )
    if drawn.near.size:
        near = drawn.points[drawn.near]
        axes.scatter(
            near[:, 0],
            near[:, 1],
            s=size * 1.25,
            facecolors="none",
            edgecolors=INK,
            linewidths=0.8,
            zorder=3,
            gid="near-boundary",
        )


def _colours(inputs: CampaignFigures) -> NDArray[np.str_]:
    """Return the colour of each solution by its verdict, shape ``(n,)``."""
    colours = np.where(inputs.archive.unsafe, UNSAFE, SAFE)
    return colours if inputs.words is None else np.where(inputs.words.others, OTHER, colours)


def _draw_rings(axes: Axes, drawn: _Map) -> None:
    """Ring the distinct boundary solutions or pairs; if there are few, number the rings by rank."""
    rings = drawn.rings
    if not rings.size:
        return
    numbered = len(rings) <= MAX_NUMBERED
    axes.scatter(
        rings[:, 0],
        rings[:, 1],
        s=330 if numbered else 110,
        facecolors=PAPER if numbered else "none",
        edgecolors=PAPER,
        linewidths=4.5,
        zorder=4,
    )
    # Worst first: where rings overlap, the better one is on top.
    for rank in range(len(rings), 0, -1):
        x, y = rings[rank - 1].tolist()
        axes.scatter(
            x,
            y,
            s=330 if numbered else 110,
            facecolors=PAPER if numbered else "none",
            edgecolors=INK,
            linewidths=1.9,
            zorder=5 + 1 / rank,
            gid=f"ring-{rank}",
        )
        if numbered:
            axes.annotate(
                str(rank),
                (x, y),
                ha="center",
                va="center_baseline",
                fontsize=SMALL_PT + 0.5,
                fontweight="bold",
                color=INK,
                zorder=5 + 1 / rank,
            )


def _name_axes(axes: Axes, drawn: _Map) -> None:
    if drawn.plane is not None:
        _show_values(axes, drawn.plane)
        return
    across, up = drawn.meanings
    if across is not None:
        axes.set_xlabel(f"across: {across.text}", fontsize=TICK_PT, color=MUTED, labelpad=8)
    if up is not None:
        axes.set_ylabel(f"up: {up.text}", fontsize=TICK_PT, color=MUTED, labelpad=8)


def _show_values(axes: Axes, plane: Plane) -> None:
    for index, (axis, name) in enumerate(zip((axes.xaxis, axes.yaxis), plane.names, strict=True)):
        ticks = np.linspace(0, plane.extent[index], 5)
        axis.set_ticks(ticks, [f"{plane.value(index, tick):g}" for tick in ticks.tolist()])
        axis.set_tick_params(labelsize=SMALL_PT, labelcolor=MUTED, color=HAIRLINE)
        axis.set_label_text(name, fontsize=TICK_PT, color=MUTED)


def _write_key(figure: Figure, inputs: CampaignFigures, drawn: _Map) -> None:
    dot = {"linestyle": "", "marker": "o", "markersize": 9, "markeredgewidth": 0}
    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none", "markeredgecolor": INK}
    near = f"near the boundary (fitness ≤ {inputs.t_b:g}): {drawn.near.size:,}"
    handles = [
        *(Line2D([], [], color=hue, label=text, **dot) for hue, text in _verdict_keys(inputs)),  # type: ignore[arg-type]
        *(
            [Line2D([], [], markersize=9, markeredgewidth=1.0, label=near, **hollow)]  # type: ignore[arg-type]
            if inputs.pairs is None and inputs.searched_boundary
            else []
        ),
        *(
            [Line2D([], [], markersize=14, markeredgewidth=2.0, label=_ring_text(inputs, drawn), **hollow)]  # type: ignore[arg-type]
            if inputs.searched_boundary
            else []
        ),
    ]
    extra_px = 30 * (len(handles) - 4) + 18 * sum("\n" in text for _, text in _verdict_keys(inputs))
    top = 1 - MAP_TOP_PX / HEIGHT_PX
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(TEXT_LEFT_PX / WIDTH_PX - 0.008, top + 0.008),
        frameon=False,
        fontsize=LABEL_PT,
        labelcolor=INK,
        labelspacing=0.9,
        handletextpad=0.7,
        borderaxespad=0,
        borderpad=0.3,
    )
    _draw_tint_key(figure, inputs, 1 - (MAP_TOP_PX + 218 + extra_px) / HEIGHT_PX)
    _list_rings(figure, inputs, drawn, 1 - (MAP_TOP_PX + 330 + extra_px) / HEIGHT_PX)
    figure.text(
        TEXT_LEFT_PX / WIDTH_PX,
        MAP_BOTTOM_PX / HEIGHT_PX,
        "The map shows the problem's own coordinates."
        if drawn.plane is not None
        else "Distances on the map follow those between solutions.\n"
        f"Its two dimensions explain {drawn.explained:.0%} of the variance.",
        fontsize=SMALL_PT,
        color=MUTED,
        va="bottom",
        linespacing=1.5,
    )


def _verdict_keys(inputs: CampaignFigures) -> list[tuple[str, str]]:
    """Return colour and words of each kind of solution, with its number."""
    archive, words = inputs.archive, inputs.words
    unsafe = int(archive.unsafe.sum())
    share = share_text(unsafe / len(archive))
    if words is None:
        return [(SAFE, f"safe: {len(archive) - unsafe:,}"), (UNSAFE, f"unsafe: {unsafe:,} ({share})")]
    others = int(words.others.sum())
    keys = [(SAFE, f"{words.held}: {len(archive) - unsafe - others:,}")]
    if others:
        broken = words.other.replace(", another", ",\nanother")
        keys.append((OTHER, f"{broken}: {others:,}"))
    keys.append((UNSAFE, f"{words.violated}: {unsafe:,} ({share})"))
    return [(hue, textwrap.fill(text, KEY_LETTERS) if "\n" not in text else text) for hue, text in keys]


def _ring_text(inputs: CampaignFigures, drawn: _Map) -> str:
    if inputs.too_many_pairs:
        return "distinct pairs: too many to mark"
    if inputs.pairs is not None:
        return f"distinct pairs: {len(inputs.pairs):,}" if inputs.pairs else "distinct pairs: none"
    if drawn.distinct.size == 0:
        return "distinct boundary solutions: none yet"
    return (
        f"distinct boundary solutions: {drawn.distinct.size:,}\n"
        f"(at least {inputs.d_th:g} apart; strict: {drawn.strict:,})"
    )


def _draw_tint_key(figure: Figure, inputs: CampaignFigures, top: float) -> None:
    p_th = inputs.archive.neighbourhood.p_th
    width, height = 300 / WIDTH_PX, 14 / HEIGHT_PX
    left = TEXT_LEFT_PX / WIDTH_PX
    figure.text(
        left, top, "background: unsafe share of neighbours", fontsize=LABEL_PT, color=INK, va="bottom"
    )
    axes = figure.add_axes((left, top - 26 / HEIGHT_PX, width, height))
    axes.imshow(_BACKGROUND(np.linspace(0, 1, 256))[None], aspect="auto", extent=(0, 1, 0, 1))
    axes.set_yticks([])
    middle = f"p_th = {p_th:g}" if inputs.pairs is None and inputs.searched_boundary else f"{p_th:g}"
    axes.set_xticks([0, 0.5, 1], ["0", middle, "1"], fontsize=SMALL_PT, color=MUTED)
    axes.tick_params(length=0, pad=5)
    for spine in axes.spines.values():
        spine.set_color(HAIRLINE)
    unknown = figure.add_axes((left, top - 66 / HEIGHT_PX, 28 / WIDTH_PX, height))
    unknown.set_xticks([])
    unknown.set_yticks([])
    for spine in unknown.spines.values():
        spine.set_color(HAIRLINE)
    _hatch(unknown, 0, 0, 1, 1)
    figure.text(
        left + 38 / WIDTH_PX,
        top - 59 / HEIGHT_PX,
        "too few simulations nearby",
        fontsize=SMALL_PT,
        color=MUTED,
        va="center",
    )


def _list_rings(figure: Figure, inputs: CampaignFigures, drawn: _Map, top: float) -> None:
    """List the first rings: the solutions in each, and the neighbourhoods of boundary solutions."""
    if not drawn.rings.size:
        return
    if inputs.pairs is not None:
        columns = [(0, "pair"), (58, "safe side"), (150, "unsafe side")]
        rows = _pair_rows(inputs)
    else:
        columns = [(0, "ring"), (58, "solution"), (150, "unsafe neighbours"), (330, "fitness")]
        rows = _boundary_rows(inputs, drawn)
    line = 21 / HEIGHT_PX
    for x, word in columns:
        figure.text((TEXT_LEFT_PX + x) / WIDTH_PX, top, word, fontsize=SMALL_PT, color=MUTED, va="top")
    # A single further one takes as much room as saying that there is one.
    listed = len(rows) if len(rows) <= MAX_LISTED + 1 else MAX_LISTED
    for row, cells in enumerate(rows[:listed], start=1):
        for index, ((x, _), (cell, colour)) in enumerate(
            zip(columns, [(f"{row}", INK), *cells], strict=True)
        ):
            figure.text(
                (TEXT_LEFT_PX + x) / WIDTH_PX,
                top - row * line - 4 / HEIGHT_PX,
                cell,
                fontsize=TICK_PT,
                va="top",
                color=colour,
                fontweight="bold" if index == 0 else "normal",
            )
    more = len(rows) - listed
    if more:
        figure.text(
            TEXT_LEFT_PX / WIDTH_PX,
            top - (MAX_LISTED + 1) * line - 6 / HEIGHT_PX,
            f"and {more:,} more",
            fontsize=SMALL_PT,
            color=MUTED,
            va="top",
        )


def _pair_rows(inputs: CampaignFigures) -> list[list[tuple[str, str]]]:
    """Return the numbers of both sides of each pair, each with its colour."""
    hues = dict(zip(inputs.archive.numbers.tolist(), _colours(inputs).tolist(), strict=True))
    return [[(f"{number}", hues[number]) for number in pair] for pair in inputs.pairs or ()]


def _boundary_rows(inputs: CampaignFigures, drawn: _Map) -> list[list[tuple[str, str]]]:
    """Return number, unsafe neighbours and fitness of each distinct boundary solution, each with its colour."""
    archive, hues = inputs.archive, _colours(inputs)
    rows = []
    for position in drawn.distinct.tolist():
        unsafe, all_of_them = int(archive.unsafe_neighbours[position]), int(archive.neighbours[position])
        rows.append(
            [
                (f"{archive.numbers[position]}", str(hues[position])),
                (f"{unsafe} of {all_of_them} ({share_text(unsafe / all_of_them)})", INK),
                (f"{archive.fitness[position]:.3f}", INK),
            ]
        )
    return rows
