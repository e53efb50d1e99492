"""The map of a frame: the scene from above, the road users on it, and what the driving system perceives.

Everything that stands still is painted once, on a canvas around the whole drive with one byte per pixel. A frame
crops its part, draws what moves on it, and is reduced to half its size, which smooths the edges.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np
from PIL import Image, ImageDraw

from brink.pictures.scene import (
    GHOSTS,
    PARKED,
    SHAPES,
    SIGHTED,
    TOUCHES_M,
    EpisodeScene,
    Flags,
    FrontGap,
    Points,
    astray_words,
    found_at,
    front_gap,
    gap_words,
    ghost_words,
    has_errors,
    is_car,
    is_there,
    label_index,
    map_centres,
    may_report_ghosts,
    obstacle_outline,
    shared_area,
    surface_style,
)
from brink.pictures.style import (
    BRAKE,
    EDGES,
    EGO,
    EGO_TRAIL,
    FILLS,
    GHOST,
    GLASS,
    GROUND,
    INK,
    PAPER,
    PEDESTRIAN,
    ROUTE,
    SUPERSAMPLING,
    VEHICLE,
    VIOLATION,
    Rgb,
    draw_dashed,
    lighter,
    typeface,
)
from brink.sim.trace import FloatArray, Surface, Trace

ROUTE_WIDTH_M: Final = 0.3
LEAST_PERSON_PX: Final = 3.0
HIDDEN_WHITE: Final = 0.85
"""Share of white in the colour of a road user who is hidden from the camera; lighter than any road."""
DOTS_M: Final = 1.0
"""Distance between the dots of the path ahead."""
_LEAST_LEADER_PX: Final = 7.0
_ARROW_FROM_MPS: Final = 0.3
_MARGIN_PX: Final = 5.0
"""Room between a label and the edge of the map, where a frame is drawn."""
_ALONG: Final = tuple(0.1 * place for place in range(1, 10))
_CROSSING_COST: Final = 10.0
"""Cost of each pixel of the line of a label that crosses something else, as area that is hidden."""
_MAY_HIDE_PX: Final = 60.0
"""Area that the label of a film may hide before it is moved."""

_RINGS: Final = (SHAPES.car_body, *SHAPES.car_windows, *SHAPES.car_brake_lights)
_CAR_CORNERS: Final = np.array([corner for ring in _RINGS for corner in ring])
_ENDS: Final = np.cumsum([len(ring) for ring in _RINGS]).tolist()
_BODY, *_DETAILS = (slice(end - len(ring), end) for ring, end in zip(_RINGS, _ENDS, strict=True))
_WINDOWS, _BRAKE_LIGHTS = _DETAILS[: len(SHAPES.car_windows)], _DETAILS[len(SHAPES.car_windows) :]
_PERSON_CORNERS: Final = np.array([(0.0, 0.0), (1.6, 0.0)])
"""Centre of a person, and a point ahead of it."""

Rect: TypeAlias = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels."""
Places: TypeAlias = dict[tuple[int, Rgb], int]
"""Number of the place of each label, by its number on the map and its colour."""


class Label(NamedTuple):
    """A text on a map.

    Attributes:
        at: Centre in pixels of the map.
        text: The text.
        colour: Its colour.
        named: What it names.
    """

    at: tuple[float, float]
    text: str
    colour: Rgb
    named: Rect


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewport:
    """The transformation from world coordinates to pixels of the canvas.

    Attributes:
        px_per_m: Scale.
        turn_rad: The world is rotated counter-clockwise by this angle before it is drawn.
        left_m: Smallest x of the rotated world on the canvas.
        top_m: Greatest y of the rotated world on the canvas.
        size_px: Width and height of the canvas.
    """

    px_per_m: float
    turn_rad: float
    left_m: float
    top_m: float
    size_px: tuple[int, int]

    @classmethod
    def along(
        cls,
        route: FloatArray,
        ego: FloatArray,
        *,
        px_per_m: float,
        margin_m: tuple[float, float],
        turn_rad: float | None = None,
    ) -> Self:
        """Return a viewport around the whole drive, rotated so that the drive starts out to the right.

        Args:
            route: The route, shape ``(k, 2)``.
            ego: The ego's poses, shape ``(n, 5)``.
            px_per_m: Scale.
            margin_m: How far the canvas extends beyond the ego's positions, horizontally and vertically.
            turn_rad: Rotation of the world instead.
        """
        places = np.asarray(ego[:, :2], dtype=np.float64)
        if turn_rad is None:
            turn_rad = -road_heading(route, ego, 0)
        turned = _turned(places, turn_rad)
        low = turned.min(axis=0) - margin_m
        high = turned.max(axis=0) + margin_m
        width, height = np.ceil((high - low) * px_per_m).astype(int)
        return cls(
            px_per_m=px_per_m,
            turn_rad=turn_rad,
            left_m=float(low[0]),
            top_m=float(high[1]),
            size_px=(int(width), int(height)),
        )

    def to_px(self, points: Points | FloatArray) -> Points:
        """Convert world coordinates to pixels of the canvas, shape ``(k, 2)``."""
        turned = _turned(np.asarray(points, dtype=np.float64), self.turn_rad)
        return (turned - (self.left_m, self.top_m)) * (self.px_per_m, -self.px_per_m)


def road_heading(route: FloatArray, ego: FloatArray, sample: int) -> float:
    """Return the heading of the road where the ego is at a sample, in radians.

    It does not change with a swerve of the ego, whose own heading is returned if there is no route.
    """
    if len(route) < 2:
        return float(ego[sample, 2])
    nearest = int(np.hypot(*(route - ego[sample, :2]).T).argmin())
    start = min(nearest, len(route) - 2)
    step = route[start + 1] - route[start]
    return float(np.arctan2(step[1], step[0]))


def _turned(points: Points, turn_rad: float) -> Points:
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    turned: Points = points @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


@dataclass(frozen=True, slots=True, kw_only=True)
class Twin:
    """A second drive from the same start on a map: the position of its ego.

    Attributes:
        ego: Outline of the ego in world coordinates, shape ``(4, 2)``.
        caption: Label of the outline.
        colour: Colour of the outline and its label.
    """

    ego: Points
    caption: str
    colour: Rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class Marked:
    """A road user that a map points out.

    Attributes:
        actor: Its index.
        caption: What is said of it.
        colour: Colour of the caption and, unless the front gap to it is too short, of its outline.
        arrow: Whether an arrow shows where it goes, as long as its way in a second.
    """

    actor: int
    caption: str
    colour: Rgb
    arrow: bool = False


class ObstacleStyle(NamedTuple):
    """How perceived obstacles are drawn.

    Attributes:
        colour: Colour of their dashed outlines and captions.
        there: Captions of those that lie where a road user is, by label.
        nothing_there: Captions of those that do not, by label.
        says_what_is_there: Whether captions say what else is at the place, parked cars included; otherwise obstacles
            are ghosts or not.
    """

    colour: Rgb
    there: tuple[str, ...]
    nothing_there: tuple[str, ...]
    says_what_is_there: bool


BY_KIND: Final = ObstacleStyle(GHOST, SIGHTED, GHOSTS, says_what_is_there=False)
_INSTEAD: Final = {
    "vehicle": "a vehicle is there",
    "pedestrian": "a person is there",
    PARKED: "a parked car is there",
}
"""Captions of an obstacle at the position of something else."""


class MapView:
    """Draws the map of any sample of one episode.

    Args:
        scene: The episode.
        size_px: Width and height of the map.
        px_per_m: Scale of the map.
        look_ahead_m: How far ahead of the ego the middle of the map lies.
        font_px: Size of the labels.
        turn_rad: Rotation of the map; by default so that the drive starts out to the right.
        obstacle_style: How perceived obstacles are drawn; None leaves them out.
        ego_colour: Colour of the ego, and in lighter shades of its way; by default blue.
    """

    def __init__(
        self,
        scene: EpisodeScene,
        *,
        size_px: tuple[int, int],
        px_per_m: float,
        look_ahead_m: float,
        font_px: int,
        turn_rad: float | None = None,
        obstacle_style: ObstacleStyle | None = BY_KIND,
        ego_colour: Rgb | None = None,
    ) -> None:
        trace = scene.trace
        self._scene = scene
        self._trace = trace
        self._size = size_px
        self._style = obstacle_style
        margin_m = tuple(side / 2 / px_per_m + look_ahead_m + 2.0 for side in size_px)
        self._viewport = Viewport.along(
            trace.route,
            trace.ego,
            px_per_m=px_per_m * SUPERSAMPLING,
            margin_m=(margin_m[0], margin_m[1]),
            turn_rad=turn_rad,
        )
        self._ego_colour = EGO if ego_colour is None else ego_colour
        self._trail_colour = EGO_TRAIL if ego_colour is None else lighter(ego_colour, 0.35)
        route_colour = ROUTE if ego_colour is None else lighter(ego_colour, 0.65)
        self._canvas = _paint_canvas(scene, self._viewport, route_colour)
        self._centres = self._viewport.to_px(map_centres(trace, look_ahead_m))
        self._trail = self._viewport.to_px(trace.ego[:, :2])
        self._ego, _ = _placed(_CAR_CORNERS, trace.ego, *trace.ego_size_m, self._viewport)
        self._actors = [
            _placed(
                _CAR_CORNERS if is_car(actor) else _PERSON_CORNERS,
                actor.motion,
                actor.length_m,
                actor.width_m,
                self._viewport,
            )
            for actor in trace.actors
        ]
        self._font = typeface(font_px, bold=True)

    def draw(
        self,
        sample: int,
        *,
        centre_m: Points | None = None,
        twin: Twin | None = None,
        ahead: int = 0,
        gap: FrontGap | None = None,
        marked: Marked | None = None,
        spread: bool = False,
        places: Places | None = None,
        ahead_gap: bool = True,
        crossed: Points | None = None,
    ) -> Image.Image:
        """Return the map at a sample as an RGB image of the view's size.

        Args:
            sample: The sample.
            centre_m: World coordinates of the middle of the map, shape ``(2,)``; by default ahead of the ego.
            twin: A second drive to show.
            ahead: Samples of the ego's path after this one to show as dots.
            gap: The gap to show.
            marked: A road user to point out.
            spread: Whether labels are moved to where they hide nothing.
            places: Where the labels of the frame before are, for a film in which they should not jump; changed.
            ahead_gap: Whether to show the front gap at the sample if no gap is given.
            crossed: Part of the lane's edge that the ego has crossed, shape ``(k, 2)``.
        """
        wide, high = (side * SUPERSAMPLING for side in self._size)
        centre = self._centres[sample] if centre_m is None else self._viewport.to_px(centre_m[None])[0]
        corner = np.round(centre - (wide / 2, high / 2))
        left, top = (int(value) for value in corner)
        image = self._canvas.crop((left, top, left + wide, top + high)).convert("RGB")
        draw = ImageDraw.Draw(image)
        labels: list[Label] = []
        gap = front_gap(self._trace, sample) if gap is None and ahead_gap else gap
        if crossed is not None:
            line = (self._viewport.to_px(crossed) - corner).ravel().tolist()
            draw.line(line, fill=VIOLATION, width=2 * SUPERSAMPLING)
        self._draw_trail(draw, sample, corner)
        self._draw_ahead(draw, sample, ahead, corner)
        self._draw_actors(draw, sample, corner, gap)
        if self._style is not None:
            self._draw_obstacles(draw, self._style, sample, corner, labels)
        self._draw_car(
            draw, self._ego[sample] - corner, self._ego_colour, brakes=bool(self._scene.ego_brakes[sample])
        )
        if marked is not None:
            crimson = gap is not None and gap.actor == marked.actor and gap.too_short
            outlined = marked if not crimson else replace(marked, colour=VIOLATION)
            self._draw_marked(draw, outlined, sample, corner)
            label = self._marked_label(marked, sample, corner)
            if spread or not _is_off(label.named, self._size):
                labels.append(label)
        if twin is not None:
            self._draw_twin(draw, twin, corner, labels)
        if gap is not None:
            self._draw_gap(draw, gap, corner, labels)
        image = image.reduce(SUPERSAMPLING)
        if spread:
            hidden = [*self._bodies(sample, corner), *(label.named for label in labels)]
            if crossed is not None:
                hidden.append(_around(self._viewport.to_px(crossed) - corner))
            if marked is not None and marked.arrow and (arrow := self._arrow(marked, sample)) is not None:
                hidden.append(_around(arrow - corner))
            self._write_beside(ImageDraw.Draw(image), labels, hidden, {} if places is None else places)
        else:
            self._write(ImageDraw.Draw(image), labels)
        return image

    def _draw_trail(self, draw: ImageDraw.ImageDraw, sample: int, corner: Points) -> None:
        if sample > 0:
            line = (self._trail[: sample + 1] - corner).ravel().tolist()
            draw.line(line, fill=self._trail_colour, width=max(2, round(0.25 * self._viewport.px_per_m)))

    def _draw_ahead(self, draw: ImageDraw.ImageDraw, sample: int, count: int, corner: Points) -> None:
        """Draw where the ego goes next as dots of equal spacing."""
        path = self._trail[sample : sample + count + 1] - corner
        if len(path) < 2:
            return
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        radius = max(SUPERSAMPLING, 0.16 * self._viewport.px_per_m)
        for at in np.arange(0.0, along[-1], DOTS_M * self._viewport.px_per_m):
            x, y = (float(np.interp(at, along, path[:, axis])) for axis in (0, 1))
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=self._ego_colour)

    def _draw_twin(self, draw: ImageDraw.ImageDraw, twin: Twin, corner: Points, labels: list[Label]) -> None:
        corners = self._viewport.to_px(twin.ego) - corner
        limit = np.array(self._size) * SUPERSAMPLING
        if (corners.max(axis=0) < 0).any() or (corners.min(axis=0) > limit).any():
            return
        closed = np.vstack([corners, corners[:2]]).ravel().tolist()
        draw.line(closed, fill=PAPER, width=4 * SUPERSAMPLING, joint="curve")
        draw.line(closed, fill=twin.colour, width=2 * SUPERSAMPLING, joint="curve")
        below = float(corners[:, 0].mean()), float(corners[:, 1].max())
        labels.append(Label(_reduced(below, 0.85), twin.caption, twin.colour, _around(corners)))

    def _draw_marked(self, draw: ImageDraw.ImageDraw, marked: Marked, sample: int, corner: Points) -> None:
        shape, present = self._actors[marked.actor]
        if not present[sample]:
            return
        if is_car(self._trace.actors[marked.actor]):
            corners = shape[sample][_BODY] - corner
            closed = np.vstack([corners, corners[:2]])
            draw.line(closed.ravel().tolist(), fill=marked.colour, width=2 * SUPERSAMPLING, joint="curve")
        else:
            x, y = (shape[sample][0] - corner).tolist()
            reach = 2.2 * self._person_px
            ring = (x - reach, y - reach, x + reach, y + reach)
            draw.ellipse(ring, outline=marked.colour, width=2 * SUPERSAMPLING)

        if marked.arrow:
            self._draw_arrow(draw, marked, sample, corner)

    def _draw_arrow(self, draw: ImageDraw.ImageDraw, marked: Marked, sample: int, corner: Points) -> None:
        """Draw an arrow from the front of a moving road user."""
        arrow = self._arrow(marked, sample)
        if arrow is None:
            return
        ends = arrow - corner
        along = (ends[1] - ends[0]) / max(1e-9, float(np.hypot(*(ends[1] - ends[0]))))
        across, head = np.array([-along[1], along[0]]), 0.7 * self._viewport.px_per_m
        draw.line(ends.ravel().tolist(), fill=marked.colour, width=round(1.5 * SUPERSAMPLING))
        tip = [
            ends[1] + along * head * 0.6,
            ends[1] - along * head + across * head * 0.7,
            ends[1] - along * head - across * head * 0.7,
        ]
        draw.polygon(np.concatenate(tip).tolist(), fill=marked.colour)

    def _arrow(self, marked: Marked, sample: int) -> Points | None:
        """Return both ends of the arrow of a moving road user in pixels of the canvas; None while it stands."""
        actor = self._trace.actors[marked.actor]
        x_m, y_m, yaw_rad, speed_mps = (float(value) for value in actor.motion[sample, :4])
        if not speed_mps >= _ARROW_FROM_MPS:
            return None
        heading = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        start_m = (x_m, y_m) + heading * (actor.length_m / 2 + 0.4)
        return self._viewport.to_px(np.array([start_m, start_m + heading * max(1.2, speed_mps)]))

    def _marked_label(self, marked: Marked, sample: int, corner: Points) -> Label:
        corners = self._actors[marked.actor][0][sample] - corner
        if not is_car(self._trace.actors[marked.actor]):
            reach = 2.2 * self._person_px
            corners = np.vstack([corners[0] - reach, corners[0] + reach])
        above = float(corners[:, 0].mean()), float(corners[:, 1].min())
        return Label(_reduced(above, -0.85), marked.caption, marked.colour, _around(corners))

    def _draw_actors(
        self, draw: ImageDraw.ImageDraw, sample: int, corner: Points, gap: FrontGap | None
    ) -> None:
        limit = np.array(self._size) * SUPERSAMPLING
        reach = 4 * self._viewport.px_per_m
        for index, (actor, (shape, present)) in enumerate(zip(self._trace.actors, self._actors, strict=True)):
            if not present[sample]:
                continue
            corners = shape[sample] - corner
            if (corners[0] < -reach).any() or (corners[0] > limit + reach).any():
                continue
            hidden = bool(self._scene.actors_hidden[index][sample])
            if not is_car(actor):
                self._draw_person(draw, corners, hidden=hidden)
                continue
            if hidden:
                self._draw_hidden_car(draw, corners)
            else:
                self._draw_car(draw, corners, VEHICLE, brakes=bool(self._scene.actors_brake[index][sample]))
            if gap is not None and gap.actor == index and gap.too_short:
                closed = np.vstack([corners[_BODY], corners[_BODY][:2]])
                draw.line(closed.ravel().tolist(), fill=VIOLATION, width=2 * SUPERSAMPLING, joint="curve")

    def _draw_car(self, draw: ImageDraw.ImageDraw, corners: Points, colour: Rgb, *, brakes: bool) -> None:
        draw.polygon(corners[_BODY].ravel().tolist(), fill=colour)
        for window in _WINDOWS:
            draw.polygon(corners[window].ravel().tolist(), fill=GLASS)
        if brakes:
            for light in _BRAKE_LIGHTS:
                draw.polygon(corners[light].ravel().tolist(), fill=BRAKE)

    def _draw_hidden_car(self, draw: ImageDraw.ImageDraw, corners: Points) -> None:
        """Draw a car that the camera does not see: pale, with a dashed outline."""
        draw.polygon(corners[_BODY].ravel().tolist(), fill=lighter(VEHICLE, HIDDEN_WHITE))
        dash = 0.4 * self._viewport.px_per_m
        draw_dashed(draw, corners[_BODY], VEHICLE, dash=dash, gap=dash, width=SUPERSAMPLING)

    @property
    def _person_px(self) -> float:
        return max(LEAST_PERSON_PX * SUPERSAMPLING, SHAPES.person_radius_m * self._viewport.px_per_m)

    def _draw_person(self, draw: ImageDraw.ImageDraw, corners: Points, *, hidden: bool) -> None:
        colour = lighter(PEDESTRIAN, HIDDEN_WHITE) if hidden else PEDESTRIAN
        edge = PEDESTRIAN if hidden else PAPER
        radius = self._person_px
        (x, y), nose = corners[0], corners[1] - corners[0]
        length = max(1e-9, float(np.hypot(*nose)))
        tip = corners[0] + nose / length * radius * SHAPES.person_nose
        draw.line([x, y, *tip.tolist()], fill=colour, width=round(radius * 0.6))
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, outline=edge)

    def _draw_obstacles(
        self,
        draw: ImageDraw.ImageDraw,
        style: ObstacleStyle,
        sample: int,
        corner: Points,
        labels: list[Label],
    ) -> None:
        perceived = self._trace.perceived
        line = 0.45 * self._viewport.px_per_m
        for row in range(perceived.first[sample], perceived.first[sample + 1]):
            label = label_index(float(perceived.rows[row, 1]))
            corners = self._viewport.to_px(obstacle_outline(self._scene, row)) - corner
            draw_dashed(draw, corners, style.colour, dash=1.2 * line, gap=0.9 * line, width=2 * SUPERSAMPLING)
            ghost, caption = self._caption(style, sample, row, label)
            if ghost:
                for one, other in ((0, 2), (1, 3)):
                    diagonal = np.vstack([corners[one], corners[other]])
                    draw.line(diagonal.ravel().tolist(), fill=style.colour, width=SUPERSAMPLING)
            if caption:
                anchor = float(corners[:, 0].mean()), float(corners[:, 1].min())
                labels.append(Label(_reduced(anchor, -0.85), caption, style.colour, _around(corners)))

    def _caption(self, style: ObstacleStyle, sample: int, row: int, label: int) -> tuple[bool, str]:
        """Return whether a perceived obstacle is crossed out, and its caption; empty if it needs none."""
        scene = self._scene
        # Where most reports are true, an obstacle that is perceived where it really is needs no caption.
        there = "" if has_errors(scene.trace) else style.there[label]
        if scene.obstacles.astray[row]:
            return False, astray_words(scene.trace, label)
        if not may_report_ghosts(scene.trace):
            return False, there
        if not style.says_what_is_there:
            is_ghost = bool(scene.obstacles.ghost[row])
            return is_ghost, ghost_words(scene.trace, label) if is_ghost else there
        found = found_at(scene, sample, row)
        if is_there(label, found):
            return False, there
        if found:
            return True, f"{style.there[label]}, {_INSTEAD[found[0]]}"
        return True, style.nothing_there[label]

    def _draw_gap(
        self, draw: ImageDraw.ImageDraw, gap: FrontGap, corner: Points, labels: list[Label]
    ) -> None:
        ends = self._viewport.to_px(gap.ends) - corner
        colour = VIOLATION if gap.too_short else INK
        draw.line(ends.ravel().tolist(), fill=colour, width=round(1.5 * SUPERSAMPLING))
        across = ends[1] - ends[0]
        across = np.array([-across[1], across[0]]) / max(1e-9, float(np.hypot(*across)))
        tick = 0.7 * self._viewport.px_per_m
        for end in ends:
            stroke = np.vstack([end - across * tick, end + across * tick])
            draw.line(stroke.ravel().tolist(), fill=colour, width=round(1.5 * SUPERSAMPLING))
        x, y = ends.mean(axis=0).tolist()
        below = y + 1.7 * self._viewport.px_per_m
        now = f"{gap.gap_m:.1f} m now" if gap.gap_m >= TOUCHES_M else "touches"
        text = f"gap {gap_words(gap.gap_m)}" if gap.required else now
        labels.append(Label(_reduced((x, below), 0.6), text, colour, _around(ends)))

    def _bodies(self, sample: int, corner: Points) -> list[Rect]:
        """Return the positions of the ego and the road users, which no label should hide."""
        shapes = [self._ego[sample]]
        shapes += [shape[sample] for shape, present in self._actors if present[sample]]
        return [_around(shape - corner) for shape in shapes]

    def _write_beside(
        self, draw: ImageDraw.ImageDraw, labels: list[Label], hidden: list[Rect], places: Places
    ) -> None:
        """Write each label as close to its subject as possible without hiding anything.

        A label stays on the side where it was in the frame before, unless it would hide something there.
        """
        placed: list[Rect] = []
        written: list[Label] = []
        for index, label in enumerate(labels):
            half = draw.textlength(label.text, font=self._font) / 2 + 3, self._font.size * 0.62
            options = _places(label.named, half, self._size)
            if not options:
                continue  # off the map
            kept = options.get(places.get((index, label.colour), -1))
            if kept is None or _cost(kept, placed, hidden, label) > _MAY_HIDE_PX:
                _, chosen = min(
                    (_cost(rect, placed, hidden, label), number) for number, rect in options.items()
                )
                places[index, label.colour] = chosen
                kept = options[chosen]
            placed.append(kept)
            written.append(label)
        for place, label in zip(placed, written, strict=True):
            _draw_leader(draw, place, label)
        # After the lines, none of which strikes through a text then.
        for place, label in zip(placed, written, strict=True):
            middle = (place[0] + place[2]) / 2, (place[1] + place[3]) / 2
            draw.text(
                middle,
                label.text,
                fill=label.colour,
                font=self._font,
                anchor="mm",
                stroke_width=2,
                stroke_fill=PAPER,
            )

    def _write(self, draw: ImageDraw.ImageDraw, labels: list[Label]) -> None:
        line = self._font.size * 1.25
        placed: list[tuple[float, float]] = []
        for (wanted, y), text, colour, _ in labels:
            half = draw.textlength(text, font=self._font) / 2 + 3
            x, at = min(max(wanted, half), self._size[0] - half), y
            # Two labels in one place are illegible: move the later one up.
            while any(abs(x - px) < half * 2 and abs(at - py) < line for px, py in placed):
                at -= line
            placed.append((x, at))
            draw.text(
                (x, at), text, fill=colour, font=self._font, anchor="mm", stroke_width=2, stroke_fill=PAPER
            )


def _reduced(point: tuple[float, float], lines: float) -> tuple[float, float]:
    """Convert a supersampled point to pixels of the map, moved down by a number of text lines."""
    return point[0] / SUPERSAMPLING, point[1] / SUPERSAMPLING + lines * 12


def _around(corners: Points) -> Rect:
    """Return the rectangle around supersampled points, in pixels of the map."""
    (left, top), (right, bottom) = corners.min(axis=0) / SUPERSAMPLING, corners.max(axis=0) / SUPERSAMPLING
    return float(left), float(top), float(right), float(bottom)


def _places(named: Rect, half: tuple[float, float], size_px: tuple[int, int]) -> dict[int, Rect]:
    """Return where the label of a rectangle may be by number, closest first; none if the rectangle is off the map."""
    left, top, right, bottom = named
    if _is_off(named, size_px):
        return {}
    left, right = max(left, 0.0), min(right, float(size_px[0]))
    top, bottom = max(top, 0.0), min(bottom, float(size_px[1]))
    wide, high = half
    found = []
    for away in (4.0, 14.0, 26.0, 40.0, 56.0, 74.0, 94.0, 120.0):
        xs = (left + right) / 2, left, right, left - wide, right + wide
        for x in xs:
            found += [(x, y) for y in (top - high - away, bottom + high + away)]
        found += [(at, (top + bottom) / 2) for at in (left - wide - away, right + wide + away)]
    least_x, least_y = wide + _MARGIN_PX, high + _MARGIN_PX
    return {
        place: (x - wide, y - high, x + wide, y + high)
        for place, (x, y) in enumerate(found)
        if least_x <= x <= size_px[0] - least_x and least_y <= y <= size_px[1] - least_y
    }


def _is_off(rect: Rect, size_px: tuple[int, int]) -> bool:
    """Return whether a rectangle is off the map."""
    left, top, right, bottom = rect
    return right < 0 or bottom < 0 or left > size_px[0] or top > size_px[1]


def _cost(rect: Rect, placed: list[Rect], hidden: list[Rect], label: Label) -> float:
    """Return how much a label and its leader line would hide; other labels count more than bodies."""
    labels, bodies = (sum(shared_area(rect, one, margin=3.0) for one in rects) for rects in (placed, hidden))
    start, end = _leader(rect, label)
    points = [
        (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])) for share in _ALONG
    ]
    outside = [point for point in points if not _is_within(point, label.named)]
    crossed = sum(_is_within(point, one) for one in (*placed, *placed, *hidden) for point in outside)
    crossed_px = crossed * float(np.hypot(end[0] - start[0], end[1] - start[1])) / len(_ALONG)
    return 10 * labels + bodies + _CROSSING_COST * crossed_px


def _is_within(point: tuple[float, float], rect: Rect) -> bool:
    return rect[0] < point[0] < rect[2] and rect[1] < point[1] < rect[3]


def _leader(rect: Rect, label: Label) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of the leader line from a label to its subject."""
    left, top, right, bottom = label.named
    start = min(max((left + right) / 2, rect[0]), rect[2]), min(max((top + bottom) / 2, rect[1]), rect[3])
    return start, (min(max(start[0], left), right), min(max(start[1], top), bottom))


def _draw_leader(draw: ImageDraw.ImageDraw, rect: Rect, label: Label) -> None:
    """Draw a leader line from a label to its subject, unless the two touch."""
    start, end = _leader(rect, label)
    if np.hypot(end[0] - start[0], end[1] - start[1]) > _LEAST_LEADER_PX:
        draw.line((*start, *end), fill=PAPER, width=3)
        draw.line((*start, *end), fill=label.colour, width=1)


def _placed(
    template: Points, poses: FloatArray, length_m: float, width_m: float, viewport: Viewport
) -> tuple[Points, Flags]:
    """Transform a shape to all its poses in advance, so that a frame only has to shift it.

    Args:
        template: Corners in half lengths ahead and half widths to the left, shape ``(k, 2)``.
        poses: x_m, y_m, yaw_rad in the first columns, shape ``(n, 3 or more)``.
        length_m: Extent along the heading.
        width_m: Extent across the heading.
        viewport: The canvas.

    Returns:
        Corners in pixels of the canvas, shape ``(n, k, 2)``, and whether the shape is present, shape ``(n,)``.
    """
    places = np.asarray(poses[:, :3], dtype=np.float64)
    local = template * (length_m / 2, width_m / 2)
    cosine, sine = np.cos(places[:, 2]), np.sin(places[:, 2])
    turn = np.stack([np.stack([cosine, sine], axis=1), np.stack([-sine, cosine], axis=1)], axis=1)
    world = local @ turn + places[:, None, :2]
    return viewport.to_px(world.reshape(-1, 2)).reshape(world.shape), np.isfinite(places.sum(axis=1))


def _paint_canvas(scene: EpisodeScene, viewport: Viewport, route_colour: Rgb) -> Image.Image:
    """Paint the static map of an episode (surfaces and route) as a palette image of the viewport's size."""
    colours = {
        colour: i
        for i, colour in enumerate(dict.fromkeys([GROUND, route_colour, *FILLS.values(), *EDGES.values()]))
    }
    canvas = Image.new("P", viewport.size_px, colours[GROUND])
    canvas.putpalette([channel for colour in colours for channel in colour])
    draw = ImageDraw.Draw(canvas)
    surfaces = scene.trace.scene
    for surface in surfaces[: scene.route_layer]:
        _draw_surface(draw, surface, viewport, colours)
    _draw_route(draw, scene.trace, viewport, colours[route_colour])
    for surface in surfaces[scene.route_layer :]:
        _draw_surface(draw, surface, viewport, colours)
    return canvas


def _draw_surface(
    draw: ImageDraw.ImageDraw, surface: Surface, viewport: Viewport, colours: dict[Rgb, int]
) -> None:
    if len(surface.points) < 2:
        return
    style = surface_style(surface.kind)
    points = viewport.to_px(surface.points)
    width, height = viewport.size_px
    low, high = points.min(axis=0), points.max(axis=0)
    if high[0] < 0 or high[1] < 0 or low[0] > width or low[1] > height:
        return
    flat = [tuple(point) for point in points.tolist()]
    fill = colours[FILLS[style.paint]]
    if surface.closed:
        draw.polygon(flat, fill=fill)
        if style.outlined:
            edge = colours[EDGES[style.paint]]
            draw.line([*flat, flat[0], flat[1]], fill=edge, width=SUPERSAMPLING, joint="curve")
    else:
        line = max(SUPERSAMPLING, round(surface.width_m * viewport.px_per_m))
        draw.line(flat, fill=fill, width=line, joint="curve")


def _draw_route(draw: ImageDraw.ImageDraw, trace: Trace, viewport: Viewport, colour: int) -> None:
    """Draw the route as a line that ends in an arrow."""
    if len(trace.route) < 2:
        return
    route = viewport.to_px(trace.route)
    width = max(SUPERSAMPLING, round(ROUTE_WIDTH_M * viewport.px_per_m))
    draw.line([tuple(point) for point in route.tolist()], fill=colour, width=width, joint="curve")
    step = route[-1] - route[-2]
    length = float(np.hypot(*step))
    if length < 1e-9:
        return
    ahead = step / length * 3.0 * width
    left = np.array([-ahead[1], ahead[0]]) * 0.7
    corners = [route[-1] + ahead, route[-1] + left, route[-1] - left]
    draw.polygon([tuple(corner.tolist()) for corner in corners], fill=colour)
