"""A trace as columns of rounded numbers, checked: a worker may have sent anything."""

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from brink.server.api.episode_schemas import (
    ActorView,
    Column,
    EgoView,
    EpisodeView,
    EpisodeWords,
    EventView,
    FilmView,
    PictureCamera,
    Point,
    RowsView,
    StoryView,
    SurfaceView,
)
from brink.sim.driving.camera import Camera
from brink.sim.errors import InvalidEpisode
from brink.sim.replay.scene import ReplayError, score_threshold
from brink.sim.replay.story import (
    perturbation_words,
    report_word,
    scenario_words,
    story_of,
    unit_of,
)
from brink.sim.trace import (
    BOX_COLUMNS,
    FOUND_COLUMNS,
    JUDGED_COLUMNS,
    PERCEIVED_COLUMNS,
    ActorTrack,
    Film,
    Ragged,
    Trace,
)

LONGEST_S: Final = 24 * 3600.0
"""Of an episode that is drawn: a page draws marks along its time."""
MOST_NUMBERS: Final = 4_000_000
"""Of a whole episode: an hour of an urban drive has a third of them."""

LEAST_SCORE: Final = 0.1
"""Detections less sure than this are left out: there are ten times as many as others, and nobody looks at them."""

_PLACE: Final = 3
_ANGLE: Final = 4
_BOX: Final = 1
_DIGITS: Final = {
    "score": 3, "x_m": _PLACE, "y_m": _PLACE, "vx_mps": 2, "vy_mps": 2, "length_m": 2, "width_m": 2,
}  # fmt: skip
_COLUMNS: Final = {
    "seen_boxes": BOX_COLUMNS, "given_boxes": BOX_COLUMNS, "perceived": PERCEIVED_COLUMNS,
    "judged": JUDGED_COLUMNS, "found": FOUND_COLUMNS,
}  # fmt: skip

T = TypeVar("T")


def episode_view(trace: Trace, requirement: str | None) -> EpisodeView:
    """Return an episode in columns.

    Args:
        trace: The episode.
        requirement: What the campaign judges; what a replay would be about, if not given.

    Raises:
        InvalidEpisode: The trace does not fit together, or is too long to be drawn.
    """
    _check(trace)
    ego = trace.ego
    return EpisodeView.model_construct(
        time_s=_column(trace.time_s, _PLACE),
        ego=EgoView.model_construct(
            x_m=_column(ego[:, 0], _PLACE),
            y_m=_column(ego[:, 1], _PLACE),
            yaw_rad=_column(ego[:, 2], _ANGLE),
            speed_mps=_column(ego[:, 3], _PLACE),
            accel_mps2=_column(ego[:, 4], _PLACE),
            length_m=_length(trace.ego_size_m[0]),
            width_m=_length(trace.ego_size_m[1]),
        ),
        route=_points(trace.route, _PLACE),
        actors=[_actor(actor) for actor in trace.actors],
        scene=[
            SurfaceView.model_construct(
                kind=str(surface.kind),
                closed=bool(surface.closed),
                width_m=_length(surface.width_m),
                points=_points(surface.points, _PLACE),
            )
            for surface in trace.scene
        ],
        seen=_rows(trace.seen_boxes),
        given=_rows(trace.given_boxes),
        perceived=_rows(trace.perceived),
        plan_mode=[str(mode) for mode in trace.plan_mode],
        target_speed_mps=_column(trace.target_speed_mps, 2),
        lights=[str(light) for light in trace.lights],
        robustness={str(name): _column(series, _PLACE) for name, series in trace.robustness.items()},
        units={str(name): unit_of(str(name)) for name in trace.robustness},
        events=[
            EventView.model_construct(time_s=_length(e.time_s), kind=str(e.kind), text=str(e.text))
            for e in trace.events
        ],
        story=_story(trace, requirement),
        words=EpisodeWords.model_construct(
            scenario=_said(scenario_words, trace, ""),
            perturbations=_said(perturbation_words, trace, ""),
            report=report_word(trace),
        ),
        camera=_camera(),
        film=None if trace.film is None else _film(trace, trace.film),
    )


def _check(trace: Trace) -> None:
    """Raise InvalidEpisode if arrays do not belong together."""
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
    shapes = {
        "ego": (trace.ego, (samples, 5)),
        "target_speed_mps": (trace.target_speed_mps, (samples,)),
        **{f"actor {i}": (actor.motion, (samples, 4)) for i, actor in enumerate(trace.actors)},
        **{f"robustness of {name}": (series, (samples,)) for name, series in trace.robustness.items()},
    }
    for name, (array, shape) in shapes.items():
        _expect(array.shape == shape, f"{name}: expected shape {shape}, got {array.shape}")
    for name, words in (("plan_mode", trace.plan_mode), ("lights", trace.lights)):
        _expect(len(words) == samples, f"{name}: expected {samples} words, got {len(words)}")
    ragged = {"seen_boxes": trace.seen_boxes, "given_boxes": trace.given_boxes, "perceived": trace.perceived}
    if trace.film is not None:
        ragged |= {"judged": trace.film.judged, "found": trace.film.found}
        pictures = trace.film.samples
        _expect(pictures.shape == (len(trace.film.pictures),), "film: expected one sample a picture")
        within = ((pictures >= 0) & (pictures < samples)).all() and (np.diff(pictures) > 0).all()
        _expect(bool(within), "film: expected ascending samples of the episode")
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
    _expect(whole, f"{name}: expected {samples + 1} whole numbers in first, got {first.dtype} {first.shape}")
    ascends = first[0] == 0 and first[-1] == len(rows) and (np.diff(first.astype(np.int64)) >= 0).all()
    _expect(bool(ascends), f"{name}: expected first to ascend from 0 to {len(rows)}")


def _expect(holds: bool, message: str) -> None:
    if not holds:
        raise InvalidEpisode(message)


def _column(values: ArrayLike, digits: int) -> Any:
    """Return numbers rounded; what is not finite is written as null later."""
    return np.round(np.asarray(values, dtype=np.float64), digits).tolist()


def _points(points: ArrayLike, digits: int) -> list[Point]:
    array = np.asarray(points, dtype=np.float64)
    _expect(array.ndim == 2 and array.shape[1] == 2, f"points: expected shape (k, 2), got {array.shape}")
    _expect(bool(np.isfinite(array).all()), "points: expected finite numbers")
    return [(x, y) for x, y in np.round(array, digits).tolist()]


def _length(value: float) -> float:
    number = float(value)
    _expect(bool(np.isfinite(number)), f"expected a finite number, got {number!r}")
    return round(number, _PLACE)


def _actor(actor: ActorTrack) -> ActorView:
    x_m, y_m, yaw_rad, speed_mps = actor.motion.T
    return ActorView.model_construct(
        name=str(actor.name),
        kind=str(actor.kind),
        length_m=_length(actor.length_m),
        width_m=_length(actor.width_m),
        x_m=_column(x_m, _PLACE),
        y_m=_column(y_m, _PLACE),
        yaw_rad=_column(yaw_rad, _ANGLE),
        speed_mps=_column(speed_mps, _PLACE),
    )


def _rows(ragged: Ragged) -> RowsView:
    columns: dict[str, Column] = {
        str(name): _column(ragged.rows[:, place], _DIGITS.get(str(name), _BOX))
        for place, name in enumerate(ragged.columns)
    }
    return RowsView.model_construct(first=ragged.first.tolist(), columns=columns)


def _surer(found: Ragged) -> Ragged:
    kept = found.rows[:, FOUND_COLUMNS.index("score")] >= LEAST_SCORE
    before = np.concatenate([[0], np.cumsum(kept)])
    return Ragged(columns=found.columns, first=before[found.first], rows=found.rows[kept])


def _story(trace: Trace, requirement: str | None) -> StoryView | None:
    """Return what the episode is about: what the campaign judges, or else what is violated first."""
    try:
        story = story_of(trace, requirement)
        if requirement is None and not story.violated:
            below = {name: np.flatnonzero(series < 0) for name, series in trace.robustness.items()}
            violated = {name: int(samples[0]) for name, samples in below.items() if samples.size}
            story = story_of(trace, min(violated, key=violated.__getitem__)) if violated else story
    except ReplayError:
        if requirement is not None:  # the campaign judges something that the trace does not record
            return _story(trace, None)
        return None
    return StoryView.model_construct(
        requirement=story.requirement, violated=story.violated, decisive=story.decisive
    )


def _said(say: Callable[[Trace], T], trace: Trace, otherwise: T) -> T:
    """Return words of a trace; what a worker wrote of its scenario may be anything."""
    try:
        return say(trace)
    except (LookupError, TypeError, ValueError, ArithmeticError):
        return otherwise


def _camera() -> PictureCamera:
    camera = Camera()
    return PictureCamera.model_construct(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=round(camera.focal_px, _PLACE),
        centre_x_px=camera.centre_x_px,
        horizon_px=camera.horizon_px,
        height_m=camera.height_m,
        forward_m=camera.forward_m,
    )


def _film(trace: Trace, film: Film) -> FilmView:
    width_px, height_px = (int(side) for side in film.size_px)
    _expect(min(width_px, height_px) > 0, f"film: expected a size above 0, got {film.size_px}")
    return FilmView.model_construct(
        size_px=(width_px, height_px),
        samples=film.samples.tolist(),
        judged=_rows(film.judged),
        found=_rows(_surer(film.found)),
        threshold=_length(score_threshold(trace)),
        regions={str(name): _points(corners, _BOX) for name, corners in film.regions.items()},
    )
