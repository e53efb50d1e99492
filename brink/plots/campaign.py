"""Figures of a campaign: boundary solutions, fitness, parameters, Pareto fronts; and writing them to files."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from brink.plots.embedding import figure_embedding
from brink.plots.inputs import CampaignFigures
from brink.plots.style import (
    DPI,
    INK,
    LABEL_PT,
    MUTED,
    SAFE,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    EndLabel,
    label_ends,
    new_figure,
    set_panel_title,
    share_text,
    show_message,
    show_percent,
    style_axes,
)
from brink.search.algorithms.multi_objective import History, MultiObjectiveConfig, diversities
from brink.search.analysis.boundary import BudgetPoint, dbs_by_budget
from brink.search.analysis.dependence import FEWEST_IN_BIN, Dependence, ParameterColumn, dependences
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS
from brink.search.archive import Archive
from brink.search.pareto import first_front
from brink.search.space import Categorical, FloatArray, IntArray, SearchSpace
from brink.search.traffic.variation import TrafficGenome

FRACTIONS: Final = tuple(np.round(np.arange(0.05, 1.001, 0.05), 2).tolist())
T_B_COLOURS: Final = ("#a6cbe3", "#6fb0d6", "#3a93c4", "#0072b2", "#00527f", "#10304a")
"""From the strictest t_b to the loosest, in equal steps of lightness."""
DBS_HEIGHT_PX: Final = 620


def figure_dbs(inputs: CampaignFigures) -> Figure:
    """Plot distinct boundary solutions against simulations: a panel per d_th, a line per t_b, strict DBS dashed."""
    archive = inputs.archive
    p_th = archive.neighbourhood.p_th
    figure = new_figure(
        DBS_HEIGHT_PX,
        f"{inputs.title}: distinct boundary solutions",
        "Number of solutions within t_b of the hazard boundary and at least d_th apart, after each share of the "
        "simulations, scored with the results known at that time.\n"
        f"Dashed: strict DBS, where the interval contains p_th = {p_th:g} and the neighbours have both verdicts.",
    )
    points = list(dbs_by_budget(archive, int(archive.numbers[-1]) + 1, FRACTIONS)) if len(archive) else []
    grid = figure.add_gridspec(
        1, len(PAPER_D_THS), left=88 / WIDTH_PX, right=1 - 96 / WIDTH_PX, top=0.755, bottom=0.115, wspace=0.34
    )
    for column, d_th in enumerate(PAPER_D_THS):
        axes = figure.add_subplot(grid[column])
        set_panel_title(axes, f"at least {d_th:g} apart")
        _plot_dbs(axes, points, column)
        axes.set_xlabel("simulations")
        if column == 0:
            axes.set_ylabel("distinct boundary solutions")
        style_axes(axes)
    keys = [
        Line2D([], [], color=T_B_COLOURS[3], linewidth=2.2, label="DBS"),
        Line2D([], [], color=T_B_COLOURS[3], linewidth=1.5, linestyle=(0, (4, 2)), label="strict DBS"),
    ]
    figure.legend(
        handles=keys,
        loc="upper right",
        bbox_to_anchor=(1 - 64 / WIDTH_PX, 1 - 16 / DBS_HEIGHT_PX),
        ncols=2,
        frameon=False,
        fontsize=LABEL_PT,
        labelcolor=INK,
        handlelength=2.6,
    )
    return figure


def _plot_dbs(axes: Axes, points: list[BudgetPoint], column: int) -> None:
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    if not points:
        axes.set_ylim(0, 1)
        show_message(axes, "no solutions evaluated yet")
        return
    simulations = [0, *(point.simulations for point in points)]
    highest = 0
    for row, colour in enumerate(T_B_COLOURS):
        plain = [0, *(int(point.grid.dbs[row, column]) for point in points)]
        strict = [0, *(int(point.grid.strict[row, column]) for point in points)]
        t_b = PAPER_T_BS[row]
        axes.plot(simulations, plain, color=colour, linewidth=2.2, label=f"t_b {t_b:g}", clip_on=False)
        axes.plot(
            simulations, strict, color=colour, linewidth=1.5, linestyle=(0, (4, 2)), label=f"strict {t_b:g}"
        )
        highest = max(highest, *plain)
    axes.set_xlim(0, simulations[-1])
    axes.set_ylim(0, max(highest * 1.06, 1))
    last = points[-1].grid.dbs[:, column].tolist()
    label_ends(
        axes,
        [
            EndLabel(count, f"{t_b:.2f}: {count}", colour)
            for count, t_b, colour in zip(last, PAPER_T_BS, T_B_COLOURS, strict=True)
        ],
    )
    axes.annotate(
        "t_b: DBS",
        (1, 1),
        xycoords="axes fraction",
        xytext=(8, 9),
        textcoords="offset points",
        va="bottom",
        fontsize=SMALL_PT,
        color=MUTED,
    )
    if highest == 0:
        show_message(axes, "none: no neighbourhood is near\nthe boundary at any t_b up to 0.2")


FITNESS_HEIGHT_PX: Final = 760


def figure_fitness(inputs: CampaignFigures) -> Figure:
    """Plot the fitness over generations (best, median, middle half of the archive) and the unsafe share."""
    figure = new_figure(
        FITNESS_HEIGHT_PX,
        f"{inputs.title}: progress of the search",
        "Fitness: distance of the 95% interval of the unsafe share around a solution from "
        f"p_th = {inputs.archive.neighbourhood.p_th:g}; 0 is on the boundary.\n"
        "All solutions are scored again after each generation, with the results known at that time.",
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
            show_message(axes, "no generation finished yet")
    lower.set_xlabel("solutions in the archive (one mark per generation)")
    lower.xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True))
    upper.set_ylabel("fitness")
    lower.set_ylabel("unsafe")
    for axes in (upper, lower):
        style_axes(axes)
    upper.tick_params(labelbottom=False)
    return figure


def _plot_fitness(axes: Axes, inputs: CampaignFigures, ends: IntArray) -> None:
    archives = (archive for archive in _archives_by_generation(inputs) if len(archive))
    quantiles = np.array([np.quantile(archive.fitness, (0, 0.25, 0.5, 0.75)) for archive in archives])
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
    sizes = np.clip(new, 8, 60)
    axes.scatter(ends, share, s=sizes, color=UNSAFE, alpha=0.45, linewidths=0, label="new in the generation")
    axes.plot(ends, so_far, color=UNSAFE, linewidth=2.2, label="so far")
    p_th = inputs.archive.neighbourhood.p_th
    axes.axhline(p_th, color=MUTED, linewidth=1.1, linestyle=(0, (4, 3)))
    axes.set_ylim(0, min(1.02, max(float(share.max()) * 1.12, p_th * 1.6)))
    show_percent(axes.yaxis)
    label_ends(
        axes,
        [
            EndLabel(float(so_far[-1]), f"so far {share_text(float(so_far[-1]))}", UNSAFE),
            EndLabel(p_th, f"p_th = {p_th:g}", MUTED),
        ],
        apart=0.1,
    )
    axes.annotate(
        "dots: the new solutions of each generation",
        (0.995, 0.97),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=SMALL_PT,
        color=UNSAFE,
        alpha=0.9,
    )


def _archives_by_generation(inputs: CampaignFigures) -> Iterator[Archive]:
    """Yield the archive after each generation, scored with the results known at that time."""
    archive = inputs.archive
    known = Archive.empty(archive.metric, archive.neighbourhood)
    for end in inputs.generation_ends:
        part = slice(len(known), end)
        known = known.grown(
            archive.numbers[part],
            archive.vectors[part],
            archive.unsafe[part],
            archive.robustness[part],
            keep_rows=False,
        )
        yield known


PARAMETER_COLUMNS: Final = 5
PARAMETER_PX: Final = 250
_TOP_PX, _BOTTOM_PX = 150, 44


def figure_parameters(inputs: CampaignFigures) -> Figure:
    """Plot the unsafe share by each parameter's values (categories or equal-sized bins), strongest dependence first.

    Values of inactive parameters are left out. A search does not sample at random, so the figure shows where unsafe
    solutions were found, not why.
    """
    found = dependences(inputs.space, inputs.archive, inputs.active)
    rows = -(-len(found) // PARAMETER_COLUMNS)
    height_px = _TOP_PX + _BOTTOM_PX + rows * PARAMETER_PX
    archive = inputs.archive
    overall = float(archive.unsafe.mean()) if len(archive) else float("nan")
    figure = new_figure(
        height_px,
        f"{inputs.title}: unsafe share by parameter",
        "Share of unsafe solutions by value; numbers in bins of equal size, without those that were inactive "
        f"in their drive. Hollow: fewer than {FEWEST_IN_BIN} solutions. Line: overall share, {share_text(overall)}.\n"
        "Strongest dependence first (Cramér's V). A search does not sample evenly, and its solutions descend from "
        "each other: this shows where unsafe solutions were found, not why.",
    )
    ceiling = _ceiling(found, overall)
    for index, dependence in enumerate(found):
        row, column = divmod(index, PARAMETER_COLUMNS)
        width = (WIDTH_PX - 84 - 36) / PARAMETER_COLUMNS
        axes = figure.add_axes(
            (
                (84 + column * width) / WIDTH_PX,
                1 - (_TOP_PX + (row + 1) * PARAMETER_PX - 76) / height_px,
                (width - 34) / WIDTH_PX,
                (PARAMETER_PX - 116) / height_px,
            )
        )
        _plot_parameter(axes, dependence, overall, ceiling)
        axes.tick_params(labelleft=column == 0)
    return figure


def _ceiling(found: list[Dependence], overall: float) -> float:
    """Return the upper limit of the panels' y axes: the highest share, rounded up, ignoring tiny groups."""
    highest = 0.0 if np.isnan(overall) else overall
    for dependence in found:
        large = dependence.counts >= FEWEST_IN_BIN
        if large.any():
            highest = max(highest, float((dependence.unsafe[large] / dependence.counts[large]).max()))
    return min(1.0, max(0.1, float(np.ceil(highest * 10) / 10)))


def _plot_parameter(axes: Axes, dependence: Dependence, overall: float, ceiling: float) -> None:
    column, filled = dependence.column, dependence.counts > 0
    if not np.isnan(overall):
        axes.axhline(overall, color=INK, linewidth=0.9, alpha=0.55)
    if filled.any():
        places, counts = dependence.places[filled], dependence.counts[filled]
        shares = dependence.unsafe[filled] / counts
        axes.plot(
            places,
            shares,
            color=UNSAFE,
            marker="o",
            markersize=5.5,
            linewidth=0 if dependence.labels else 1.2,
            gid="share",
        )
        few = counts < FEWEST_IN_BIN
        axes.plot(
            places[few],
            shares[few],
            color=UNSAFE,
            marker="o",
            markersize=5.5,
            markerfacecolor="white",
            linewidth=0,
        )
    else:
        show_message(axes, "inactive in all\nsolutions so far")
    axes.set_ylim(-0.02 * ceiling, ceiling)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
    show_percent(axes.yaxis)
    style_axes(axes)
    _name_parameter(axes, column, dependence)
    _set_ticks(axes, column, dependence)


def _name_parameter(axes: Axes, column: ParameterColumn, dependence: Dependence) -> None:
    unit = "" if isinstance(column.parameter, Categorical) else column.parameter.unit
    parameter = column.parameter
    name = parameter.title or parameter.name.replace("_", " ").replace(".", ": ").removesuffix(f" {unit}")
    facts = [unit, f"V = {dependence.strength:.2f}", f"n = {int(dependence.counts.sum()):,}"]
    # There is room for about forty characters; a long unit is more important than the component.
    if not parameter.title and len("".join([column.component, *facts])) < 34:
        facts.insert(0, column.component)
    axes.text(
        0, 1.25, name, transform=axes.transAxes, fontsize=TICK_PT, fontweight="bold", color=INK, va="bottom"
    )
    axes.text(
        0,
        1.07,
        "   ".join(filter(None, facts)),
        transform=axes.transAxes,
        fontsize=SMALL_PT - 0.5,
        color=MUTED,
        va="bottom",
    )


def _set_ticks(axes: Axes, column: ParameterColumn, dependence: Dependence) -> None:
    if dependence.labels:
        axes.set_xlim(dependence.places[0] - 0.6, dependence.places[-1] + 0.6)
        axes.xaxis.set_minor_locator(NullLocator())
        long = sum(map(len, dependence.labels)) > 26 or len(dependence.labels) > 8
        axes.xaxis.set_major_locator(FixedLocator(dependence.places.tolist()))
        axes.set_xticklabels(
            [label if len(label) <= 14 else label[:13] + "…" for label in dependence.labels],
            rotation=28 if long else 0,
            ha="right" if long else "center",
            rotation_mode="anchor",
        )
        axes.tick_params(axis="x", labelsize=SMALL_PT - 0.5, length=3)
    elif not isinstance(column.parameter, Categorical):
        low, high = column.parameter.low, column.parameter.high
        if column.parameter.log:
            axes.set_xscale("log")
            axes.set_xlim(low * (low / high) ** 0.03, high * (high / low) ** 0.03)
        else:
            axes.set_xlim(low - 0.03 * (high - low), high + 0.03 * (high - low))
            axes.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 4, 5, 10]))
        axes.tick_params(axis="x", labelsize=SMALL_PT - 0.5, length=3)


FRONTS_HEIGHT_PX: Final = 760
FRONTS_SHOWN: Final = 5
"""Number of fronts drawn, including the first and the last."""

_FRONT_SHADES: Final = ("#c6dbef", "#9ecae1", "#6baed6", "#2171b5", "#08306b")


def figure_fronts(
    title: str,
    space: SearchSpace,
    vectors: FloatArray,
    ends: Sequence[int],
    criticality: FloatArray,
    config: MultiObjectiveConfig,
    *,
    by_gap: bool = True,
    unavoidable: float = np.inf,
) -> Figure:
    """Plot the Pareto fronts of criticality and diversity after some of the generations.

    Args:
        title: Name of the campaign.
        space: The search space, which has participants.
        vectors: Solutions of the archive in ascending order of number, shape ``(n, d)``.
        ends: Size of the archive after each generation.
        criticality: Criticality, shape ``(n,)``.
        config: Settings of the algorithm.
        by_gap: Whether criticality is the smallest gap to a road user, not the robustness.
        unavoidable: Criticality of solutions whose violations do not count; these are left out.
    """
    shown = criticality < unavoidable
    hidden = int(np.count_nonzero(~shown))
    figure = new_figure(
        FRONTS_HEIGHT_PX,
        f"{title}: criticality and diversity",
        "Each line is the Pareto front of all solutions known after a generation: no other solution is closer to a\n"
        "violation and also farther from the solutions of earlier generations. Left of 0, "
        f"{'a collision occurs' if by_gap else 'it is violated'}."
        + (
            f" Without the {hidden:,} whose violations a careful driver could not have avoided."
            if hidden
            else ""
        ),
    )
    axes = figure.add_subplot()
    figure.subplots_adjust(left=100 / WIDTH_PX, right=1 - 60 / WIDTH_PX, top=0.82, bottom=0.1)
    style_axes(axes)
    measure = "smallest gap to a road user (m)" if by_gap else "robustness of the requirement"
    axes.set_xlabel(f"criticality: {measure}")
    axes.set_ylabel("diversity: distance to recent solutions (m)")
    known = [end for end in ends if end > 0]
    if not known:
        show_message(axes, "no generation finished yet")
        return figure
    diversity = recorded_diversities(space, vectors, ends, config)
    axes.scatter(criticality[shown], diversity[shown], s=9, color=MUTED, alpha=0.25, linewidths=0)
    axes.axvline(0.0, color=UNSAFE, linewidth=1)
    chosen = np.unique(np.linspace(0, len(known) - 1, FRONTS_SHOWN).round().astype(int)).tolist()
    for place, shade in zip(chosen, _FRONT_SHADES[-len(chosen) :], strict=True):
        end = known[place]
        rows = np.flatnonzero(shown[:end])
        front = rows[first_front(criticality[rows], -diversity[rows])]
        axes.plot(
            criticality[front],
            diversity[front],
            "o-",
            color=shade,
            markersize=4,
            linewidth=1.6,
            label=f"{end} solutions",
        )
    axes.legend(frameon=False, title="known")
    return figure


def recorded_diversities(
    space: SearchSpace, vectors: FloatArray, ends: Sequence[int], config: MultiObjectiveConfig
) -> FloatArray:
    """Return each solution's distance to the solutions that were recent when it was evaluated.

    Args:
        space: The search space, which has participants.
        vectors: Solutions in ascending order of number, shape ``(n, d)``.
        ends: Number of solutions after each generation.
        config: Settings of the algorithm.

    Returns:
        Distances in m, shape ``(n,)``.
    """
    genome = TrafficGenome.of(space)
    generations = np.searchsorted(ends, np.arange(len(vectors)), side="right").astype(np.float64)
    found = np.zeros(len(vectors))
    start = 0
    for end in ends:
        numbers = list(range(start, end))
        if numbers:
            none = np.zeros(end)
            book = History(
                rows=vectors[:end],
                criticality=none,
                gaps=np.zeros((end, genome.max_participants)),
                unsafe=none,
                generations=generations[:end],
                origins=none,
            )
            found[numbers] = diversities(genome, book, numbers, config)
        start = end
    return found


FIGURES: Final[Mapping[str, Callable[[CampaignFigures], Figure]]] = {
    "map": figure_embedding,
    "dbs": figure_dbs,
    "fitness": figure_fitness,
    "parameters": figure_parameters,
}
"""The figures by the stems of their file names."""
_OF_THE_BOUNDARY: Final = frozenset({"dbs", "fitness"})

FORMATS: Final = ("png", "svg")
# No date and no software version: the same campaign gives the same files.
_METADATA: Final[Mapping[str, dict[str, Any]]] = {"png": {"Software": None}, "svg": {"Date": None}}


def write_campaign_figures(
    inputs: CampaignFigures,
    folder: Path,
    formats: Sequence[str] = ("png",),
    *,
    only: Collection[str] = FIGURES.keys(),
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write the figures of a campaign to a folder, creating it if needed and replacing existing files.

    Figures of boundary solutions are left out if the search was for anything else, such as pairs.

    Args:
        inputs: The campaign.
        folder: The folder.
        formats: ``png``, ``svg`` or both.
        only: Which figures to write, of those in `FIGURES`.
        on_progress: Called with the number of figures written so far, and of all.

    Returns:
        The files, in the order of `FIGURES`, then of the formats.

    Raises:
        ValueError: A format is unknown.
        OSError: A file cannot be written.
    """
    for name in formats:
        if name not in FORMATS:
            raise ValueError(f"formats: expected some of {', '.join(FORMATS)}; got {name!r}")
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    about_boundary = inputs.searched_boundary and inputs.pairs is None
    left_out = frozenset() if about_boundary else _OF_THE_BOUNDARY
    stems = [stem for stem in FIGURES if stem in only and stem not in left_out]
    for done, stem in enumerate(stems):
        if on_progress is not None:
            on_progress(done, len(stems))
        figure = FIGURES[stem](inputs)
        for extension in formats:
            path = folder / f"{stem}.{extension}"
            figure.savefig(path, format=extension, dpi=DPI, metadata=_METADATA[extension])
            files.append(path)
    return files
