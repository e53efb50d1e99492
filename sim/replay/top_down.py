"""One frame of a replay: the map from above, the camera's picture, the panel and the time bar."""

from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from brink.sim.replay.camera_view import CameraView
from brink.sim.replay.captions import perturbation_words, scenario_words, with_unit
from brink.sim.replay.errors import ReplayError
from brink.sim.replay.layout import DEFAULT_SIZE, Layout, Rectangle, Size, extent
from brink.sim.replay.map_view import MapView
from brink.sim.replay.moments import Story, tell
from brink.sim.replay.palette import HAIRLINE, INK, PAPER, VIOLATION, Rgb, typeface
from brink.sim.replay.panel import Panel, paint_grounds
from brink.sim.replay.picture_view import PictureView, draw_key, threshold_of
from brink.sim.replay.time_bar import TimeBar
from brink.sim.trace import Trace

MAP_WIDTH_M: Final = 62.0
SMALL_MAP_WIDTH_M: Final = 40.0
LOOK_AHEAD_M: Final = 9.0
SCALE_BAR_M: Final = 10.0


class FramePainter:
    """Draws any sample of one episode as a frame; what does not change is drawn once.

    Args:
        trace: The episode.
        requirement: Id of the requirement to judge; the front gap, or the first of the trace, if not given.
        size: Width and height of the frames in pixels.

    Raises:
        ReplayError: The trace is empty, lacks the requirement, or the size is out of bounds.
    """

    def __init__(self, trace: Trace, *, requirement: str | None = None, size: Size = DEFAULT_SIZE) -> None:
        self.trace = trace
        self.story: Story = tell(trace, requirement)
        film = trace.film
        self.layout = Layout.of(size, filmed=film is not None)
        self.px_per_m = extent(self.layout.map)[0] / (MAP_WIDTH_M if film is None else SMALL_MAP_WIDTH_M)
        self._map = MapView(
            trace,
            self.story,
            size_px=extent(self.layout.map),
            px_per_m=self.px_per_m,
            look_ahead_m=LOOK_AHEAD_M,
            font_px=round(13 * self.layout.unit),
        )
        camera_size = extent(self.layout.camera)
        self._camera: CameraView | PictureView = (
            CameraView(trace, size_px=camera_size)
            if film is None
            else PictureView(film, threshold=threshold_of(trace), size_px=camera_size)
        )
        self._panel = Panel(trace, self.story, self.layout)
        self._bar = TimeBar(trace, self.story, self.layout)
        self._still = Image.new("RGB", size, PAPER)
        paint_grounds(self._still, self.layout)
        self._panel.draw_still(self._still)
        self._bar.draw_still(self._still)
        self._clock = typeface(round(17 * self.layout.unit), bold=True)
        self._draw_caption()

    def __len__(self) -> int:
        return len(self.trace.time_s)

    def frame(self, sample: int) -> Image.Image:
        """Return the frame of a sample, in RGB."""
        frame = self._still.copy()
        frame.paste(self.map(sample), self.layout.map[:2])
        frame.paste(self.camera(sample), self.layout.camera[:2])
        draw = ImageDraw.Draw(frame)
        draw.rectangle(_grown(self.layout.camera), outline=HAIRLINE)
        self._panel.draw(frame, sample)
        self._bar.draw(frame, sample)
        self._draw_clock(draw, sample)
        return frame

    def map(self, sample: int) -> Image.Image:
        """Return the map of a sample alone, with its scale bar and, once violated, the verdict."""
        image = self._map.draw(sample)
        self._draw_scale(image)
        return image if self.filmed else self._judged(image, sample)

    def camera(self, sample: int) -> Image.Image:
        """Return the camera's picture of a sample alone; where it is the large one, with the verdict."""
        image = self._camera.draw(sample)
        return self._judged(image, sample) if self.filmed else image

    def picture(self, sample: int, size_px: Size) -> Image.Image:
        """Return what the camera saw at a sample, at another size.

        Raises:
            ReplayError: There are no pictures of a camera.
        """
        if self.trace.film is None:
            raise ReplayError("the trace has no pictures of a camera")
        view = PictureView(self.trace.film, threshold=threshold_of(self.trace), size_px=size_px)
        return view.draw(sample)

    @property
    def filmed(self) -> bool:
        """Whether there are pictures of a camera in the loop."""
        return self.trace.film is not None

    def _judged(self, image: Image.Image, sample: int) -> Image.Image:
        if self.story.violated and sample >= self.story.decisive:
            self._draw_violation(image)
        return image

    def _draw_caption(self) -> None:
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
            seen = typeface(round(15 * unit), bold=True)
            through = perturbation_words(self.trace) or "not perturbed"
            draw.text((left + 12 * unit, bottom + 22 * unit), through, fill=INK, font=seen, anchor="lm")
            draw_key(draw, (left + 12 * unit, bottom + 50 * unit), unit)

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

    def _draw_violation(self, image: Image.Image) -> None:
        unit = self.layout.unit
        draw = ImageDraw.Draw(image)
        draw.rectangle(
            (0, 0, image.width - 1, image.height - 1), outline=VIOLATION, width=max(3, round(4 * unit))
        )
        draw_banner(draw, (image.width / 2, 22 * unit), self.verdict(), unit)

    def verdict(self) -> str:
        """Return what came of the episode, in words."""
        name, time_s = self.story.title, float(self.trace.time_s[self.story.decisive])
        if self.story.violated:
            return f"{name} violated at {time_s:.1f} s"
        if not np.isfinite(self.story.least):
            return f"{name} was never at stake"
        return f"{name} held: {with_unit(self.story.least, name)} to spare at {time_s:.1f} s"


def draw_banner(
    draw: ImageDraw.ImageDraw, centre: tuple[float, float], text: str, unit: float, colour: Rgb = VIOLATION
) -> None:
    """Draw words in white on a filled plate."""
    font = typeface(round(14 * unit), bold=True)
    half = draw.textlength(text, font=font) / 2 + 12 * unit
    x, y = centre
    draw.rounded_rectangle((x - half, y - 13 * unit, x + half, y + 13 * unit), radius=5 * unit, fill=colour)
    draw.text(centre, text, fill=PAPER, font=font, anchor="mm")


def _grown(rectangle: Rectangle) -> Rectangle:
    left, top, right, bottom = rectangle
    return left - 1, top - 1, right, bottom
