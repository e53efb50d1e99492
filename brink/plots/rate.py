"""The interval of a rate against simulations, with the claim."""

import textwrap
from typing import Final

from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator, PercentFormatter, StrMethodFormatter

from brink.plots.style import (
    INK,
    MARGIN_PX,
    MUTED,
    SAFE,
    SMALL_PT,
    UNSAFE,
    WIDTH_PX,
    new_figure,
    show_message,
    style_axes,
)
from brink.server.findings.rate.views import RateView

_HEIGHT_PX: Final = 620
_TICKS: Final = 8
_LINE_CHARACTERS: Final = 150


def figure_rate(view: RateView, sentence: str) -> Figure:
    """Plot how the interval became narrower.

    Args:
        view: The rate.
        sentence: What it says.
    """
    says = (
        f"{sentence[:1].upper()}{sentence[1:]}. The band contains the rate at all numbers of simulations at once, "
        f"with {100 * view.confidence:.4g}% confidence."
    )
    figure = new_figure(
        _HEIGHT_PX, "How often it is unsafe in operation", textwrap.fill(says, _LINE_CHARACTERS)
    )
    axes = figure.add_axes(
        ((MARGIN_PX + 60) / WIDTH_PX, 90 / _HEIGHT_PX, 1 - (MARGIN_PX + 120) / WIDTH_PX, 1 - 260 / _HEIGHT_PX)
    )
    style_axes(axes)
    if len(view.looks) < 2:
        show_message(axes, "too few simulations")
        return figure
    simulations = [one.simulations for one in view.looks]
    lows, highs = [one.low for one in view.looks], [one.high for one in view.looks]
    axes.fill_between(simulations, lows, highs, color=SAFE, alpha=0.25, linewidth=0)
    axes.plot(simulations, [one.rate for one in view.looks], color=INK)
    tops = [view.rate.high]
    if view.claim is not None:
        limit = view.claim.at_most
        tops.append(limit)
        axes.axhline(limit, color=UNSAFE, linewidth=1.0)
        axes.annotate(
            f"claim: at most {100 * limit:.3g}%, {view.claim.decision}",
            (1.0, limit),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="bottom",
            fontsize=SMALL_PT,
            color=UNSAFE,
        )
    axes.set_xscale("log")
    axes.set_xlim(simulations[0], simulations[-1])
    axes.set_xticks(simulations[:: -len(simulations) // _TICKS], minor=False)
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(0.0, min(1.0, 3.0 * max(tops)))
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1))
    axes.set_xlabel("simulations", fontsize=SMALL_PT, color=MUTED)
    return figure
