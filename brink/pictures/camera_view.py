"""The camera view of a replay frame: a recorded camera image, or a perspective sketch if none were recorded.

On a sketch, green solid boxes are the ground truth and vermilion dashed ones what was reported to the driving system.
On a recorded image, green boxes are the ground truth, red ones the detections that counted, and yellow lines the
regions in which a detection triggers the brake.

A sketch pitches with the camera where the trace tells its pitch. It shows the brake lights of the cars that the
camera sees, and what the ego's traffic light shows.
"""

import io
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from brink.pictures.scene import (
    LABELS,
    PERSON,
    PERSON_REGION,
    SKETCHED_FROM_M,
    SKETCHED_TO_M,
    EpisodeScene,
    Points,
    SurfaceStyle,
    has_errors,
    is_car,
    label_index,
    pictures_shown,
    score_threshold,
    shared_area,
    surface_style,
    wrong_boxes,
)
from brink.pictures.style import (
    BLURRED_PEDESTRIAN,
    BLURRED_VEHICLE,
    BRAKE,
    EDGES,
    FILLS,
    FOUND_ON_PICTURE,
    GHOST,
    GROUND,
    INK,
    LAMP_OFF,
    LIGHTS,
    PAPER,
    REGION_ON_PICTURE,
    SEEN,
    SEEN_ON_PICTURE,
    SKY,
    SUPERSAMPLING,
    Rgb,
    draw_dashed,
    typeface,
)
from brink.sim.driving.camera import Camera
from brink.sim.trace import Film, FloatArray, Trace

FAR_PX: Final = 4000.0
"""Points are drawn at most this far outside the image."""
_BRAKE_LIGHT_M: Final = 0.7
_BRAKE_LIGHT_RADIUS_M: Final = 0.12
_BRAKE_LIGHT_ASIDE: Final = 0.36
"""Distance of a brake light from the middle of a car, in widths."""
_POST_M: Final = 3.4
_LAMP_RADIUS_M: Final = 0.15
_LAMP_M: Final = 0.36
"""Distance between the lamps of a traffic light."""


class Reported(NamedTuple):
    """Boxes reported to the driving system at one moment, and how they are drawn.

    Attributes:
        rows: The boxes, columns `brink.sim.trace.BOX_COLUMNS`.
        colour: Colour of the lines.
        source: Whose boxes they are, written before the label; empty if there is only one source.
    """

    rows: FloatArray
    colour: Rgb
    source: str


class _Area(NamedTuple):
    style: SurfaceStyle
    first: int
    last: int


class SketchView:
    """Sketches the camera view at any sample of one episode.

    Args:
        trace: The episode.
        size_px: Width and height of the image, 4:3.
    """

    def __init__(self, trace: Trace, *, size_px: tuple[int, int]) -> None:
        self._trace = trace
        self._scene = EpisodeScene.of(trace)
        self._size = size_px
        self._camera = Camera()
        self._stop_lines = [s.points.astype(np.float64) for s in trace.scene if s.kind == "stop-line"]
        surfaces = [surface for surface in trace.scene if surface.closed and len(surface.points) > 2]
        ends = np.cumsum([0, *(len(surface.points) for surface in surfaces)]).tolist()
        self._areas = [
            _Area(surface_style(s.kind), a, b) for s, a, b in zip(surfaces, ends[:-1], ends[1:], strict=True)
        ]
        self._points = np.vstack([np.zeros((0, 2)), *(s.points.astype(np.float64) for s in surfaces)])
        self._scale = np.array(size_px) / (self._camera.width_px, self._camera.height_px)
        self._font = typeface(max(8, round(size_px[1] / 18)), bold=True)

    def draw(self, sample: int, reports: Sequence[Reported] | None = None) -> Image.Image:
        """Return the camera view at a sample as an RGB image of the view's size.

        Args:
            sample: The sample.
            reports: Reported boxes to draw, by default those of the episode; where it has errors, the wrong ones.
        """
        if reports is None:
            trace = self._trace
            boxes = wrong_boxes(trace, sample) if has_errors(trace) else trace.given_boxes.at(sample)
            reports = [Reported(boxes, GHOST, "")]
        width, height = (side * SUPERSAMPLING for side in self._size)
        image = Image.new("RGB", (width, height), SKY)
        draw = ImageDraw.Draw(image)
        tan_pitch = float(np.tan(self._scene.pitch_rad[sample]))
        horizon = (
            (self._camera.horizon_px + self._camera.focal_px * tan_pitch) * self._scale[1] * SUPERSAMPLING
        )
        draw.rectangle((0, horizon, width, height), fill=GROUND)
        self._draw_areas(draw, sample, tan_pitch)
        self._draw_traffic_light(draw, sample, tan_pitch)
        self._draw_ground_truth(draw, sample)
        self._draw_brake_lights(draw, sample, tan_pitch)
        image = image.reduce(SUPERSAMPLING)
        draw = ImageDraw.Draw(image)
        for report in reports:
            for row in report.rows:
                draw_dashed(draw, self._sides(row), report.colour, dash=7.0, gap=4.0, width=2)
        self._write_labels(draw, reports)
        return image

    def _seen(self, points_m: Points, sample: int) -> Points:
        """Convert world coordinates to (depth, left)."""
        x_m, y_m, yaw_rad = (float(value) for value in self._trace.ego[sample, :3])
        cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
        seen: Points = (points_m - (x_m, y_m)) @ np.array([[cosine, -sine], [sine, cosine]])
        seen[:, 0] -= self._camera.forward_m
        return seen

    def _draw_areas(self, draw: ImageDraw.ImageDraw, sample: int, tan_pitch: float) -> None:
        if not self._areas:
            return
        seen = self._seen(self._points, sample)
        ground = self._project(seen, 0.0, tan_pitch)
        starts = [area.first for area in self._areas]
        nearest, farthest = np.minimum.reduceat(seen[:, 0], starts), np.maximum.reduceat(seen[:, 0], starts)
        beside = np.minimum.reduceat(np.abs(seen[:, 1]) - np.maximum(seen[:, 0], 0.0), starts) > 0
        one_side = np.minimum.reduceat(seen[:, 1], starts) * np.maximum.reduceat(seen[:, 1], starts) > 0
        drawn = (farthest > SKETCHED_FROM_M) & (nearest < SKETCHED_TO_M)
        drawn &= ~(beside & one_side & (nearest > 0))
        standing: list[tuple[float, SurfaceStyle, Points]] = []
        for index in np.flatnonzero(drawn).tolist():
            style, first, last = self._areas[index]
            if style.height_m > 0:
                standing.append((float(nearest[index] + farthest[index]), style, seen[first:last]))
                continue
            whole = nearest[index] >= SKETCHED_FROM_M
            corners = ground[first:last] if whole else self._project(_cut(seen[first:last]), 0.0, tan_pitch)
            if len(corners) > 2:
                draw.polygon(corners.ravel().tolist(), fill=FILLS[style.paint])
        for _, style, points in sorted(standing, key=lambda item: -item[0]):
            self._draw_walls(draw, style, points, tan_pitch)

    def _draw_walls(
        self, draw: ImageDraw.ImageDraw, style: SurfaceStyle, points: Points, tan_pitch: float
    ) -> None:
        """Draw the walls over a footprint, farthest first; walls across the view are lighter than those along it."""
        corners = _cut(points)
        if len(corners) < 2:
            return
        foot = self._project(corners, 0.0, tan_pitch)
        top = self._project(corners, style.height_m, tan_pitch)
        depth = corners[:, 0] + np.roll(corners[:, 0], 1)
        along = np.abs(np.diff(corners, axis=0, prepend=corners[-1:]))
        for index in np.argsort(-depth).tolist():
            wall = np.vstack([foot[index - 1], foot[index], top[index], top[index - 1]])
            shades = EDGES if along[index, 0] > along[index, 1] else FILLS
            draw.polygon(wall.ravel().tolist(), fill=shades[style.paint])

    def _project(self, points: Points, height_m: float, tan_pitch: float) -> Points:
        """Project points (depth, left) at a height above the ground to supersampled pixels of the view."""
        camera = self._camera
        depth = np.maximum(points[:, 0], SKETCHED_FROM_M)
        pixels = np.empty((len(points), 2))
        pixels[:, 0] = camera.centre_x_px - camera.focal_px * points[:, 1] / depth
        # As in `Camera`, pitch moves rows alone.
        down = (camera.height_m - height_m) / depth
        down = (down + tan_pitch) / np.maximum(1.0 - down * tan_pitch, 0.1)
        pixels[:, 1] = camera.horizon_px + camera.focal_px * down
        return np.clip(pixels, -FAR_PX, FAR_PX) * (self._scale * SUPERSAMPLING)

    def _draw_ground_truth(self, draw: ImageDraw.ImageDraw, sample: int) -> None:
        """Draw a silhouette and a solid box for each road user in the image, the nearest last."""
        rows = self._trace.seen_boxes.at(sample)
        for row in rows[np.argsort(rows[:, 4])]:
            box = self._corners(row) * SUPERSAMPLING
            colour = BLURRED_VEHICLE if row[0] == 0 else BLURRED_PEDESTRIAN
            draw.rectangle(box.ravel().tolist(), fill=colour, outline=SEEN, width=2 * SUPERSAMPLING)

    def _draw_brake_lights(self, draw: ImageDraw.ImageDraw, sample: int, tan_pitch: float) -> None:
        """Draw the brake lights of cars whose rear is in the camera's view."""
        scene = self._scene
        for actor, brakes, hidden in zip(
            self._trace.actors, scene.actors_brake, scene.actors_hidden, strict=True
        ):
            motion = actor.motion[sample, :3].astype(np.float64)
            if not is_car(actor) or not brakes[sample] or hidden[sample] or not np.isfinite(motion).all():
                continue
            x_m, y_m, yaw_rad = motion.tolist()
            ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
            left = np.array([-ahead[1], ahead[0]]) * _BRAKE_LIGHT_ASIDE * actor.width_m
            rear = (x_m, y_m) - ahead * actor.length_m / 2
            lights = self._seen(np.array([rear + left, rear - left]), sample)
            faces_camera = (self._trace.ego[sample, :2] - rear) @ ahead < 0
            if faces_camera and (lights[:, 0] > SKETCHED_FROM_M).all() and lights[0, 0] < SKETCHED_TO_M:
                for light in lights:
                    self._draw_disc(draw, light, _BRAKE_LIGHT_M, _BRAKE_LIGHT_RADIUS_M, BRAKE, tan_pitch)

    def _draw_traffic_light(self, draw: ImageDraw.ImageDraw, sample: int, tan_pitch: float) -> None:
        """Draw the ego's traffic light at the right end of its stop line, which is ahead."""
        state = self._trace.lights[sample]
        lines = [self._seen(points, sample) for points in self._stop_lines]
        ends = [seen[seen[:, 1].argmin()] for seen in lines if len(seen)]
        ends = [end for end in ends if 1.0 < end[0] < SKETCHED_TO_M]
        if state not in LIGHTS or not ends:
            return
        post = min(ends, key=lambda end: float(end[0]))
        low, high = (
            self._project(post[None], height_m, tan_pitch)[0] for height_m in (0.0, _POST_M - 3 * _LAMP_M)
        )
        draw.line([*low.tolist(), *high.tolist()], fill=LAMP_OFF, width=SUPERSAMPLING)
        for number, name in enumerate(("red", "amber", "green")):
            height_m = _POST_M - (number + 0.5) * _LAMP_M
            colour = LIGHTS[name] if name == state else LAMP_OFF
            self._draw_disc(draw, post, height_m, _LAMP_RADIUS_M, colour, tan_pitch)

    def _draw_disc(
        self,
        draw: ImageDraw.ImageDraw,
        at: Points,
        height_m: float,
        radius_m: float,
        colour: Rgb,
        tan_pitch: float,
    ) -> None:
        """Draw a disc at a point (depth, left), which is at least a pixel large."""
        x, y = self._project(at[None], height_m, tan_pitch)[0].tolist()
        px_per_m = self._camera.focal_px / float(at[0]) * float(self._scale[0]) * SUPERSAMPLING
        reach = max(radius_m * px_per_m, 0.8 * SUPERSAMPLING)
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), fill=colour)

    def _sides(self, row: FloatArray) -> Points:
        """Return the four corners of an image box in pixels of the view."""
        (left, top), (right, bottom) = self._corners(row).tolist()
        return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])

    def _write_labels(self, draw: ImageDraw.ImageDraw, reports: Sequence[Reported]) -> None:
        """Write the label of each reported box close to it, where it hides no box if there is room."""
        line = self._font.size + 3
        boxes = [self._corners(row).ravel().tolist() for report in reports for row in report.rows]
        written: list[list[float]] = []
        for report in reports:
            for row in report.rows:
                (left, top), (right, bottom) = self._corners(row).tolist()
                word = f"{report.source} {LABELS[label_index(row[0])]}".strip()
                wide = draw.textlength(word, font=self._font)
                ys = [
                    top - line - 1,
                    bottom + 3,
                    *(top - line * n for n in (2, 3)),
                    bottom + line + 3,
                    top + 2,
                ]
                places = [(x, y) for y in ys for x in (left, right - wide, left - wide - 6, right + 6)]
                inside = [
                    [x, y, x + wide, y + line]
                    for x, y in (
                        (min(max(x, 3.0), self._size[0] - wide - 3), min(max(y, 2.0), self._size[1] - line))
                        for x, y in places
                    )
                ]
                best = min(
                    inside,
                    key=lambda at: (
                        sum(_edge_hidden(at, box) for box in boxes)
                        + 10 * sum(shared_area(at, other) for other in written)
                    ),
                )
                written.append(best)
                above, below = top - best[3], best[1] - bottom
                if max(above, below) > line:
                    x = min(max((left + right) / 2, best[0]), best[2])
                    ends = (x, best[3], x, top) if above > 0 else (x, best[1], x, bottom)
                    draw.line(ends, fill=report.colour, width=1)
                draw.text(
                    (best[0], best[1]),
                    word,
                    fill=report.colour,
                    font=self._font,
                    stroke_width=2,
                    stroke_fill=PAPER,
                )

    def _corners(self, row: FloatArray) -> Points:
        """Return the top-left and bottom-right corner of an image box in pixels of the view, clipped to it."""
        corners = np.array([(row[1], row[3]), (row[2], row[4])], dtype=np.float64) * self._scale
        return np.clip(corners, 1.0, np.array(self._size) - 2.0)


def _edge_hidden(text: Sequence[float], box: Sequence[float]) -> float:
    """Return how much of a box a text hides: mainly its edges and, for a large box, less its inside."""
    within = (box[0] + 2, box[1] + 2, box[2] - 2, box[3] - 2)
    inner = shared_area(text, within) if within[2] > within[0] and within[3] > within[1] else 0.0
    return 20 * (shared_area(text, box) - inner) + inner


def _cut(points: Points) -> Points:
    """Clip a polygon of (depth, left) points to depths beyond the smallest one that is drawn."""
    if (points[:, 0] >= SKETCHED_FROM_M).all():
        return points
    corners: list[Points] = []
    for index, here in enumerate(points):
        if here[0] >= SKETCHED_FROM_M:
            corners.append(here)
        following = points[(index + 1) % len(points)]
        if (here[0] >= SKETCHED_FROM_M) != (following[0] >= SKETCHED_FROM_M):
            share = (SKETCHED_FROM_M - here[0]) / (following[0] - here[0])
            corners.append(here + share * (following - here))
    return np.array(corners).reshape(-1, 2)


class FilmView:
    """Draws the recorded camera image at any sample of one episode, with its boxes.

    Args:
        trace: The episode.
        film: Its recorded images and boxes.
        size_px: Width and height of the drawing; the image is stretched to it.
    """

    def __init__(self, trace: Trace, film: Film, *, size_px: tuple[int, int]) -> None:
        self._film = film
        self._shown = pictures_shown(film, len(trace.time_s))
        self._threshold = score_threshold(trace)
        self._size = size_px
        self._scale = np.array(size_px) / np.array(film.size_px)
        self._font = typeface(max(9, round(size_px[1] / 28)), bold=True)

    def draw(self, sample: int) -> Image.Image:
        """Return the camera view at a sample as an RGB image of the view's size."""
        film = self._film
        index = int(self._shown[sample])
        with Image.open(io.BytesIO(film.pictures[index])) as picture:
            image = picture.convert("RGB").resize(self._size, Image.Resampling.BILINEAR)
        draw = ImageDraw.Draw(image)
        for name, corners in film.regions.items():
            self._draw_region(draw, corners, solid=name == PERSON_REGION)
        shown = int(film.samples[index])
        for row in film.judged.at(shown):
            if not row[5]:
                draw.rectangle(self._corners(row), outline=SEEN_ON_PICTURE, width=1)
        for row in film.found.at(shown)[::-1]:
            if row[5] >= self._threshold:
                draw.rectangle(self._corners(row), outline=FOUND_ON_PICTURE, width=2)
                if row[0] == PERSON:
                    self._write_score(draw, row)
        return image

    def _draw_region(self, draw: ImageDraw.ImageDraw, corners: FloatArray, *, solid: bool) -> None:
        points = corners * self._scale
        points[:, 1] = np.minimum(points[:, 1], self._size[1] - 1)
        if solid:
            draw.line([*points.ravel().tolist(), *points[0].tolist()], fill=REGION_ON_PICTURE, width=2)
        else:
            draw_dashed(draw, points, REGION_ON_PICTURE, dash=6.0, gap=6.0, width=1)

    def _write_score(self, draw: ImageDraw.ImageDraw, row: FloatArray) -> None:
        left, top, _, bottom = self._corners(row)
        text = f"{LABELS[PERSON]} {row[5]:.2f}".replace("0.", ".")
        high = self._font.size
        y = top - high - 3 if top > high + 4 else bottom + 1
        draw.text((left, y), text, fill=FOUND_ON_PICTURE, font=self._font, stroke_width=2, stroke_fill=PAPER)

    def _corners(self, row: FloatArray) -> tuple[float, float, float, float]:
        """Return left, top, right and bottom of an image box in pixels of the view, clipped to it."""
        low = np.array([row[1], row[3]], np.float64) * self._scale
        high = np.array([row[2], row[4]], np.float64) * self._scale
        limit = np.array(self._size) - 1.0
        (left, top), (right, bottom) = np.clip(low, 0.0, limit), np.clip(high, 0.0, limit)
        return float(left), float(top), float(max(right, left)), float(max(bottom, top))


def camera_view(trace: Trace, size_px: tuple[int, int]) -> FilmView | SketchView:
    """Return a view of the recorded camera images, or a sketch if the trace has none."""
    if trace.film is None:
        return SketchView(trace, size_px=size_px)
    return FilmView(trace, trace.film, size_px=size_px)


def draw_film_legend(draw: ImageDraw.ImageDraw, at: tuple[float, float], unit: float) -> None:
    """Draw the legend of a recorded camera image in one row.

    Args:
        draw: Where to draw.
        at: Left end and middle of the row in pixels.
        unit: Scale of text and lines, 1 in a frame of 540 px height.
    """
    x, y = at
    font = typeface(round(11 * unit))
    entries: tuple[tuple[Rgb, str], ...] = (
        (SEEN_ON_PICTURE, "ground truth"),
        (FOUND_ON_PICTURE, "detected"),
        (REGION_ON_PICTURE, "a person here triggers the brake (dashed: a vehicle)"),
    )
    for colour, text in entries:
        box = (x, y - 6 * unit, x + 20 * unit, y + 6 * unit)
        draw.rectangle(box, fill=(70, 74, 78), outline=colour, width=2)
        draw.text((x + 26 * unit, y), text, fill=INK, font=font, anchor="lm")
        x += 26 * unit + draw.textlength(text, font=font) + 14 * unit
