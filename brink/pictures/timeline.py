"""Plots of an episode over time: speed, robustness, and bands of plan, lights, reports, scripts and guard."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from brink.pictures.figure import LiteralFigure
from brink.pictures.guard import guard_probability, guard_words
from brink.pictures.motion import scripts_of
from brink.pictures.scene import LABELS, PERSON, count_wrong, has_errors
from brink.pictures.story import (
    Judged,
    Story,
    margin_name,
    notable_events,
    report_word,
    reported,
    runs,
    story_of,
)
from brink.pictures.style import (
    EGO,
    GHOST,
    GUARD_DOES,
    HAIRLINE,
    INK,
    LIGHTS,
    MUTED,
    PLAN_MODES,
    UNKNOWN_MODE,
    VIOLATION,
    Rgb,
    action_colour,
    hexadecimal,
    readable_on,
)
from brink.sim.trace import Trace

DPI: Final = 100
GREATEST_ROBUSTNESS: Final = 12.0
"""Robustness is drawn up to this value: beyond it there is no danger, and the rest would look flat."""


def timeline_figure(
    trace: Trace, *, requirement: Judged = None, size: tuple[int, int] = (1200, 620)
) -> Figure:
    """Return a figure with plots of an episode over time.

    Args:
        trace: The episode.
        requirement: Ids of the requirements to judge; for the default see `story_of`.
        size: Width and height in pixels.

    Raises:
        ReplayError: The trace is empty, or lacks the requirement.
    """
    story = story_of(trace, requirement)
    figure = LiteralFigure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left, right = 124 / size[0], 1 - 108 / size[0]
    grid = figure.add_gridspec(
        3, 1, height_ratios=(3, 3, 1.9), hspace=0.16, left=left, right=right, top=0.95, bottom=0.1
    )
    speed = figure.add_subplot(grid[0])
    robustness = figure.add_subplot(grid[1], sharex=speed)
    bands = figure.add_subplot(grid[2], sharex=speed)
    _plot_speed(speed, trace)
    _plot_robustness(robustness, trace, story)
    _plot_bands(bands, trace)
    _mark_events(speed, (robustness, bands), trace, story)
    end_s = float(trace.time_s[-1])
    bands.set_xlim(float(trace.time_s[0]), end_s if end_s > trace.time_s[0] else end_s + 1)
    bands.set_xlabel("simulated time (s)", color=hexadecimal(INK))
    for axes in (speed, robustness):
        axes.tick_params(labelbottom=False)
    return figure


def timeline_image(
    trace: Trace, *, requirement: Judged = None, size: tuple[int, int] = (1200, 620)
) -> Image.Image:
    """Return `timeline_figure` as an RGB image.

    Args:
        trace: The episode.
        requirement: As for `timeline_figure`.
        size: Exact width and height in pixels.

    Raises:
        ReplayError: As for `timeline_figure`.
    """
    canvas = FigureCanvasAgg(timeline_figure(trace, requirement=requirement, size=size))
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return Image.fromarray(pixels).convert("RGB").resize(size)


def _plot_speed(axes: Axes, trace: Trace) -> None:
    time_s = trace.time_s
    axes.step(
        time_s,
        trace.target_speed_mps,
        where="post",
        color=hexadecimal(MUTED),
        linewidth=1.2,
        linestyle=(0, (4, 2)),
    )
    axes.plot(time_s, trace.ego[:, 3], color=hexadecimal(EGO), linewidth=2.0)
    highest = max(1.0, float(trace.ego[:, 3].max()), float(trace.target_speed_mps.max()))
    axes.set_ylim(min(0.0, float(trace.ego[:, 3].min())), highest * 1.12)
    axes.set_ylabel("m/s")
    style_axes(axes)
    _label_ends(
        axes,
        [(float(trace.ego[-1, 3]), "speed", EGO), (float(trace.target_speed_mps[-1]), "target speed", MUTED)],
    )


def _plot_robustness(axes: Axes, trace: Trace, story: Story) -> None:
    values = np.asarray(trace.robustness[story.requirement], dtype=np.float64)
    least = min(story.least, 0.0) if np.isfinite(story.least) else 0.0
    most = min(GREATEST_ROBUSTNESS, float(values[np.isfinite(values)].max(initial=1.0)))
    most = max(most, 1.0, 1.3 * story.least if np.isfinite(story.least) else 0.0)
    shown = np.minimum(np.where(np.isfinite(values), values, most * 2), most * 2)
    axes.axhspan(least - 2 * most, 0, color=hexadecimal(VIOLATION), alpha=0.07, linewidth=0)
    axes.axhline(0, color=hexadecimal(VIOLATION), linewidth=1.2)
    # A sample keeps the lowest robustness until the next one: drawn when it was reached.
    time_s = np.asarray(trace.time_s, dtype=np.float64) + story.lag_s
    axes.plot(time_s, shown, color=hexadecimal(INK), linewidth=1.8)
    axes.fill_between(time_s, np.minimum(shown, 0), 0, color=hexadecimal(VIOLATION), alpha=0.55, linewidth=0)
    axes.set_ylim(least - 0.22 * (most - least), most * 1.08)
    axes.set_ylabel(story.unit or "robustness")
    style_axes(axes)
    write_formula(axes, story)
    axes.text(
        1.008,
        0.97,
        margin_name(story.title).replace(" margin", "\nmargin"),
        transform=axes.transAxes,
        va="top",
        fontsize=9,
        color=hexadecimal(INK),
        linespacing=1.25,
    )
    axes.annotate(
        "violated below",
        (1, 0),
        xycoords=("axes fraction", "data"),
        xytext=(6, -3),
        textcoords="offset points",
        va="top",
        fontsize=9,
        color=hexadecimal(VIOLATION),
    )


def _plot_bands(axes: Axes, trace: Trace) -> None:
    scripts = scripts_of(trace)
    reports = {} if scripts else {f"{report_word(trace)} {LABELS[i]}": i for i in range(PERSON + 1)}
    if has_errors(trace):
        reports = {"wrong or missing": -1}
    guard = ["guard"] if trace.guard is not None else []
    names = ["plan", *(["light"] if any(trace.lights) else []), *reports, *scripts, *guard]
    for row, name in enumerate(names):
        axes.axhspan(row - 0.36, row + 0.36, color="#f0f2f4", linewidth=0)
        if name == "plan":
            for mode, first, last in runs(trace.plan_mode):
                _band(axes, trace, row, first, last, PLAN_MODES.get(mode, UNKNOWN_MODE), mode)
        elif name == "light":
            for state, first, last in runs(trace.lights):
                if state:
                    _band(axes, trace, row, first, last, LIGHTS.get(state, UNKNOWN_MODE), state)
        elif name == "guard":
            _plot_guard(axes, trace, row)
        elif name in scripts:
            for words, first, last in runs(scripts[name]):
                _band(axes, trace, row, first, last, action_colour(words), words)
        else:
            counts = count_wrong(trace) if has_errors(trace) else reported(trace, reports[name])
            for count, first, last in runs(counts.tolist()):
                if count:
                    _band(axes, trace, row, first, last, GHOST, f"{count}" if count != 1 else "")
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names)
    style_axes(axes)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def _plot_guard(axes: Axes, trace: Trace, row: int) -> None:
    """Draw when the guard raised the alarm and the fallback intervened, under the probability from 0 to 1."""
    for word, first, last in runs(guard_words(trace)):
        if word:
            _band(axes, trace, row, first, last, GUARD_DOES[word], word)
    probability = guard_probability(trace)
    if probability is not None:
        shown = row + 0.36 - 0.72 * np.clip(probability, 0.0, 1.0)
        axes.step(trace.time_s, shown, where="post", color=hexadecimal(INK), linewidth=1.0)


def _band(axes: Axes, trace: Trace, row: int, first: int, last: int, colour: Rgb, text: str) -> None:
    start_s = float(trace.time_s[first])
    end_s = float(trace.time_s[min(last + 1, len(trace.time_s) - 1)])
    axes.broken_barh(
        [(start_s, end_s - start_s)], (row - 0.36, 0.72), facecolor=hexadecimal(colour), linewidth=0
    )
    span_s = float(trace.time_s[-1] - trace.time_s[0])
    if text and end_s - start_s > 0.011 * span_s * len(text):
        axes.text(
            (start_s + end_s) / 2,
            row + 0.03,
            text,
            ha="center",
            va="center",
            fontsize=8,
            color=hexadecimal(readable_on(colour)),
        )


def _mark_events(top: Axes, below: tuple[Axes, ...], trace: Trace, story: Story) -> None:
    """Draw a thin line through all panels for each event, labelled above if there is room."""
    span_s = max(1e-6, float(trace.time_s[-1] - trace.time_s[0]))
    marks = [(float(trace.time_s[story.decisive]), "closest", INK)]
    if story.violated:
        marks = [(story.violations[0].time_s, "violation", VIOLATION)]
    others = [one for one in story.violations if one.requirement != story.requirement]
    marks += [(one.time_s, one.words.partition(" at ")[0], VIOLATION) for one in others]
    marks += [(event.time_s, event.kind, MUTED) for event in notable_events(trace)]
    written: list[tuple[float, float]] = []
    for time_s, word, colour in marks:
        for axes in (top, *below):
            axes.axvline(time_s, color=hexadecimal(colour), linewidth=0.9, alpha=0.8, linestyle=(0, (2, 2)))
        half = 0.0042 * span_s * len(word)
        if all(abs(time_s - other) > half + width for other, width in written):
            written.append((time_s, half))
            top.annotate(
                word,
                (time_s, 1.02),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="bottom",
                fontsize=9,
                color=hexadecimal(colour),
            )


def _label_ends(axes: Axes, ends: list[tuple[float, str, Rgb]]) -> None:
    """Label lines at their right ends without overlaps."""
    low, high = axes.get_ylim()
    apart = 0.14 * (high - low)
    at = -np.inf
    places = []
    for value, _, _ in sorted(ends):
        at = max(value, at + apart, low + apart / 2)
        places.append(at)
    excess = max(0.0, places[-1] - high)
    for at, (_, word, colour) in zip(places, sorted(ends), strict=True):
        axes.annotate(
            word,
            (1, at - excess),
            xycoords=("axes fraction", "data"),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            color=hexadecimal(colour),
        )


def write_formula(axes: Axes, story: Story) -> None:
    """Write the formula of the requirement, if it is one, into the plot of its robustness."""
    axes.text(
        0.006,
        0.03,
        story.formula,
        transform=axes.transAxes,
        fontsize=7.5,
        color=hexadecimal(MUTED),
        parse_math=False,
        wrap=True,
    )


def style_axes(axes: Axes) -> None:
    """Style axes: two thin spines, small muted ticks, a faint grid along y."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(hexadecimal(HAIRLINE))
    axes.tick_params(colors=hexadecimal(MUTED), labelsize=9)
    axes.yaxis.label.set_color(hexadecimal(MUTED))
    axes.grid(axis="y", color=hexadecimal(HAIRLINE), linewidth=0.6, alpha=0.6)
    axes.set_axisbelow(True)
