"""Thresholds driven again: many simulations along the unit, beside the estimate of the run.

The places are spread evenly from well before the 20% point to well beyond the 80% point, as far as the line was
estimated, each with a fresh seed. The 50% point is where their isotonic regression passes one half, which assumes
nothing but that the probability rises.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.table import Table
from scipy.optimize import isotonic_regression

from benchmarks.finder_runs import Estimated
from benchmarks.finders import Found, runner_of
from benchmarks.measurement import Progress
from benchmarks.trials import stored
from brink.api.terminal import plain_table
from brink.plots.style import (
    DPI,
    HAIRLINE,
    INK,
    MARGIN_PX,
    SAFE,
    SMALL_PT,
    TICK_PT,
    UNSAFE,
    WIDTH_PX,
    add_legend,
    new_figure,
    show_percent,
    style_axes,
)
from brink.search.algorithm import Scored
from brink.server.findings.thresholds.words import Amounts

DRIVES: Final = 200
"""Simulations along a unit."""
_BEYOND: Final = 2.0
"""How far they go beyond the 20 and the 80% point, in stretches."""
_BINS: Final = 20
_FIRST: Final = 10**7
"""Number of the first fresh simulation; see `Runner.fresh`."""
_COLUMNS: Final = 3
_TITLE: Final = 66
"""Characters of a panel's title."""
_ROW_PX, _TOP_PX, _BOTTOM_PX = 330, 190, 70


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """A threshold and its simulations along the unit.

    Attributes:
        found: The run that found it.
        one: The threshold.
        values: Values of the number, ascending.
        unsafe: Their verdicts.
    """

    found: Found
    one: Estimated
    values: list[float]
    unsafe: list[bool]

    @property
    def middle(self) -> float:
        """Where the isotonic regression of the verdicts passes one half; NaN if it does not."""
        rises = self.one.end >= self.one.start
        fitted = isotonic_regression(np.array(self.unsafe, np.float64), increasing=rises).x
        above = np.flatnonzero((fitted >= 0.5) if rises else (fitted < 0.5))
        if not above.size or above[0] == 0:
            return math.nan
        return 0.5 * (self.values[int(above[0]) - 1] + self.values[int(above[0])])

    @property
    def is_inside(self) -> bool:
        """Whether this point lies within the interval of the estimate."""
        return min(self.one.low, self.one.high) <= self.middle <= max(self.one.low, self.one.high)

    @property
    def amounts(self) -> Amounts:
        """The values in the unit that people use."""
        problem = runner_of(self.found.task.problem).problem
        return Amounts.of(problem, self.one.leading, np.array(self.one.row), self.one.resolution)


def driven(found: Sequence[Found], count: int, folder: Path, progress: Progress) -> list[Driven]:
    """Drive thresholds again, evenly chosen among those of all runs.

    Args:
        found: Runs of one method.
        count: Number of thresholds.
        folder: Folder for the simulations, which are kept.
        progress: Progress callback.
    """
    all_ = [(run, place) for run in found for place in range(len(run.thresholds))]
    chosen = [
        all_[at] for at in np.unique(np.linspace(0, len(all_) - 1, min(count, len(all_))).round().astype(int))
    ]
    made = []
    for done, (run, place) in enumerate(chosen):
        progress("curves", done, len(chosen))
        name = f"curve-{run.task.file.name.removesuffix('.json.gz')}-{place}.json.gz"
        kept = stored(folder / run.task.folder.name / name, partial(_drives, run, place))
        made.append(
            Driven(found=run, one=run.thresholds[place], values=kept["values"], unsafe=kept["unsafe"])
        )
    progress("curves", len(chosen), len(chosen))
    return made


def places_of(one: Estimated) -> list[float]:
    """Return the values at which a threshold is driven again, all on the line that was estimated.

    Further on, drives may be safe again, which would be another threshold.
    """
    width = _BEYOND * max(abs(one.end - one.start), 2.0 * one.resolution)
    low, high = min(one.start, one.end) - width, max(one.start, one.end) + width
    line = one.curve[0]
    return [float(value) for value in np.linspace(max(low, min(line)), min(high, max(line)), DRIVES)]


def _drives(run: Found, place: int) -> dict[str, list[float] | list[bool]]:
    """Simulate along the unit of a threshold of a run."""
    runner, one = runner_of(run.task.problem), run.thresholds[place]
    space = runner.problem.space
    values: list[float] = []
    unsafe: list[bool] = []
    for number, value in enumerate(places_of(one), start=_FIRST + place * DRIVES):
        row = one.at(space, value)
        if row is None:
            continue
        ((evaluation, _),) = runner.fresh(row, run.task.seed, number, 1)
        if isinstance(evaluation, Scored):
            values.append(float(row[one.leading]))
            unsafe.append(evaluation.unsafe)
    return {"values": values, "unsafe": unsafe}


def curves_table(curves: Sequence[Driven]) -> Table:
    """Return the estimates beside what the simulations along the unit show."""
    inside = sum(one.is_inside for one in curves)
    shown = plain_table(
        "",
        "number",
        "estimated 50% point",
        f"of {DRIVES} simulations",
        "",
        right=["estimated 50% point", f"of {DRIVES} simulations"],
        title=f"{inside} of {len(curves)} driven 50% points within the 90% interval of the estimate",
    )
    for place, one in enumerate(curves, start=1):
        amounts = one.amounts
        point = "none" if math.isnan(one.middle) else amounts.words(one.middle)
        shown.add_row(
            str(place),
            f"seed {one.found.task.seed}: {' / '.join(one.one.kind)}",
            f"{amounts.words(one.one.middle)} {amounts.interval(one.one.low, one.one.high)}",
            point,
            "inside" if one.is_inside else "outside",
        )
    return shown


def curves_document(curves: Sequence[Driven]) -> list[dict[str, object]]:
    """Return the same as a document; values are those of the parameter."""
    return [
        {
            "seed": one.found.task.seed,
            "kind": one.one.kind,
            "middle": one.one.middle,
            "low": one.one.low,
            "high": one.one.high,
            "driven": None if math.isnan(one.middle) else one.middle,
            "inside": one.is_inside,
        }
        for one in curves
    ]


def draw_curves(curves: Sequence[Driven], title: str, file: Path) -> None:
    """Draw the estimates and the shares of the simulations along the unit."""
    figure_curves(curves, title).savefig(file, dpi=DPI, metadata={"Software": None})


def figure_curves(curves: Sequence[Driven], title: str) -> Figure:
    """Plot the estimates and the shares of the simulations along the unit, a panel for each threshold."""
    rows = max(1, math.ceil(len(curves) / _COLUMNS))
    height_px = _TOP_PX + rows * _ROW_PX + _BOTTOM_PX
    figure = new_figure(
        height_px,
        title,
        f"{DRIVES} simulations along each unit, with fresh seeds, beside the estimate of the search.",
    )
    grid = figure.add_gridspec(
        rows,
        _COLUMNS,
        left=(MARGIN_PX + 20) / WIDTH_PX,
        right=1 - 40 / WIDTH_PX,
        top=1 - _TOP_PX / height_px,
        bottom=_BOTTOM_PX / height_px,
        hspace=0.5,
        wspace=0.16,
    )
    for place, one in enumerate(curves):
        _panel(figure, grid[place // _COLUMNS, place % _COLUMNS], one, place + 1)
    add_legend(
        figure,
        [
            Line2D([], [], color=UNSAFE, linewidth=2, label="estimate, with its 90% interval"),
            Line2D([], [], color=INK, linewidth=1.8, label="50% point, 90% interval"),
            Line2D([], [], color=SAFE, marker="o", linewidth=0, label="unsafe share of ten simulations"),
            Line2D([], [], color=SAFE, linewidth=1.2, linestyle="--", label="their 50% point"),
        ],
        100,
    )
    return figure


def _panel(figure: Figure, place: object, one: Driven, number: int) -> None:
    axes, amounts = figure.add_subplot(place), one.amounts  # type: ignore[call-overload]
    style_axes(axes)

    def amount(values: object) -> np.ndarray:
        return np.asarray(amounts.at_0 + np.asarray(values, np.float64) * amounts.per_1)

    values, median, low, high = one.one.curve
    axes.fill_between(amount(values), low, high, color=UNSAFE, alpha=0.14, linewidth=0)
    axes.plot(amount(values), median, color=UNSAFE, linewidth=2)
    axes.axhline(0.5, color=HAIRLINE, linewidth=0.8)
    axes.plot(amount([one.one.low, one.one.high]), [0.5, 0.5], color=INK, linewidth=1.8)
    axes.plot(amount([one.one.middle]), [0.5], "o", color=INK, markersize=5)
    bins = np.array_split(np.arange(len(one.values)), _BINS)
    centres = [float(np.mean(np.array(one.values)[part])) for part in bins if part.size]
    shares = [float(np.mean(np.array(one.unsafe)[part])) for part in bins if part.size]
    axes.plot(amount(centres), shares, "o", color=SAFE, markersize=5)
    if not math.isnan(one.middle):
        axes.axvline(float(amount(one.middle)), color=SAFE, linewidth=1.2, linestyle="--")
    ends = amount([one.values[0], one.values[-1]])
    axes.set_xlim(float(ends.min()), float(ends.max()))
    axes.set_ylim(-0.06, 1.06)
    show_percent(axes.yaxis)
    axes.tick_params(labelsize=TICK_PT - 1)
    axes.set_xlabel(amounts.unit, fontsize=SMALL_PT)
    state = "inside" if one.is_inside else "outside"
    title = textwrap.shorten(f"{number}. {state}: {' / '.join(one.one.kind)}", _TITLE, placeholder=" …")
    axes.set_title(title, fontsize=SMALL_PT, loc="left", color=INK)
