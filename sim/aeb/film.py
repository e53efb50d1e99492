"""Records the camera's images, true boxes and detections of an emergency-braking episode as a film."""

import io
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from brink.sim.aeb.braking import Region
from brink.sim.perception.boxes import Detections, GroundTruth
from brink.sim.trace import FOUND_COLUMNS, JUDGED_COLUMNS, Film
from brink.sim.urban.recorder import RaggedRows

PICTURE_EVERY: Final = 2
"""Every second frame is kept as an image: ten per second, the frame rate of replay videos."""
MAX_PICTURE_BYTES: Final = 4_500_000
"""All images of a film; the rest of `MAX_TRACE_BYTES` is for boxes and positions. A film that would be larger, of a
long or a noisy drive, has fewer images a second."""
JPEG_QUALITY: Final = 70
PICTURE_WIDTH_PX: Final = 480
"""Wider images are scaled down to this width, so that a ten-second film takes one or two megabytes."""
Picture: TypeAlias = NDArray[np.uint8]


class CameraShot(NamedTuple):
    """One image of a camera in the loop, with its ground truth and detections.

    Attributes:
        picture: The image shown to the detector, RGB, shape ``(h, w, 3)``.
        truth: Ground truth, including ignored boxes.
        found: All detections.
    """

    picture: Picture
    truth: GroundTruth
    found: Detections


class FilmRecorder:
    """Records the true boxes and detections of every frame, and images at even intervals.

    The interval is `PICTURE_EVERY` and doubles whenever all images together would exceed `MAX_PICTURE_BYTES`.
    """

    def __init__(self) -> None:
        self._every = PICTURE_EVERY
        self._pictures: list[bytes] = []
        self._samples: list[int] = []
        self._judged = RaggedRows(JUDGED_COLUMNS)
        self._found = RaggedRows(FOUND_COLUMNS)
        self._count = 0

    def append(self, sample: int, shot: CameraShot) -> None:
        """Record the image and boxes of a sample."""
        if sample % self._every == 0:
            self._samples.append(sample)
            self._pictures.append(_jpeg(shot.picture))
            while sum(map(len, self._pictures)) > MAX_PICTURE_BYTES:
                self._thin()
        self._judged.add(_rows(shot.truth.labels, shot.truth.boxes, shot.truth.ignored))
        self._found.add(_rows(shot.found.labels, shot.found.boxes, shot.found.scores))
        self._count += 1

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
        for _ in range(samples - self._count):
            self._judged.add(())
            self._found.add(())
        return Film(
            size_px=size_px,
            pictures=tuple(self._pictures),
            samples=np.array(self._samples, np.int32),
            judged=self._judged.ragged(),
            found=self._found.ragged(),
            regions={
                name: np.array(Region.from_reference(*size_px, warning=warning).corners(), np.float32)
                for name, warning in (("warning", True), ("danger", False))
            },
        )


def _jpeg(picture: Picture) -> bytes:
    image = Image.fromarray(picture)
    image.thumbnail((PICTURE_WIDTH_PX, picture.shape[0]), reducing_gap=2.0)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def _rows(labels: NDArray[Any], boxes: NDArray[Any], last: NDArray[Any]) -> list[list[float]]:
    """Return boxes as rows of label, x_min, x_max, y_min, y_max and one additional column."""
    rows: list[list[float]] = np.column_stack([labels, boxes[:, [0, 2, 1, 3]], last]).tolist()
    return rows
