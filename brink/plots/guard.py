"""Figures of guards: how long ahead violations are predicted, and at what cost in false alarms."""

from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from brink.guard.choices import FALSE_ALARMS
from brink.guard.evaluation import (
    ALWAYS,
    BOX_TTC,
    GUARD,
    LEAD_S,
    LEADS_S,
    NEVER,
    GuardEvaluation,
    PredictorResult,
)
from brink.plots.style import (
    HAIRLINE,
    INK,
    MUTED,
    OTHER,
    SAFE,
    UNSAFE,
    add_legend,
    add_panels,
    new_figure,
    set_panel_title,
    show_percent,
    style_axes,
    style_shares,
)

HEIGHT_PX: Final = 760
_COLOURS: Final = {GUARD: SAFE, BOX_TTC: UNSAFE}
_SHOWN_LEADS_S: Final = (0.5, 1.5, 3.0)
_STYLES: Final = ("--", "-", ":")


def figure_guard(evaluation: GuardEvaluation) -> Figure:
    """Plot predicted violations against false alarms, and how long ahead they are predicted, beside the baselines."""
    figure = new_figure(
        HEIGHT_PX,
        f"Guard on {evaluation.drives:,} drives ({evaluation.sensor})",
        f"{evaluation.violations:,} of the drives violate {' or '.join(evaluation.requirements)}. Left: each point "
        f"is an alarm threshold; solid: predicted at least {LEAD_S:g} s ahead, dashed: 0.5 s, dotted: 3 s.\nRight: "
        f"with alarms in {FALSE_ALARMS:.0%} of the safe drives (dotted on the left), by thresholds of other drives.",
    )
    left, right = add_panels(figure, 2, top_px=190, bottom_px=70, left_px=96)
    drawn = [one for one in evaluation.predictors if one.name not in (ALWAYS, NEVER)]
    _plot_alarms(left, evaluation, drawn)
    _plot_leads(right, drawn)
    keys = [
        Line2D([], [], color=_colour(one), linewidth=2.2, label=f"{one.name}: {one.compared.recall:.0%}")
        for one in drawn
    ]
    keys.append(Line2D([], [], color=HAIRLINE, linewidth=1.2, label="an alarm at random"))
    add_legend(figure, keys, 122, handlelength=2.2)
    return figure


def _colour(one: PredictorResult) -> str:
    return _COLOURS.get(one.name, OTHER)


def _plot_alarms(axes: Axes, evaluation: GuardEvaluation, drawn: list[PredictorResult]) -> None:
    axes.plot([0, 1], [0, 1], color=HAIRLINE, linewidth=1.2, zorder=0)
    axes.axvline(FALSE_ALARMS, color=MUTED, linewidth=1.0, linestyle=":")
    for one in drawn:
        for lead_s, style in zip(_SHOWN_LEADS_S, _STYLES, strict=True):
            if one.name != GUARD and lead_s != LEAD_S:
                continue
            place = LEADS_S.index(lead_s)
            axes.plot(
                [point.false_alarms for point in one.points],
                [point.warned[place] for point in one.points],
                color=_colour(one),
                linewidth=2.2 if lead_s == LEAD_S else 1.4,
                linestyle=style,
            )
    own = evaluation.own.point
    axes.plot([own.false_alarms], [own.recall], marker="o", markersize=9, color=INK, linestyle="")
    axes.annotate(
        "its own threshold",
        (own.false_alarms, own.recall),
        xytext=(12, -14),
        textcoords="offset points",
        color=INK,
    )
    style_shares(
        axes, "Predicted violations and false alarms", x="safe drives with an alarm", y="predicted violations"
    )


def _plot_leads(axes: Axes, drawn: list[PredictorResult]) -> None:
    axes.axvline(LEAD_S, color=MUTED, linewidth=1.0, linestyle=":")
    for one in drawn:
        axes.plot(LEADS_S, one.compared.warned, color=_colour(one), linewidth=2.2, marker="o", markersize=5)
    axes.set_xlim(0, LEADS_S[-1])
    axes.set_ylim(0, 1)
    show_percent(axes.yaxis)
    set_panel_title(axes, f"Lead time, alarms in {FALSE_ALARMS:.0%} of safe drives")
    axes.set_xlabel("predicted at least this many seconds ahead")
    axes.set_ylabel("predicted violations")
    style_axes(axes, grid="both")
