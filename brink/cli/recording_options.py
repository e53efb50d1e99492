"""Options that describe a recording of a detector: its files, camera and classes, and what counts in it."""

import functools
import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from dataclasses import fields as dataclass_fields
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeVar, get_type_hints

import typer

from brink.cli.options import fields
from brink.recordings.choices import Visibility, format_names
from brink.server.errors import InvalidInput

if TYPE_CHECKING:
    from brink.recordings.recording import ReadOptions, Recording

T = TypeVar("T")
THRESHOLD: Final = 0.5
"""Smallest score of a detection that counts, unless the user says otherwise."""

RecordingFormat = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="NAME",
        show_default=False,
        help=f"Format of the recording: {', '.join(format_names())} (default: recognised by its files).",
    ),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """What a recording is, besides its detections: each field is an option of the commands that read one.

    Attributes:
        truth: File or folder with the true road users; None for the same.
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

    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="PATH",
            show_default=False,
            help="File or folder with the true road users, if the detections are elsewhere.",
        ),
    ] = None
    camera: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            "--camera",
            metavar="WIDTH HEIGHT FOV ABOVE",
            show_default=False,
            help="Level camera of the recording: size in px, horizontal field of view in degrees, height in m "
            "(default: what the files say, else 800 600 90 1.7).",
        ),
    ] = None
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            metavar="FILE.yaml",
            show_default=False,
            help="Camera by focal length, optical axis, height and pitch; also classes, conditions and cameras of "
            "single drives.",
        ),
    ] = None
    frames_per_s: Annotated[
        float | None,
        typer.Option(
            "--frames-per-s",
            min=0.1,
            max=1000.0,
            show_default=False,
            help="Images per second of a recording that numbers its images.",
        ),
    ] = None
    classes: Annotated[
        list[str] | None,
        typer.Option(
            "--classes",
            metavar="CLASS=MEANING",
            show_default=False,
            help="What a class of the recording is: vehicle, person or ignore, such as cyclist=person. May be given "
            "several times.",
        ),
    ] = None
    condition: Annotated[
        str | None,
        typer.Option(
            "--condition",
            metavar="NAME",
            show_default=False,
            help="Condition of drives of which the recording says none, such as 'day, dry'.",
        ),
    ] = None
    clip: Annotated[
        bool,
        typer.Option("--clip", help="Clip boxes that reach beyond the image; otherwise they are refused."),
    ] = False
    threshold: Annotated[
        float,
        typer.Option(
            "--threshold", help="Smallest score of a detection that counts, where there are scores."
        ),
    ] = THRESHOLD
    most_occlusion: Annotated[
        int,
        typer.Option(
            "--max-occlusion",
            min=0,
            max=3,
            help="Largest occlusion flag of a road user that should be reported: 0 visible, 1 partly, 2 largely "
            "hidden, 3 unknown.",
        ),
    ] = Visibility().most_occlusion
    least_share: Annotated[
        float,
        typer.Option(
            "--min-visible",
            min=0.0,
            max=1.0,
            help="Smallest visible share of a road user that should be reported.",
        ),
    ] = Visibility().least_share

    def given(self) -> list[str]:
        """Return the options that were given, as far as they are not what they are by default."""
        named = {"most_occlusion": "--max-occlusion", "least_share": "--min-visible"}
        return [
            named.get(one.name, f"--{one.name.replace('_', '-')}")
            for one in dataclass_fields(self)
            if getattr(self, one.name) not in (one.default, [])
        ]


def with_recording(command: Callable[..., T]) -> Callable[..., T]:
    """Return a command with an option for each field of `RecordingOptions` in place of its argument ``recording``."""
    signature = inspect.signature(command)
    names = [one.name for one in dataclass_fields(RecordingOptions)]
    hints = get_type_hints(RecordingOptions, include_extras=True)
    options = [
        Parameter(one.name, Parameter.POSITIONAL_OR_KEYWORD, default=one.default, annotation=hints[one.name])
        for one in dataclass_fields(RecordingOptions)
    ]
    parameters: list[Parameter] = []
    for one in signature.parameters.values():
        parameters += options if one.name == "recording" else [one]

    @functools.wraps(command)
    def call(**given: Any) -> T:
        recording = RecordingOptions(**{name: given.pop(name) for name in names})
        return command(recording=recording, **given)

    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    return call


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenRecording(RecordingOptions):
    """A recording as a command was given it.

    Attributes:
        detections: File or folder with what the detector reported.
        format: Name of the format; None to recognise it.
    """

    detections: Path
    format: str | None = None

    @classmethod
    def of(cls, detections: Path, format_: str | None, options: RecordingOptions) -> Self:
        """Return the recording that consists of these detections and options."""
        return cls(detections=detections, format=format_, **fields(options))

    @property
    def visibility(self) -> Visibility:
        """From when on a road user should be reported."""
        return Visibility(most_occlusion=self.most_occlusion, least_share=self.least_share)

    def read(self) -> "Recording":
        """Return the recording.

        Raises:
            InvalidInput: Options contradict each other, or the calibration is wrong.
            RecordingError: The files cannot be used.
            CameraError: The camera cannot be.
        """
        from brink.recordings.reading import read_recording

        if math.isnan(self.threshold):
            raise InvalidInput.at("--threshold", "expected a number, got nan")
        return read_recording(self.detections, self.truth, format=self.format, options=self._options())

    def _options(self) -> "ReadOptions":
        from brink.recordings.camera import CameraModel
        from brink.recordings.reading import parse_classes, read_settings
        from brink.recordings.recording import ReadOptions

        options = ReadOptions() if self.calibration is None else read_settings(self.calibration)
        if self.camera is not None:
            if options.camera is not None:
                raise InvalidInput.at("--camera", f"cannot be combined with a camera in {self.calibration}")
            options = replace(options, camera=CameraModel.level(*self.camera))
        return replace(
            options,
            classes={**options.classes, **parse_classes(self.classes or ())},
            frames_per_s=self.frames_per_s or options.frames_per_s,
            condition=self.condition or options.condition,
            clip=self.clip,
        )

    def words(self, recording: "Recording") -> list[str]:
        """Describe in sentences what was read, what was left out, what counts, and what looks wrong.

        Args:
            recording: The recording, after it was measured, which counts drives that are too short.
        """
        from brink.recordings.measure import contradictions

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


def detection_scores(recording: "Recording") -> Iterable[float]:
    """Yield the score of each detection of a recording."""
    for drive in recording.drives.values():
        for detections in (
            *(image.detections for image in drive.images.values()),
            *drive.detections_elsewhere.values(),
        ):
            for detection in detections:
                yield detection.score
