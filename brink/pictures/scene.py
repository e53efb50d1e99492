"""The scene model of an episode: what videos, still images and the web page show, computed once from its trace.

All rules that they share are here: which perceived obstacles are ghosts, whose brake lights are on, who is hidden
from the camera, how tall a building is drawn, where the map is centred, which vehicle the front gap is measured to. A
drawing only adds colours and pixels.

SimulatorError
└── ReplayError         the replay cannot be rendered; the message says what can
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.driving.camera import LEAST_VISIBLE, Camera
from brink.sim.episode import Json
from brink.sim.errors import SimulatorError
from brink.sim.perception_errors import MODE
from brink.sim.plane import Rectangle, approaches, overlaps
from brink.sim.requirements import REQUIRED_GAP_M
from brink.sim.trace import ActorTrack, Film, Trace
from brink.sim.verdict import Impact
from brink.sim.world.vehicle import BRAKE_LIGHTS_FROM_MPS2, HELD_BELOW_MPS

Points: TypeAlias = NDArray[np.float64]
"""Corners, shape ``(k, 2)``."""

Flags: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.int64]
BoxRows: TypeAlias = NDArray[np.float32]
"""Boxes, shape ``(n, 5)``; columns as in `brink.sim.trace.BOX_COLUMNS`."""

LABELS: Final = ("vehicle", "person", "obstacle")
"""Names of the labels 0 and 1 of boxes and obstacles; the last one is for any other label."""
SIGHTED: Final = tuple(f"sees {label}" for label in LABELS)
"""Captions of perceived obstacles that are there, by label."""
GHOSTS: Final = tuple(f"ghost {label}" for label in LABELS)
"""Captions of ghosts, by label."""
PERSON: Final = 1
"""Label of a person."""
PERSON_REGION: Final = "warning"
"""Region of the recorded camera images in which a person triggers the brake; in the others a vehicle does."""
PICTURE_COLOURS: Final = {"judged": (64, 222, 128), "found": (255, 52, 52), "region": (255, 214, 64)}
"""Colours of lines that are visible on images by day and by night: ground truth, detections, brake regions."""

_MATCH_M: Final = 2.5
"""A perceived obstacle this close to a road user of its kind is assumed to be that road user."""
_MATCH_PX: Final = 4.0
"""Where boxes are placed by what is seen, a place that is nearer or farther by this many pixels is the same, too.

A pixel is centimetres close by and metres far away.
"""
_GHOST_ERROR: Final = "ghost"
"""Prefixes of the names of errors that report things that do not exist."""
_LABEL_ERROR: Final = "wrong_label"
_IN_PLACE: Final = frozenset({"miss", "late", "flicker", "short_range", "too_fast", "speed_noise"})
"""Errors that hide objects or mistake their speed, but report nothing that does not exist."""
_ACTOR_KINDS: Final = ("vehicle", "pedestrian", "vehicle")
"""The kind of road user that an obstacle matches, by label."""
PARKED: Final = "parked-car"
"""A kind of surface: a vehicle that is not a road user."""
_MOVING_MPS: Final = 1.0
"""A slower obstacle has no heading of its own."""
_LEAST_SIDE_M: Final = 0.8
"""Smaller obstacles are drawn this large."""
SKETCHED_FROM_M: Final = 0.4
SKETCHED_TO_M: Final = 90.0
"""Smallest and greatest distance of objects shown in a sketch of the camera view."""

_CAMERA: Final = Camera()
_SMOOTHING_S: Final = 2.0
_GAP_DRAWN_UP_TO_M: Final = 40.0
_CORRIDOR_M: Final = 2.5
"""How far off the ego's axis a vehicle may be and still count as ahead, if no front gap was recorded."""
_TOUCHING_M: Final = 1.0
"""Vehicles that collide bounce off between two samples: a gap below this counts as contact."""
_GAP_TOLERANCE_M: Final = 0.75
"""How far a clearance between outlines may differ from the recorded gap: float32 poses, sampling, slopes."""
_MOST_DIGITS: Final = 4
STANDING_MARGIN_M: Final = 0.0
"""Robustness of `front-gap@2` while the ego stands and would otherwise violate it."""
TOUCHES_M: Final = 0.05
"""Bodies this close are said to touch."""
_TIED_M: Final = 0.02
"""Distances this close count as equal."""


class ReplayError(SimulatorError, ValueError):
    """The image or video cannot be rendered from this trace."""


class SurfaceStyle(NamedTuple):
    """The drawing style of a kind of surface: its paint, its height, and whether it has an outline."""

    paint: str
    outlined: bool = False
    height_m: float = 0.0


_SURFACE_STYLES: Final[Mapping[str, SurfaceStyle]] = {
    "road": SurfaceStyle("road"),
    "pavement": SurfaceStyle("pavement", outlined=True),
    "marking": SurfaceStyle("marking"),
    "crossing": SurfaceStyle("marking"),
    "stop-line": SurfaceStyle("marking"),
    "building": SurfaceStyle("building", outlined=True, height_m=6.0),
    PARKED: SurfaceStyle("parked-car", outlined=True, height_m=1.4),
    "tree": SurfaceStyle("tree", outlined=True, height_m=4.5),
}
_UNKNOWN_SURFACE: Final = SurfaceStyle("unknown")


def surface_style(kind: str) -> SurfaceStyle:
    """Return how a kind of surface is drawn; heights are assumed, since traces record only footprints."""
    return _SURFACE_STYLES.get(kind, _UNKNOWN_SURFACE)


Ring: TypeAlias = tuple[tuple[float, float], ...]


class Shapes(NamedTuple):
    """Top-view outlines of the road users.

    Corners of a car are in half lengths ahead and half widths to the left of its centre. A person is a disc.
    """

    car_body: Ring
    car_windows: tuple[Ring, ...]
    car_brake_lights: tuple[Ring, ...]
    person_radius_m: float
    person_nose: float
    """How far the nose reaches from the centre, in radii."""


SHAPES: Final = Shapes(
    car_body=(
        (1.0, 0.62), (0.9, 0.94), (0.72, 1.0), (-0.8, 1.0), (-0.95, 0.92), (-1.0, 0.7),
        (-1.0, -0.7), (-0.95, -0.92), (-0.8, -1.0), (0.72, -1.0), (0.9, -0.94), (1.0, -0.62),
    ),
    car_windows=(
        ((0.42, 0.8), (0.42, -0.8), (0.12, -0.68), (0.12, 0.68)),
        ((-0.58, 0.66), (-0.58, -0.66), (-0.76, -0.74), (-0.76, 0.74)),
    ),
    car_brake_lights=(
        ((-0.9, 0.9), (-0.9, 0.42), (-1.0, 0.42), (-1.0, 0.8)),
        ((-0.9, -0.9), (-0.9, -0.42), (-1.0, -0.42), (-1.0, -0.8)),
    ),
    person_radius_m=0.35,
    person_nose=1.9,
)  # fmt: skip


def is_car(actor: ActorTrack) -> bool:
    """Return whether a road user is drawn as a car; any other is drawn as a person."""
    return actor.kind == "vehicle"


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacles:
    """Perceived obstacles for drawing, one row for each row of ``trace.perceived``.

    Attributes:
        yaw_rad: Headings: of the motion, or the ego's for an obstacle that hardly moves, shape ``(k,)``.
        length_m: Extents along the headings, shape ``(k,)``.
        width_m: Extents across the headings, shape ``(k,)``.
        ghost: Whether it is known that no road user of that kind is reported there, shape ``(k,)``.
        astray: Whether it is not a ghost, but no road user of that kind is where it is perceived, shape ``(k,)``: a
            true one was reported at a wrong place or with a wrong label.
    """

    yaw_rad: Points
    length_m: Points
    width_m: Points
    ghost: Flags
    astray: Flags


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeScene:
    """An episode with everything derived from it for drawing.

    Attributes:
        trace: The episode.
        obstacles: What the driving system perceives.
        ego_brakes: Whether the ego's brake lights are on at each sample, shape ``(n,)``.
        actors_brake: The same for each actor of the trace.
        actors_hidden: Whether each actor is hidden from the camera, though within its image, at each sample.
        pitch_rad: Pitch of the camera at each sample, shape ``(n,)``; 0 if the trace does not tell.
        route_layer: Number of surfaces below the route, which lies on the road and under everything that stands.
    """

    trace: Trace
    obstacles: Obstacles
    ego_brakes: Flags
    actors_brake: tuple[Flags, ...]
    actors_hidden: tuple[Flags, ...]
    pitch_rad: Points
    route_layer: int

    @classmethod
    def of(cls, trace: Trace) -> Self:
        """Return the scene of a trace; its arrays must be consistent."""
        standing = [index for index, s in enumerate(trace.scene) if surface_style(s.kind).height_m > 0]
        with np.errstate(all="ignore"):  # a trace may hold any number
            return cls(
                trace=trace,
                obstacles=_obstacles(trace),
                ego_brakes=_brake_lights_on(trace.ego[:, 3], trace.ego[:, 4]),
                actors_brake=tuple(_brakes(actor, trace) for actor in trace.actors),
                actors_hidden=tuple(_hidden(actor, trace) for actor in trace.actors),
                pitch_rad=_pitch_rad(trace),
                route_layer=standing[0] if standing else len(trace.scene),
            )


def _obstacles(trace: Trace) -> Obstacles:
    rows = trace.perceived.rows.astype(np.float64)
    label, x_m, y_m, vx_mps, vy_mps, length_m, width_m = rows[:, 1:].T
    samples = np.repeat(np.arange(len(trace.time_s)), np.diff(trace.perceived.first))
    moving = np.hypot(vx_mps, vy_mps) > _MOVING_MPS
    kinds = np.array([_ACTOR_KINDS[label_index(value)] for value in label.tolist()], dtype=np.str_)
    limit_m = np.full(len(rows), _MATCH_M)
    from_ego = x_m - trace.ego[samples, 0], y_m - trace.ego[samples, 1]
    if not is_injected(trace):
        away_m = np.hypot(*from_ego)
        limit_m = np.maximum(limit_m, _MATCH_PX * away_m**2 / (_CAMERA.focal_px * _CAMERA.height_m))
    sight_rad = np.arctan2(from_ego[1], from_ego[0])
    cos_sight, sin_sight = np.cos(sight_rad), np.sin(sight_rad)
    real = np.zeros(len(rows), dtype=np.bool_)
    for actor in trace.actors:
        there = actor.motion[samples]
        # A comparison with NaN is false: an actor that is absent matches nothing.
        dx, dy = there[:, 0] - x_m, there[:, 1] - y_m
        along_m, across_m = dx * cos_sight + dy * sin_sight, dy * cos_sight - dx * sin_sight
        near = np.hypot(along_m / limit_m, across_m / _MATCH_M) < 1.0
        real |= near & (kinds == str(actor.kind))
    ghosts = may_report_ghosts(trace)
    return Obstacles(
        yaw_rad=np.where(moving, np.arctan2(vy_mps, vx_mps), trace.ego[samples, 2]),
        length_m=np.fmax(length_m, _LEAST_SIDE_M),
        width_m=np.fmax(width_m, _LEAST_SIDE_M),
        ghost=~real if ghosts else np.zeros_like(real),
        astray=~real if not ghosts and bool(_errors_of_place(trace)) else np.zeros_like(real),
    )


def may_report_ghosts(trace: Trace) -> bool:
    """Return whether false reports are possible: not with ground truth, or with errors that only hide objects."""
    if has_errors(trace):
        return any(kind.startswith(_GHOST_ERROR) for kind in _error_types(trace))
    return not _is_true(trace)


def astray_words(trace: Trace, label: int) -> str:
    """Return the caption of a misplaced obstacle, such as ``misplaced vehicle``."""
    return f"{' or '.join(_errors_of_place(trace)) or 'misplaced'} {LABELS[label]}"


def ghost_words(trace: Trace, label: int) -> str:
    """Return the caption of a ghost; if the errors are inconclusive, it may be a misplaced true object."""
    doubt = "".join(f" or {word}" for word in _errors_of_place(trace))
    return f"ghost{doubt} {LABELS[label]}"


def _errors_of_place(trace: Trace) -> list[str]:
    """Return how the errors of an episode may distort true objects: misplace them, or change their labels."""
    kinds = {kind for kind in _error_types(trace) if not kind.startswith(_GHOST_ERROR)}
    places = kinds - _IN_PLACE - {_LABEL_ERROR}
    return [*(["misplaced"] if places else []), *(["mislabelled"] if _LABEL_ERROR in kinds else [])]


def _error_types(trace: Trace) -> list[str]:
    """Return the types of the errors of an episode; some simulators have only one."""
    behaviour = spec_part(trace, "behaviour")
    errors = behaviour.get("errors", [behaviour.get("error")])
    if not isinstance(errors, list):
        return []
    found = [one.get("type") for one in errors if isinstance(one, Mapping)]
    return [kind for kind in found if isinstance(kind, str)]


def _is_true(trace: Trace) -> bool:
    """Return whether the reported boxes are the ground truth."""
    return trace.film is None and spec_part(trace, "behaviour").get("mode") == "oracle"


def label_index(label: float) -> int:
    """Return the index of a label in `LABELS` and in the captions by label."""
    return int(label) if label in (0, PERSON) else len(LABELS) - 1


def _brakes(actor: ActorTrack, trace: Trace) -> Flags:
    speed_mps = actor.motion[:, 3]
    accel_mps2 = np.diff(speed_mps) / np.maximum(1e-6, np.diff(trace.time_s))
    return _brake_lights_on(speed_mps, np.concatenate([[0.0], accel_mps2]))


def _brake_lights_on(speed_mps: NDArray[np.floating], accel_mps2: NDArray[np.floating]) -> Flags:
    """Return for each sample what `brink.sim.world.vehicle.brake_lights_on` says."""
    return np.asarray((accel_mps2 < -BRAKE_LIGHTS_FROM_MPS2) | (speed_mps < HELD_BELOW_MPS))


def _hidden(actor: ActorTrack, trace: Trace) -> Flags:
    if actor.visible is None:
        return np.zeros(len(trace.time_s), np.bool_)
    least = spec_part(trace, "options").get("least_visible")
    return np.asarray(actor.visible < (least if isinstance(least, int | float) else LEAST_VISIBLE))


def _pitch_rad(trace: Trace) -> Points:
    if trace.pitch_rad is None:
        return np.zeros(len(trace.time_s))
    return np.nan_to_num(np.clip(trace.pitch_rad.astype(np.float64), -0.5, 0.5))


def map_centres(trace: Trace, look_ahead_m: float) -> Points:
    """Return the centre of the map at each sample: ahead of the ego, smoothed so that the map does not swing around.

    Args:
        trace: The episode.
        look_ahead_m: How far ahead of the ego the centre lies.

    Returns:
        World coordinates, shape ``(n, 2)``. Where the ego's pose is not finite, the last finite one is used.
    """
    pose = np.asarray(trace.ego[:, :3], dtype=np.float64)
    known = np.flatnonzero(np.isfinite(pose).all(axis=1))
    if not known.size:
        return np.zeros((len(pose), 2))
    pose = pose[known[np.maximum(0, np.searchsorted(known, np.arange(len(pose)), side="right") - 1)]]
    ahead = pose[:, :2] + look_ahead_m * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    if len(ahead) < 3:
        return ahead
    step_s = float(np.median(np.diff(trace.time_s)))
    half = int(min(len(ahead) - 1, _SMOOTHING_S / 2 / max(step_s, 1e-6)))
    padded = np.pad(ahead, ((half, half), (0, 0)), mode="edge")
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)])


def pictures_shown(film: Film, samples: int) -> NDArray[np.int64]:
    """Return the index of the image shown at each sample: the latest so far, or the first if there is none yet."""
    latest = np.searchsorted(film.samples, np.arange(samples), side="right") - 1
    return np.asarray(np.maximum(0, latest), dtype=np.int64)


def plain_name(plugin_id: str) -> str:
    """Return an id without its version: ``front-gap`` for ``front-gap@1``."""
    return plugin_id.partition("@")[0]


def spec_part(trace: Trace, name: str) -> Mapping[str, Json]:
    """Return a part of the episode's specification, such as ``behaviour``; empty if it is missing."""
    spec = trace.about.get("spec")
    part = spec.get(name) if isinstance(spec, Mapping) else None
    return part if isinstance(part, Mapping) else {}


def score_threshold(trace: Trace) -> float:
    """Return the score threshold of an episode's detector; 0 if the trace does not record it."""
    value = spec_part(trace, "behaviour").get("threshold")
    return float(value) if isinstance(value, int | float) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontGap:
    """The line from the ego to the vehicle ahead, or to another road user.

    Attributes:
        actor: Index of the road user among the trace's actors.
        ends: A point of the ego's outline and one of the road user's, shape ``(2, 2)``.
        gap_m: Length, as the requirement measured it if it was recorded.
        required: Whether the front gap is required to it.
    """

    actor: int
    ends: Points
    gap_m: float
    required: bool = True

    @property
    def too_short(self) -> bool:
        """Whether the gap is shorter than required."""
        return self.required and self.gap_m < REQUIRED_GAP_M


def front_gap(trace: Trace, sample: int) -> FrontGap | None:
    """Return the gap to the vehicle ahead; None if there is none within 40 m, or the ego has hit that vehicle."""
    series = {plain_name(name): values for name, values in trace.robustness.items()}
    recorded = series.get("front-gap")
    # Of a standing ego, front-gap@2 tells no gap that is too short.
    stands = recorded is not None and recorded[sample] == STANDING_MARGIN_M
    gap_m = None if recorded is None or stands else float(recorded[sample]) + REQUIRED_GAP_M
    if gap_m is not None and gap_m > _GAP_DRAWN_UP_TO_M:
        return None
    x_m, y_m, yaw_rad = (float(value) for value in trace.ego[sample, :3])
    ego = outline(x_m, y_m, yaw_rad, *trace.ego_size_m)
    route = trace.route if len(trace.route) else trace.ego[sample : sample + 1, :2]
    # A sample keeps the smallest gap until the next one: the ego may have come closer since its pose was recorded.
    following = min(sample + 1, len(trace.time_s) - 1)
    closed_m = abs(float(trace.ego[sample, 3])) * float(trace.time_s[following] - trace.time_s[sample])
    found: list[tuple[float, FrontGap]] = []
    for index, actor in enumerate(trace.actors):
        there = actor.motion[sample].tolist()
        dx_m, dy_m = there[0] - x_m, there[1] - y_m
        reach_m = _GAP_DRAWN_UP_TO_M + trace.ego_size_m[0] + actor.length_m
        # A comparison with NaN is false: an actor that is absent is not ahead.
        ahead = dx_m * np.cos(yaw_rad) + dy_m * np.sin(yaw_rad) > 0 and np.hypot(dx_m, dy_m) < reach_m
        if not is_car(actor) or not ahead:
            continue
        other = outline(there[0], there[1], there[2], actor.length_m, actor.width_m)
        start, end, clearance_m = closest_points(ego, other)
        if gap_m is None:
            if abs(dy_m * np.cos(yaw_rad) - dx_m * np.sin(yaw_rad)) > _CORRIDOR_M:
                continue
            rank = clearance_m
        elif not -_GAP_TOLERANCE_M <= clearance_m - gap_m <= _GAP_TOLERANCE_M + closed_m:
            continue
        else:
            # An oncoming vehicle may pass at just that distance: the one ahead is the one on the route.
            rank = float(np.hypot(*(route - actor.motion[sample, :2]).T).min())
        line_m = clearance_m if gap_m is None else max(0.0, gap_m)
        line = FrontGap(actor=index, ends=np.vstack([start, end]), gap_m=line_m, required=not stands)
        found.append((rank, line))
    nearest = min(found, key=lambda pair: pair[0])[1] if found else None
    collided = "no-collision" in series and bool(series["no-collision"][sample] < 0)
    return None if nearest is None or (collided and nearest.gap_m < _TOUCHING_M) else nearest


def gap_words(gap_m: float) -> str:
    """Return a gap with enough digits to tell it apart from the required one."""
    for digits in range(1, _MOST_DIGITS):
        shown = f"{gap_m:.{digits}f}"
        if (float(shown) < REQUIRED_GAP_M) == (gap_m < REQUIRED_GAP_M):
            break
    return f"{shown} m"


def gap_to(trace: Trace, sample: int, actor: int, gap_m: float | None = None) -> FrontGap | None:
    """Return the line from the ego to a road user at a sample; None while that one is absent.

    Args:
        trace: The episode.
        sample: The sample.
        actor: Index of the road user.
        gap_m: Length as the requirement measured it; by default the distance between the outlines.
    """
    other = trace.actors[actor]
    x_m, y_m, yaw_rad = (float(value) for value in other.motion[sample, :3])
    if not np.isfinite(x_m):
        return None
    ego_x_m, ego_y_m, ego_yaw_rad = (float(value) for value in trace.ego[sample, :3])
    ego = outline(ego_x_m, ego_y_m, ego_yaw_rad, *trace.ego_size_m)
    start, end, clearance_m = closest_points(ego, outline(x_m, y_m, yaw_rad, other.length_m, other.width_m))
    return FrontGap(
        actor=actor, ends=np.vstack([start, end]), gap_m=clearance_m if gap_m is None else max(0.0, gap_m)
    )


def impact_at(trace: Trace, sample: int, actor: int) -> Impact | None:
    """Return how the ego and a road user collided at a sample; None if they do not touch there."""
    gap = gap_to(trace, sample, actor)
    if gap is None or gap.gap_m > _TOUCHING_M:
        return None
    other = trace.actors[actor]
    x_m, y_m, yaw_rad, speed_mps = (float(value) for value in other.motion[sample, :4])
    ego = np.asarray(trace.ego[sample, :4], dtype=np.float64)
    body = outline(x_m, y_m, yaw_rad, other.length_m, other.width_m)
    _, middle, nearest = min(approaches([(float(ego[0]), float(ego[1]))], body.tolist()))
    dx, dy = nearest[0] - middle[0], nearest[1] - middle[1]
    cosine, sine = np.cos(ego[2]), np.sin(ego[2])
    length_m, width_m = trace.ego_size_m
    return Impact.of(
        bearing_rad=float(
            np.arctan2((dy * cosine - dx * sine) / width_m, (dx * cosine + dy * sine) / length_m)
        ),
        heading_rad=yaw_rad - float(ego[2]),
        speed_mps=speed_mps,
        ego_mps=float(ego[3]),
        on_foot=not is_car(other),
    )


def is_injected(trace: Trace) -> bool:
    """Return whether the reported boxes were injected, so that no detector processed the scene."""
    return trace.film is None and spec_part(trace, "behaviour").get("mode") not in (
        "detector",
        "oracle",
        MODE,
    )


def has_errors(trace: Trace) -> bool:
    """Return whether the reported boxes are the true ones with errors."""
    return spec_part(trace, "behaviour").get("mode") == MODE


def wrong_boxes(trace: Trace, sample: int) -> BoxRows:
    """Return the reported boxes of a sample that are not true ones."""
    true = set(map(bytes, trace.seen_boxes.at(sample)))
    given = trace.given_boxes.at(sample)
    return given[[bytes(row) not in true for row in given]]


def count_wrong(trace: Trace) -> IntArray:
    """Return how many boxes are wrong or missing at each sample, shape ``(n,)``."""
    counts = []
    for sample in range(len(trace.time_s)):
        true, given = (set(map(bytes, boxes.at(sample))) for boxes in (trace.seen_boxes, trace.given_boxes))
        counts.append(max(len(true - given), len(given - true)))
    return np.array(counts, np.int64)


def obstacles_on(scene: EpisodeScene, sample: int, actor: int) -> list[int]:
    """Return the rows of the perceived obstacles of a sample that lie on a road user, whatever their label.

    Detected obstacles are not exactly where their road users are: one of the same kind only has to be close.
    """
    trace = scene.trace
    other = trace.actors[actor]
    x_m, y_m, yaw_rad = (float(value) for value in other.motion[sample, :3])
    if not np.isfinite(x_m):
        return []
    body = outline(x_m, y_m, yaw_rad, other.length_m, other.width_m)
    injected = is_injected(trace)
    found = []
    for row in range(trace.perceived.first[sample], trace.perceived.first[sample + 1]):
        label, at_x_m, at_y_m = (float(value) for value in trace.perceived.rows[row, 1:4])
        near = not injected and np.hypot(at_x_m - x_m, at_y_m - y_m) < _MATCH_M
        if (near and _ACTOR_KINDS[label_index(label)] == other.kind) or overlaps(
            obstacle_outline(scene, row).tolist(), body.tolist()
        ):
            found.append(row)
    return found


def found_at(scene: EpisodeScene, sample: int, row: int) -> tuple[str, ...]:
    """Return what is at the position of a perceived obstacle: kinds of road users, and `PARKED` for a parked car."""
    trace = scene.trace
    box = obstacle_outline(scene, row)
    middle, reach_m = box.mean(axis=0), float(np.hypot(*(box[0] - box[2])))
    found = [
        str(actor.kind)
        for index, actor in enumerate(trace.actors)
        if np.hypot(*(actor.motion[sample, :2] - middle)) < reach_m + actor.length_m
        and row in obstacles_on(scene, sample, index)
    ]
    parked = (s.points.astype(np.float64) for s in trace.scene if s.kind == PARKED and len(s.points) > 2)
    if any(overlaps(box.tolist(), corners.tolist()) for corners in parked):
        found.append(PARKED)
    return tuple(dict.fromkeys(found))


def is_there(label: int, kinds: Sequence[str]) -> bool:
    """Return whether the objects at a position match a label; a parked car is a vehicle."""
    wanted = _ACTOR_KINDS[label]
    return wanted in kinds or (wanted == "vehicle" and PARKED in kinds)


def obstacle_outline(scene: EpisodeScene, row: int) -> Points:
    """Return the outline of a perceived obstacle, a row of ``trace.perceived``, shape ``(4, 2)``."""
    x_m, y_m = (float(value) for value in scene.trace.perceived.rows[row, 2:4])
    drawn = scene.obstacles
    return outline(x_m, y_m, drawn.yaw_rad[row], drawn.length_m[row], drawn.width_m[row])


def outline(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> Points:
    """Return the outline of a road user as a rectangle.

    Args:
        x_m: World coordinate of its centre.
        y_m: World coordinate of its centre.
        yaw_rad: Heading, counter-clockwise from x.
        length_m: Extent along the heading.
        width_m: Extent across the heading.

    Returns:
        Corners front left, front right, rear right, rear left, shape ``(4, 2)``.
    """
    rectangle = Rectangle(float(x_m), float(y_m), float(yaw_rad), 0.5 * float(length_m), 0.5 * float(width_m))
    return np.array(rectangle.corners())


def closest_points(one: Points, other: Points) -> tuple[Points, Points, float]:
    """Return the closest points of two convex polygons and the distance between the polygons.

    Where parallel edges face each other, the points are in the middle of the part that they share.

    Args:
        one: Corners in order, shape ``(k, 2)``.
        other: Corners in order, shape ``(l, 2)``.

    Returns:
        A point of each polygon, shape ``(2,)``, and the distance; 0 if the polygons overlap.
    """
    first, second = one.tolist(), other.tolist()
    if overlaps(first, second):
        middle = (one.mean(axis=0) + other.mean(axis=0)) / 2
        return middle, middle, 0.0
    found = [*approaches(first, second)]
    found += [(apart_m, on_one, on_other) for apart_m, on_other, on_one in approaches(second, first)]
    least = min(apart_m for apart_m, *_ in found)
    tied = np.array([points for apart_m, *points in found if apart_m <= least + _TIED_M])
    return tied[:, 0].mean(axis=0), tied[:, 1].mean(axis=0), least


def shared_area(one: Sequence[float], other: Sequence[float], margin: float = 0.0) -> float:
    """Return the area of the intersection of two rectangles (left, top, right, bottom), enlarged by a margin."""
    wide = min(one[2], other[2]) - max(one[0], other[0]) + margin
    high = min(one[3], other[3]) - max(one[1], other[1]) + margin
    return max(0.0, wide) * max(0.0, high)
