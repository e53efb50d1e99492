"""An episode as the API returns it: a trace and its scene model as columns of rounded numbers, ready to be drawn.

Absent and unbounded values are null. Positions are rounded to 1 mm, angles to 0.0001 rad, boxes to a
tenth of a pixel. Traces are checked first: a worker may have sent anything.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from brink.pictures.guard import guard_words
from brink.pictures.motion import plan_words
from brink.pictures.pair import ended_words
from brink.pictures.reference import comparison_of
from brink.pictures.scene import (
    LABELS,
    PERSON_REGION,
    PICTURE_COLOURS,
    SHAPES,
    SIGHTED,
    SKETCHED_FROM_M,
    SKETCHED_TO_M,
    EpisodeScene,
    Flags,
    ReplayError,
    ghost_words,
    is_car,
    map_centres,
    pictures_shown,
    score_threshold,
    surface_style,
)
from brink.pictures.story import (
    event_caption,
    perturbation_words,
    report_word,
    scenario_words,
    story_of,
    unit_of,
)
from brink.server.views import View
from brink.sim.driving.camera import Camera
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import (
    ACTION,
    BOX_COLUMNS,
    FOUND_COLUMNS,
    JUDGED_COLUMNS,
    PERCEIVED_COLUMNS,
    ActorTrack,
    Film,
    FloatArray,
    GuardTrack,
    Ragged,
    Surface,
    Trace,
)

LONGEST_S: Final = 24 * 3600.0
"""Longest episode that is drawn, since the dashboard draws marks along its whole duration."""
MOST_NUMBERS: Final = 4_000_000
"""Maximum total size of the arrays of one episode; an hour of urban driving has a third of this."""
LEAST_SCORE: Final = 0.1
"""Detections with a lower score are left out: there are ten times as many of them, and they are of no interest."""
LOOK_AHEAD_M: Final = 12.0
"""Distance from the ego to the centre of the dashboard's map, which lies ahead of it."""

_COLUMNS: Final = {
    "seen_boxes": BOX_COLUMNS,
    "given_boxes": BOX_COLUMNS,
    "perceived": PERCEIVED_COLUMNS,
    "judged": JUDGED_COLUMNS,
    "found": FOUND_COLUMNS,
}
_PLACE: Final = 3
_ANGLE: Final = 4
_BOX: Final = 1
_DECIMALS: Final = {
    "score": 3,
    "x_m": _PLACE,
    "y_m": _PLACE,
    "vx_mps": 2,
    "vy_mps": 2,
    "length_m": 2,
    "width_m": 2,
}
"""Decimal places by column; columns not listed are rounded like box coordinates."""

Column: TypeAlias = list[float | None]
Point: TypeAlias = tuple[float, float]
Ring: TypeAlias = Sequence[Point]


class TrackView(View):
    """The motion of a road user, with one value per sample; null where it is absent."""

    x_m: Column
    y_m: Column
    yaw_rad: Column
    speed_mps: Column
    length_m: float
    width_m: float
    brakes: Annotated[list[bool], Field(description="Whether its brake lights are on.")]


class EgoView(TrackView):
    """The motion of the ego, with one value per sample."""

    accel_mps2: Column


class ActorView(TrackView):
    """Another road user: its kind, and its motion with one value per sample."""

    name: str
    kind: Annotated[str, Field(description="vehicle or pedestrian.")]
    shape: Annotated[str, Field(description="How it is drawn: car or person.")]
    hidden: Annotated[
        list[bool], Field(description="Whether it is within the camera's image, but hidden from the camera.")
    ]


class SurfaceView(View):
    """A flat polygon or line of the scene; surfaces are drawn in the given order."""

    kind: str
    closed: Annotated[bool, Field(description="True for an area; false for a line `width_m` wide.")]
    width_m: float
    points: Annotated[list[Point], Field(description="In metres.")]
    paint: Annotated[str, Field(description="Name of its style; kinds that look alike share one.")]
    outlined: Annotated[bool, Field(description="Whether its edge is drawn.")]
    height_m: Annotated[
        float, Field(description="Height at which it is drawn in perspective; 0 if it is flat.")
    ]


class CentreView(View):
    """Centre of the map at each sample, in metres."""

    x_m: Column
    y_m: Column


class ShapesView(View):
    """Top-view outlines of road users.

    The points of a car are relative to its centre: half lengths ahead, half widths to the left.
    """

    car_body: Ring
    car_windows: Sequence[Ring]
    car_brake_lights: Sequence[Ring]
    person_radius_m: float
    person_nose: Annotated[
        float, Field(description="Distance from the centre to the tip of the nose, in radii.")
    ]


class RowsView(View):
    """Table rows, any number of them per sample, as one list per column."""

    first: Annotated[
        list[int],
        Field(description="Index of each sample's first row, followed by the total number of rows."),
    ]
    columns: Annotated[
        dict[str, Column], Field(description="By name; in the column `label`, 0 is a vehicle and 1 a person.")
    ]


class PictureCamera(View):
    """The camera to whose image the boxes `seen` and `given` refer, in pixels. It faces along the ego's yaw."""

    width_px: int
    height_px: int
    focal_px: float
    centre_x_px: float
    horizon_px: float
    height_m: Annotated[float, Field(description="Above the ground.")]
    forward_m: Annotated[float, Field(description="Ahead of the ego's centre.")]
    from_m: Annotated[float, Field(description="Sketches omit anything nearer.")]
    to_m: Annotated[float, Field(description="Sketches omit areas that begin farther away.")]


class FilmView(View):
    """The pictures recorded by a camera in the loop. Boxes are in pixels of these pictures."""

    size_px: tuple[int, int]
    samples: Annotated[list[int], Field(description="The sample of each picture, ascending.")]
    shown: Annotated[list[int], Field(description="Index of the picture that each sample shows.")]
    judged: Annotated[
        RowsView, Field(description="Ground truth; `ignored` is 1 for boxes that do not count.")
    ]
    found: Annotated[
        RowsView,
        Field(
            description="Detections with a score of at least `least_score`; `counts` is 1 from `threshold` on."
        ),
    ]
    threshold: Annotated[float, Field(description="Minimum score of a detection that counts.")]
    least_score: Annotated[float, Field(description="Minimum score of a detection that is listed.")]
    regions: Annotated[dict[str, list[Point]], Field(description="Areas that trigger the brake.")]
    person_region: Annotated[
        str, Field(description="Name of the region for people; the other regions are for vehicles.")
    ]
    colours: Annotated[dict[str, str], Field(description="Line colours of `judged`, `found` and `region`.")]


class EventView(View):
    """A notable moment of an episode."""

    time_s: float
    kind: str
    text: str
    caption: Annotated[str, Field(description="The event in words.")]
    marked: Annotated[bool, Field(description="Whether the event is marked on a time axis.")]


class ViolatedHereView(View):
    """The first violation of a requirement."""

    requirement: str
    sample: int
    time_s: Annotated[float, Field(description="When, to the fraction of a sample if that was recorded.")]
    words: Annotated[str, Field(description="Such as `hit a pedestrian at 12.8 s`, with this time.")]


class GuardView(View):
    """What a guard and the fallback that it triggers did."""

    fallback: Annotated[str, Field(description="Id of the fallback.")]
    horizons_s: Annotated[list[float], Field(description="Horizons of the probabilities.")]
    probabilities: Annotated[
        list[Column],
        Field(description="Probability of a violation within each horizon: one value per sample each."),
    ]
    state: Annotated[
        list[str],
        Field(
            description="At each sample: `fallback` while the fallback intervenes, otherwise `alarm` during an "
            "alarm; else empty."
        ),
    ]


class StoryView(View):
    """The requirement that the episode is about, its decisive sample, and all violations."""

    requirement: str
    violated: bool
    decisive: Annotated[
        int, Field(description="Sample of the first violation or, without one, of the lowest robustness.")
    ]
    violations: Annotated[
        list[ViolatedHereView],
        Field(description="First violations of all requirements: of this one, then by time."),
    ]
    words: Annotated[str, Field(description="Such as `front gap held; hit a pedestrian at 12.8 s`.")]


class EpisodeWords(View):
    """The episode in words. Lists are indexed by label; their last entry is for any other label."""

    scenario: str
    perturbations: Annotated[
        str, Field(description="Perturbations of the pictures; empty if there are none.")
    ]
    report: Annotated[str, Field(description="Origin of the given boxes: injected, detected or seen.")]
    ended: Annotated[str, Field(description="How the drive ends, such as `recorded until 20.5 s`.")]
    labels: Annotated[Sequence[str], Field(description="Names of labels.")]
    sighted: Annotated[Sequence[str], Field(description="Captions of perceived obstacles that really exist.")]
    ghosts: Annotated[Sequence[str], Field(description="Captions of ghosts.")]


class EpisodeView(View):
    """A sampled episode."""

    time_s: list[float]
    ego: EgoView
    route: Annotated[list[Point], Field(description="Centre line of the ego's lane.")]
    route_layer: Annotated[
        int, Field(description="Number of surfaces of the scene that lie below the route.")
    ]
    centre: CentreView
    actors: list[ActorView]
    scene: list[SurfaceView]
    shapes: ShapesView
    seen: Annotated[RowsView, Field(description="Ground truth in the picture: the component's input.")]
    given: Annotated[RowsView, Field(description="Boxes that the driving system receives.")]
    perceived: Annotated[
        RowsView,
        Field(
            description="What the driving system perceives. A box is drawn at `yaw_rad`, `drawn_length_m` by "
            "`drawn_width_m`; `ghost` is 1 if nothing of its kind is there."
        ),
    ]
    plan_mode: Annotated[
        list[str],
        Field(
            description="The driving system's plan at each sample; of a reference driver, what it does: `brakes`, "
            "`waits` or `drives`."
        ),
    ]
    target_speed_mps: Column
    lights: Annotated[
        list[str],
        Field(description="State of the ego's traffic light at each sample; empty if there is no light."),
    ]
    robustness: Annotated[dict[str, Column], Field(description="Value at each sample, by requirement.")]
    units: Annotated[
        dict[str, str], Field(description="Unit of the robustness, by requirement; empty if unknown.")
    ]
    events: list[EventView]
    story: StoryView | None
    words: EpisodeWords
    camera: PictureCamera
    pitch_rad: Annotated[
        Column, Field(description="Pitch of the camera, positive if it looks up; 0 if it was not recorded.")
    ]
    film: FilmView | None
    guard: Annotated[GuardView | None, Field(description="Null for a car without a guard.")] = None
    reference: Annotated[
        "ReferenceView | None",
        Field(
            description="What a reference driver does in the system's place; null if none avoids a violation."
        ),
    ] = None


class ReferenceView(View):
    """The drive of a reference driver among the same road users, who would have avoided what the system violated."""

    driver: Annotated[str, Field(description="`careful` (UN Regulation No. 157, Annex 3), or `ideal`.")]
    name: Annotated[str, Field(description="Such as `careful driver`.")]
    sentences: Annotated[
        list[str],
        Field(description="The actions of the system, and those of the driver instead, in a sentence each."),
    ]
    explanation: Annotated[
        str, Field(description="Explanation of the driver and the other road users, in sentences.")
    ]
    avoided_by: Annotated[
        str,
        Field(description="That the driver avoids it without braking, in a sentence; empty if it brakes."),
    ]
    violated: Annotated[
        dict[str, str],
        Field(description="What the system violated and when, with the names of others, by requirement."),
    ]
    moment_s: Annotated[float, Field(description="Time of the violation that these are about.")]
    brakes_at_s: Annotated[
        float | None, Field(description="When the driver begins to brake; null if it drives on.")
    ]
    drive: EpisodeView


def episode_view(trace: Trace, judged: Sequence[str]) -> EpisodeView:
    """Convert a trace to the column-oriented form that the API returns.

    Args:
        trace: The episode.
        judged: The requirements that the campaign judges; if empty, the one that a replay is about by default.

    Raises:
        InvalidEpisode: The trace is inconsistent, or too long to be drawn.
    """
    _check(trace)
    scene = EpisodeScene.of(trace)
    obstacles = scene.obstacles
    centre_x_m, centre_y_m = map_centres(trace, LOOK_AHEAD_M).T
    return EpisodeView.model_construct(
        time_s=_metres(trace.time_s),
        ego=EgoView.model_construct(
            **_track(trace.ego, trace.ego_size_m, scene.ego_brakes), accel_mps2=_metres(trace.ego[:, 4])
        ),
        route=_points(trace.route, _PLACE),
        route_layer=scene.route_layer,
        centre=CentreView.model_construct(x_m=_metres(centre_x_m), y_m=_metres(centre_y_m)),
        actors=[
            _actor(actor, brakes, hidden)
            for actor, brakes, hidden in zip(
                trace.actors, scene.actors_brake, scene.actors_hidden, strict=True
            )
        ],
        scene=[_surface(surface) for surface in trace.scene],
        shapes=ShapesView.model_construct(**SHAPES._asdict()),
        seen=_rows(trace.seen_boxes),
        given=_rows(trace.given_boxes),
        perceived=_rows(
            trace.perceived,
            yaw_rad=_column(obstacles.yaw_rad, _ANGLE),
            drawn_length_m=_metres(obstacles.length_m),
            drawn_width_m=_metres(obstacles.width_m),
            ghost=obstacles.ghost.astype(int).tolist(),
        ),
        plan_mode=plan_words(trace),
        target_speed_mps=_column(trace.target_speed_mps, 2),
        lights=[str(light) for light in trace.lights],
        robustness={str(name): _metres(series) for name, series in trace.robustness.items()},
        units={str(name): unit_of(trace, str(name)) for name in trace.robustness},
        events=[
            EventView.model_construct(
                time_s=_length(event.time_s),
                kind=str(event.kind),
                text=str(event.text),
                caption=event_caption(event),
                marked=event.kind != ACTION,
            )
            for event in trace.events
        ],
        story=_story(trace, judged),
        words=EpisodeWords.model_construct(
            scenario=_or_empty(scenario_words, trace),
            perturbations=_or_empty(perturbation_words, trace),
            report=report_word(trace),
            ended=ended_words(trace),
            labels=LABELS,
            sighted=SIGHTED,
            ghosts=[ghost_words(trace, label) for label in range(len(LABELS))],
        ),
        camera=_camera(),
        pitch_rad=_column(scene.pitch_rad, _ANGLE),
        film=None if trace.film is None else _film(trace, trace.film),
        guard=None if trace.guard is None else _guard(trace, trace.guard),
        reference=_reference(trace, judged),
    )


def _guard(trace: Trace, guard: GuardTrack) -> GuardView:
    return GuardView.model_construct(
        fallback=guard.fallback,
        horizons_s=[_length(horizon_s) for horizon_s in guard.horizons_s],
        probabilities=[_column(guard.probabilities[:, place], 3) for place in range(len(guard.horizons_s))],
        state=guard_words(trace),
    )


def _reference(trace: Trace, judged: Sequence[str]) -> ReferenceView | None:
    """Return the drive of the reference driver who avoids a violation of a judged requirement, if there is one."""
    try:
        compared = comparison_of(trace, judged or None)
    except ReplayError:
        return None  # the trace does not record the requirements that the campaign judges
    if compared is None:
        return None
    return ReferenceView.model_construct(
        driver=compared.driver,
        name=compared.name,
        sentences=list(compared.sentences),
        explanation=compared.explanation,
        avoided_by=compared.avoided_by,
        violated=dict(compared.words),
        moment_s=_length(compared.about.time_s),
        brakes_at_s=None if compared.brakes_at_s is None else _length(compared.brakes_at_s),
        drive=episode_view(compared.reference, (compared.about.requirement,)),
    )


def _check(trace: Trace) -> None:
    """Raise InvalidEpisode if the arrays of a trace are inconsistent."""
    samples = len(trace.time_s)
    _expect(isinstance(trace.about, Mapping), "about: expected a mapping")
    _expect(
        all(isinstance(name, str) for name in trace.robustness), "robustness: expected names of requirements"
    )
    _expect(trace.time_s.ndim == 1 and samples > 0, "time_s: expected at least one sample")
    ascends = np.isfinite(trace.time_s).all() and (np.diff(trace.time_s) >= 0).all()
    _expect(bool(ascends), "time_s: expected ascending times")
    span_s = float(trace.time_s[-1]) - float(trace.time_s[0])
    _expect(span_s <= LONGEST_S, f"time_s: expected at most {LONGEST_S:g} s, got {span_s:g}")
    shapes: dict[str, tuple[NDArray[Any], tuple[int, ...]]] = {
        "ego": (trace.ego, (samples, 5)),
        "target_speed_mps": (trace.target_speed_mps, (samples,)),
        **{f"actor {i}": (actor.motion, (samples, 4)) for i, actor in enumerate(trace.actors)},
        **{f"robustness of {name}": (series, (samples,)) for name, series in trace.robustness.items()},
    }
    if trace.guard is not None:
        probabilities = trace.guard.probabilities
        shapes["probabilities of the guard"] = (probabilities, (samples, len(trace.guard.horizons_s)))
    for name, (array, shape) in shapes.items():
        _expect(array.shape == shape, f"{name}: expected shape {shape}, got {array.shape}")
    for name, words in (("plan_mode", trace.plan_mode), ("lights", trace.lights)):
        _expect(len(words) == samples, f"{name}: expected {samples} strings, got {len(words)}")
    ragged = {"seen_boxes": trace.seen_boxes, "given_boxes": trace.given_boxes, "perceived": trace.perceived}
    if trace.film is not None:
        ragged |= {"judged": trace.film.judged, "found": trace.film.found}
        pictures = trace.film.samples
        _expect(pictures.shape == (len(trace.film.pictures),), "film: expected one sample per picture")
        within = ((pictures >= 0) & (pictures < samples)).all() and (np.diff(pictures) > 0).all()
        _expect(bool(within), "film: expected ascending indices of samples of the episode")
    for name, rows in ragged.items():
        _check_rows(name, rows, samples)
    numbers = sum(array.size for array, _ in shapes.values()) + sum(
        rows.rows.size for rows in ragged.values()
    )
    numbers += trace.route.size + sum(surface.points.size for surface in trace.scene)
    _expect(numbers <= MOST_NUMBERS, f"expected at most {MOST_NUMBERS} numbers, got {numbers}")


def _check_rows(name: str, ragged: Ragged, samples: int) -> None:
    first, rows, columns = ragged.first, ragged.rows, _COLUMNS[name]
    _expect(
        tuple(ragged.columns) == columns and rows.ndim == 2 and rows.shape[1] == len(columns),
        f"{name}: expected columns {', '.join(columns)}, got shape {rows.shape}",
    )
    whole = first.shape == (samples + 1,) and first.dtype.kind in "iu"
    _expect(whole, f"{name}: expected {samples + 1} integers in `first`, got {first.dtype} {first.shape}")
    ascends = first[0] == 0 and first[-1] == len(rows) and (np.diff(first.astype(np.int64)) >= 0).all()
    _expect(bool(ascends), f"{name}: expected `first` to ascend from 0 to {len(rows)}")


def _expect(holds: bool, message: str) -> None:
    if not holds:
        raise InvalidEpisode(message)


def _column(values: ArrayLike, decimals: int) -> Any:
    """Return rounded numbers; pydantic writes non-finite ones as null."""
    return np.round(np.asarray(values, dtype=np.float64), decimals).tolist()


def _metres(values: ArrayLike) -> Any:
    return _column(values, _PLACE)


def _points(points: ArrayLike, decimals: int) -> list[Point]:
    array = np.asarray(points, dtype=np.float64)
    _expect(array.ndim == 2 and array.shape[1] == 2, f"points: expected shape (k, 2), got {array.shape}")
    _expect(bool(np.isfinite(array).all()), "points: expected finite numbers")
    return [(x, y) for x, y in np.round(array, decimals).tolist()]


def _length(value: float) -> float:
    number = float(value)
    _expect(bool(np.isfinite(number)), f"expected a finite number, got {number!r}")
    return round(number, _PLACE)


def _track(motion: FloatArray, size_m: tuple[float, float], brakes: Flags) -> dict[str, Any]:
    """Return the fields of a `TrackView`; x_m, y_m, yaw_rad, speed_mps are the first columns of the motion."""
    names = {"x_m": _PLACE, "y_m": _PLACE, "yaw_rad": _ANGLE, "speed_mps": _PLACE}
    columns = {name: _column(motion[:, place], names[name]) for place, name in enumerate(names)}
    return columns | {
        "length_m": _length(size_m[0]),
        "width_m": _length(size_m[1]),
        "brakes": brakes.tolist(),
    }


def _actor(actor: ActorTrack, brakes: Flags, hidden: Flags) -> ActorView:
    return ActorView.model_construct(
        name=str(actor.name),
        kind=str(actor.kind),
        shape="car" if is_car(actor) else "person",
        hidden=hidden.tolist(),
        **_track(actor.motion, (actor.length_m, actor.width_m), brakes),
    )


def _surface(surface: Surface) -> SurfaceView:
    style = surface_style(str(surface.kind))
    return SurfaceView.model_construct(
        kind=str(surface.kind),
        closed=bool(surface.closed),
        width_m=_length(surface.width_m),
        points=_points(surface.points, _PLACE),
        paint=style.paint,
        outlined=style.outlined,
        height_m=style.height_m,
    )


def _rows(ragged: Ragged, **derived: Column) -> RowsView:
    """Return rows as one list per column, including the columns that the scene model adds."""
    columns: dict[str, Column] = {
        str(name): _column(ragged.rows[:, place], _DECIMALS.get(str(name), _BOX))
        for place, name in enumerate(ragged.columns)
    }
    return RowsView.model_construct(first=ragged.first.tolist(), columns={**columns, **derived})


def _story(trace: Trace, judged: Sequence[str]) -> StoryView | None:
    """Return what the episode is about: a requirement that the campaign judges, or the first that is violated."""
    try:
        story = story_of(trace, judged or None)
    except ReplayError:
        # The trace does not record the requirements that the campaign judges.
        return _story(trace, ()) if judged else None
    return StoryView.model_construct(
        requirement=story.requirement,
        violated=story.violated,
        decisive=story.decisive,
        words=story.words,
        violations=[
            ViolatedHereView.model_construct(
                requirement=one.requirement, sample=one.sample, time_s=_length(one.time_s), words=one.words
            )
            for one in story.violations
        ],
    )


def _or_empty(describe: Callable[[Trace], str], trace: Trace) -> str:
    """Return a description of a trace, or an empty one if the trace is malformed, since workers are not trusted."""
    try:
        return describe(trace)
    except (LookupError, TypeError, ValueError, ArithmeticError):
        return ""


def _camera() -> PictureCamera:
    camera = Camera()
    names = ("width_px", "height_px", "centre_x_px", "horizon_px", "height_m", "forward_m")
    return PictureCamera.model_construct(
        **{name: getattr(camera, name) for name in names},
        focal_px=round(camera.focal_px, _PLACE),
        from_m=SKETCHED_FROM_M,
        to_m=SKETCHED_TO_M,
    )


def _film(trace: Trace, film: Film) -> FilmView:
    width_px, height_px = (int(side) for side in film.size_px)
    _expect(min(width_px, height_px) > 0, f"film: expected a size above 0, got {film.size_px}")
    threshold = score_threshold(trace)
    found = _with_score(film.found, LEAST_SCORE)
    counts = found.rows[:, FOUND_COLUMNS.index("score")] >= threshold
    return FilmView.model_construct(
        size_px=(width_px, height_px),
        samples=film.samples.tolist(),
        shown=pictures_shown(film, len(trace.time_s)).tolist() if len(film.samples) else [],
        judged=_rows(film.judged),
        found=_rows(found, counts=counts.astype(int).tolist()),
        threshold=_length(threshold),
        least_score=LEAST_SCORE,
        regions={str(name): _points(corners, _BOX) for name, corners in film.regions.items()},
        person_region=PERSON_REGION,
        colours={line: "#{:02x}{:02x}{:02x}".format(*colour) for line, colour in PICTURE_COLOURS.items()},
    )


def _with_score(found: Ragged, least: float) -> Ragged:
    """Return the detections with at least the given score."""
    listed = found.rows[:, FOUND_COLUMNS.index("score")] >= least
    before = np.concatenate([[0], np.cumsum(listed)])
    return Ragged(columns=found.columns, first=before[found.first], rows=found.rows[listed])
