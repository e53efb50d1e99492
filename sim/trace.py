"""The trace of an episode: everything needed to draw it, plot it and evaluate it again.

Sampled at the perception rate. Positions are in metres, angles in radians, image boxes in pixels of the 800 x 600
image. `Trace.to_bytes` returns a compressed npz archive without pickles, lossless except for rounding to float32.
`Trace.from_bytes` accepts untrusted archives: their size, types and coordinates are bounded.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.packed import read_arrays
from brink.sim.episode import Json
from brink.sim.errors import InvalidEpisode

FloatArray: TypeAlias = NDArray[np.float32]
IntArray: TypeAlias = NDArray[np.int32]
FlagArray: TypeAlias = NDArray[np.uint8]

TRACE_VERSION = 1

VIOLATED_AT_S: Final = "violated_at_s"
"""Entry of a trace's description: the exact time of each violated requirement's first violation."""
AVOIDABLE: Final = "avoidable"
"""Entry of a trace's description: who would have avoided the first violation of each requirement.

``careful`` for the careful reference driver, ``ideal`` for the ideal one alone, ``no`` for neither.
"""
WORDS: Final = "words"
"""Entry of a trace's description: the scenario in words and, after a semicolon, the behaviour.

Of traces without it, replays describe the specification, which they understand if the simulator is Brink's own.
"""
MAX_BYTES: Final = 256 * 1024**2
"""Limit on the unpacked size of all arrays: a compressed trace of six megabytes may unpack to gigabytes."""
MAX_SAMPLES: Final = 36_000
"""One hour at ten samples per second."""
MAX_COORDINATE: Final = 1e5
"""Largest absolute position or time, in m or s."""

_REFERENCE: Final = "reference"
_PLACES: Final = ("time_s", "ego", "route", "actor.", "scene.")


@dataclass(frozen=True, slots=True, kw_only=True)
class ActorTrack:
    """The motion of one road user other than the ego.

    Attributes:
        name: Unique name in the trace, such as ``lead`` or ``pedestrian-3``.
        kind: ``vehicle`` or ``pedestrian``.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
        motion: x_m, y_m, yaw_rad, speed_mps at each sample, shape ``(n, 4)``; NaN while it is absent.
        visible: Share of it that the camera sees at each sample, shape ``(n,)``; NaN while it is not in the image.
            None if it is unknown.
    """

    name: str
    kind: str
    length_m: float
    width_m: float
    motion: FloatArray
    visible: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Ragged:
    """Rows grouped by sample, with any number of rows per sample.

    Attributes:
        columns: Names of the columns.
        first: Index of each sample's first row, shape ``(n + 1,)``.
        rows: All rows, shape ``(k, len(columns))``.
    """

    columns: tuple[str, ...]
    first: IntArray
    rows: FloatArray

    def at(self, sample: int) -> FloatArray:
        """Return the rows of one sample, shape ``(any, len(columns))``."""
        return self.rows[self.first[sample] : self.first[sample + 1]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """An event at a point in time, such as a collision or the start of overtaking."""

    time_s: float
    kind: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A flat polygon or line of the scene.

    Attributes:
        kind: ``road``, ``pavement``, ``marking``, ``crossing``, ``stop-line``, ``building``, ``parked-car``,
            ``tree``.
        points: Corners in world coordinates, shape ``(k, 2)``.
        closed: True for an area; false for a line `width_m` wide.
        width_m: Width of a line, 0 for an area.
    """

    kind: str
    points: FloatArray
    closed: bool
    width_m: float


MAX_TRACE_BYTES = 6_000_000
"""A worker refuses to send a larger trace (`trace` in `brink.worker.wire`, in base64)."""

ACTION = "action"
"""Kind of the events at which a scripted road user changes its action; their text is ``name:action``."""

BOX_COLUMNS = ("label", "x_min_px", "x_max_px", "y_min_px", "y_max_px")
"""Columns of image boxes; label is 0 for a vehicle, 1 for a person."""

JUDGED_COLUMNS = (*BOX_COLUMNS, "ignored")
"""Columns of ground truth for scoring; ignored is 1 for objects that count neither for nor against a detector."""

FOUND_COLUMNS = (*BOX_COLUMNS, "score")
"""Columns of all detections, at any score."""

PERCEIVED_COLUMNS = ("track", "label", "x_m", "y_m", "vx_mps", "vy_mps", "length_m", "width_m")
"""Columns of perceived obstacles, as in `brink.sim.driving.interface.PerceivedObstacle`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """Recorded images of a camera in the loop with ground truth and all detections, enough to rescore the episode.

    Attributes:
        size_px: Width and height of the images that the detector received.
        pictures: Some of these images, with their perturbations, as JPEG and possibly downscaled.
        samples: Sample of each image, ascending, shape ``(len(pictures),)``.
        judged: Ground truth of every sample, columns `JUDGED_COLUMNS`, in px of the images.
        found: Detections of every sample, columns `FOUND_COLUMNS`, in px of the images.
        regions: Regions of interest in the image, by name: corners in px, shape ``(k, 2)``.
    """

    size_px: tuple[int, int]
    pictures: tuple[bytes, ...]
    samples: IntArray
    judged: Ragged
    found: Ragged
    regions: Mapping[str, FloatArray]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the film as named arrays."""
        lengths = [len(picture) for picture in self.pictures]
        return {
            "film.size_px": np.array(self.size_px, np.int32),
            "film.pictures": np.frombuffer(b"".join(self.pictures), np.uint8),
            "film.ends": np.cumsum(lengths, dtype=np.int64),
            "film.samples": self.samples,
            "film.judged.first": self.judged.first,
            "film.judged.rows": self.judged.rows,
            "film.found.first": self.found.first,
            "film.found.rows": self.found.rows,
            **{f"film.region.{name}": corners for name, corners in self.regions.items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self | None:
        """Return the film stored in the result of `arrays`, or None if there is none."""
        if "film.size_px" not in arrays:
            return None
        blob, ends = arrays["film.pictures"].tobytes(), arrays["film.ends"].tolist()
        width_px, height_px = arrays["film.size_px"].tolist()
        region = "film.region."
        return cls(
            size_px=(width_px, height_px),
            pictures=tuple(blob[start:end] for start, end in zip([0, *ends], ends, strict=False)),
            samples=arrays["film.samples"],
            judged=Ragged(
                columns=JUDGED_COLUMNS, first=arrays["film.judged.first"], rows=arrays["film.judged.rows"]
            ),
            found=Ragged(
                columns=FOUND_COLUMNS, first=arrays["film.found.first"], rows=arrays["film.found.rows"]
            ),
            regions={name.removeprefix(region): a for name, a in arrays.items() if name.startswith(region)},
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardTrack:
    """What a guard and the fallback that it triggers did during an episode.

    Attributes:
        fallback: Id of the fallback.
        horizons_s: Horizons of the probabilities.
        probabilities: Probability of a violation within each horizon, at each sample, shape ``(n, len(horizons_s))``.
        alarm: 1 while the guard raises the alarm, shape ``(n,)``.
        intervenes: 1 while the fallback intervenes, shape ``(n,)``.
    """

    fallback: str
    horizons_s: tuple[float, ...]
    probabilities: FloatArray
    alarm: FlagArray
    intervenes: FlagArray

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the track as named arrays."""
        return {
            "guard.probabilities": self.probabilities,
            "guard.alarm": self.alarm,
            "guard.intervenes": self.intervenes,
        }

    def header(self) -> dict[str, Any]:
        """Return everything that is not an array, as JSON."""
        return {"fallback": self.fallback, "horizons_s": list(self.horizons_s)}

    @classmethod
    def of(cls, header: Mapping[str, Any] | None, arrays: Mapping[str, NDArray[Any]]) -> Self | None:
        """Return the track that the results of `header` and `arrays` hold, or None if there is none.

        Raises:
            ValueError: The arrays do not have an entry for each sample.
        """
        if header is None:
            return None
        track = cls(
            fallback=str(header["fallback"]),
            horizons_s=tuple(float(horizon_s) for horizon_s in header["horizons_s"]),
            probabilities=arrays["guard.probabilities"],
            alarm=arrays["guard.alarm"],
            intervenes=arrays["guard.intervenes"],
        )
        samples = len(arrays["time_s"])
        for name, array, shape in (
            ("probabilities", track.probabilities, (samples, len(track.horizons_s))),
            ("alarm", track.alarm, (samples,)),
            ("intervenes", track.intervenes, (samples,)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name} of the guard: expected shape {shape}, got {array.shape}")
        return track


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """One sampled episode.

    Attributes:
        time_s: Sample times, shape ``(n,)``.
        ego: x_m, y_m, yaw_rad, speed_mps, accel_mps2 of the ego, shape ``(n, 5)``.
        ego_size_m: Length and width of the ego.
        route: x_m and y_m along the centre line of the ego's lane, shape ``(k, 2)``.
        actors: All other road users.
        seen_boxes: Ground truth in the image: the input of the component under test.
        given_boxes: Boxes that the obstacle detector reported: the output of the component under test.
        perceived: Confirmed tracks.
        plan_mode: Name of the plan mode at each sample.
        target_speed_mps: Target speed of the planner, shape ``(n,)``.
        target_offset_m: Target offset of the planner, shape ``(n,)``.
        lights: State of the ego's traffic light at each sample; ``""`` if there is none.
        robustness: Robustness of each requirement over time, shape ``(n,)`` each; +inf where it does not apply.
        events: Events in chronological order.
        scene: Static surfaces in drawing order.
        about: Scenario, behaviour and versions, for captions.
        film: Images of a camera in the loop; None without one.
        reference: What a reference driver did in the system's place; None without one.
        guard: What a guard said; None without one.
        pitch_rad: Pitch of the camera, positive if it looks up, shape ``(n,)``; None if it is unknown.
        signals: Signals that the simulator logs, by name, shape ``(n,)`` each.
    """

    time_s: FloatArray
    ego: FloatArray
    ego_size_m: tuple[float, float]
    route: FloatArray
    actors: tuple[ActorTrack, ...]
    seen_boxes: Ragged
    given_boxes: Ragged
    perceived: Ragged
    plan_mode: tuple[str, ...]
    target_speed_mps: FloatArray
    target_offset_m: FloatArray
    lights: tuple[str, ...]
    robustness: Mapping[str, FloatArray]
    events: tuple[Event, ...]
    scene: tuple[Surface, ...]
    about: Mapping[str, Json]
    film: Film | None = None
    reference: "Trace | None" = None
    guard: GuardTrack | None = None
    pitch_rad: FloatArray | None = None
    signals: Mapping[str, FloatArray] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """Return the trace as a compressed npz archive."""
        arrays: dict[str, NDArray[Any]] = {
            "time_s": self.time_s,
            "ego": self.ego,
            "route": self.route,
            "target_speed_mps": self.target_speed_mps,
            "target_offset_m": self.target_offset_m,
        }
        for name in ("seen_boxes", "given_boxes", "perceived"):
            ragged: Ragged = getattr(self, name)
            arrays[f"{name}.first"] = ragged.first
            arrays[f"{name}.rows"] = ragged.rows
        for index, actor in enumerate(self.actors):
            arrays[f"actor.{index}"] = actor.motion
            if actor.visible is not None:
                arrays[f"visible.{index}"] = actor.visible
        if self.pitch_rad is not None:
            arrays["pitch_rad"] = self.pitch_rad
        for index, surface in enumerate(self.scene):
            arrays[f"scene.{index}"] = surface.points
        for index, series in enumerate(self.robustness.values()):
            arrays[f"robustness.{index}"] = series
        for index, series in enumerate(self.signals.values()):
            arrays[f"signal.{index}"] = series
        header: dict[str, Any] = {
            "version": TRACE_VERSION,
            "ego_size_m": list(self.ego_size_m),
            "actors": [[a.name, a.kind, a.length_m, a.width_m] for a in self.actors],
            "scene": [[s.kind, s.closed, s.width_m] for s in self.scene],
            "robustness": list(self.robustness),
            "columns": {
                n: list(getattr(self, n).columns) for n in ("seen_boxes", "given_boxes", "perceived")
            },
            "plan_mode": list(self.plan_mode),
            "lights": list(self.lights),
            "events": [[e.time_s, e.kind, e.text] for e in self.events],
            "about": dict(self.about),
        }
        if self.signals:
            header["signals"] = list(self.signals)
        if self.film is not None:
            arrays.update(self.film.arrays())
        if self.reference is not None:
            arrays[_REFERENCE] = np.frombuffer(self.reference.to_bytes(), np.uint8)
        if self.guard is not None:
            arrays.update(self.guard.arrays())
            header["guard"] = self.guard.header()
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        return buffer.getvalue()

    @classmethod
    def from_bytes(cls, document: bytes) -> Self:
        """Parse the result of `to_bytes`.

        Raises:
            InvalidEpisode: The document is not a trace, or has an unknown version.
        """
        arrays = _unpack(document)
        reference = arrays.pop(_REFERENCE, None)
        trace = cls._parsed(arrays)
        if reference is None:
            return trace
        return replace(trace, reference=cls._parsed(_unpack(reference.tobytes())))

    @classmethod
    def _parsed(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return the trace in the arrays of a document, without its companion trace.

        Raises:
            InvalidEpisode: They are not a trace, or have an unknown version.
        """
        try:
            header = json.loads(arrays["header"].tobytes())
            version = header["version"]
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise InvalidEpisode(f"not a trace: {error}") from error
        if version != TRACE_VERSION:
            raise InvalidEpisode(f"trace version: expected {TRACE_VERSION}, got {version!r}")
        try:
            return cls._of(header, arrays)
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise InvalidEpisode(f"not a trace: {type(error).__name__}: {error}") from error

    @classmethod
    def _of(cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        def ragged(name: str) -> Ragged:
            return Ragged(
                columns=tuple(header["columns"][name]),
                first=arrays[f"{name}.first"],
                rows=arrays[f"{name}.rows"],
            )

        def series(name: str) -> FloatArray | None:
            """Return an optional array, which traces of earlier versions lack."""
            found = arrays.get(name)
            if found is not None and found.shape != arrays["time_s"].shape:
                raise ValueError(f"{name}: expected shape {arrays['time_s'].shape}, got {found.shape}")
            return found

        return cls(
            time_s=arrays["time_s"],
            ego=arrays["ego"],
            ego_size_m=(header["ego_size_m"][0], header["ego_size_m"][1]),
            route=arrays["route"],
            actors=tuple(
                ActorTrack(
                    name=n,
                    kind=k,
                    length_m=length,
                    width_m=w,
                    motion=arrays[f"actor.{i}"],
                    visible=series(f"visible.{i}"),
                )
                for i, (n, k, length, w) in enumerate(header["actors"])
            ),
            seen_boxes=ragged("seen_boxes"),
            given_boxes=ragged("given_boxes"),
            perceived=ragged("perceived"),
            plan_mode=tuple(header["plan_mode"]),
            target_speed_mps=arrays["target_speed_mps"],
            target_offset_m=arrays["target_offset_m"],
            lights=tuple(header["lights"]),
            robustness={name: arrays[f"robustness.{i}"] for i, name in enumerate(header["robustness"])},
            events=tuple(Event(time_s=t, kind=k, text=x) for t, k, x in header["events"]),
            scene=tuple(
                Surface(kind=k, points=arrays[f"scene.{i}"], closed=c, width_m=w)
                for i, (k, c, w) in enumerate(header["scene"])
            ),
            about=header["about"],
            film=Film.from_arrays(arrays),
            guard=GuardTrack.of(header.get("guard"), arrays),
            pitch_rad=series("pitch_rad"),
            signals={str(name): arrays[f"signal.{i}"] for i, name in enumerate(header.get("signals", ()))},
        )


def _unpack(document: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz archive.

    Raises:
        InvalidEpisode: It is not an npz archive, or exceeds a limit.
    """
    try:
        arrays = read_arrays(document, MAX_BYTES)
    except (
        ValueError,
        KeyError,
        OSError,
        EOFError,
        MemoryError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InvalidEpisode(f"not a trace: {error}") from error
    _check_arrays(arrays)
    return arrays


def _check_arrays(arrays: dict[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
            raise InvalidEpisode(f"not a trace: expected numbers in {name!r}")
        if name.startswith(_PLACES):
            if array.ndim == 0 or len(array) > MAX_SAMPLES:
                raise InvalidEpisode(f"not a trace: expected at most {MAX_SAMPLES} rows of {name!r}")
            if np.any(np.abs(array) > MAX_COORDINATE):
                raise InvalidEpisode(
                    f"not a trace: expected coordinates up to {MAX_COORDINATE:g} in {name!r}"
                )
