"""Users' own detectors: an ONNX or TorchScript file, or weights for Ultralytics, named as ``onnx:FILE`` and the like.

A file's network takes one RGB picture, shape ``(1, 3, h, w)``, float32 in [0, 1], scaled to fit and padded with grey.
It answers in one of two ways, in px of its input:

- one array of shape ``(1, 4 + c, n)``, as YOLO networks are exported: middle x, middle y, width, height, and a score
  for each of c classes, of n boxes;
- three arrays: boxes ``(n, 4)`` as x_min, y_min, x_max, y_max, scores ``(n,)`` and labels ``(n,)``, in this order or
  by the names ``boxes``, ``scores`` and ``labels``, as torchvision's detectors answer.

Names of the classes come from a file beside it, ``FILE.json`` with ``{"names": ["vehicle", "person"]}``, or from the
metadata that YOLO's exporter writes. Without names, one array of two classes is vehicle and person, of any other
number COCO's classes in YOLO's order; three arrays have COCO's numbers as torchvision has them. Everything else is
refused when it is loaded.
"""

import ast
import importlib
import json
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.perception.boxes import FloatArray, suppressed
from brink.sim.perception.coco import LABELS
from brink.sim.perception.detector import (
    DOUBLE_OVERLAP,
    MOST,
    SCORE_FLOOR,
    Detector,
    Picture,
    check_picture,
    onnx_session,
)
from brink.sim.perception.errors import DetectorError
from brink.sim.perception.quality import Found
from brink.sim.perception.weights_file import KINDS, file_of

INPUT_PX: Final = (640, 384)
"""What a network is given whose input may have any size: width and height."""
COCO_LABELS: Final[Mapping[int, int]] = {0: 1, 2: 0, 3: 0, 5: 0, 6: 0, 7: 0}
"""COCO's classes by index, from 0: person; car, motorcycle, bus, train, truck."""
TORCHVISION_LABELS: Final[Mapping[int, int]] = {1: 1, 3: 0, 4: 0, 6: 0, 7: 0, 8: 0}
"""The same by torchvision's numbers, from 1."""
_GREY: Final = 114


class Network(Protocol):
    """A network that was loaded."""

    @property
    def input_px(self) -> tuple[int, int]:
        """Width and height of its input."""
        ...

    @property
    def names(self) -> Mapping[int, str]:
        """Names of its classes by index; empty if it does not say."""
        ...

    def answer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        """Return what it answers to a picture, shape ``(1, 3, h, w)``."""
        ...


class FileDetector:
    """Runs a user's network.

    Args:
        network: The network.
        where: Its file, for messages.

    Raises:
        DetectorError: It answers a grey picture with something that is no detection.
    """

    def __init__(self, network: Network, where: str) -> None:
        self._network = network
        self._where = where
        width_px, height_px = network.input_px
        self.detect(np.full((height_px, width_px, 3), _GREY, np.uint8))

    def detect(self, picture: Picture) -> Found:
        """Return what is in a picture."""
        check_picture(picture)
        canvas, scale, left, top = _letterboxed(picture, self._network.input_px)
        planes = np.ascontiguousarray(canvas.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)
        boxes, scores, classes, unnamed = self._read(self._network.answer(planes))
        label_of = _named(self._network.names) or unnamed
        labels = np.array([label_of.get(int(index), -1) for index in classes], np.int64)
        known = (labels >= 0) & (scores >= SCORE_FLOOR)
        boxes, scores, labels = boxes[known], scores[known], labels[known]
        best = np.argsort(-scores, kind="stable")[:MOST]
        boxes, scores, labels = boxes[best], scores[best], labels[best]
        height_px, width_px = picture.shape[:2]
        boxes = (boxes - np.array([left, top, left, top], np.float32)) / np.float32(scale)
        boxes = np.clip(boxes, 0.0, np.array([width_px, height_px] * 2, np.float32))
        kept = suppressed(boxes, scores, labels, DOUBLE_OVERLAP)
        return Found(labels=labels[kept], boxes=boxes[kept], scores=scores[kept])

    def _read(
        self, answer: Sequence[NDArray[Any]]
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64], Mapping[int, int]]:
        """Return boxes, scores, classes, and which label each class is if the network names none."""
        shapes = [array.shape for array in answer]
        if len(answer) == 1 and answer[0].ndim == 3 and answer[0].shape[0] == 1 and answer[0].shape[1] > 4:
            unnamed = {0: 0, 1: 1} if answer[0].shape[1] == 6 else COCO_LABELS
            rows = answer[0][0].T.astype(np.float32)
            best = rows[:, 4:].argmax(axis=1)
            half = 0.5 * rows[:, 2:4]
            boxes = np.hstack([rows[:, :2] - half, rows[:, :2] + half]).astype(np.float32)
            return boxes, rows[np.arange(len(rows)), 4 + best], best.astype(np.int64), unnamed
        if len(answer) == 3 and [a.ndim for a in answer] == [2, 1, 1] and answer[0].shape[1] == 4:
            boxes, scores, classes = answer
            if len(boxes) == len(scores) == len(classes):
                floats = boxes.astype(np.float32), scores.astype(np.float32)
                return *floats, classes.astype(np.int64), TORCHVISION_LABELS
        raise DetectorError(
            f"{self._where}: expected one output (1, 4 + classes, n), or boxes (n, 4), scores (n,) and labels (n,); "
            f"got outputs of shapes {shapes}"
        )


def _named(names: Mapping[int, str]) -> Mapping[int, int]:
    """Return which label each class is by its name, those that are neither left out."""
    return {index: LABELS[name.lower()] for index, name in names.items() if name.lower() in LABELS}


def _letterboxed(picture: Picture, size_px: tuple[int, int]) -> tuple[Picture, float, int, int]:
    """Return a picture in the middle of the network's input, how much smaller it is, and where its corner lies."""
    height_px, width_px = picture.shape[:2]
    scale = min(size_px[0] / width_px, size_px[1] / height_px)
    wide, high = max(1, round(width_px * scale)), max(1, round(height_px * scale))
    small = cv2.resize(picture, (wide, high), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    canvas = np.full((size_px[1], size_px[0], 3), _GREY, np.uint8)
    left, top = (size_px[0] - wide) // 2, (size_px[1] - high) // 2
    canvas[top : top + high, left : left + wide] = small
    return canvas, scale, left, top


class _OnnxNetwork:
    def __init__(self, file: Path) -> None:
        self._session = onnx_session(file)
        inputs = self._session.get_inputs()
        shape = list(inputs[0].shape) if inputs else []
        if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3:
            raise DetectorError(
                f"{file}: expected one input of shape (1, 3, h, w), got {[i.shape for i in inputs]}"
            )
        fixed = isinstance(shape[2], int) and isinstance(shape[3], int)
        self.input_px = (shape[3], shape[2]) if fixed else INPUT_PX
        self._input = inputs[0].name
        outputs = [output.name for output in self._session.get_outputs()]
        by_name = ("boxes", "scores", "labels")
        self._outputs = list(by_name) if set(by_name) <= set(outputs) else outputs
        self.names = _beside(file) or _names(self._session.get_modelmeta().custom_metadata_map.get("names"))

    def answer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        answer: list[NDArray[Any]] = self._session.run(self._outputs, {self._input: planes})
        return answer


class _TorchNetwork:
    def __init__(self, file: Path) -> None:
        torch = _imported(
            "torch", "torchscript", "the torch extra (pip install -c constraints.txt -e '.[torch]')"
        )
        self._torch = torch
        torch.set_num_threads(1)
        extra = {"config.txt": ""}  # what Ultralytics writes into its TorchScript files
        try:
            self._module = torch.jit.load(str(file), map_location="cpu", _extra_files=extra).eval()
        except Exception as error:  # torch raises several kinds
            line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise DetectorError(f"{file}: cannot be loaded as a TorchScript network: {line}") from error
        config = _literal(extra["config.txt"])
        self.input_px = INPUT_PX
        self.names = _beside(file) or (_names(config.get("names")) if isinstance(config, dict) else {})

    def answer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        with self._torch.no_grad():
            answer = self._module(self._torch.from_numpy(planes))
        while isinstance(answer, list | tuple) and len(answer) == 1:
            answer = answer[0]
        if isinstance(answer, dict):
            answer = [answer[name] for name in ("boxes", "scores", "labels") if name in answer]
        parts = list(answer) if isinstance(answer, list | tuple) else [answer]
        return [part.numpy() for part in parts if self._torch.is_tensor(part)]


class UltralyticsDetector:
    """Runs a YOLO model with the Ultralytics package, where a user has installed it.

    Raises:
        DetectorError: The package is not installed, or does not take the file.
    """

    def __init__(self, file: Path) -> None:
        package = _imported(
            "ultralytics", "ultralytics", "the package ultralytics, which is not a part of Brink (AGPL)"
        )
        try:
            self._model = package.YOLO(str(file))
        except Exception as error:  # its errors have no common class
            raise DetectorError(f"{file}: cannot be loaded by ultralytics: {error}") from error
        self._label_of = _named(dict(self._model.names))

    def detect(self, picture: Picture) -> Found:
        """Return what is in a picture."""
        answer = self._model.predict(
            picture[:, :, ::-1],
            conf=SCORE_FLOOR,
            iou=DOUBLE_OVERLAP,
            max_det=MOST,
            device="cpu",
            verbose=False,
        )[0].boxes
        classes = answer.cls.cpu().numpy().astype(int)
        labels = np.array([self._label_of.get(int(index), -1) for index in classes], np.int64)
        known = labels >= 0
        return Found(
            labels=labels[known],
            boxes=answer.xyxy.cpu().numpy().astype(np.float32)[known],
            scores=answer.conf.cpu().numpy().astype(np.float32)[known],
        )


@cache
def file_detector(detector_id: str) -> Detector:
    """Return the detector of an id such as ``onnx:FILE``, loaded once a process.

    Raises:
        DetectorError: The kind is unknown, the file is not there, or is no detector.
    """
    file = file_of(detector_id)
    if file is None:
        raise DetectorError(
            f"detector: expected {', '.join(f'{one}:FILE' for one in KINDS)}; got {detector_id!r}"
        )
    kind = detector_id.partition(":")[0]
    if kind == "ultralytics":
        return UltralyticsDetector(file)
    network = _OnnxNetwork(file) if kind == "onnx" else _TorchNetwork(file)
    return FileDetector(network, str(file))


def _imported(module: str, kind: str, what: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise DetectorError(f"detector: {kind} needs {what}") from None


def _beside(file: Path) -> dict[int, str]:
    """Return the names of classes that a file beside the weights gives; empty without one.

    Raises:
        DetectorError: It is there, but not what it should be.
    """
    named = file.with_name(file.name + ".json")
    if not named.is_file():
        return {}
    try:
        names = _names(json.loads(named.read_text(encoding="utf-8"))["names"])
    except (ValueError, KeyError, TypeError):
        names = {}
    if not _named(names):
        raise DetectorError(f'{named}: expected {{"names": ["vehicle", "person"]}}, one of them at least')
    return names


def _names(value: object) -> dict[int, str]:
    found = _literal(value) if isinstance(value, str) else value
    if isinstance(found, dict):
        return {int(index): str(name) for index, name in found.items()}
    return dict(enumerate(map(str, found))) if isinstance(found, list) else {}


def _literal(text: object) -> Any:
    try:
        return ast.literal_eval(str(text))
    except (ValueError, SyntaxError):
        return None


def main(arguments: Sequence[str]) -> int:
    """Load the detector of an id; print what is wrong with it and return 1 if it does not load."""
    try:
        file_detector(arguments[0])
    except DetectorError as error:
        print(" ".join(str(error).split()))  # noqa: T201
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
