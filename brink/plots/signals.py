"""Signals of episodes over time: both sides of a pair, or one episode, each with the thresholds of requirements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from brink.plots.style import HAIRLINE, INK, MUTED, SMALL_PT, UNSAFE, WIDTH_PX, new_figure, style_axes

MAX_PANELS: Final = 8
_PANEL_PX: Final = 220
_TOP_PX: Final = 150
_BOTTOM_PX: Final = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """The signals of an episode.

    Attributes:
        label: What it is called, such as ``safe``.
        colour: Colour of its lines.
        time_s: Times, shape ``(n,)``.
        signals: Signals by name, shape ``(n,)`` each.
        margins: Robustness of each requirement over time, shape ``(n,)`` each.
        violated_at_s: Time of the first violation of each violated requirement.
    """

    label: str
    colour: str
    time_s: NDArray[Any]
    signals: Mapping[str, NDArray[Any]]
    margins: Mapping[str, NDArray[Any]]
    violated_at_s: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Panel:
    """One axis.

    Attributes:
        name: The signal, or the requirement whose robustness is drawn.
        label: Label of the axis.
        requirement: The requirement that it is about; empty for none.
        limits: Thresholds.
    """

    name: str
    label: str
    requirement: str = ""
    limits: tuple[float, ...] = ()


def figure_signals(
    sides: Sequence[Recorded], requirements: Mapping[str, Mapping[str, Any]], title: str, facts: str
) -> Figure:
    """Plot the signals of episodes over time on common axes, with thresholds and the moments of violations.

    Args:
        sides: The episodes.
        requirements: The requirements as the campaign states them. The signal of one with a threshold is drawn with
            it; of any other, the robustness is drawn.
        title: The title.
        facts: A sentence below it.
    """
    panels = _panels(sides[0], requirements)
    height_px = _TOP_PX + _PANEL_PX * len(panels) + _BOTTOM_PX
    figure = new_figure(height_px, title, facts)
    grid = figure.add_gridspec(
        len(panels),
        1,
        top=1 - _TOP_PX / height_px,
        bottom=_BOTTOM_PX / height_px,
        left=90 / WIDTH_PX,
        right=0.9,
    )
    shared = None
    for place, panel in enumerate(panels):
        axes = shared = figure.add_subplot(grid[place], sharex=shared)
        style_axes(axes)
        for limit in panel.limits:
            axes.axhline(limit, color=UNSAFE, linewidth=1.2, linestyle=(0, (4, 2)))
            axes.text(
                1.005, limit, f"{limit:g}", transform=axes.get_yaxis_transform(), va="center", color=UNSAFE
            )
        for side in sides:
            values = (side.signals if panel.name in side.signals else side.margins)[panel.name]
            drawn = np.where(np.isfinite(values), values, np.nan)
            axes.plot(side.time_s, drawn, color=side.colour, linewidth=1.8, label=side.label)
            at_s = side.violated_at_s.get(panel.requirement)
            if at_s is not None:
                axes.axvline(at_s, color=side.colour, linewidth=1.0, linestyle=(0, (1, 2)))
                words = f" violated at {at_s:.2f} s"
                axes.text(
                    at_s,
                    0.97,
                    words,
                    transform=axes.get_xaxis_transform(),
                    va="top",
                    fontsize=SMALL_PT,
                    color=INK,
                )
        axes.set_title(panel.label, loc="left", fontsize=SMALL_PT, color=INK)
        axes.tick_params(labelbottom=place == len(panels) - 1)
        axes.grid(color=HAIRLINE, linewidth=0.6)
        if place == 0 and len(sides) > 1:
            axes.legend(
                loc="upper right",
                fontsize=SMALL_PT,
                frameon=False,
                ncols=len(sides),
                bbox_to_anchor=(1, 1.25),
            )
    if shared is not None:
        shared.set_xlabel("simulated time (s)", color=MUTED)
    return figure


def _panels(side: Recorded, requirements: Mapping[str, Mapping[str, Any]]) -> list[_Panel]:
    panels = []
    for name, stated in requirements.items():
        unit = f" ({unit})" if (unit := stated.get("unit")) else ""
        signal = str(stated.get("signal", ""))
        if signal in side.signals:
            limits = tuple(float(stated[key]) for key in ("above", "below") if stated.get(key) is not None)
            panels.append(
                _Panel(name=signal, label=f"{name}: {signal}{unit}", requirement=name, limits=limits)
            )
        elif name in side.margins:
            panels.append(
                _Panel(
                    name=name,
                    label=f"{name}: {stated.get('stl', 'robustness')}{unit}",
                    requirement=name,
                    limits=(0.0,),
                )
            )
    drawn = {panel.name for panel in panels}
    panels += [_Panel(name=name, label=name) for name in side.signals if name not in drawn]
    return panels[:MAX_PANELS]
