"""The chart of a pair over time: what was reported in each drive, plans, speeds, and the margin of the requirement.

Blue is the safe drive, vermilion the unsafe one. Each row of bands has a lane for each drive, in the order in which
they are shown.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from textwrap import wrap
from typing import Final, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patheffects import withStroke
from PIL import Image

from brink.pictures.figure import LiteralFigure
from brink.pictures.guard import guard_words
from brink.pictures.motion import distances, plan_words, scripts_of
from brink.pictures.pair import Interval, Mark, Nearest, PairStory, ended_words
from brink.pictures.scene import LABELS, PERSON, EpisodeScene, front_gap, obstacles_on
from brink.pictures.story import margin_name, report_word, reported, runs
from brink.pictures.style import (
    GUARD_DOES,
    INK,
    MUTED,
    PAPER,
    PLAN_MODES,
    REFERENCE_DOES,
    SAFE_DRIVE,
    UNKNOWN_MODE,
    UNSAFE_DRIVE,
    VEHICLE,
    VIOLATION,
    Rgb,
    action_colour,
    hexadecimal,
    readable_on,
    typeface,
)
from brink.pictures.timeline import DPI, GREATEST_ROBUSTNESS, style_axes, write_formula
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import Trace
from brink.sim.verdict import clock_words

_LANE: Final = 0.4
_LANE_PX: Final = 17
_GAP_PX: Final = 7
_MOST_SCRIPTS: Final = 3
_TOP: Final = 1.04
"""Where greater robustness is drawn, in multiples of the greatest one that is not cut."""
_PANEL_NAME_LETTERS: Final = 13
"""Letters that a line of a panel's name may have, so that it fits beside the panel."""
_ROW_NAME_LETTERS: Final = 10
"""Letters of the name of a row that fit beside it."""
_CROWDED: Final = 0.55
"""Share of a panel's height above which a word beside it would hide its name."""
_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 158, 118, 26, 44
_NEAR_END: Final = 0.05
"""Share of the chart's width, at either end, within which a centred word would not fit."""
_LAST_S: Final = 0.3
"""A line this shortly after the end of a drive does not cross out the text behind it."""
_ABOVE_PX: Final = round(9.4 * DPI / 72)
"""Size of the words above the lanes."""
_SECOND_ROW_PX: Final = 15
"""Height of a second row of words above the lanes."""
DIFFERENCE: Final[Rgb] = (253, 238, 214)
"""Shading of the time in which the reports of the drives differ."""
_COLOURS: Final = {False: SAFE_DRIVE, True: UNSAFE_DRIVE}
"""Colours of the drives, by whether they are unsafe."""
_HATCH: Final[Rgb] = (222, 160, 172)
_REPORTED, _NOT_REPORTED = "reported", "not reported"

Run: TypeAlias = tuple[str, int, int]
"""Word, first and last sample."""
Paint: TypeAlias = Callable[[str], Rgb]


class Panel(StrEnum):
    """A panel of a chart below its lanes."""

    SPEED = "speed"
    MARGIN = "margin"
    """The margin of the requirement or, among the same road users, the distance to the one the violation is about."""


_SHARES: Final = {Panel.SPEED: 0.4, Panel.MARGIN: 0.6}
"""How high the panels are, one against the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """Two lanes of bands, one for each drive; without a colour by word, lanes have their own."""

    name: str
    lanes: tuple[list[Run], list[Run]]
    colour: Paint | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PairChart:
    """A drawn chart, and where its time axis is.

    Attributes:
        image: The chart.
        window: The span of time that it shows.
        left_px: Where the span begins.
        right_px: Where it ends.
        top_px: Top of the lanes.
        bottom_px: Bottom of the lowest panel.
    """

    image: Image.Image
    window: Interval
    left_px: float
    right_px: float
    top_px: float
    bottom_px: float

    def x_px(self, time_s: float) -> float:
        """Return where a time is."""
        span_s = max(1e-6, self.window.end_s - self.window.start_s)
        return self.left_px + (time_s - self.window.start_s) / span_s * (self.right_px - self.left_px)


def draw_pair_chart(
    story: PairStory,
    *,
    size: tuple[int, int],
    window: Interval,
    panels: Sequence[Panel] = tuple(Panel),
    scale: float = 1.0,
) -> PairChart:
    """Draw the chart of a pair.

    Args:
        story: The pair.
        size: Width and height in pixels.
        window: The span of time to show.
        panels: What to show below the lanes, from above.
        scale: Size of text and lanes.
    """
    width, height = size
    figure = LiteralFigure(
        figsize=(width / DPI / scale, height / DPI / scale), dpi=DPI * scale, facecolor="white"
    )
    canvas = FigureCanvasAgg(figure)
    wide, high = width / scale, height / scale
    rows = [row for row in _rows(story, window) if row.colour is not None or _is_in(row, story, window)]
    lanes_px = len(rows) * (2 * _LANE_PX + _GAP_PX)
    left, span = _LEFT_PX / wide, (wide - _LEFT_PX - _RIGHT_PX) / wide
    above_px = _TOP_PX + (_SECOND_ROW_PX if story.pair.marks and len(_moments(story)) > 1 else 0)
    bands = figure.add_axes((left, 1 - (above_px + lanes_px) / high, span, lanes_px / high))
    rest_px = high - above_px - lanes_px - _BOTTOM_PX - _GAP_PX * 2
    whole = sum(_SHARES[panel] for panel in panels)
    drawn: list[Axes] = []
    top_px = float(above_px + lanes_px + _GAP_PX * 2)
    for panel in panels:
        panel_px = rest_px * _SHARES[panel] / whole - (_GAP_PX if len(panels) > 1 else 0)
        drawn.append(figure.add_axes((left, 1 - (top_px + panel_px) / high, span, panel_px / high)))
        top_px += panel_px + _GAP_PX * 2
    _plot_bands(bands, story, rows, window, width_px=wide - _LEFT_PX - _RIGHT_PX)
    for panel, axes in zip(panels, drawn, strict=True):
        if panel is Panel.SPEED:
            _plot_speeds(axes, story)
        elif story.pair.about_reports or story.target is None:
            _plot_robustness(axes, story, window)
        else:
            _plot_distance(axes, story, story.target.actor, window)
    for axes in (bands, *drawn):
        axes.set_xlim(window.start_s, window.end_s)
        _mark(axes, story, window)
        axes.tick_params(labelbottom=axes is drawn[-1])
    _name_marks(bands, story, window, width_px=wide - _LEFT_PX - _RIGHT_PX)
    drawn[-1].set_xlabel("simulated time (s)", color=hexadecimal(MUTED), fontsize=9)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return PairChart(
        image=Image.fromarray(pixels).convert("RGB").resize(size),
        window=window,
        left_px=_LEFT_PX * scale,
        right_px=width - _RIGHT_PX * scale,
        top_px=above_px * scale,
        bottom_px=height - _BOTTOM_PX * scale,
    )


def _rows(story: PairStory, window: Interval) -> list[_Row]:
    traces = [side.trace for _, side, _, _ in story.parts]
    word = report_word(story.pair.unsafe.trace)
    # The boxes of these rows are all that was reported, whether true or not.
    word = "reported" if word in ("injected", "wrong") else word
    rows = []
    scripts = [scripts_of(trace) for trace in traces]
    if not any(scripts):
        for label in range(PERSON + 1):
            lanes = [_counts(trace, label) for trace in traces]
            if any(lanes):
                rows.append(_Row(name=f"{word}\n{LABELS[label]}", lanes=(lanes[0], lanes[1]), colour=None))
    for name in _scripted(story, scripts):
        lanes = [_words(actions.get(name, [])) for actions in scripts]
        rows.append(_Row(name=f"script of\n{name}", lanes=(lanes[0], lanes[1]), colour=action_colour))
    if story.unsafe.title == "front-gap" and story.pair.about_reports:
        ahead = [_ahead(trace, window) for trace in traces]
        if any(ahead):
            rows.append(_Row(name="vehicle\nahead", lanes=(ahead[0], ahead[1]), colour=_ahead_colour))
    plans = [_words(plan_words(trace)) for trace in traces]
    rows.append(_Row(name="plan", lanes=(plans[0], plans[1]), colour=_plan_colour))
    if any(trace.guard is not None for trace in traces):
        guards = [_words(guard_words(trace)) for trace in traces]
        rows.append(_Row(name="guard", lanes=(guards[0], guards[1]), colour=GUARD_DOES.__getitem__))
    return rows


def _scripted(story: PairStory, scripts: Sequence[Mapping[str, object]]) -> list[str]:
    """Return whose actions are shown: among the same road users, those of the one that the violation is about."""
    names = list(dict.fromkeys(name for actions in scripts for name in actions))
    if not story.pair.about_reports and story.target is not None:
        about = story.pair.unsafe.trace.actors[story.target.actor].name
        return [name for name in names if name == about]
    return names[:_MOST_SCRIPTS]


def _is_in(row: _Row, story: PairStory, window: Interval) -> bool:
    """Return whether a lane of a row has a band in a span of time."""
    return any(
        side.trace.time_s[first] <= window.end_s and side.trace.time_s[last] >= window.start_s
        for (_, side, _, _), lane in zip(story.parts, row.lanes, strict=True)
        for _, first, last in lane
    )


def _plan_colour(mode: str) -> Rgb:
    return PLAN_MODES.get(mode) or REFERENCE_DOES.get(mode, UNKNOWN_MODE)


def _ahead(trace: Trace, window: Interval) -> list[Run]:
    """Return when a vehicle was ahead within the reach of the front gap, and whether it was reported."""
    scene = EpisodeScene.of(trace)
    words = []
    for sample, time_s in enumerate(trace.time_s.tolist()):
        gap = front_gap(trace, sample) if window.start_s <= time_s <= window.end_s else None
        if gap is None:
            words.append("")
        else:
            words.append(_REPORTED if obstacles_on(scene, sample, gap.actor) else _NOT_REPORTED)
    return _words(words)


def _ahead_colour(word: str) -> Rgb:
    return VEHICLE if word == _REPORTED else PAPER


def _counts(trace: Trace, label: int) -> list[Run]:
    """Return when boxes of a label were reported, with their number if there were several."""
    return [
        ("" if count == 1 else str(count), first, last)
        for count, first, last in runs(reported(trace, label).tolist())
        if count
    ]


def _words(values: Sequence[str]) -> list[Run]:
    return [(word, first, last) for word, first, last in runs(values) if word]


def _plot_bands(axes: Axes, story: PairStory, rows: list[_Row], window: Interval, *, width_px: float) -> None:
    style_axes(axes)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    step = 2 * _LANE + _LANE * _GAP_PX / _LANE_PX
    ticks, names = [], []
    lines_s = [mark.time_s for mark in (*_moments(story), *story.pair.marks)]
    for index, row in enumerate(rows):
        for lane, (name, side, _, is_unsafe) in enumerate(story.parts):
            y = index * step + lane * _LANE
            trace = side.trace
            end_s = float(trace.time_s[-1])
            axes.broken_barh([(0.0, end_s)], (y, _LANE * 0.94), facecolor="#eef0f2", linewidth=0)
            own = _COLOURS[is_unsafe]
            for run in row.lanes[lane]:
                colour = own if row.colour is None else row.colour(run[0])
                _band(axes, trace, y, run, colour, window, lines_s)
            if end_s < story.end_s - 0.5 and end_s < window.end_s - 0.5 and index == len(rows) - 1:
                words = ended_words(trace)
                until_s = end_s + 2 * _half_s(words, window, width_px)
                room_s = window.end_s + _RIGHT_PX / width_px * (window.end_s - window.start_s)
                fits = until_s < room_s and not any(end_s + _LAST_S < at < until_s for at in lines_s)
                axes.text(
                    end_s,
                    y + _LANE / 2,
                    f" {words} ",
                    va="center",
                    ha="left" if fits else "right",
                    fontsize=8,
                    color=hexadecimal(MUTED if fits else INK),
                )
            ticks.append(y + _LANE / 2)
            names.append(name)
        middle = index * step + _LANE
        axes.annotate(
            row.name,
            (0, middle),
            xycoords=("axes fraction", "data"),
            xytext=(-44, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontweight="bold",
            fontsize=9.5 if max(map(len, row.name.split("\n"))) <= _ROW_NAME_LETTERS else 8.5,
            color=hexadecimal(INK),
            linespacing=1.1,
        )
    axes.set_ylim(len(rows) * step, 0)
    axes.set_yticks(ticks, names)
    axes.tick_params(axis="y", length=0, labelsize=8.5, pad=3)
    axes.tick_params(axis="x", length=0)
    for index, label in enumerate(axes.get_yticklabels()):
        label.set_color(hexadecimal(_COLOURS[story.parts[index % len(story.parts)].is_unsafe]))


def _band(
    axes: Axes, trace: Trace, y: float, run: Run, colour: Rgb, window: Interval, lines_s: Sequence[float]
) -> None:
    word, first, last = run[0].replace("_", " "), *run[1:]
    start_s = float(trace.time_s[first])
    end_s = float(trace.time_s[min(last + 1, len(trace.time_s) - 1)])
    if end_s <= window.start_s or start_s >= window.end_s:
        return
    start_s, end_s = max(start_s, window.start_s), min(max(end_s, start_s + 0.05), window.end_s)
    hidden = word == _NOT_REPORTED
    axes.broken_barh(
        [(start_s, end_s - start_s)],
        (y, _LANE * 0.94),
        facecolor=hexadecimal(colour),
        linewidth=0,
        hatch="////" if hidden else None,
        edgecolor=hexadecimal(_HATCH) if hidden else None,
    )
    # Lines would strike the word through: it is written in the longest part between them.
    cuts = [start_s, *sorted(at for at in lines_s if start_s < at < end_s), end_s]
    start_s, end_s = max(pairwise(cuts), key=lambda part: part[1] - part[0])
    if word and end_s - start_s > 0.012 * (window.end_s - window.start_s) * len(word):
        axes.text(
            (start_s + end_s) / 2,
            y + _LANE * 0.49,
            word,
            ha="center",
            va="center",
            fontsize=8,
            color=hexadecimal(VIOLATION if hidden else readable_on(colour)),
            path_effects=[withStroke(linewidth=4, foreground="white")] if hidden else None,
        )


def _plot_speeds(axes: Axes, story: PairStory) -> None:
    style_axes(axes)
    highest = 1.0
    for _, trace, colour in _drives(story):
        speed_mps = np.asarray(trace.ego[:, 3], dtype=np.float64)
        axes.plot(trace.time_s, speed_mps, color=hexadecimal(colour), linewidth=1.8)
        highest = max(highest, float(np.nanmax(speed_mps)))
    axes.set_ylim(-0.04 * highest, highest * 1.12)
    axes.set_ylabel("m/s", fontsize=9)
    _name_panel(axes, "speed")


def _plot_robustness(axes: Axes, story: PairStory, window: Interval) -> None:
    style_axes(axes)
    name = story.unsafe.requirement
    found = []
    for _, trace, colour in _drives(story):
        values = np.asarray(trace.robustness[name], dtype=np.float64)
        values = np.where(np.isfinite(values), values, 1e3)
        inside = (trace.time_s >= window.start_s) & (trace.time_s <= window.end_s)
        found.append(values[inside])
        # A sample keeps the lowest robustness until the next one: drawn when it was reached.
        time_s = np.asarray(trace.time_s, dtype=np.float64) + story.unsafe.lag_s
        axes.plot(time_s, values, color=hexadecimal(colour), linewidth=2.0, zorder=3)
        if colour == UNSAFE_DRIVE:
            axes.fill_between(
                time_s, np.minimum(values, 0), 0, color=hexadecimal(VIOLATION), alpha=0.5, linewidth=0
            )
    shown = np.concatenate(found) if found else np.zeros(1)
    least = min(0.0, float(shown.min(initial=0.0)))
    most = max(1.0, min(GREATEST_ROBUSTNESS, float(shown.max(initial=1.0))))
    # A safe drive that keeps far away from the requirement's limit is drawn along the top.
    axes.set_ylim(least - 0.2 * (most - least), most * 1.1)
    for line in axes.get_lines():
        line.set_ydata(np.minimum(np.asarray(line.get_ydata(), dtype=np.float64), most * _TOP))
    axes.axhspan(least - most, 0, color=hexadecimal(VIOLATION), alpha=0.07, linewidth=0)
    axes.axhline(0, color=hexadecimal(VIOLATION), linewidth=1.1)
    axes.set_ylabel(story.unsafe.unit or "robustness", fontsize=9)
    write_formula(axes, story.unsafe)
    lines = wrap(margin_name(name), _PANEL_NAME_LETTERS)
    if story.unsafe.title == "front-gap":
        lines.append(f"(gap − {REQUIRED_GAP_M:g} m)")
    _name_panel(axes, "\n".join(lines))
    if float(shown.max(initial=0.0)) > most * _TOP:
        # Where the lines are cut is a tick: words inside would be struck through by them.
        ticks = [tick for tick in axes.get_yticks().tolist() if least <= tick < 0.7 * most]
        axes.set_yticks([*ticks, most * _TOP], [*(f"{tick:g}" for tick in ticks), f"{most * _TOP:.3g}+"])
    low, high = axes.get_ylim()
    crowded = -low / (high - low) > _CROWDED  # the name of the panel is where the line is
    axes.annotate(
        "violated",
        (1, 0),
        xycoords="axes fraction" if crowded else ("axes fraction", "data"),
        xytext=(6, 2 if crowded else -4),
        textcoords="offset points",
        va="bottom" if crowded else "top",
        fontsize=9,
        color=hexadecimal(VIOLATION),
    )


def _plot_distance(axes: Axes, story: PairStory, actor: int, window: Interval) -> None:
    """Plot how far the cars are from a road user that is in both drives."""
    style_axes(axes)
    highest = 1.0
    for _, trace, colour in _drives(story):
        gap_m = distances(trace, actor)
        axes.plot(trace.time_s, gap_m, color=hexadecimal(colour), linewidth=2.0, zorder=3)
        highest = max(highest, float(np.nanmax(gap_m, initial=1.0)))
    highest = min(highest, GREATEST_ROBUSTNESS)
    axes.set_ylim(-0.12 * highest, 1.08 * highest)
    axes.axhspan(-highest, 0.0, color=hexadecimal(VIOLATION), alpha=0.12, linewidth=0)
    _draw_limit(axes, 0.0, "contact", above=False)
    if story.gap_required:
        axes.axhspan(0.0, REQUIRED_GAP_M, color=hexadecimal(VIOLATION), alpha=0.05, linewidth=0)
        _draw_limit(axes, REQUIRED_GAP_M, story.gap_required, above=True)
    nearest = story.pair.nearest
    if nearest is not None and nearest.gap_m <= highest:
        _mark_nearest(axes, nearest, window)
    axes.set_ylabel("m", fontsize=9)
    name = story.pair.unsafe.trace.actors[actor].name
    _name_panel(axes, "\n".join(["distance to", *wrap(name, _PANEL_NAME_LETTERS)]))


def _draw_limit(axes: Axes, limit_m: float, words: str, *, above: bool) -> None:
    axes.axhline(limit_m, color=hexadecimal(VIOLATION), linewidth=1.1)
    axes.annotate(
        words,
        (1, limit_m),
        xycoords=("axes fraction", "data"),
        xytext=(6, 3 if above else -3),
        textcoords="offset points",
        va="bottom" if above else "center",
        fontsize=8.5 if above else 9,
        color=hexadecimal(VIOLATION),
        linespacing=1.05,
    )


def _mark_nearest(axes: Axes, nearest: Nearest, window: Interval) -> None:
    colour = hexadecimal(SAFE_DRIVE)
    axes.plot([nearest.time_s], [nearest.gap_m], "o", color=colour, markersize=5, zorder=6)
    late = nearest.time_s > window.end_s - _NEAR_END * (window.end_s - window.start_s)
    axes.annotate(
        nearest.words,
        (nearest.time_s, nearest.gap_m),
        xytext=(0, 5),
        textcoords="offset points",
        ha="right" if late else "center",
        va="bottom",
        fontsize=9,
        fontweight="bold",
        color=colour,
        zorder=7,
        path_effects=[withStroke(linewidth=3, foreground="white")],
    )


def _drives(story: PairStory) -> list[tuple[str, Trace, Rgb]]:
    return [(name, side.trace, _COLOURS[is_unsafe]) for name, side, _, is_unsafe in story.parts]


def _name_panel(axes: Axes, name: str) -> None:
    axes.text(
        1.008,
        0.98,
        name,
        transform=axes.transAxes,
        va="top",
        fontsize=9,
        color=hexadecimal(INK),
        linespacing=1.2,
    )


def _mark(axes: Axes, story: PairStory, window: Interval) -> None:
    """Mark the moment, and when reports differ."""
    for span in story.differing:
        start_s, end_s = max(span.start_s, window.start_s), min(span.end_s, window.end_s)
        axes.axvspan(start_s, end_s, color=hexadecimal(DIFFERENCE), linewidth=0, zorder=0)
    for at in story.pair.marks:
        axes.axvline(at.time_s, color=hexadecimal(SAFE_DRIVE), linewidth=1.1, linestyle=(0, (3, 2)), zorder=4)
    for at in _moments(story):
        is_shown = at.time_s == story.moment_s
        axes.axvline(
            at.time_s,
            color=hexadecimal(VIOLATION),
            linewidth=1.1 if is_shown else 0.8,
            linestyle=(0, (3, 2) if is_shown else (1, 2)),
            zorder=4,
        )


def _moments(story: PairStory) -> tuple[Mark, ...]:
    """Return the moments of the unsafe drive to name: that of the pair, and perhaps further violations."""
    named = "violation" if story.unsafe.violated else "closest"
    found = story.pair.violated or (Mark(story.moment_s, named),)
    return tuple(
        at._replace(time_s=story.moment_s) if abs(at.time_s - story.moment_s) < 1e-3 else at for at in found
    )


def _half_s(words: str, window: Interval, width_px: float) -> float:
    """Return half of the width of words above the lanes, as a span of time on a chart of some width."""
    letters_px = typeface(_ABOVE_PX).getlength(f"  {words}  ")
    return 0.5 * letters_px / width_px * (window.end_s - window.start_s)


def _name_marks(axes: Axes, story: PairStory, window: Interval, *, width_px: float) -> None:
    """Name the marks above the lanes; the moment first, and those of the safe drive in a row of their own."""
    moments = _moments(story)
    higher = bool(story.pair.marks) and len(moments) > 1
    rows: dict[int, list[tuple[float, float]]] = {0: [], 1: []}

    def write(mark: Mark, row: int, colour: Rgb) -> None:
        words = f"{mark.words} {clock_words(mark.time_s)}"
        half = _half_s(words, window, width_px)
        middle = max(mark.time_s, window.start_s + half)
        for taken, its in sorted(rows[row], reverse=mark.time_s <= story.moment_s):
            if abs(middle - taken) < half + its:
                middle = taken - half - its if mark.time_s <= story.moment_s else taken + half + its
        rows[row].append((middle, half))
        _above(axes, middle, words, colour, row)

    for mark in sorted(moments, key=lambda one: abs(one.time_s - story.moment_s)):
        if window.start_s <= mark.time_s <= window.end_s:
            write(mark, 0, VIOLATION)
    for mark in story.pair.marks:
        write(mark, 1 if higher else 0, SAFE_DRIVE)
    taken = rows[0]
    for span in story.differing:
        start_s, end_s = max(span.start_s, window.start_s), min(span.end_s, window.end_s)
        words = "reports differ"
        middle, half = (start_s + end_s) / 2, _half_s(words, window, width_px)
        middle = min(max(middle, window.start_s + half), window.end_s - half)
        if end_s > start_s and all(abs(middle - at) > half + other for at, other in taken):
            taken.append((middle, half))
            _above(axes, middle, words, (150, 95, 0))


def _above(axes: Axes, time_s: float, words: str, colour: Rgb, row: int = 0) -> None:
    axes.annotate(
        words,
        (time_s, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 4 + 11 * row),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        color=hexadecimal(colour),
    )
