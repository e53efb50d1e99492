"""The study of heredity: what selection contributes to a search by MLCSHE, at several mutation rates.

An experiment runs every search twice: with selection, and with otherwise equal settings without it, where parents and
population archives are drawn at random. With the paper's mutation probability of 1, scenarios inherit nothing, so a
lead over that twin is due to archives and boxes; what inheriting adds is how much larger the lead is at lower rates.
All have behaviour-blind controls, and each method is compared with its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from brink.plots.experiment import interval_limits
from brink.plots.style import INK, MUTED, SAFE, SMALL_PT, add_panels, new_figure, set_panel_title, style_axes
from brink.report.experiment import NAMES
from brink.report.text import interval_text, p_text
from brink.search.analysis.comparison import (
    Duel,
    Line,
    Repeat,
    compared_lines,
    lines_of,
    values_of,
    with_low_controls,
)
from brink.search.analysis.paper import LEVEL, Measure
from brink.search.analysis.scores import Figures
from brink.search.analysis.statistics import MeanInterval, mean_interval
from brink.server.errors import InvalidInput
from brink.server.experiments.body import ExperimentBody, Method, parse_experiment

T_BS: Final = (0.05, 0.10, 0.15)
D_TH: Final = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Twins:
    """Two methods of the study that differ in selection alone.

    Attributes:
        method: Name of the one with selection.
        twin: Name of the one without.
    """

    method: str
    twin: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Heredity:
    """The study, from the campaigns that have finished.

    Attributes:
        twins: Its methods, the first mutation rate first.
        values: The measure of each campaign of a line, by line, measure and t_b.
        effects: Every method against its twin, then every rate against the first, for each measure and t_b.
        against_controls: Every method against its own control, for each measure and t_b; empty without controls.
            Methods whose control reads low are left out, because such a comparison proves nothing.
    """

    twins: Sequence[Twins]
    values: dict[tuple[Line, Measure, float], list[float]]
    effects: Sequence[Duel]
    against_controls: Sequence[Duel]

    @property
    def lines(self) -> list[Line]:
        """The methods and, after each, its behaviour-blind control."""
        known = dict.fromkeys(line for line, *_ in self.values)
        names = [name for one in self.twins for name in (one.method, one.twin)]
        return [line for name in names for line in known if line.method == name]

    def mean(self, line: Line, measure: Measure, t_b: float) -> MeanInterval:
        """Return the mean over the seeds with its 95% interval."""
        return mean_interval(self.values[line, measure, t_b])

    def rows(self, measure: Measure) -> Iterator[tuple[str, ...]]:
        """Yield the name of each line, and its means with intervals at `T_BS`."""
        for line in self.lines:
            yield line.label, *(interval_text(self.mean(line, measure, t_b)) for t_b in T_BS)

    def effect_rows(self, measure: Measure) -> Iterator[tuple[str, ...]]:
        """Yield the names of each two methods that are compared, and their comparisons at `T_BS`."""
        return self._table(self.effects, measure)

    def control_rows(self, measure: Measure) -> Iterator[tuple[str, ...]]:
        """Yield the names of each method and its control, and their comparisons at `T_BS`."""
        return self._table(self.against_controls, measure)

    def _table(self, duels: Sequence[Duel], measure: Measure) -> Iterator[tuple[str, ...]]:
        ours = [one for one in duels if one.measure is measure]
        for first, second in dict.fromkeys(map(_names, ours)):
            cells = [_effect_cell(one) for one in ours if _names(one) == (first, second)]
            yield f"{first} : {second}", *cells

    def conclusions(self) -> Iterator[str]:
        """Yield sentences on selection, on the mutation rates and on the controls, for each measure."""
        alone = {(one.method, one.twin) for one in self.twins}
        for measure in Measure:
            ours = [one for one in self.effects if one.measure is measure]
            for words, found in (
                ("selection", [one for one in ours if _names(one) in alone]),
                ("the mutation rate", [one for one in ours if _names(one) not in alone]),
                (
                    "the component's behaviour",
                    [one for one in self.against_controls if one.measure is measure],
                ),
            ):
                if found:
                    yield f"{NAMES[measure]}, {words}: {_effect_words(found)}"

    def document(self) -> dict[str, Any]:
        """Return the study as a JSON document."""
        return {
            "t_bs": list(T_BS),
            "d_th": D_TH,
            "values": [
                {
                    "method": line.method,
                    "control": line.control,
                    "measure": str(measure),
                    "t_b": t_b,
                    "values": values,
                    "mean": mean_interval(values).mean,
                }
                for (line, measure, t_b), values in self.values.items()
            ],
            "effects": [_duel_document(one) for one in self.effects],
            "against_controls": [_duel_document(one) for one in self.against_controls],
            "conclusions": list(self.conclusions()),
        }


def _duel_document(one: Duel) -> dict[str, Any]:
    return {
        "first": one.first.label,
        "second": one.second.label,
        "measure": str(one.measure),
        "t_b": one.t_b,
        "u": one.result.u,
        "a12": one.result.a12,
        "p": one.result.p_value,
        "p_holm": one.adjusted,
    }


def _names(one: Duel) -> tuple[str, str]:
    """Return the names of the two lines that are compared."""
    return one.first.label, one.second.label


def _effect_cell(one: Duel) -> str:
    """Return the effect size and the corrected p-value."""
    return "equal" if one.adjusted is None else f"{one.result.a12:.2f} {one.size}, p {p_text(one.adjusted)}"


def _effect_words(found: Sequence[Duel]) -> str:
    """Return which of several comparisons show a difference."""
    better: dict[tuple[str, str], list[str]] = {}
    for one in found:
        if one.differs:
            first, second = _names(one)
            names = (first, second) if one.result.a12 > 0.5 else (second, first)
            better.setdefault(names, []).append(f"{one.t_b:g}")
    if not better:
        return f"no difference is significant (corrected p at most {LEVEL:g}) at any t_b"
    return "; ".join(
        f"{more} finds more than {less} at t_b {', '.join(t_bs)}" for (more, less), t_bs in better.items()
    )


def sized(body: ExperimentBody, *, seeds: int | None, simulations: int | None) -> ExperimentBody:
    """Return a study of another size.

    Args:
        body: The study.
        seeds: Number of seeds, counted from the first; None for those of the study.
        simulations: Budget of each campaign; None for that of the study.

    Raises:
        InvalidInput: The size is not possible.
    """
    document = body.document()
    if seeds is not None:
        document["seeds"] = {"first": body.seeds[0], "count": seeds}
    if simulations is not None:
        document["budget"] = {**document["budget"], "simulations": simulations}
    return parse_experiment(document)


def twins_of(body: ExperimentBody) -> list[Twins]:
    """Return the methods of a study in pairs that differ in selection alone.

    Raises:
        InvalidInput: There is more than one problem, or a method has no twin.
    """
    if len(body.problems) > 1:
        raise InvalidInput.at("/problems", f"expected one problem, got {len(body.problems)}")
    without = [method for method in body.algorithms if _has_no_selection(method)]
    found = []
    for place, method in enumerate(body.algorithms):
        if _has_no_selection(method):
            continue
        twin = next(
            (one for one in without if _apart_from_selection(one) == _apart_from_selection(method)), None
        )
        if twin is None:
            message = "expected another method with the same settings and selection: none"
            raise InvalidInput.at(f"/algorithms/{place}", message)
        found.append(Twins(method=method.label, twin=twin.label))
    return found


def _has_no_selection(method: Method) -> bool:
    return method.params.get("selection") == "none"


def _apart_from_selection(method: Method) -> tuple[str, dict[str, Any]]:
    return method.id, {key: value for key, value in method.params.items() if key != "selection"}


def heredity_of(repeats: Sequence[Repeat], twins: Sequence[Twins]) -> Heredity:
    """Return the study of finished campaigns.

    Args:
        repeats: Campaigns on one problem; at least one of each method.
        twins: The methods.
    """
    lines = lines_of(repeats)
    values = {
        (line, measure, t_b): values_of(campaigns, measure, t_b, D_TH)
        for line, campaigns in lines.items()
        for measure in Measure
        for t_b in T_BS
    }
    names = [(one.method, one.twin) for one in twins] + [(one.method, twins[0].method) for one in twins[1:]]
    methods = {line.method: line for line in lines if not line.control}
    pairs = [(methods[first], methods[second]) for first, second in names]
    low = with_low_controls(repeats)
    controls = [replace(line, control=True) for line in methods.values() if line.method not in low]
    controlled = [(methods[one.method], one) for one in controls if one in lines]
    return Heredity(
        twins=twins,
        values=values,
        effects=_compared(lines, pairs),
        against_controls=_compared(lines, controlled),
    )


def _compared(
    lines: Mapping[Line, Sequence[tuple[int, Figures]]], pairs: Sequence[tuple[Line, Line]]
) -> list[Duel]:
    """Return a table of comparisons for each measure; p-values are corrected within a table."""
    return [
        duel for measure in Measure for duel in compared_lines(lines, pairs, measure, t_bs=T_BS, d_ths=[D_TH])
    ]


HEIGHT_PX: Final = 620


def figure_heredity(study: Heredity, measure: Measure, title: str) -> Figure:
    """Plot a measure of each method with and without selection, a panel per t_b.

    Args:
        study: The study.
        measure: DBS or strict DBS.
        title: Title of the figure.
    """
    figure = new_figure(
        HEIGHT_PX,
        title,
        f"{NAMES[measure][0].upper()}{NAMES[measure][1:]} at d_th {D_TH:g}: dots are campaigns, bars means over the "
        "seeds with 95% intervals. Blue: with selection; grey: without.\nCrosses: means of controls, whose verdicts "
        "ignore the component's behaviour.",
    )
    panels = add_panels(figure, len(T_BS), top_px=150, bottom_px=80, wspace=0.18)
    for axes, t_b in zip(panels, T_BS, strict=True):
        set_panel_title(axes, f"t_b {t_b:g}")
        for place, one in enumerate(study.twins):
            for name, shift, colour in ((one.method, -0.17, SAFE), (one.twin, 0.17, MUTED)):
                _plot_line(axes, study, name, measure, t_b, place + shift, colour)
        axes.set_xticks(range(len(study.twins)), [one.method for one in study.twins])
        axes.set_xlim(-0.5, len(study.twins) - 0.5)
        axes.set_ylim(0, 1.12 * max(1.0, axes.get_ylim()[1]))  # room for the means above the bars
        axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
        style_axes(axes)
        axes.tick_params(axis="x", labelcolor=INK, length=0)
    return figure


def _plot_line(
    axes: Axes, study: Heredity, name: str, measure: Measure, t_b: float, x: float, colour: str
) -> None:
    for line in study.lines:
        if line.method != name:
            continue
        span = study.mean(line, measure, t_b)
        if line.control:
            axes.plot([x + 0.1], [span.mean], "x", color=colour, markersize=7)
            continue
        values = study.values[line, measure, t_b]
        axes.plot(
            np.full(len(values), x - 0.06),
            values,
            "o",
            color=colour,
            alpha=0.5,
            markersize=5,
            markeredgewidth=0,
        )
        axes.plot([x + 0.02] * 2, interval_limits(span), color=colour, linewidth=2.4)
        axes.plot([x + 0.02], [span.mean], "_", color=colour, markersize=13, markeredgewidth=2.4)
        axes.annotate(
            f"{span.mean:.1f}",
            (x, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, -2),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=SMALL_PT,
            color=colour,
        )
