"""Records an emergency-braking episode as a `brink.sim.trace.Trace` that every replay can render.

Boxes are in coordinates of the trace's 800 x 600 image. They apply to any resolution, because the horizontal field
of view is the same.
"""

import io
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from brink.sim.aeb.braking import Detection, EmergencyBrake
from brink.sim.aeb.sight import CameraShot, FrameObservation, Picture, boxes_of
from brink.sim.aeb.street import CRUISE_MPS, END_M, LANE_Y_M, Street
from brink.sim.episode import Json
from brink.sim.rendering.scene import BodyKind, Material
from brink.sim.trace import (
    BOX_COLUMNS,
    FOUND_COLUMNS,
    JUDGED_COLUMNS,
    PERCEIVED_COLUMNS,
    ActorTrack,
    Event,
    Film,
    FloatArray,
    Ragged,
    Surface,
    Trace,
)
from brink.sim.world.ego import EgoCar

TRACE_PX: Final = (800.0, 600.0)
PICTURE_EVERY: Final = 2
"""Every second frame is kept as an image: ten per second, the frame rate of replay videos."""
MAX_PICTURE_BYTES: Final = 4_500_000
"""All images of a film; the rest of `MAX_TRACE_BYTES` is for boxes and positions. A film that would be larger, of a
long or a noisy drive, has fewer images a second."""
JPEG_QUALITY: Final = 70
PICTURE_WIDTH_PX: Final = 480
"""Wider images are scaled down to this width, so that a ten-second film takes one or two megabytes."""
_SURFACES: Final = {Material.ASPHALT: "road", Material.PAVEMENT: "pavement", Material.MARKING: "marking"}


class AebRecorder:
    """Records one sample per frame.

    Args:
        street: The street.
        ego: The car under test.
        size_px: Size of the camera's image.
    """

    def __init__(self, street: Street, ego: EgoCar, size_px: tuple[int, int]) -> None:
        self._street = street
        self._ego = ego
        self._size_px = size_px
        self._time_s: list[float] = []
        self._ego_rows: list[tuple[float, ...]] = []
        self._actor_rows: list[list[tuple[float, float, float, float]]] = []
        self._truth: list[list[tuple[float, ...]]] = []
        self._given: list[list[tuple[float, ...]]] = []
        self._brakes: list[bool] = []
        self._robustness: dict[str, list[float]] = {}
        self._events: list[Event] = []
        self._film = _FilmRecorder()

    def record_frame(self, time_s: float, observation: FrameObservation, *, brakes: bool) -> None:
        """Record a frame.

        Args:
            time_s: Time of the frame.
            observation: What was observed.
            brakes: Whether the brake is on.
        """
        if brakes and not (self._brakes and self._brakes[-1]):
            self._events.append(Event(time_s=time_s, kind="brakes", text="emergency braking begins"))
        self._place(time_s)
        self._truth.append(self._scaled(observation.truth))
        self._given.append(self._scaled(observation.detections))
        if observation.shot is not None:
            self._film.append(len(self._time_s) - 1, observation.shot)
        self._brakes.append(brakes)

    def record_robustness(self, name: str, robustness: float) -> None:
        """Record the robustness of a requirement at the end of the frame."""
        self._robustness.setdefault(name, []).append(robustness)

    def finish(self, time_s: float) -> None:
        """Record the final positions."""
        if self._brakes:
            self._place(time_s)
            self._truth.append([])
            self._given.append([])
            self._brakes.append(self._brakes[-1])
            for series in self._robustness.values():
                series.append(series[-1])

    def _place(self, time_s: float) -> None:
        ego = self._ego
        self._time_s.append(time_s)
        self._ego_rows.append((ego.x_m, ego.y_m, ego.yaw_rad, ego.speed_mps, ego.accel_mps2))
        self._actor_rows.append([(a.x_m, a.y_m, a.body.yaw_rad, a.speed_mps) for a in self._street.actors])

    def _scaled(self, boxes: Sequence[Detection]) -> list[tuple[float, ...]]:
        width_px, height_px = self._size_px
        scale = TRACE_PX[0] / width_px
        shift_px = 0.5 * TRACE_PX[1] - 0.5 * height_px * scale
        return [
            (label, x_min * scale, x_max * scale, y_min * scale + shift_px, y_max * scale + shift_px)
            for label, x_min, x_max, y_min, y_max in boxes_of(boxes)
        ]

    def trace(self, about: Mapping[str, Json]) -> Trace:
        """Return the recorded trace."""
        count = len(self._time_s)
        tracks = np.array(self._actor_rows, dtype=np.float32).reshape(count, len(self._street.actors), 4)
        return Trace(
            time_s=_array(self._time_s),
            ego=_array(self._ego_rows),
            ego_size_m=(self._ego.length_m, self._ego.width_m),
            route=_array([(-10.0, LANE_Y_M), (END_M, LANE_Y_M)]),
            actors=tuple(
                ActorTrack(
                    name=actor.name,
                    kind="pedestrian" if actor.body.kind is BodyKind.PERSON else "vehicle",
                    length_m=actor.body.length_m,
                    width_m=actor.body.width_m,
                    motion=np.ascontiguousarray(tracks[:, index]),
                )
                for index, actor in enumerate(self._street.actors)
            ),
            seen_boxes=_ragged(self._truth),
            given_boxes=_ragged(self._given),
            perceived=Ragged(
                columns=PERCEIVED_COLUMNS,
                first=np.zeros(count + 1, np.int32),
                rows=np.zeros((0, len(PERCEIVED_COLUMNS)), np.float32),
            ),
            plan_mode=tuple("brake" if brakes else "cruise" for brakes in self._brakes),
            target_speed_mps=_array([0.0 if brakes else CRUISE_MPS for brakes in self._brakes]),
            target_offset_m=_array([0.0] * count),
            lights=("",) * count,
            robustness={name: _array(series) for name, series in self._robustness.items()},
            events=tuple(self._events),
            scene=_surfaces(self._street),
            about=about,
            film=self._film.film(count, self._size_px),
        )


class _FilmRecorder:
    """Records the true boxes and detections of every frame, and images at even intervals.

    The interval is `PICTURE_EVERY` and doubles whenever all images together would exceed `MAX_PICTURE_BYTES`.
    """

    def __init__(self) -> None:
        self._every = PICTURE_EVERY
        self._pictures: list[bytes] = []
        self._samples: list[int] = []
        self._judged: list[list[tuple[float, ...]]] = []
        self._found: list[list[tuple[float, ...]]] = []

    def append(self, sample: int, shot: CameraShot) -> None:
        """Record the image and boxes of a sample."""
        if sample % self._every == 0:
            self._samples.append(sample)
            self._pictures.append(_jpeg(shot.picture))
            while sum(map(len, self._pictures)) > MAX_PICTURE_BYTES:
                self._thin()
        self._judged.append(_rows(shot.truth.labels, shot.truth.boxes, shot.truth.ignored))
        self._found.append(_rows(shot.found.labels, shot.found.boxes, shot.found.scores))

    def _thin(self) -> None:
        """Double the interval, and drop the images in between."""
        self._every *= 2
        kept = [place for place, sample in enumerate(self._samples) if sample % self._every == 0]
        self._samples = [self._samples[place] for place in kept]
        self._pictures = [self._pictures[place] for place in kept]

    def film(self, samples: int, size_px: tuple[int, int]) -> Film | None:
        """Return the film of an episode with the given number of samples, or None if there was no camera."""
        if not self._samples:
            return None
        nothing: list[list[tuple[float, ...]]] = [[]] * (samples - len(self._judged))
        brake = EmergencyBrake.for_picture(*size_px)
        return Film(
            size_px=size_px,
            pictures=tuple(self._pictures),
            samples=np.array(self._samples, np.int32),
            judged=_ragged([*self._judged, *nothing], JUDGED_COLUMNS),
            found=_ragged([*self._found, *nothing], FOUND_COLUMNS),
            regions={"warning": _array(brake.warning.corners()), "danger": _array(brake.danger.corners())},
        )


def _jpeg(picture: Picture) -> bytes:
    image = Image.fromarray(picture)
    image.thumbnail((PICTURE_WIDTH_PX, picture.shape[0]), reducing_gap=2.0)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def _rows(labels: NDArray[Any], boxes: NDArray[Any], last: NDArray[Any]) -> list[tuple[float, ...]]:
    """Return boxes as rows of label, x_min, x_max, y_min, y_max and one additional column."""
    whole = np.column_stack([labels, boxes[:, [0, 2, 1, 3]], last])
    return [tuple(row) for row in whole.tolist()]


def _array(values: Sequence[object]) -> FloatArray:
    return np.asarray(values, dtype=np.float32)


def _ragged(rows: Sequence[Sequence[tuple[float, ...]]], columns: tuple[str, ...] = BOX_COLUMNS) -> Ragged:
    first = np.concatenate([[0], np.cumsum([len(part) for part in rows])]).astype(np.int32)
    flat = [row for part in rows for row in part]
    return Ragged(
        columns=columns, first=first, rows=np.array(flat, np.float32).reshape(len(flat), len(columns))
    )


def _surfaces(street: Street) -> tuple[Surface, ...]:
    """Return the static scene as seen from above."""
    scene = street.scene
    surfaces = [
        Surface(kind=_SURFACES[g.material], points=g.points.astype(np.float32), closed=True, width_m=0.0)
        for g in scene.ground
        if g.material in _SURFACES
    ]
    boxes = [("building", b.x_m, b.y_m, b.length_m, b.width_m) for b in scene.buildings]
    boxes += [("parked-car", b.x_m, b.y_m, b.length_m, b.width_m) for b in scene.parked]
    boxes += [("tree", t.x_m, t.y_m, 0.6 * t.crown_m, 0.6 * t.crown_m) for t in scene.trees]
    for kind, x_m, y_m, length_m, width_m in boxes:
        along, across = 0.5 * length_m, 0.5 * width_m
        corners = [
            (x_m - along, y_m - across),
            (x_m + along, y_m - across),
            (x_m + along, y_m + across),
            (x_m - along, y_m + across),
        ]
        surfaces.append(Surface(kind=kind, points=_array(corners), closed=True, width_m=0.0))
    return tuple(surfaces)
