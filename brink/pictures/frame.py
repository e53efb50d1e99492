"""One frame of a replay: header, map from above, camera view, panel with legend, and time bar."""

from dataclasses import dataclass
from typing import Final, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from brink.pictures.camera_view import camera_view, draw_film_legend
from brink.pictures.guard import guard_words
from brink.pictures.map_view import HIDDEN_WHITE, MapView
from brink.pictures.reference import avoidable_words
from brink.pictures.scene import PERSON, EpisodeScene, ReplayError, count_wrong, has_errors
from brink.pictures.story import (
    Judged,
    Story,
    ViolatedHere,
    margin_name,
    measured_words,
    no_needless_braking,
    perturbation_words,
    report_word,
    reported,
    runs,
    scenario_words,
    story_of,
    with_unit,
)
from brink.pictures.style import (
    EGO,
    EGO_TRAIL,
    GHOST,
    GUARD_DOES,
    HAIRLINE,
    INK,
    LAMP_OFF,
    LIGHTS,
    MUTED,
    PANEL,
    PAPER,
    PEDESTRIAN,
    PLAN_MODES,
    ROUTE,
    SEEN,
    UNKNOWN_MODE,
    VEHICLE,
    VIOLATION,
    Rgb,
    draw_banner,
    draw_dashed,
    lighter,
    readable_on,
    typeface,
)
from brink.sim.trace import FloatArray, Trace
from brink.sim.verdict import clock_words, held_words

Size: TypeAlias = tuple[int, int]
Rectangle: TypeAlias = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels."""

DEFAULT_SIZE: Final[Size] = (960, 540)
LEAST_SIZE: Final[Size] = (640, 360)
GREATEST_SIZE: Final[Size] = (1920, 1080)

MAP_WIDTH_M: Final = 62.0
SMALL_MAP_WIDTH_M: Final = 40.0
LOOK_AHEAD_M: Final = 9.0
SCALE_BAR_M: Final = 10.0
SPEED_BAR_TO_MPS: Final = 14.0
LAMPS: Final = ("red", "amber", "green")
_ROW: Final = 13
"""Height of a row of the time bar, in units."""
_FEW_LETTERS: Final = 16
"""A longer text in the panel is written smaller."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The rectangles of a frame, and the unit that text and lines scale with, 1 at a height of 540 px."""

    size: Size
    unit: float
    header: Rectangle
    map: Rectangle
    camera: Rectangle
    panel: Rectangle
    time_bar: Rectangle

    @classmethod
    def of(cls, size: Size, *, filmed: bool = False, guarded: bool = False) -> Self:
        """Return the layout of a frame.

        Args:
            size: Width and height of the frame.
            filmed: Whether the recorded camera image (16:9) takes the large area and the map the small one.
            guarded: Whether the time bar has a row for a guard.

        Raises:
            ReplayError: The size is out of bounds, or odd (H.264 stores colours at half resolution).
        """
        width, height = size
        (least_width, least_height), (most_width, most_height) = LEAST_SIZE, GREATEST_SIZE
        within = least_width <= width <= most_width and least_height <= height <= most_height
        if not within or width % 2 or height % 2:
            raise ReplayError(
                f"size: expected even numbers of pixels from {least_width}x{least_height} to "
                f"{most_width}x{most_height}, got {width}x{height}"
            )
        unit = min(width / DEFAULT_SIZE[0], height / DEFAULT_SIZE[1])
        top, bottom = round(32 * unit), height - round((58 + (_ROW if guarded else 0)) * unit)
        side = width - round(300 * unit)
        gap = round(10 * unit)
        camera_right, camera_top = width - gap, top + gap
        camera_left = side + gap
        camera_bottom = camera_top + round((camera_right - camera_left) * 3 / 4)
        large, small = (0, top, side, bottom), (camera_left, camera_top, camera_right, camera_bottom)
        return cls(
            size=size,
            unit=unit,
            header=(0, 0, width, top),
            map=small if filmed else large,
            camera=(0, top, side, top + round(side * 9 / 16)) if filmed else small,
            panel=(camera_left, camera_bottom + gap, camera_right, bottom),
            time_bar=(0, bottom, width, height),
        )


def extent(rectangle: Rectangle) -> Size:
    """Return the width and height of a rectangle."""
    left, top, right, bottom = rectangle
    return right - left, bottom - top


class FramePainter:
    """Draws any sample of one episode as a frame; the parts that never change are drawn once.

    Args:
        trace: The episode.
        requirement: Ids of the requirements to judge; for the default see `story_of`.
        size: Width and height of the frames in pixels.

    Raises:
        ReplayError: The trace is empty, lacks the requirement, or the size is out of bounds.
    """

    def __init__(self, trace: Trace, *, requirement: Judged = None, size: Size = DEFAULT_SIZE) -> None:
        self.trace = trace
        self.story: Story = story_of(trace, requirement)
        self.layout = Layout.of(size, filmed=self.filmed, guarded=trace.guard is not None)
        self.px_per_m = extent(self.layout.map)[0] / (SMALL_MAP_WIDTH_M if self.filmed else MAP_WIDTH_M)
        self.scene = EpisodeScene.of(trace)
        self._map = MapView(
            self.scene,
            size_px=extent(self.layout.map),
            px_per_m=self.px_per_m,
            look_ahead_m=LOOK_AHEAD_M,
            font_px=round(13 * self.layout.unit),
        )
        self._camera = camera_view(trace, extent(self.layout.camera))
        self._panel = _Panel(self.scene, self.story, self.layout)
        self._bar = _TimeBar(trace, self.story, self.layout)
        self._still = Image.new("RGB", size, PAPER)
        self._paint_grounds()
        self._panel.draw_still(self._still)
        self._bar.draw_still(self._still)
        self._clock = typeface(round(17 * self.layout.unit), bold=True)
        self._draw_captions()

    def __len__(self) -> int:
        return len(self.trace.time_s)

    @property
    def size(self) -> Size:
        """Width and height of the frames in pixels."""
        return self.layout.size

    @property
    def time_s(self) -> FloatArray:
        """Times of the samples, shape ``(n,)``."""
        return self.trace.time_s

    @property
    def key_samples(self) -> list[int]:
        """Samples of the moments of the story, which have all colours of a film."""
        return [moment.sample for moment in self.story.moments]

    @property
    def filmed(self) -> bool:
        """Whether the trace contains recorded camera images."""
        return self.trace.film is not None

    def frame(self, sample: int) -> Image.Image:
        """Return the frame at a sample as an RGB image."""
        frame = self._still.copy()
        frame.paste(self.map(sample), self.layout.map[:2])
        frame.paste(self.camera(sample), self.layout.camera[:2])
        draw = ImageDraw.Draw(frame)
        left, top, right, bottom = self.layout.camera
        draw.rectangle((left - 1, top - 1, right, bottom), outline=HAIRLINE)
        self._panel.draw(frame, sample)
        self._bar.draw(frame, sample)
        self._draw_clock(draw, sample)
        return frame

    def map(self, sample: int) -> Image.Image:
        """Return the map at a sample with its scale bar and, without camera images, the verdict on a violation."""
        image = self._map.draw(sample)
        self._draw_scale(image)
        return image if self.filmed else self._with_verdict(image, sample)

    def camera(self, sample: int) -> Image.Image:
        """Return the camera view at a sample; for recorded images, also with the verdict on a violation."""
        image = self._camera.draw(sample)
        return self._with_verdict(image, sample) if self.filmed else image

    def verdict(self) -> str:
        """Return what happened in words: the requirement of the replay, and every other one that was violated."""
        name, time_s = self.story.title, float(self.trace.time_s[self.story.decisive])
        if self.story.violated:
            return "; ".join(map(self._told, self.story.violations))
        held = held_words([name])
        if no_needless_braking(name, self.story.least):
            return self.story.words
        if not np.isfinite(self.story.least):
            return self.story.words.replace(held, f"{name.replace('-', ' ')} never applied", 1)
        spare = f"{held} ({with_unit(self.story.least, self.story.unit)} to spare at {clock_words(time_s)})"
        return self.story.words.replace(held, spare, 1)

    def _told(self, violation: ViolatedHere) -> str:
        """Describe a violation, and who would have avoided it, if that was measured."""
        return ", ".join(filter(None, (violation.words, avoidable_words(self.trace, violation.requirement))))

    def _with_verdict(self, image: Image.Image, sample: int) -> Image.Image:
        """Frame an image in red from the first violation of any requirement on, and name those so far."""
        so_far = [self._told(one) for one in self.story.violations if sample >= one.shown]
        if so_far:
            unit = self.layout.unit
            draw = ImageDraw.Draw(image)
            width = max(3, round(4 * unit))
            draw.rectangle((0, 0, image.width - 1, image.height - 1), outline=VIOLATION, width=width)
            draw_banner(draw, (image.width / 2, 22 * unit), "; ".join(so_far), unit, room=image.width)
        return image

    def _paint_grounds(self) -> None:
        draw = ImageDraw.Draw(self._still)
        width, height = self.layout.size
        draw.rectangle((0, 0, width, height), fill=PANEL)
        draw.rectangle(self.layout.header, fill=PAPER)
        draw.rectangle(self.layout.time_bar, fill=PAPER)
        for y in (self.layout.header[3] - 1, self.layout.time_bar[1]):
            draw.line((0, y, width, y), fill=HAIRLINE)

    def _draw_captions(self) -> None:
        unit = self.layout.unit
        draw = ImageDraw.Draw(self._still)
        words = scenario_words(self.trace) or "Episode"
        font = typeface(round(13 * unit))
        room = self.layout.size[0] - 100 * unit
        while draw.textlength(words, font=font) > room and len(words) > 4:
            words = words[:-2].rstrip(" ,…") + "…"
        draw.text((12 * unit, 16 * unit), words, fill=INK, font=font, anchor="lm")
        if self.filmed:
            left, _, _, bottom = self.layout.camera
            bold = typeface(round(15 * unit), bold=True)
            perturbations = perturbation_words(self.trace) or "not perturbed"
            draw.text((left + 12 * unit, bottom + 22 * unit), perturbations, fill=INK, font=bold, anchor="lm")
            draw_film_legend(draw, (left + 12 * unit, bottom + 50 * unit), unit)

    def _draw_clock(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        unit = self.layout.unit
        text = f"{float(self.trace.time_s[sample]):.1f} s"
        draw.text((self.layout.size[0] - 12 * unit, 16 * unit), text, fill=INK, font=self._clock, anchor="rm")

    def _draw_scale(self, image: Image.Image) -> None:
        unit = self.layout.unit
        draw = ImageDraw.Draw(image)
        left, y = 12 * unit, image.height - 14 * unit
        right = left + SCALE_BAR_M * self.px_per_m
        width = max(2, round(2 * unit))
        draw.line((left, y, right, y), fill=INK, width=width)
        for x in (left, right):
            draw.line((x, y - 4 * unit, x, y + 4 * unit), fill=INK, width=width)
        font = typeface(round(11 * unit))
        draw.text(((left + right) / 2, y - 9 * unit), f"{SCALE_BAR_M:g} m", fill=INK, font=font, anchor="mm")


class _Panel:
    """Draws speed, robustness, plan mode, traffic light and legend onto a frame."""

    def __init__(self, scene: EpisodeScene, story: Story, layout: Layout) -> None:
        self._trace = trace = scene.trace
        self._hides = any(hidden.any() for hidden in scene.actors_hidden)
        self._story = story
        self._unit = layout.unit
        self._left, self._top, self._right, self._bottom = layout.panel
        self._small = typeface(round(11 * layout.unit))
        self._word = typeface(round(12 * layout.unit), bold=True)
        self._number = typeface(round(17 * layout.unit), bold=True)
        self._fastest = max(SPEED_BAR_TO_MPS, float(trace.ego[:, 3].max()))

    def draw_still(self, frame: Image.Image) -> None:
        """Draw the parts that every frame shares: captions and the legend."""
        draw = ImageDraw.Draw(frame)
        unit, left = self._unit, self._left
        middle = (left + self._right) / 2
        draw.text((left, self._top), "speed", fill=MUTED, font=self._small)
        gap = self._story.title == "front-gap"
        name = "front gap" if gap else margin_name(self._story.title)
        draw.text((middle, self._top), name, fill=MUTED, font=self._small)
        draw.text((left, self._top + 52 * unit), "plan", fill=MUTED, font=self._small)
        draw.text((middle, self._top + 52 * unit), "traffic light", fill=MUTED, font=self._small)
        line = self._top + round(100 * unit)
        draw.line((left, line, self._right, line), fill=HAIRLINE)
        self._draw_legend(draw, line + round(8 * unit))

    def draw(self, frame: Image.Image, sample: int) -> None:
        """Draw the values at a sample."""
        draw = ImageDraw.Draw(frame)
        self._draw_speed(draw, sample)
        self._draw_requirement(draw, sample)
        self._draw_plan(draw, self._trace.plan_mode[sample])
        self._draw_light(draw, self._trace.lights[sample])

    def _draw_speed(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        unit, left, top = self._unit, self._left, self._top + 14 * self._unit
        speed, target = float(self._trace.ego[sample, 3]), float(self._trace.target_speed_mps[sample])
        draw.text((left, top), f"{speed:.1f} m/s", fill=INK, font=self._number)
        right = left + 120 * unit
        bar = top + 24 * unit
        draw.rectangle((left, bar, right, bar + 5 * unit), fill=HAIRLINE)
        full = (right - left) / self._fastest
        draw.rectangle((left, bar, left + max(0.0, speed) * full, bar + 5 * unit), fill=EGO)
        at = left + min(max(0.0, target), self._fastest) * full
        draw.line((at, bar - 2 * unit, at, bar + 7 * unit), fill=INK, width=max(2, round(2 * unit)))

    def _draw_requirement(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        middle = (self._left + self._right) / 2
        value = float(self._trace.robustness[self._story.requirement][sample])
        top = self._top + 14 * self._unit
        finite = bool(np.isfinite(value))
        text, note = "not applicable", ""
        if finite:
            text, note = measured_words(self._story.requirement, value, self._story.unit)
        colour = VIOLATION if value < 0 else INK
        draw.text(
            (middle, top),
            text,
            fill=colour,
            font=self._number if note and len(text) <= _FEW_LETTERS else self._word,
        )
        draw.text(
            (middle, top + 21 * self._unit), note, fill=colour if value < 0 else MUTED, font=self._small
        )

    def _draw_plan(self, draw: ImageDraw.ImageDraw, mode: str) -> None:
        unit = self._unit
        colour = PLAN_MODES.get(mode, UNKNOWN_MODE)
        left, top = self._left, self._top + 67 * unit
        box = (left, top, left + 100 * unit, top + 21 * unit)
        draw.rounded_rectangle(box, radius=4 * unit, fill=colour)
        middle = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
        draw.text(middle, mode, fill=readable_on(colour), font=self._word, anchor="mm")

    def _draw_light(self, draw: ImageDraw.ImageDraw, state: str) -> None:
        unit = self._unit
        left, top = (self._left + self._right) / 2, self._top + 67 * unit
        if not state:
            draw.text((left, top + 10 * unit), "none", fill=MUTED, font=self._small, anchor="lm")
            return
        draw.rounded_rectangle((left, top, left + 62 * unit, top + 21 * unit), radius=5 * unit, fill=INK)
        for index, lamp in enumerate(LAMPS):
            x, y, radius = left + (12 + 19 * index) * unit, top + 10.5 * unit, 7 * unit
            colour = LIGHTS[lamp] if lamp == state else LAMP_OFF
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
        draw.text((left + 69 * unit, top + 10.5 * unit), state, fill=INK, font=self._small, anchor="lm")

    def _draw_legend(self, draw: ImageDraw.ImageDraw, top: float) -> None:
        unit = self._unit
        entries = [
            ("ego and trail", "ego"),
            ("route", "route"),
            ("vehicle", "vehicle"),
            ("pedestrian", "person"),
            ("ghost: perceived, not there", "ghost"),
            ("camera: ground truth", "box"),
            ("camera: reported", "dashed"),
        ]
        if self._trace.film is not None:
            entries = entries[:4]  # the lines on the image are explained below it
        if self._hides:
            entries.append(("camera: hidden", "hidden"))
        spots = [(0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (0, 3), (0, 4), (1, 4)]
        for (text, key), (column, row) in zip(entries, spots, strict=False):
            x = self._left + column * (self._right - self._left) / 2
            y = top + (9 + 20 * row) * unit
            if y + 8 * unit > self._bottom:
                continue
            self._draw_key(draw, key, x, y)
            draw.text((x + 32 * unit, y), text, fill=INK, font=self._small, anchor="lm")

    def _draw_key(self, draw: ImageDraw.ImageDraw, key: str, x: float, y: float) -> None:
        """Draw a legend key (an example of a shape or line) to the left of its name."""
        unit = self._unit
        left, top, right, bottom = x + 5 * unit, y - 6 * unit, x + 25 * unit, y + 6 * unit
        if key == "ego":
            draw.line((x, y, x + 8 * unit, y), fill=EGO_TRAIL, width=max(2, round(2 * unit)))
        if key in ("ego", "vehicle"):
            car = (left, y - 4.5 * unit, right, y + 4.5 * unit)
            draw.rounded_rectangle(car, radius=3 * unit, fill=EGO if key == "ego" else VEHICLE)
        elif key == "route":
            draw.line((x + 2 * unit, y, right, y), fill=ROUTE, width=max(2, round(3 * unit)))
        elif key == "person":
            draw.ellipse((x + 11 * unit, y - 4 * unit, x + 19 * unit, y + 4 * unit), fill=PEDESTRIAN)
        elif key == "hidden":
            low, high = y - 4.5 * unit, y + 4.5 * unit
            draw.rectangle((left, low, right, high), fill=lighter(VEHICLE, HIDDEN_WHITE))
            outline = np.array([(left, low), (right, low), (right, high), (left, high)])
            draw_dashed(draw, outline, VEHICLE, dash=3 * unit, gap=3 * unit, width=1)
        elif key == "box":
            draw.rectangle((left, top, right, bottom), outline=SEEN, width=2)
        else:
            box = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
            draw_dashed(draw, box, GHOST, dash=4 * unit, gap=3 * unit, width=2)
        if key == "ghost":
            draw.line((left, top, right, bottom), fill=GHOST)
            draw.line((left, bottom, right, top), fill=GHOST)


class _TimeBar:
    """Draws plan, reported boxes, violations and the guard over time onto a frame, and a pointer at the sample."""

    def __init__(self, trace: Trace, story: Story, layout: Layout) -> None:
        self._trace = trace
        self._story = story
        self._unit = layout.unit
        left, self._top, right, self._bottom = layout.time_bar
        self._left = left + round(70 * layout.unit)
        self._right = right - round(16 * layout.unit)
        self._font = typeface(round(10 * layout.unit))
        self._time_s = np.asarray(trace.time_s, dtype=np.float64)
        self._start_s = float(self._time_s[0])
        self._span_s = max(1e-6, float(self._time_s[-1] - self._time_s[0]))
        self._axis_y = self._top + (46 + (_ROW if trace.guard is not None else 0)) * layout.unit

    def draw_still(self, frame: Image.Image) -> None:
        """Draw the rows and the time axis."""
        draw = ImageDraw.Draw(frame)
        unit = self._unit
        reports = report_word(self._trace) if self._trace.film is None else "person seen"
        names = ["plan", reports, "violated", *(["guard"] if self._trace.guard is not None else [])]
        rows = [self._top + (6 + _ROW * row) * unit for row in range(len(names))]
        for name, y in zip(names, rows, strict=True):
            draw.text((self._left - 6 * unit, y + 5 * unit), name, fill=MUTED, font=self._font, anchor="rm")
            draw.rectangle((self._left, y, self._right, y + 10 * unit), fill=(238, 240, 242))
        for mode, first, last in runs(self._trace.plan_mode):
            self._draw_word(draw, mode, first, last, rows[0], PLAN_MODES.get(mode, UNKNOWN_MODE))
        for count, first, last in runs(self._reported().tolist()):
            if count:
                self._draw_run(draw, first, last, rows[1], GHOST)
        below = np.any([np.asarray(series) < 0 for series in self._trace.robustness.values()], axis=0)
        for violated, first, last in runs(below.tolist()):
            if violated:
                self._draw_run(draw, self._shown_from(first), last, rows[2], VIOLATION)
        for word, first, last in runs(guard_words(self._trace)):
            if word:
                self._draw_word(draw, word, first, last, rows[-1], GUARD_DOES[word])
        self._draw_axis(draw, self._axis_y)

    def draw(self, frame: Image.Image, sample: int) -> None:
        """Draw the pointer at a sample."""
        draw = ImageDraw.Draw(frame)
        unit = self._unit
        x = self._x_px(float(self._time_s[sample]))
        tip = self._top + 2 * unit
        draw.line((x, tip, x, self._axis_y - 2 * unit), fill=INK, width=max(2, round(2 * unit)))
        draw.polygon(
            (x - 5 * unit, tip - 3 * unit, x + 5 * unit, tip - 3 * unit, x, tip + 4 * unit), fill=INK
        )

    def _shown_from(self, sample: int) -> int:
        """Return the sample that shows a violation that begins at a sample."""
        return next((one.shown for one in self._story.violations if one.sample == sample), sample)

    def _x_px(self, time_s: float) -> float:
        return self._left + (time_s - self._start_s) / self._span_s * (self._right - self._left)

    def _reported(self) -> NDArray[np.int64]:
        """Return the number of reported boxes at each sample, shape ``(n,)``.

        With recorded images, only people are counted; with errors, wrong and missing boxes.
        """
        if has_errors(self._trace):
            return count_wrong(self._trace)
        if self._trace.film is None:
            return np.asarray(np.diff(self._trace.given_boxes.first), np.int64)
        return reported(self._trace, PERSON)

    def _edges(self, first: int, last: int) -> tuple[float, float]:
        end = min(last + 1, len(self._time_s) - 1)
        left = self._x_px(float(self._time_s[first]))
        return left, max(left + 2, self._x_px(float(self._time_s[end])))

    def _draw_run(self, draw: ImageDraw.ImageDraw, first: int, last: int, y: float, colour: Rgb) -> None:
        left, right = self._edges(first, last)
        draw.rectangle((left, y, right, y + 10 * self._unit), fill=colour)

    def _draw_word(
        self, draw: ImageDraw.ImageDraw, word: str, first: int, last: int, y: float, colour: Rgb
    ) -> None:
        self._draw_run(draw, first, last, y, colour)
        left, right = self._edges(first, last)
        if draw.textlength(word, font=self._font) + 6 < right - left:
            middle = (left + right) / 2, y + 5 * self._unit
            draw.text(middle, word, fill=readable_on(colour), font=self._font, anchor="mm")

    def _draw_axis(self, draw: ImageDraw.ImageDraw, y: float) -> None:
        step_s = next(step for step in (1, 2, 5, 10, 30, 60, 600) if self._span_s / step <= 12 or step == 600)
        for tick in np.arange(
            np.ceil(self._start_s / step_s) * step_s, self._start_s + self._span_s + 1e-6, step_s
        ):
            x = self._x_px(float(tick))
            draw.line((x, y - 2 * self._unit, x, y), fill=HAIRLINE)
            draw.text((x, y + 5 * self._unit), f"{tick:g} s", fill=MUTED, font=self._font, anchor="mm")
