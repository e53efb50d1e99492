"""The map of a frame: the scene from above, and on it whatever moves, is believed to be there, or is judged."""

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from brink.sim.replay import bodies
from brink.sim.replay.gap import FrontGap, front_gap
from brink.sim.replay.geometry import Points, dashes, outline
from brink.sim.replay.moments import Story
from brink.sim.replay.palette import (
    BRAKE,
    EGO,
    EGO_TRAIL,
    GHOST,
    GLASS,
    INK,
    PAPER,
    PEDESTRIAN,
    VEHICLE,
    VIOLATION,
    Rgb,
    typeface,
)
from brink.sim.replay.scene import SUPERSAMPLING, paint_scene
from brink.sim.replay.viewport import Viewport
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import Trace

SMOOTHING_S: Final = 2.0
BRAKING_MPS2: Final = -1.0
MATCH_M: Final = 2.5
"""A perceived obstacle this close to a road user of its kind is that road user; any other is a ghost."""
LABELS: Final = ("vehicle", "person")
KINDS: Final = ("vehicle", "pedestrian")

Text: TypeAlias = tuple[tuple[float, float], str, Rgb]


class MapView:
    """Draws the map of any sample of one episode.

    Args:
        trace: The episode.
        story: What the replay is about.
        size_px: Width and height of the map.
        px_per_m: Scale of the map.
        look_ahead_m: How far ahead of the ego the middle of the map lies.
        font_px: Size of the labels.
    """

    def __init__(
        self,
        trace: Trace,
        story: Story,
        *,
        size_px: tuple[int, int],
        px_per_m: float,
        look_ahead_m: float,
        font_px: int,
    ) -> None:
        self._trace = trace
        self._story = story
        self._size = size_px
        self._px_per_m = px_per_m
        margin_m = tuple(side / 2 / px_per_m + look_ahead_m + 2.0 for side in size_px)
        self._viewport = Viewport.along(
            trace.route, trace.ego, px_per_m=px_per_m * SUPERSAMPLING, margin_m=(margin_m[0], margin_m[1])
        )
        self._canvas = paint_scene(trace, self._viewport)
        self._centres = self._viewport.to_px(_centres(trace, look_ahead_m))
        self._trail = self._viewport.to_px(trace.ego[:, :2])
        self._ego = bodies.shape_over_time(bodies.CAR, trace.ego, *trace.ego_size_m, self._viewport)
        self._actors = [
            bodies.shape_over_time(
                bodies.CAR if actor.kind == "vehicle" else bodies.WALKER,
                actor.motion,
                actor.length_m,
                actor.width_m,
                self._viewport,
            )
            for actor in trace.actors
        ]
        self._font = typeface(font_px, bold=True)

    def draw(self, sample: int) -> Image.Image:
        """Return the map at a sample, in RGB, of the view's size."""
        wide, high = (side * SUPERSAMPLING for side in self._size)
        corner = np.round(self._centres[sample] - (wide / 2, high / 2))
        left, top = (int(value) for value in corner)
        image = self._canvas.crop((left, top, left + wide, top + high)).convert("RGB")
        draw = ImageDraw.Draw(image)
        texts: list[Text] = []
        gap = front_gap(self._trace, sample)
        self._draw_trail(draw, sample, corner)
        self._draw_actors(draw, sample, corner, gap)
        self._draw_perceived(draw, sample, corner, texts)
        self._draw_car(draw, self._ego.corners_px[sample] - corner, EGO, float(self._trace.ego[sample, 4]))
        if gap is not None:
            self._draw_gap(draw, gap, corner, texts)
        image = image.reduce(SUPERSAMPLING)
        self._write(ImageDraw.Draw(image), texts)
        return image

    def _draw_trail(self, draw: ImageDraw.ImageDraw, sample: int, corner: Points) -> None:
        if sample > 0:
            line = (self._trail[: sample + 1] - corner).ravel().tolist()
            draw.line(line, fill=EGO_TRAIL, width=max(2, round(0.25 * self._viewport.px_per_m)))

    def _draw_actors(
        self, draw: ImageDraw.ImageDraw, sample: int, corner: Points, gap: FrontGap | None
    ) -> None:
        limit = np.array(self._size) * SUPERSAMPLING
        reach = 4 * self._viewport.px_per_m
        for index, (actor, shape) in enumerate(zip(self._trace.actors, self._actors, strict=True)):
            if not shape.present[sample]:
                continue
            corners = shape.corners_px[sample] - corner
            if (corners[0] < -reach).any() or (corners[0] > limit + reach).any():
                continue
            if actor.kind == "vehicle":
                self._draw_car(draw, corners, VEHICLE, self._accel(index, sample))
                if gap is not None and gap.actor == index and gap.gap_m < REQUIRED_GAP_M:
                    _outline(draw, corners[bodies.BODY], VIOLATION, 2 * SUPERSAMPLING)
            else:
                self._draw_walker(draw, corners)

    def _accel(self, actor: int, sample: int) -> float:
        if sample == 0:
            return 0.0
        speed = self._trace.actors[actor].motion[sample - 1 : sample + 1, 3]
        time_s = self._trace.time_s[sample - 1 : sample + 1]
        return float((speed[1] - speed[0]) / max(1e-6, float(time_s[1] - time_s[0])))

    def _draw_car(
        self, draw: ImageDraw.ImageDraw, corners: NDArray[np.float64], colour: Rgb, accel_mps2: float
    ) -> None:
        draw.polygon(corners[bodies.BODY].ravel().tolist(), fill=colour)
        draw.polygon(corners[bodies.WINDSCREEN].ravel().tolist(), fill=GLASS)
        draw.polygon(corners[bodies.REAR_WINDOW].ravel().tolist(), fill=GLASS)
        if accel_mps2 < BRAKING_MPS2:
            for light in bodies.BRAKE_LIGHTS:
                draw.polygon(corners[light].ravel().tolist(), fill=BRAKE)

    def _draw_walker(self, draw: ImageDraw.ImageDraw, corners: NDArray[np.float64]) -> None:
        radius = max(3.0 * SUPERSAMPLING, 0.35 * self._viewport.px_per_m)
        (x, y), nose = corners[0], corners[1] - corners[0]
        length = max(1e-9, float(np.hypot(*nose)))
        tip = corners[0] + nose / length * radius * 1.9
        draw.line([x, y, *tip.tolist()], fill=PEDESTRIAN, width=round(radius * 0.6))
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=PEDESTRIAN, outline=PAPER)

    def _draw_perceived(
        self, draw: ImageDraw.ImageDraw, sample: int, corner: Points, texts: list[Text]
    ) -> None:
        yaw_rad = float(self._trace.ego[sample, 2])
        for row in self._trace.perceived.at(sample):
            _, label, x_m, y_m, vx_mps, vy_mps, length_m, width_m = (float(value) for value in row)
            heading = float(np.arctan2(vy_mps, vx_mps)) if np.hypot(vx_mps, vy_mps) > 1.0 else yaw_rad
            ghost = not self._is_real(sample, int(label), x_m, y_m)
            box = outline(x_m, y_m, heading, max(length_m, 0.8), max(width_m, 0.8))
            corners = self._viewport.to_px(box) - corner
            line = 0.45 * self._viewport.px_per_m
            for piece in dashes(corners, 1.2 * line, 0.9 * line, closed=True):
                draw.line(piece.ravel().tolist(), fill=GHOST, width=2 * SUPERSAMPLING)
            if ghost:
                _cross(draw, corners, GHOST)
            word = LABELS[int(label)] if int(label) in (0, 1) else "obstacle"
            anchor = (float(corners[:, 0].mean()), float(corners[:, 1].min()))
            texts.append((_halved(anchor, -0.85), f"ghost {word}" if ghost else f"sees {word}", GHOST))

    def _is_real(self, sample: int, label: int, x_m: float, y_m: float) -> bool:
        for actor in self._trace.actors:
            if actor.kind == KINDS[label if label in (0, 1) else 0]:
                there = actor.motion[sample]
                if np.hypot(there[0] - x_m, there[1] - y_m) < MATCH_M:
                    return True
        return False

    def _draw_gap(self, draw: ImageDraw.ImageDraw, gap: FrontGap, corner: Points, texts: list[Text]) -> None:
        ends = self._viewport.to_px(gap.ends) - corner
        colour = VIOLATION if gap.gap_m < REQUIRED_GAP_M else INK
        draw.line(ends.ravel().tolist(), fill=colour, width=round(1.5 * SUPERSAMPLING))
        across = ends[1] - ends[0]
        across = np.array([-across[1], across[0]]) / max(1e-9, float(np.hypot(*across)))
        tick = 0.7 * self._viewport.px_per_m
        for end in ends:
            stroke = np.vstack([end - across * tick, end + across * tick])
            draw.line(stroke.ravel().tolist(), fill=colour, width=round(1.5 * SUPERSAMPLING))
        x, y = ends.mean(axis=0).tolist()
        below = y + 1.7 * self._viewport.px_per_m
        texts.append((_halved((x, below), 0.6), f"gap {gap.gap_m:.1f} m", colour))

    def _write(self, draw: ImageDraw.ImageDraw, texts: list[Text]) -> None:
        line = self._font.size * 1.25
        placed: list[tuple[float, float]] = []
        for (wanted, y), text, colour in texts:
            half = draw.textlength(text, font=self._font) / 2 + 3
            x, at = min(max(wanted, half), self._size[0] - half), y
            # Two labels on one spot read as neither: the later one makes way.
            while any(abs(x - px) < half * 2 and abs(at - py) < line for px, py in placed):
                at -= line
            placed.append((x, at))
            draw.text(
                (x, at), text, fill=colour, font=self._font, anchor="mm", stroke_width=2, stroke_fill=PAPER
            )


def _centres(trace: Trace, look_ahead_m: float) -> Points:
    """Return where each map is centred: ahead of the ego, moving smoothly, in world coordinates."""
    yaw = np.asarray(trace.ego[:, 2], dtype=np.float64)
    ahead = np.asarray(trace.ego[:, :2], dtype=np.float64)
    ahead = ahead + look_ahead_m * np.column_stack([np.cos(yaw), np.sin(yaw)])
    if len(ahead) < 3:
        return ahead
    step_s = float(np.median(np.diff(trace.time_s)))
    half = int(min(len(ahead) - 1, SMOOTHING_S / 2 / max(step_s, 1e-6)))
    padded = np.pad(ahead, ((half, half), (0, 0)), mode="edge")
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)])


def _outline(draw: ImageDraw.ImageDraw, corners: NDArray[np.float64], colour: Rgb, width: int) -> None:
    closed = np.vstack([corners, corners[:2]])
    draw.line(closed.ravel().tolist(), fill=colour, width=width, joint="curve")


def _cross(draw: ImageDraw.ImageDraw, corners: NDArray[np.float64], colour: Rgb) -> None:
    for one, other in ((0, 2), (1, 3)):
        draw.line(
            np.vstack([corners[one], corners[other]]).ravel().tolist(), fill=colour, width=SUPERSAMPLING
        )


def _halved(point: tuple[float, float], lines: float) -> tuple[float, float]:
    return point[0] / SUPERSAMPLING, point[1] / SUPERSAMPLING + lines * 12
