"""The worst episodes of a recording as strips of frames with boxes, so that a person can check them by eye."""

import base64
import io
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from PIL import Image as PillowImage

from brink.recordings.camera import CameraModel
from brink.recordings.measure import ObservedDrive
from brink.recordings.recording import Image, RecordedDrive, RecordingError, Sides
from brink.server.findings.tolerances.views import DetectorCell, DetectorView
from brink.server.findings.words import as_sentence
from brink.server.states import CheckResult
from brink.sim.urban.detection_errors import ErrorType, Target
from brink.sim.urban.error_meter import Sample, Span
from brink.user_file import read_file

MOST_STRIPS: Final = 10
FRAMES: Final = 8
AROUND_S: Final = 0.6
"""Time shown before and after an error."""
_LEAST_SHOWN: Final = 0.2
"""A frame shows at least this share of the image's width."""
_PICTURE_ENDINGS: Final = (".png", ".jpg", ".jpeg")
_MOST_PICTURE_BYTES: Final = 64 * 1024**2
_PICTURE_WIDTH_PX: Final = 320
_MARGIN: Final = 1.6
"""How much larger than the road user's boxes a frame is."""


@dataclass(frozen=True, slots=True)
class ShownBox:
    """A box in a frame, in pixels of the camera.

    Attributes:
        kind: ``true``, ``hidden`` (not visible enough to be reported), ``reported`` or ``ignored`` (a region).
        is_subject: Whether it is the road user that the episode is about.
    """

    x: float
    y: float
    width: float
    height: float
    kind: str
    is_subject: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """One image of an episode: its caption, its boxes, and the picture behind them as a data URI, if any."""

    time: str
    words: str
    boxes: Sequence[ShownBox]
    picture: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """An episode.

    Attributes:
        title: What went wrong.
        words: Where and when.
        view_box: The part of the image that is shown: x, y, width, height.
        image: Size of the whole image.
        frames: Its frames.
    """

    title: str
    words: str
    view_box: tuple[float, float, float, float]
    image: tuple[float, float]
    frames: Sequence[Frame]


def worst_strips(
    view: DetectorView,
    observed: Iterable[ObservedDrive],
    camera: CameraModel | None,
    threshold: float,
    pictures: Path | None = None,
) -> list[Strip]:
    """Return the worst episodes: those of each cell in turn, starting with the errors that make most drives violate.

    Args:
        view: The check of the detector.
        observed: Its drives.
        camera: Camera of drives without one of their own; None for the driving system's.
        threshold: Smallest score of a detection that counts.
        pictures: Folder with a folder of pictures for each drive, one for each image, in the order of their names.

    Raises:
        RecordingError: A drive's pictures are missing or cannot be read.
    """
    drives = {one.drive.name: one for one in observed}
    return [
        _strip(cell, drives[name], span, camera or CameraModel.own(), threshold, pictures)
        for cell, name, span in itertools.islice(_episodes(view, drives), MOST_STRIPS)
    ]


def _episodes(
    view: DetectorView, drives: Mapping[str, ObservedDrive]
) -> Iterator[tuple[DetectorCell, str, Span]]:
    told = (cell for cell in view.cells if cell.result is not CheckResult.NO_DATA)
    cells = sorted(told, key=lambda cell: -(cell.share or 0.0))
    shown: set[tuple[str, int | None, float]] = set()
    for place in range(max((len(cell.worst) for cell in cells), default=0)):
        for cell in cells:
            for name in cell.worst[place : place + 1]:
                span = _span_of(cell, drives.get(name))
                # One outage may be the worst of several cells: of the lead and of everybody.
                if span is not None and (name, span.track, span.from_s) not in shown:
                    shown.add((name, span.track, span.from_s))
                    yield cell, name, span


def _span_of(cell: DetectorCell, drive: ObservedDrive | None) -> Span | None:
    chosen = {name.rpartition(".")[2]: value for name, value in cell.choices.items()}
    if drive is None or "type" not in chosen or "target" not in chosen:
        return None
    return drive.measured.errors.spans.get(Target(chosen["target"]), {}).get(ErrorType(chosen["type"]))


def _strip(
    cell: DetectorCell,
    observed: ObservedDrive,
    span: Span,
    camera: CameraModel,
    threshold: float,
    pictures: Path | None,
) -> Strip:
    camera = observed.drive.camera or camera
    track = None if span.track is None else observed.tracks[span.track]
    until_s = span.from_s + span.duration_s
    times = [
        time_s
        for time_s in sorted(observed.drive.images)
        if span.from_s - AROUND_S <= time_s <= until_s + AROUND_S
    ]
    last = len(times) - 1
    chosen = sorted({round(place * last / (FRAMES - 1)) for place in range(FRAMES)})
    images = [observed.drive.images[times[place]] for place in chosen]
    samples = {
        (sample.time_s, observed.tracks[sample.track]): sample
        for sample in observed.meter.samples
        if times[0] <= sample.time_s <= times[-1]
    }
    view_box = _view_box(_subjects(images, track, threshold), camera)
    frames = [_frame(image, track, samples, threshold) for image in images]
    if pictures is not None:
        files = dict(zip(sorted(observed.drive.images), _pictures(pictures, observed.drive), strict=True))
        frames = [
            replace(frame, picture=_crop(files[image.time_s], view_box, camera))
            for frame, image in zip(frames, images, strict=True)
        ]
    return Strip(
        title=f"Drive {observed.drive.name}: {cell.error.replace('…', f'{span.duration_s:.1f} s')}",
        words=f"{as_sentence(cell.condition)}, from {span.from_s:.1f} to {until_s:.1f} s"
        + ("" if track is None else f", road user {track}"),
        view_box=view_box,
        image=(camera.width_px, camera.height_px),
        frames=frames,
    )


def _subjects(images: Sequence[Image], track: str | None, threshold: float) -> list[Sides]:
    """Return the boxes that a strip must show: those of its road user, or everything reported."""
    if track is None:
        return [one.sides for image in images for one in image.detections if one.score >= threshold]
    return [user.sides for image in images for user in image.road_users if user.track == track]


def _view_box(boxes: Sequence[Sides], camera: CameraModel) -> tuple[float, float, float, float]:
    """Return the part of the image to show: around the boxes, in the image's own proportions."""
    if not boxes:
        return 0.0, 0.0, camera.width_px, camera.height_px
    x_min, x_max = min(one.x_min for one in boxes), max(one.x_max for one in boxes)
    y_min, y_max = min(one.y_min for one in boxes), max(one.y_max for one in boxes)
    share = max(
        _LEAST_SHOWN,
        _MARGIN * (x_max - x_min) / camera.width_px,
        _MARGIN * (y_max - y_min) / camera.height_px,
    )
    width, height = min(share, 1.0) * camera.width_px, min(share, 1.0) * camera.height_px
    left = min(max(0.5 * (x_min + x_max - width), 0.0), camera.width_px - width)
    top = min(max(0.5 * (y_min + y_max - height), 0.0), camera.height_px - height)
    return left, top, width, height


def _frame(
    image: Image, track: str | None, samples: Mapping[tuple[float, str], Sample], threshold: float
) -> Frame:
    boxes = [_shown(sides, "ignored") for sides in image.ignored]
    words = "" if track is None else "not in sight"
    for user in image.road_users:
        sample = samples[image.time_s, user.track]
        boxes.append(
            _shown(user.sides, "true" if sample.is_visible else "hidden", is_subject=user.track == track)
        )
        if user.track == track:
            state = "hidden" if not sample.is_visible else "reported" if sample.is_seen else "missed"
            words = f"{sample.depth_m:.0f} m, {state}"
    boxes += [_shown(one.sides, "reported") for one in image.detections if one.score >= threshold]
    return Frame(f"{image.time_s:.1f} s", words, boxes)


def _shown(sides: Sides, kind: str, *, is_subject: bool = False) -> ShownBox:
    return ShownBox(
        sides.x_min, sides.y_min, sides.x_max - sides.x_min, sides.y_max - sides.y_min, kind, is_subject
    )


def _pictures(folder: Path, drive: RecordedDrive) -> list[Path]:
    """Return the picture of each image of a drive, in the order of time.

    Raises:
        RecordingError: There are not as many pictures as images.
    """
    own = folder / drive.name
    found: list[Path] = []
    if Path(drive.name).name == drive.name != ".." and own.is_dir():
        found = sorted(path for path in own.iterdir() if path.suffix.lower() in _PICTURE_ENDINGS)
    if len(found) != len(drive.images):
        raise RecordingError(
            f"{own}: expected a picture ({', '.join(_PICTURE_ENDINGS)}) for each of the {len(drive.images):,} images "
            f"of drive {drive.name}, in the order of their names; found {len(found):,}"
        )
    return found


def _crop(file: Path, view_box: tuple[float, float, float, float], camera: CameraModel) -> str:
    """Return a part of a picture as a data URI.

    Raises:
        RecordingError: It cannot be read.
    """
    left, top, width, height = view_box
    out = io.BytesIO()
    try:
        with PillowImage.open(io.BytesIO(read_file(file, _MOST_PICTURE_BYTES))) as picture:
            across, down = picture.width / camera.width_px, picture.height / camera.height_px
            part = picture.convert("RGB").crop(
                (
                    round(left * across),
                    round(top * down),
                    round((left + width) * across),
                    round((top + height) * down),
                )
            )
            part.thumbnail((_PICTURE_WIDTH_PX, _PICTURE_WIDTH_PX))
            part.save(out, "JPEG", quality=80)
    except (OSError, ValueError, ArithmeticError, PillowImage.DecompressionBombError) as error:
        raise RecordingError(f"{file}: expected a picture: {error}") from error
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
