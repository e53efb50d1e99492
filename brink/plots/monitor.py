"""Figures of a monitor on trial: calibration, and missed hazards against false alarms."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from brink.plots.style import HAIRLINE, INK, LABEL_PT, MUTED, SAFE, UNSAFE, WIDTH_PX, frame, new_figure
from brink.search.analysis.monitor_evaluation import MAJORITY, MONITOR, MonitorEvaluation, Predictor

HEIGHT_PX: Final = 760
_HUES: Final = {MONITOR: SAFE, MAJORITY: MUTED}


def figure_monitor(trial: MonitorEvaluation, title: str) -> Figure:
    """Return calibration and the trade of missed hazards against false alarms, side by side.

    Args:
        trial: What became of the monitor and of others.
        title: What it is about.
    """
    figure = new_figure(
        HEIGHT_PX,
        title,
        f"Learned from {trial.learned:,} simulations, judged by {trial.fresh:,} that the search never saw.\n"
        "Left: the unsafe share of solutions with similar probabilities, with its own 95% interval; shaded, what the "
        "monitor stated. Right: every point is an alarm level.",
    )
    grid = figure.add_gridspec(
        1,
        2,
        left=96 / WIDTH_PX,
        right=1 - 40 / WIDTH_PX,
        top=1 - 190 / HEIGHT_PX,
        bottom=70 / HEIGHT_PX,
        wspace=0.2,
    )
    _calibration(figure.add_subplot(grid[0]), trial)
    _trade(figure.add_subplot(grid[1]), trial)
    keys = [
        Line2D([], [], color=_hue(witness), linewidth=2.2, label=f"{witness.name}: {_figures(witness)}")
        for witness in trial.predictors
    ]
    figure.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(64 / WIDTH_PX, 1 - 122 / HEIGHT_PX), ncols=len(keys),
        frameon=False, fontsize=LABEL_PT, labelcolor=INK, handlelength=2.2, borderaxespad=0,
    )  # fmt: skip
    return figure


def _figures(witness: Predictor) -> str:
    return f"AUROC {witness.metrics.auroc:.3f}, Brier {witness.metrics.brier:.3f}"


def _hue(witness: Predictor) -> str:
    return _HUES.get(witness.name, UNSAFE)


def _calibration(axes: Axes, trial: MonitorEvaluation) -> None:
    axes.plot([0, 1], [0, 1], color=HAIRLINE, linewidth=1.2, zorder=0)
    for witness in trial.predictors:
        if witness.name == MAJORITY:
            continue
        bins = witness.metrics.bins
        x = np.array([one.predicted for one in bins])
        y = np.array([one.observed for one in bins])
        if witness.name == MONITOR:
            axes.fill_between(
                x, [one.low for one in bins], [one.high for one in bins], color=_hue(witness), alpha=0.12,
                linewidth=0,
            )  # fmt: skip
        errors = np.array([[o.observed - o.observed_low, o.observed_high - o.observed] for o in bins]).T
        axes.errorbar(
            x, y, yerr=np.maximum(errors, 0.0), color=_hue(witness), marker="o", markersize=5, linewidth=1.8,
            elinewidth=1.1, capsize=3,
        )  # fmt: skip
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.set_title("Calibration", loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold")
    axes.set_xlabel("probability of unsafe that was foretold")
    axes.set_ylabel("unsafe share that came")
    frame(axes, grid="both")


def _trade(axes: Axes, trial: MonitorEvaluation) -> None:
    for witness in trial.predictors:
        axes.plot(
            [alarm.missed for alarm in witness.operating_points], [alarm.false for alarm in witness.operating_points],
            color=_hue(witness), linewidth=2.2, linestyle="--" if witness.name == MAJORITY else "-",
        )  # fmt: skip
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.xaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    axes.set_title("What alarms cost", loc="left", fontsize=LABEL_PT, color=INK, fontweight="bold")
    axes.set_xlabel("hazards that are missed")
    axes.set_ylabel("safe solutions with a false alarm")
    frame(axes, grid="both")
