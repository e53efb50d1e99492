"""What finds vehicles and people in a picture.

A detector takes any RGB picture and returns boxes in its pixels. `NetworkDetector` runs `brink-det@1` with
onnxruntime on one thread; weights ship with the package.
"""

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final, Protocol, TypeAlias

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from brink.sim.perception.boxes import FloatArray, suppressed
from brink.sim.perception.errors import DetectorError
from brink.sim.perception.quality import Found

Picture: TypeAlias = NDArray[np.uint8]

INPUT_PX: Final = (320, 192)
STRIDE: Final = 4
LABELS: Final = ("vehicle", "person")
SCORE_FLOOR: Final = 0.001
DOUBLE_OVERLAP: Final = 0.6
MOST: Final = 100
WEIGHTS: Final = "weights/brink-det-1.onnx"
_PADDING: Final = 115


class Detector(Protocol):
    """Finds vehicles and people."""

    def detect(self, picture: Picture) -> Found:
        """Return what is in a picture: labels 0 (vehicle) and 1 (person), boxes in its pixels, scores.

        Args:
            picture: RGB, shape ``(h, w, 3)``.
        """
        ...


def check_picture(picture: Picture) -> None:
    """Raise DetectorError if this is no RGB picture."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or min(picture.shape[:2]) < 1:
        raise DetectorError(
            f"picture: expected uint8 of shape (h, w, 3), got {picture.dtype} of shape {picture.shape}"
        )


def onnx_session(file: Path) -> onnxruntime.InferenceSession:
    """Return a session of an ONNX file on one thread.

    Raises:
        DetectorError: The file does not load.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common class of its errors
        raise DetectorError(f"{file}: cannot be loaded as an ONNX network: {error}") from error


def fitted(picture: Picture) -> tuple[Picture, float]:
    """Return a picture as the network takes it, shape ``(192, 320, 3)``, and how much smaller it is.

    It is scaled to fit, its proportions kept, and padded with grey at the right or below.

    Raises:
        DetectorError: It is no RGB picture.
    """
    check_picture(picture)
    height_px, width_px = picture.shape[:2]
    scale = min(INPUT_PX[0] / width_px, INPUT_PX[1] / height_px)
    size = max(1, round(width_px * scale)), max(1, round(height_px * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    canvas = np.full((INPUT_PX[1], INPUT_PX[0], 3), _PADDING, np.uint8)
    canvas[: size[1], : size[0]] = small
    return canvas, scale


def decoded(heat: FloatArray, edges: FloatArray) -> Found:
    """Return the boxes of a network's answer, best first, in px of its input.

    Args:
        heat: Logits of centres, shape ``(classes, h, w)``.
        edges: Distances to left, upper, right and lower edge in px, shape ``(classes, 4, h, w)``.
    """
    scores = (1.0 / (1.0 + np.exp(-heat))).astype(np.float32)
    peaks = np.stack([cv2.dilate(plane, np.ones((3, 3), np.uint8)) for plane in scores]) == scores
    labels, rows, columns = np.nonzero(peaks & (scores >= SCORE_FLOOR))
    found = scores[labels, rows, columns]
    best = np.argsort(-found, kind="stable")[:MOST]
    labels, rows, columns, found = labels[best], rows[best], columns[best], found[best]
    x, y = (columns + 0.5) * STRIDE, (rows + 0.5) * STRIDE
    left, upper, right, lower = edges[labels, :, rows, columns].T
    boxes = np.stack([x - left, y - upper, x + right, y + lower], axis=1).astype(np.float32)
    kept = suppressed(boxes, found, labels, DOUBLE_OVERLAP)
    return Found(labels=labels[kept], boxes=boxes[kept], scores=found[kept])


class NetworkDetector:
    """Runs a network with onnxruntime on one thread.

    Args:
        weights: An ONNX file with one input of shape ``(1, 3, 192, 320)`` and the outputs that
            `brink.sim.perception.network` describes.

    Raises:
        DetectorError: The file does not load, or is not such a network.
    """

    def __init__(self, weights: Path) -> None:
        self._session = onnx_session(weights)
        shapes = [tuple(put.shape) for put in (*self._session.get_inputs(), *self._session.get_outputs())]
        across, down = INPUT_PX[0] // STRIDE, INPUT_PX[1] // STRIDE
        grid = (down, across)
        expected = [(1, 3, *INPUT_PX[::-1]), (1, len(LABELS), *grid), (1, len(LABELS), 4, *grid)]
        if shapes != expected:
            raise DetectorError(f"{weights}: expected input and outputs of shapes {expected}, got {shapes}")
        self._input = self._session.get_inputs()[0].name

    def answer(self, canvas: Picture) -> tuple[FloatArray, FloatArray]:
        """Return heat map and edges of a fitted picture."""
        planes = np.ascontiguousarray(canvas.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)
        heat, edges = self._session.run(None, {self._input: planes})
        return heat[0], edges[0]

    def detect(self, picture: Picture) -> Found:
        """Return what is in a picture."""
        canvas, scale = fitted(picture)
        found = decoded(*self.answer(canvas))
        height_px, width_px = picture.shape[:2]
        limits = np.array([width_px, height_px, width_px, height_px], np.float32)
        boxes = np.clip(found.boxes / np.float32(scale), 0.0, limits)
        return Found(labels=found.labels, boxes=boxes, scores=found.scores)


@cache
def own_detector() -> NetworkDetector:
    """Return `brink-det@1` with the weights that ship with the package.

    Raises:
        DetectorError: They are not there.
    """
    weights = Path(str(files("brink.sim.perception").joinpath(WEIGHTS)))
    if not weights.is_file():
        raise DetectorError(
            f"brink-det@1 has no weights here: train them with `python -m brink.sim.perception.train --out "
            f"{weights.parent}`, which takes half an hour"
        )
    return NetworkDetector(weights)
