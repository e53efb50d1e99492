"""Pictures of a pair: a still image of both drives at the decisive moment, and the frames of a film of both."""

import re
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from brink.pictures.camera_view import FilmView, Reported, SketchView
from brink.pictures.frame import Size
from brink.pictures.map_view import DOTS_M, MapView, Marked, ObstacleStyle, Places, Twin, road_heading
from brink.pictures.motion import is_reference, lane_edge, motion_of
from brink.pictures.pair import (
    DrivePair,
    Interval,
    PairStory,
    Part,
    Side,
    has_ended,
    middles,
    outcome_words,
    pair_story,
    part_state_words,
    reality_words,
    sample_at,
)
from brink.pictures.pair_chart import DIFFERENCE, PairChart, Panel, draw_pair_chart
from brink.pictures.scene import (
    LABELS,
    PARKED,
    TOUCHES_M,
    EpisodeScene,
    FrontGap,
    front_gap,
    gap_to,
    is_car,
    label_index,
    outline,
    plain_name,
)
from brink.pictures.story import report_word, scenario_words
from brink.pictures.style import (
    EDGES,
    FILLS,
    HAIRLINE,
    INK,
    MUTED,
    OTHER_VIOLATED,
    PAPER,
    PEDESTRIAN,
    PLAN_MODES,
    SAFE_DRIVE,
    UNKNOWN_MODE,
    UNSAFE_DRIVE,
    VEHICLE,
    VIOLATION,
    Rgb,
    draw_dashed,
    lighter,
    typeface,
    wrapped,
)
from brink.pictures.timeline import GREATEST_ROBUSTNESS
from brink.sim.trace import Trace
from brink.sim.verdict import clock_words

STILL_WIDTH_PX: Final = 1600
_PLANS: Final = {
    "follow": "keeps behind a vehicle",
    "yield": "slows for crossing traffic",
    "nudge": "passes within the lane",
    "overtake": "passes in the other lane",
    "stop": "stops at a light",
}
"""Meanings of the driving system's plans, in half a line each."""
_LEAST_LEGEND_PX: Final = 10
_ROAD_NUMBER: Final = re.compile(r" \(road \d+\)")
_UNIT: Final = re.compile(r"(\d) (s|m|m/s)\b")
_EDGE_M: Final = 9.0
"""How much of the edge of a lane is drawn on either side of a car that crosses it."""
FILM_SIZE: Final[Size] = (1280, 720)
MAP_SIZE: Final[Size] = (480, 228)
"""Size of the picture of one drive on its own, which a page shows at about half of it."""
_MAP_UNIT_PX: Final = 300
"""Width of a map on which type has its usual size."""
MAP_WIDTH_M: Final = 52.0
_SMALL_MAP_WIDTH_M: Final = 36.0
_REACH_M: Final = 20.0
"""How far from its car the middle of a map may be; the canvas of a map reaches as far beyond the drive."""
AHEAD_S: Final = 4.0
"""How much of each car's way after the moment a still image shows."""
FILM_LEAD_UP_S: Final = 2.0
"""How long before the relevant span a film begins, if the pair names that span."""
_TOLERANCE_S: Final = 1e-3

_MARGIN: Final = 24
_MAP_GAP_PX: Final = 16
_STILL_MAP_WIDTH_PX: Final = (STILL_WIDTH_PX - 2 * _MARGIN - _MAP_GAP_PX) // 2
_MAP_HEIGHT_PX: Final = 400
_SAME_CAR_M: Final = 0.3
"""Cars this close are in the same place: one of them is drawn."""
_CAMERA_SIZE: Final[Size] = (496, 372)
_ONE_BOX_PX: Final = 2.0
"""Reports of both drives whose boxes are this close together are drawn as one."""
_OBSTACLES: Final = ObstacleStyle(
    colour=INK,
    there=tuple(f"reported {label}" for label in LABELS),
    nothing_there=tuple(f"reported {label}, nothing there" for label in LABELS),
    says_what_is_there=True,
)
"""Perceived obstacles in the colour of neither drive."""


class PairPainter:
    """Draws a pair at any time: both drives from above, side by side, over a chart of both.

    Args:
        pair: The pair.
        size: Width and height of the frames in pixels.

    Raises:
        ReplayError: A trace is empty, or does not record the requirement.
    """

    def __init__(self, pair: DrivePair, *, size: Size = FILM_SIZE) -> None:
        self.story: PairStory = pair_story(pair)
        self.size = size
        width, height = size
        self._unit = unit = width / FILM_SIZE[0]
        whole = _clock(pair)
        begins_s = self.story.window().start_s - FILM_LEAD_UP_S if pair.marks else 0.0
        self.time_s = whole[whole >= begins_s - _TOLERANCE_S]
        self._still = Image.new("RGB", size, PAPER)
        draw = ImageDraw.Draw(self._still)
        font = typeface(round(17 * unit), bold=True)
        room = width - 2 * round(14 * unit) - 70 * unit
        lines = [line for words in pair.change.splitlines() for line in wrapped(draw, words, font, room)]
        lines = _at_most(lines or [""], 2)
        y = 8 * unit
        for line in lines:
            draw.text((14 * unit, y), line, fill=INK, font=font)
            y += 22 * unit
        words_px, top = round(42 * unit), round(60 * unit)
        gap = round(10 * unit)
        compares = not pair.about_reports and self.story.target is not None
        chart_px = round((330 if compares else 256) * unit)
        self._map_size = (width - 3 * gap) // 2, height - top - words_px - chart_px
        self._lefts = (gap, 2 * gap + self._map_size[0])
        self._words_y, self._map_y = top, top + words_px
        self._turn_rad = _turn_rad(self.story)
        self._maps = _maps(self.story, self._map_size, unit, self._turn_rad)
        shown = Interval(start_s=float(self.time_s[0]), end_s=max(float(self.time_s[-1]), 1.0))
        panel = Panel.MARGIN if pair.about_reports else Panel.SPEED
        self._chart = draw_pair_chart(
            self.story,
            size=(width, chart_px),
            window=shown,
            panels=tuple(Panel) if compares else (panel,),
            scale=0.92 * unit,
        )
        self._places: tuple[Places, Places] = ({}, {})
        self._still.paste(self._chart.image, (0, height - chart_px))
        self._chart_top = height - chart_px
        for part, left in zip(self.story.parts, self._lefts, strict=True):
            _draw_chip(draw, part, (left, self._words_y), unit)
            text, at = chip_words(part)[1], (left + 98 * unit, self._words_y + unit)
            _fit(draw, at, text, self._map_size[0] - 86 * unit, round(13 * unit), bold=True)

    @property
    def key_samples(self) -> list[int]:
        """Samples that a palette for all frames should cover."""
        return sorted({0, self._sample(self.story.moment_s), len(self.time_s) - 1})

    def frame(self, sample: int) -> Image.Image:
        """Return the frame at a sample of `time_s` as an RGB image."""
        time_s = float(self.time_s[sample])
        frame = self._still.copy()
        draw = ImageDraw.Draw(frame)
        unit = self._unit
        centres = middles(self.story, time_s, self._turn_rad)
        for index, part in enumerate(self.story.parts):
            side, story = part.side, part.story
            left = self._lefts[index]
            compares = not self.story.pair.about_reports
            image = _draw_map(
                self.story,
                self._maps,
                index,
                time_s,
                centres[index],
                ahead=0,
                spread=compares,
                marked=_marked(self.story, index, time_s) if compares else None,
                places=self._places[index],
                gap=_gap_now(self.story, index, time_s) if compares else None,
            )
            frame.paste(image, (left, self._map_y))
            bad = story.violated and time_s >= float(side.trace.time_s[story.shown]) - 1e-3
            heavy = bad and _is_violated(self.story, part, time_s)
            box = (left, self._map_y, left + self._map_size[0] - 1, self._map_y + self._map_size[1] - 1)
            draw.rectangle(
                box, outline=VIOLATION if bad else HAIRLINE, width=round((4 if heavy else 1) * unit)
            )
            at, font = (left + 98 * unit, self._words_y + 20 * unit), typeface(round(12 * unit))
            draw.text(
                at, part_state_words(self.story, part, time_s), fill=VIOLATION if bad else MUTED, font=font
            )
        clock, font = f"{time_s:.1f} s", typeface(round(19 * unit), bold=True)
        draw.text((self.size[0] - 14 * unit, 8 * unit), clock, fill=INK, font=font, anchor="ra")
        _draw_pointer(draw, self._chart, self._chart_top, time_s, unit)
        return frame

    def _sample(self, time_s: float) -> int:
        return int(np.abs(self.time_s - time_s).argmin())


def pair_still(pair: DrivePair) -> Image.Image:
    """Return one image of a pair at the decisive moment.

    Below the change in words are both drives from above at the same time, then the camera image with the boxes that
    were reported in either drive when they differ most, and a chart of both drives over time.

    Args:
        pair: The pair.

    Raises:
        ReplayError: A trace is empty, or does not record the requirement.
    """
    story = pair_story(pair)
    header = _header(story)
    maps = _side_by_side(story)
    camera = _camera(story)
    chart_px = STILL_WIDTH_PX - (_MARGIN + camera.width if camera else 0)
    chart = draw_pair_chart(story, size=(chart_px, 490), window=story.window(), scale=1.2).image
    below = Image.new("RGB", (STILL_WIDTH_PX, max(chart.height, camera.height if camera else 0)), PAPER)
    if camera:
        below.paste(camera, (_MARGIN, 0))
    below.paste(chart, (STILL_WIDTH_PX - chart_px, 0))
    parts = [header, maps, below, _legend(story)]
    whole = Image.new("RGB", (STILL_WIDTH_PX, sum(part.height for part in parts)), PAPER)
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    return whole


def pair_maps(pair: DrivePair, size: Size = MAP_SIZE) -> tuple[Image.Image, Image.Image]:
    """Return both drives from above at the decisive moment, in order, without any text.

    Args:
        pair: The pair.
        size: Width and height of each image.

    Raises:
        ReplayError: A trace is empty, or does not record the requirement.
    """
    story = pair_story(pair)
    turn_rad = _turn_rad(story)
    maps = _maps(story, size, size[0] / _MAP_UNIT_PX, turn_rad, _SMALL_MAP_WIDTH_M)
    first, second = (_still_map(story, maps, index, _middle(story, index, turn_rad)) for index in (0, 1))
    return first, second


def _still_map(
    story: PairStory, maps: list[MapView], index: int, centre_m: NDArray[np.float64]
) -> Image.Image:
    """Return the map of one drive at the moment, with the gap and the road user that the violation is about."""
    side, shown_s = story.parts[index].side, story.shown_at(index)
    ahead = sample_at(side.trace, shown_s + AHEAD_S) - sample_at(side.trace, shown_s)
    return _draw_map(
        story,
        maps,
        index,
        shown_s,
        centre_m,
        ahead=ahead,
        gap=_gap(story, index),
        marked=_marked(story, index, shown_s),
        spread=True,
    )


def _middle(story: PairStory, index: int, turn_rad: float) -> NDArray[np.float64]:
    """Return the middle of the map of a drive in a still image, shape ``(2,)``."""
    shown_s = story.shown_at(index)
    if shown_s == story.shown_at(1 - index):
        return middles(story, shown_s, turn_rad)[index]
    middle: NDArray[np.float64] = story.centres[index][sample_at(story.parts[index].side.trace, shown_s)]
    return middle


def _clock(pair: DrivePair) -> NDArray[np.float64]:
    longer = max((pair.safe.trace, pair.unsafe.trace), key=lambda trace: float(trace.time_s[-1]))
    return np.asarray(longer.time_s, dtype=np.float64)


def _header(story: PairStory) -> Image.Image:
    """Return the change in words as a headline, with the scenario and further facts below."""
    probe = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    room = STILL_WIDTH_PX - 2 * _MARGIN
    place = scenario_words(story.pair.unsafe.trace).partition("; ")[0]
    about = [f"Scenario: {_ROAD_NUMBER.sub('', place)}."]
    if story.pair.about_reports and story.same_seed is not None:
        about.append(
            "Same episode seed: without the change, both drives would be identical."
            if story.same_seed
            else "Different episode seeds: chance differs, too."
        )
    lines = [
        line
        for words in story.pair.change.splitlines()
        for line in _lines(probe, words, 29, INK, room, bold=True)
    ]
    if story.pair.about_reports:
        lines += _lines(probe, reality_words(story), 19, INK, room)
    lines += _lines(probe, " ".join(story.pair.findings), 19, INK, room)
    lines += _lines(probe, " ".join([*about, *story.pair.facts]), 15, MUTED, room)
    image = Image.new("RGB", (STILL_WIDTH_PX, 34 + sum(line.height_px for line in lines)), PAPER)
    _write(ImageDraw.Draw(image), lines, (_MARGIN, 18))
    return image


def _turn_rad(story: PairStory) -> float:
    """Return the rotation of the maps with which the unsafe drive goes to the right at the moment."""
    trace = story.pair.unsafe.trace
    return -road_heading(trace.route, trace.ego, story.unsafe.decisive)


def _maps(
    story: PairStory, size: Size, unit: float, turn_rad: float, width_m: float = MAP_WIDTH_M
) -> list[MapView]:
    return [
        MapView(
            EpisodeScene.of(side.trace),
            size_px=size,
            px_per_m=size[0] / width_m,
            look_ahead_m=_REACH_M,
            font_px=round(12.5 * unit),
            turn_rad=turn_rad,
            obstacle_style=_OBSTACLES if _shows_reports(story, side) else None,
            ego_colour=UNSAFE_DRIVE if is_unsafe else SAFE_DRIVE,
        )
        for _, side, _, is_unsafe in story.parts
    ]


def _shows_reports(story: PairStory, side: Side) -> bool:
    """Return whether the map of a drive shows what was reported: not the truth where that is the same in both."""
    return story.pair.about_reports or report_word(side.trace) != "seen"


def _draw_map(
    story: PairStory,
    maps: list[MapView],
    index: int,
    time_s: float,
    centre_m: "NDArray[np.float64]",
    *,
    ahead: int,
    gap: FrontGap | None = None,
    marked: Marked | None = None,
    spread: bool = False,
    places: Places | None = None,
) -> Image.Image:
    """Return the map of one drive at a time, with the outline of the other drive's car."""
    side, (other_name, other, _, is_unsafe) = story.parts[index].side, story.parts[1 - index]
    twin = None
    if story.same_road:
        x_m, y_m, yaw_rad = (float(v) for v in other.trace.ego[sample_at(other.trace, time_s), :3])
        twin = Twin(
            ego=outline(x_m, y_m, yaw_rad, *other.trace.ego_size_m),
            caption=other.car or f"{other_name} drive",
            colour=UNSAFE_DRIVE if is_unsafe else SAFE_DRIVE,
        )
        mine = side.trace.ego[sample_at(side.trace, time_s), :2]
        if float(np.hypot(*(mine - (x_m, y_m)))) < _SAME_CAR_M:
            twin = None  # the cars are in the same place
    return maps[index].draw(
        sample_at(side.trace, time_s),
        centre_m=centre_m,
        twin=twin,
        ahead=ahead,
        gap=gap,
        marked=marked,
        spread=spread,
        places=places,
        ahead_gap=story.pair.about_reports,
        crossed=_crossed(side.trace, time_s),
    )


def _side_by_side(story: PairStory) -> Image.Image:
    """Return both maps at the moment, each below its verdict."""
    gap, chip_px = _MAP_GAP_PX, 124
    wide = _STILL_MAP_WIDTH_PX
    size = wide, _MAP_HEIGHT_PX
    probe = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    verdicts = [_verdict_lines(probe, story, index, wide - chip_px) for index in (0, 1)]
    words_px = 12 + max(sum(line.height_px for line in lines) for lines in verdicts)
    image = Image.new("RGB", (STILL_WIDTH_PX, words_px + size[1] + 10), PAPER)
    draw = ImageDraw.Draw(image)
    turn_rad = _turn_rad(story)
    maps = _maps(story, size, 1.25, turn_rad)
    for index, part in enumerate(story.parts):
        left = _MARGIN + index * (wide + gap)
        _draw_chip(draw, part, (left, 4), 1.25)
        _write(draw, verdicts[index], (left + chip_px, 5))
        image.paste(_still_map(story, maps, index, _middle(story, index, turn_rad)), (left, words_px))
        box = (left, words_px, left + wide - 1, words_px + size[1] - 1)
        violated = part.story.violated
        edge = VIOLATION if violated else _chip_colour(part)
        draw.rectangle(box, outline=edge, width=4 if violated else 2)
        _draw_scale(draw, (left + 14, words_px + size[1] - 16), size[0] / MAP_WIDTH_M)
    return image


class _Line(NamedTuple):
    text: str
    size_px: int
    bold: bool
    colour: Rgb

    @property
    def height_px(self) -> int:
        return round(1.4 * self.size_px)


def _lines(
    draw: ImageDraw.ImageDraw, text: str, size_px: int, colour: Rgb, width_px: float, *, bold: bool = False
) -> list[_Line]:
    """Return a text as lines of at most a width, without breaks between numbers and units."""
    lines = wrapped(draw, _UNIT.sub("\\1\u00a0\\2", text), typeface(size_px, bold=bold), width_px)
    return [_Line(line, size_px, bold, colour) for line in lines if line]


def _write(draw: ImageDraw.ImageDraw, lines: list[_Line], at: tuple[float, float]) -> None:
    x, y = at
    for line in lines:
        draw.text((x, y), line.text, fill=line.colour, font=typeface(line.size_px, bold=line.bold))
        y += line.height_px


def _marked(story: PairStory, index: int, time_s: float) -> Marked | None:
    """Return the mark of the road user that the violation is about: crimson unless it is reported.

    Where both drives are among the same road users, it is marked in both, with what it does.
    """
    target, is_unsafe = story.target, story.parts[index].is_unsafe
    if target is None or (story.pair.about_reports and not is_unsafe):
        return None
    if story.pair.about_reports:
        return Marked(actor=target.actor, caption=target.words, colour=INK if target.reported else VIOLATION)
    trace = story.parts[index].side.trace
    actor = trace.actors[target.actor]
    caption = ": ".join(filter(None, (actor.name, motion_of(trace, target.actor, sample_at(trace, time_s)))))
    return Marked(actor=target.actor, caption=caption, colour=VIOLATION if is_unsafe else INK, arrow=True)


def _gap(story: PairStory, index: int) -> FrontGap | None:
    """Return the gap of a drive at the moment, with the length that the requirement measured.

    It is the front gap; among the same road users, it is the distance to the one that the violation is about.
    """
    _, side, _, is_unsafe = story.parts[index]
    if is_unsafe and story.target is not None:
        return story.target.gap
    if not story.pair.about_reports:
        return _gap_now(story, index, story.shown_at(index))
    gap = front_gap(side.trace, sample_at(side.trace, story.sample_s))
    return gap and gap_to(side.trace, sample_at(side.trace, story.shown_s), gap.actor, gap.gap_m)


def _gap_now(story: PairStory, index: int, time_s: float) -> FrontGap | None:
    """Return the distance of a drive to the road user that the violation is about at a time, if it is near."""
    trace, is_unsafe = story.parts[index].side.trace, story.parts[index].is_unsafe
    if story.target is None or has_ended(trace, time_s):
        return None
    sample = sample_at(trace, time_s)
    gap = gap_to(trace, sample, story.target.actor)
    if gap is None or not TOUCHES_M <= gap.gap_m < GREATEST_ROBUSTNESS:
        return None
    series = next(
        (values for name, values in trace.robustness.items() if plain_name(name) == "front-gap"), None
    )
    violated = series is not None and bool(series[sample] < 0)
    return replace(gap, required=is_unsafe and violated)


def _is_violated(story: PairStory, part: Part, time_s: float) -> bool:
    """Return whether a drive violates the requirement at a time; a collision lasts for ever."""
    trace = part.side.trace
    if part.story.title == "no-collision":
        return True
    value = float(trace.robustness[part.story.requirement][sample_at(trace, time_s)])
    return value < 0 and not has_ended(trace, time_s)


def _crossed(trace: Trace, time_s: float) -> NDArray[np.float64] | None:
    """Return the edge of the lane that a drive has crossed at a time."""
    sample = sample_at(trace, time_s)
    series = next(
        (values for name, values in trace.robustness.items() if plain_name(name) == "lane-keeping"), None
    )
    if series is None or not series[sample] < 0:
        return None
    return lane_edge(trace, sample, _EDGE_M)


def _verdict_lines(draw: ImageDraw.ImageDraw, story: PairStory, index: int, width_px: float) -> list[_Line]:
    """Return the outcome of a drive, the result of simulating it again, and its state at the moment."""
    part = story.parts[index]
    side = part.side
    time_s, judged_s = story.moment_s, _judged_s(story)
    nearest = part.side.shown_s is not None
    if part.side.shown_s is not None:
        time_s = judged_s = part.side.shown_s
    when = f"{clock_words(time_s)}{', its nearest' if nearest else ''}"
    state = f"at {when}: {part_state_words(story, part, judged_s)}"
    state = f"A{state[1:]}" if side.number is None else f"Solution {side.number} {state}"
    again = side.again[:1].upper() + side.again[1:]
    return [
        *_lines(draw, chip_words(part)[1], 18, INK, width_px, bold=True),
        *_lines(draw, again, 15, INK, width_px),
        *_lines(draw, state, 15, MUTED, width_px),
    ]


def _judged_s(story: PairStory) -> float:
    """Return the time of the sample that decides the moment; distances come from the sample that shows it."""
    return story.sample_s if story.pair.about_reports else story.shown_s


def _held_but(part: Part) -> bool:
    """Return whether a drive is the safe one of a pair, but violated another requirement."""
    return not part.is_unsafe and not part.story.violated and bool(part.story.violations)


def _chip_colour(part: Part) -> Rgb:
    if _held_but(part):
        return OTHER_VIOLATED
    return UNSAFE_DRIVE if part.is_unsafe else SAFE_DRIVE


def chip_words(part: Part) -> tuple[str, str]:
    """Return the word on the chip of a drive, and its outcome as text that continues where the chip ends."""
    words = outcome_words(part.side, part.story)
    if part.side.chip:
        return part.side.chip, words
    if not _held_but(part):
        return "VIOLATED" if part.is_unsafe else "HELD", words
    held, _, others = words.partition("; ")
    return "HELD, BUT", f"{others} ({held})" if others else words


def _draw_chip(draw: ImageDraw.ImageDraw, part: Part, at: tuple[float, float], unit: float) -> None:
    """Draw whether a side held the requirement in white on its colour, or purple if it violated another one."""
    left, top = at
    box = (left, top, left + 90 * unit, top + 22 * unit)
    draw.rounded_rectangle(box, radius=4 * unit, fill=_chip_colour(part))
    font = typeface(round(13 * unit), bold=True)
    middle = left + 45 * unit, top + 11 * unit
    word, _ = chip_words(part)
    draw.text(middle, word, fill=PAPER, font=font, anchor="mm")


def _camera(story: PairStory) -> Image.Image | None:
    """Return the camera's view of the reports: both drives' boxes when they differ most; None without any."""
    safe, unsafe = (side.trace for side in (story.pair.safe, story.pair.unsafe))
    if not story.pair.about_reports:
        return None
    if safe.film is not None and unsafe.film is not None:
        return _films(story)
    if not len(safe.given_boxes.rows) and not len(unsafe.given_boxes.rows):
        return None
    differs_s = story.report_moment_s()
    time_s = story.moment_s if differs_s is None else differs_s
    size = _CAMERA_SIZE
    sample = sample_at(unsafe, time_s)
    reports = [
        Reported(side.trace.given_boxes.at(sample_at(side.trace, time_s)), colour, f"{name}:")
        for (name, side, _, _), colour in zip(story.parts, (SAFE_DRIVE, UNSAFE_DRIVE), strict=True)
    ]
    image = Image.new("RGB", (size[0], size[1] + 104), PAPER)
    draw = ImageDraw.Draw(image)
    what = "when the reports differ most" if differs_s is not None else "at the moment of the violation"
    draw.text((0, 4), f"Camera at {clock_words(time_s)}, {what}", fill=INK, font=typeface(17, bold=True))
    image.paste(SketchView(unsafe, size_px=size).draw(sample, _joined(reports)), (0, 32))
    draw.rectangle((0, 32, size[0] - 1, 31 + size[1]), outline=HAIRLINE)
    y = 32 + size[1] + 8
    said = [_report_words(report) for report in reports]
    words = f"Reported: {said[0]} in the safe drive, {said[1]} in the unsafe one."
    if report_word(unsafe) == "injected":
        words += " The car knows nothing else of other road users."
    _write(draw, _lines(draw, f"{words} Green: what is there.", 15, MUTED, size[0]), (0, y))
    return image


def _joined(reports: list[Reported]) -> list[Reported]:
    """Return reports of two drives with the boxes that both drives have in a third report."""
    safe, unsafe = reports
    shared: list[tuple[int, int]] = []
    for index, row in enumerate(safe.rows):
        near = np.flatnonzero(
            (np.abs(unsafe.rows - row).max(axis=1) < _ONE_BOX_PX) & (unsafe.rows[:, 0] == row[0])
        )
        shared += [(index, int(other)) for other in near[:1]]
    if not shared:
        return reports
    return [
        safe._replace(rows=np.delete(safe.rows, [one for one, _ in shared], axis=0)),
        unsafe._replace(rows=np.delete(unsafe.rows, [other for _, other in shared], axis=0)),
        Reported(safe.rows[[one for one, _ in shared]], INK, "both:"),
    ]


def _report_words(report: Reported) -> str:
    """Describe the reports, such as ``person, 2 vehicles``."""
    labels = [label_index(label) for label in report.rows[:, 0]]
    counts = [(LABELS[label], labels.count(label)) for label in sorted(set(labels))]
    return ", ".join(name if count == 1 else f"{count} {name}s" for name, count in counts) or "nothing"


def _films(story: PairStory) -> Image.Image:
    """Return the recorded images of both drives at the moment, one above the other."""
    size = (400, 204)
    image = Image.new("RGB", (size[0], 2 * (size[1] + 28)), PAPER)
    draw = ImageDraw.Draw(image)
    for index, (name, side, _, _) in enumerate(story.parts):
        top = index * (size[1] + 28)
        film = side.trace.film
        assert film is not None  # checked by the caller
        draw.text((0, top + 4), f"Camera, {name} drive", fill=INK, font=typeface(15, bold=True))
        view = FilmView(side.trace, film, size_px=size)
        image.paste(view.draw(sample_at(side.trace, story.moment_s)), (0, top + 26))
    return image


def _legend(story: PairStory) -> Image.Image:
    """Return the keys of the maps in one row."""
    rows = [row for row in (_legend_entries(story), _plan_entries(story)) if row]
    image = Image.new("RGB", (STILL_WIDTH_PX, 18 + 26 * len(rows)), PAPER)
    draw = ImageDraw.Draw(image)
    for place, row in enumerate(rows):
        size = 14
        while size > _LEAST_LEGEND_PX and _row_width(draw, row, size) > STILL_WIDTH_PX - 2 * _MARGIN:
            size -= 1
        x, y, font = float(_MARGIN), 18.0 + 26 * place, typeface(size)
        for key, words in row:
            _draw_key(draw, key, x, y)
            draw.text((x + 40, y), words, fill=MUTED, font=font, anchor="lm")
            x += 40 + draw.textlength(words, font=font) + 26
    return image


def _row_width(draw: ImageDraw.ImageDraw, row: list[tuple[str, str]], size_px: int) -> float:
    return sum(66 + draw.textlength(words, font=typeface(size_px)) for _, words in row) - 26


def _plan_entries(story: PairStory) -> list[tuple[str, str]]:
    """Return the keys of the plans that need an explanation, as far as the chart shows them."""
    window = story.window()
    shown: set[str] = set()
    for part in story.parts:
        trace = part.side.trace
        inside = (trace.time_s >= window.start_s) & (trace.time_s <= window.end_s)
        if not is_reference(trace):
            shown |= {str(trace.plan_mode[sample]) for sample in np.flatnonzero(inside)}
    return [(f"plan {mode}", f"{mode}: {words}") for mode, words in _PLANS.items() if mode in shown]


def _legend_entries(story: PairStory) -> list[tuple[str, str]]:
    """Return the keys of the maps and the chart, each with its words."""
    seen = [_in_view(story, index) for index in (0, 1)]
    entries = [
        ("unsafe" if part.is_unsafe else "safe", part.side.car or f"{part.name} drive")
        for part in story.parts
    ]
    entries += [
        (key, words)
        for key, words in (
            ("twin", "filled: this drive; outline: the other one at the same time"),
            ("dots", f"its next {AHEAD_S:g} s"),
            ("vehicle", "vehicle"),
            ("parked", "parked"),
            ("person", "person"),
            ("ghost", "reported obstacle; crossed: not there"),
        )
        if any(key in one for one in seen)
    ]
    window = story.window()
    if any(span.start_s < window.end_s and span.end_s > window.start_s for span in story.differing):
        entries.append(("shading", "reports differ"))
    return entries


def _in_view(story: PairStory, index: int) -> set[str]:
    """Return which keys of the legend a map at the moment needs."""
    trace, other = story.parts[index].side.trace, story.parts[1 - index].side.trace
    shown_s = story.shown_at(index)
    turn_rad, sample = _turn_rad(story), sample_at(trace, shown_s)
    centre = _middle(story, index, turn_rad)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    half = np.array([MAP_WIDTH_M / 2, MAP_WIDTH_M / 2 * _MAP_HEIGHT_PX / _STILL_MAP_WIDTH_PX])

    def visible(points: NDArray[np.float64]) -> bool:
        return bool((np.abs((points - centre) @ turn) < half).all(axis=-1).any())

    found = set()
    for actor in trace.actors:
        if visible(np.asarray(actor.motion[sample, :2], np.float64)):
            found.add("vehicle" if is_car(actor) else "person")
    if any(s.kind == PARKED and visible(s.points.astype(np.float64)) for s in trace.scene):
        found.add("parked")
    rows = trace.perceived.at(sample)
    if (
        len(rows)
        and _shows_reports(story, story.parts[index].side)
        and visible(rows[:, 2:4].astype(np.float64))
    ):
        found.add("ghost")
    if story.same_road:
        there = other.ego[sample_at(other, shown_s), :2].astype(np.float64)
        if visible(there) and float(np.hypot(*(there - trace.ego[sample, :2]))) >= _SAME_CAR_M:
            found.add("twin")
    last = sample_at(trace, shown_s + AHEAD_S)
    path = np.hypot(*np.diff(trace.ego[sample : last + 1, :2], axis=0).T).sum()
    if path > trace.ego_size_m[0] / 2 + DOTS_M:
        found.add("dots")
    return found


def _draw_key(draw: ImageDraw.ImageDraw, key: str, x: float, y: float) -> None:
    box = (x + 8, y - 6, x + 34, y + 6)
    corners = np.array([(box[0], box[1]), (box[2], box[1]), (box[2], box[3]), (box[0], box[3])])
    if key in ("safe", "unsafe"):
        colour = SAFE_DRIVE if key == "safe" else UNSAFE_DRIVE
        draw.line((x, y, x + 10, y), fill=lighter(colour, 0.35), width=3)
        draw.rounded_rectangle(box, radius=4, fill=colour)
    elif key == "vehicle":
        draw.rounded_rectangle(box, radius=4, fill=VEHICLE)
    elif key == "dots":
        for at in (x + 12, x + 21, x + 30):
            draw.ellipse((at - 2, y - 2, at + 2, y + 2), fill=MUTED)
    elif key.startswith("plan "):
        draw.rectangle((x + 12, y - 6, x + 30, y + 6), fill=PLAN_MODES.get(key[5:], UNKNOWN_MODE))
    elif key == "parked":
        draw.rectangle(box, fill=FILLS[PARKED], outline=EDGES[PARKED])
    elif key == "shading":
        draw.rectangle(box, fill=DIFFERENCE)
    elif key == "person":
        draw.ellipse((x + 16, y - 5, x + 26, y + 5), fill=PEDESTRIAN)
    elif key == "twin":
        for shift, colour in ((0, SAFE_DRIVE), (6, UNSAFE_DRIVE)):
            draw.rectangle(
                (x + shift, y - 6 + shift / 2, x + 24 + shift, y + 4 + shift / 2), outline=colour, width=2
            )
    else:
        draw_dashed(draw, corners, INK, dash=5, gap=3, width=2)
        draw.line(box, fill=INK)
        draw.line((box[0], box[3], box[2], box[1]), fill=INK)


def _draw_scale(draw: ImageDraw.ImageDraw, at: tuple[float, float], px_per_m: float) -> None:
    left, y = at
    right = left + 10 * px_per_m
    draw.line((left, y, right, y), fill=INK, width=2)
    for x in (left, right):
        draw.line((x, y - 5, x, y + 5), fill=INK, width=2)
    draw.text(((left + right) / 2, y - 11), "10 m", fill=INK, font=typeface(14), anchor="mm")


def _draw_pointer(draw: ImageDraw.ImageDraw, chart: PairChart, top: int, time_s: float, unit: float) -> None:
    x = chart.x_px(time_s)
    tip = top + chart.top_px
    draw.line((x, tip, x, top + chart.bottom_px), fill=INK, width=max(2, round(2 * unit)))
    draw.polygon((x - 5 * unit, tip - 6 * unit, x + 5 * unit, tip - 6 * unit, x, tip + 2 * unit), fill=INK)


def _fit(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    text: str,
    width_px: float,
    size_px: int,
    colour: Rgb = INK,
    *,
    bold: bool = False,
) -> None:
    """Write text on one line, smaller if it is too wide, and cut if it still is."""
    size = size_px
    while size > 0.7 * size_px and draw.textlength(text, font=typeface(size, bold=bold)) > width_px:
        size -= 1
    font = typeface(size, bold=bold)
    while draw.textlength(text, font=font) > width_px and len(text) > 4:
        text = text[:-2].rstrip(" ,;…") + "…"
    draw.text(at, text, fill=colour, font=font)


def _at_most(lines: list[str], count: int) -> list[str]:
    return lines if len(lines) <= count else [*lines[: count - 1], lines[count - 1] + " …"]
