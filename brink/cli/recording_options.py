"""Options that describe a recording of a detector: its files, camera and classes, and what counts in it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

import typer

from brink.recordings.camera import CameraModel
from brink.recordings.measure import Visibility, contradictions
from brink.recordings.reading import formats_by_name, parse_classes, read_recording, read_settings
from brink.recordings.recording import ReadOptions, Recording
from brink.server.errors import InvalidInput

THRESHOLD: Final = 0.5
"""Smallest score of a detection that counts, unless the user says otherwise."""

Truth = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="PATH",
        show_default=False,
        help="File or folder with the true road users, if the detections are elsewhere.",
    ),
]
RecordingFormat = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        show_default=False,
        help=f"Format of the recording: {', '.join(formats_by_name())} (default: recognised by its files).",
    ),
]
CameraSizes = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--camera",
        metavar="WIDTH HEIGHT FOV ABOVE",
        show_default=False,
        help="Level camera of the recording: size in px, horizontal field of view in degrees, height in m "
        "(default: what the files say, else 800 600 90 1.7).",
    ),
]
Calibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE.yaml",
        show_default=False,
        help="Camera by focal length, optical axis, height and pitch; also classes, conditions and cameras of single "
        "drives.",
    ),
]
FramesPerS = Annotated[
    float | None,
    typer.Option(
        "--frames-per-s",
        min=0.1,
        max=1000.0,
        show_default=False,
        help="Images per second of a recording that numbers its images.",
    ),
]
Classes = Annotated[
    list[str] | None,
    typer.Option(
        "--classes",
        metavar="CLASS=MEANING",
        show_default=False,
        help="What a class of the recording is: vehicle, person or ignore, such as cyclist=person. May be given "
        "several times.",
    ),
]
Condition = Annotated[
    str | None,
    typer.Option(
        "--condition",
        metavar="NAME",
        show_default=False,
        help="Condition of drives of which the recording says none, such as 'day, dry'.",
    ),
]
Clip = Annotated[
    bool, typer.Option("--clip", help="Clip boxes that reach beyond the image; otherwise they are refused.")
]
Threshold = Annotated[
    float,
    typer.Option("--threshold", help="Smallest score of a detection that counts, where there are scores."),
]
MaxOcclusion = Annotated[
    int,
    typer.Option(
        "--max-occlusion",
        min=0,
        max=3,
        help="Largest occlusion flag of a road user that should be reported: 0 visible, 1 partly, 2 largely hidden, "
        "3 unknown.",
    ),
]
MinVisible = Annotated[
    float,
    typer.Option(
        "--min-visible",
        min=0.0,
        max=1.0,
        help="Smallest visible share of a road user that should be reported.",
    ),
]
MOST_OCCLUSION: Final = Visibility().most_occlusion
LEAST_SHARE: Final = Visibility().least_share


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenRecording:
    """A recording as given to a command.

    Attributes:
        detections: File or folder with what the detector reported.
        truth: File or folder with the true road users; None for the same.
        format: Name of the format; None to recognise it.
        camera: Width and height of the images in px, field of view in degrees, height above the ground in m.
        calibration: File with the camera and more.
        frames_per_s: Images per second.
        classes: What classes mean, such as ``cyclist=person``.
        condition: Condition of drives of which the recording says none.
        clip: Whether boxes are clipped to the image.
        threshold: Smallest score of a detection that counts.
        most_occlusion: Largest occlusion flag that counts as visible.
        least_share: Smallest visible share that counts as visible.
    """

    detections: Path
    truth: Path | None = None
    format: str | None = None
    camera: tuple[float, float, float, float] | None = None
    calibration: Path | None = None
    frames_per_s: float | None = None
    classes: Sequence[str] = ()
    condition: str | None = None
    clip: bool = False
    threshold: float = THRESHOLD
    most_occlusion: int = MOST_OCCLUSION
    least_share: float = LEAST_SHARE

    @property
    def visibility(self) -> Visibility:
        """From when on a road user should be reported."""
        return Visibility(most_occlusion=self.most_occlusion, least_share=self.least_share)

    def read(self) -> Recording:
        """Return the recording.

        Raises:
            InvalidInput: Options contradict each other, or the calibration is wrong.
            RecordingError: The files cannot be used.
            CameraError: The camera cannot be.
        """
        if math.isnan(self.threshold):
            raise InvalidInput.at("--threshold", "expected a number, got nan")
        return read_recording(self.detections, self.truth, format=self.format, options=self._options())

    def _options(self) -> ReadOptions:
        options = ReadOptions() if self.calibration is None else read_settings(self.calibration)
        if self.camera is not None:
            if options.camera is not None:
                raise InvalidInput.at("--camera", f"cannot be combined with a camera in {self.calibration}")
            options = replace(options, camera=CameraModel.level(*self.camera))
        return replace(
            options,
            classes={**options.classes, **parse_classes(self.classes)},
            frames_per_s=self.frames_per_s or options.frames_per_s,
            condition=self.condition or options.condition,
            clip=self.clip,
        )

    def words(self, recording: Recording) -> list[str]:
        """Describe in sentences what was read, what was left out, what counts, and what looks wrong.

        Args:
            recording: The recording, after it was measured, which counts drives that are too short.
        """
        images = [image for drive in recording.drives.values() for image in drive.images.values()]
        scores = list(detection_scores(recording))
        counted = sum(score >= self.threshold for score in scores)
        lines = [
            f"Read {len(recording.drives):,} {'drive' if len(recording.drives) == 1 else 'drives'}, "
            f"{len(images):,} images, "
            f"{sum(len(image.road_users) for image in images):,} true boxes, {len(scores):,} detections"
            + (
                f", of which {counted:,} have a score of at least {self.threshold:g}"
                if counted < len(scores)
                else ""
            )
            + "."
        ]
        dropped = "; ".join(
            f"{reason}: {count:,}" for reason, count in sorted(recording.dropped.items()) if count
        )
        if dropped:
            lines.append(f"Dropped or changed: {dropped}.")
        lines.append(f"A road user should be reported while it is visible: {self.visibility.words}.")
        lines += recording.notes
        lines += [f"Warning: {sentence}." for sentence in contradictions(recording)]
        return lines


def detection_scores(recording: Recording) -> Iterable[float]:
    """Yield the score of each detection of a recording."""
    for drive in recording.drives.values():
        for detections in (
            *(image.detections for image in drive.images.values()),
            *drive.detections_elsewhere.values(),
        ):
            for detection in detections:
                yield detection.score
