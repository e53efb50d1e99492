"""Detectors of vehicles and people: `brink-det@1` and `@2`, networks from users' files, and the lookup by id.

A detector takes an RGB image of any size and returns boxes in its pixels. The two run with onnxruntime on
one thread; their weights ship with the package.

Users name their own detectors as ``onnx:FILE``, ``torchscript:FILE`` or ``ultralytics:FILE``. The network in an
ONNX or TorchScript file takes one RGB image, shape ``(1, 3, h, w)``, float32 in [0, 1], scaled to fit and padded
with grey. Its output, in px of its input, has one of two forms:

- one array of shape ``(1, 4 + c, n)``, as exported from YOLO networks: centre x, centre y, width, height, and a
  score for each of c classes, of n boxes;
- three arrays: boxes ``(n, 4)`` as x_min, y_min, x_max, y_max, scores ``(n,)`` and labels ``(n,)``, in this order or
  named ``boxes``, ``scores`` and ``labels``, as in torchvision's detectors.

An ONNX file with the input and the outputs of `brink-det`, as Brink's own training writes it, runs like that one.

Class names are read from ``FILE.json`` next to the weights, ``{"names": ["vehicle", "person"]}``, or from the
metadata that YOLO's exporter writes. Without names, a single array of two classes means vehicle and person, and of
80 classes COCO's in YOLO's order; three arrays use torchvision's COCO numbers. The size of the input is that of the
network, if it is fixed, else ``"input_px": [width, height]`` in ``FILE.json`` or the exporter's ``imgsz``, else
640 x 384. Any other output, number of classes or size of the input is rejected when the network is loaded.
"""

import ast
import importlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Protocol, Self, TypeAlias, cast

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from brink.extras import install_command
from brink.sim.catalogue import load_plugin, plugin_ids
from brink.sim.episode import nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import Detections, FloatArray, non_maximum_suppression
from brink.sim.perception.user_files import (
    CATEGORY_LABELS,
    KINDS,
    MAX_DESCRIPTION_BYTES,
    DetectorError,
    InvalidDetections,
    weights_digest,
    weights_file,
)
from brink.user_file import read_text

Picture: TypeAlias = NDArray[np.uint8]

DETECTORS: Final = "brink.detectors"
LABELS: Final = ("vehicle", "person")
STRIDE: Final = 4
SIDE_PX: Final = 32
"""Width and height of the input of `brink-det` are multiples of this."""
MIN_SCORE: Final = 0.001
MAX_DETECTIONS: Final = 100
NMS_OVERLAP: Final = 0.6
MAX_NAMED: Final = 5
"""Number of classes that a message names."""
MAX_INPUT_PX: Final = 4096
FLEXIBLE_INPUT_PX: Final = (640, 384)
"""Width and height used for a network that accepts inputs of any size."""
COCO_LABELS: Final[Mapping[int, int]] = {0: 1, 2: 0, 3: 0, 5: 0, 6: 0, 7: 0}
"""Labels of COCO's classes numbered from 0: person; car, motorcycle, bus, train, truck."""
COCO_CLASSES: Final = 80
TORCHVISION_LABELS: Final[Mapping[int, int]] = {1: 1, 3: 0, 4: 0, 6: 0, 7: 0, 8: 0}
"""The same for torchvision's class numbers, which start at 1."""
_OWN_PADDING: Final = 115
_PADDING: Final = 114


class Detector(Protocol):
    """Finds vehicles and people in images."""

    def detect(self, picture: Picture) -> Detections:
        """Return the labels (0 vehicle, 1 person), boxes (in image pixels) and scores of the detections in an image.

        Args:
            picture: RGB, shape ``(h, w, 3)``.
        """


class CheckedDetector:
    """Checks everything that a detector returns, so that a broken detector is not mistaken for one that sees nothing.

    Args:
        detector: The detector.
        source: Its id, named in messages.
    """

    def __init__(self, detector: Detector, source: str) -> None:
        self._detector = detector
        self._source = source

    def detect(self, picture: Picture) -> Detections:
        """Return the detections in an image.

        Raises:
            InvalidDetections: The detector returned something else.
        """
        found: object = self._detector.detect(picture)
        if not isinstance(found, Detections):
            raise InvalidDetections(f"{self._source}: expected Detections, got {type(found).__name__}")
        shapes = [np.shape(part) for part in (found.labels, found.boxes, found.scores)]
        count = len(found.labels) if shapes[0] else 0
        if shapes != [(count,), (count, 4), (count,)]:
            raise InvalidDetections(
                f"{self._source}: expected labels (n,), boxes (n, 4) and scores (n,), got arrays of shapes {shapes}"
            )
        if not np.isin(found.labels, range(len(LABELS))).all():
            raise InvalidDetections(
                f"{self._source}: expected labels 0 (vehicle) and 1 (person), got "
                f"{np.unique(found.labels).tolist()!r:.80}"
            )
        if not all(np.issubdtype(np.asarray(part).dtype, np.number) for part in (found.boxes, found.scores)):
            raise InvalidDetections(f"{self._source}: expected boxes and scores to be arrays of numbers")
        _check_finite(self._source, found.boxes, found.scores)
        _check_scores(self._source, found.scores)
        turned = (found.boxes[:, 2:] < found.boxes[:, :2]).any(axis=1)
        if turned.any():
            raise InvalidDetections(
                f"{self._source}: expected boxes (x_min, y_min, x_max, y_max), got {found.boxes[turned][0].tolist()}"
            )
        return found


def _check_scores(source: str, scores: NDArray[Any]) -> None:
    """Check that scores lie in [0, 1].

    Raises:
        InvalidDetections: They are not, as those of a network that returns logits.
    """
    if scores.size and not (scores.min() >= 0 and scores.max() <= 1):
        raise InvalidDetections(
            f"{source}: expected scores from 0 to 1, got {scores.min():g} to {scores.max():g}; if these are logits, "
            "export the network with its sigmoid"
        )


def _check_finite(source: str, boxes: NDArray[Any], scores: NDArray[Any]) -> None:
    """Check that boxes and scores are finite.

    Networks' detectors call it before they select by score, because NaN is not above any threshold and would be
    dropped, and before they clip boxes to the image, because infinity would become its edge.

    Raises:
        InvalidDetections: A number is NaN or infinite.
    """
    broken = [int(np.count_nonzero(~np.isfinite(part))) for part in (scores, boxes)]
    if any(broken):
        raise InvalidDetections(
            f"{source}: expected finite scores and boxes, got NaN or infinity in {broken[0]} of {scores.size} scores "
            f"and {broken[1]} of {boxes.size} coordinates of boxes"
        )


def find_detector(detector_id: str) -> CheckedDetector:
    """Return the detector with the given id; detectors are stateless, so it may be shared.

    Args:
        detector_id: A registered detector such as ``brink-det@1``, or a user's file: ``onnx:FILE``,
            ``torchscript:FILE``, ``ultralytics:FILE``.

    Raises:
        InvalidEpisode: No such detector is registered, or the file is not a detector.
    """
    if ":" in detector_id:
        try:
            return CheckedDetector(load_file_detector(detector_id), detector_id)
        except DetectorError as error:
            raise InvalidEpisode(str(error)) from error
    try:
        factory = load_plugin(DETECTORS, detector_id)
    except KeyError:
        known = plugin_ids(DETECTORS)
        expected = ", ".join([*known, *(f"{kind}:FILE" for kind in KINDS)]) + nearest(detector_id, known)
        raise InvalidEpisode(f"detector: expected one of {expected}; got {detector_id!r}") from None
    return CheckedDetector(cast(Callable[[], Detector], factory)(), detector_id)


def _check_picture(picture: Picture) -> None:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or min(picture.shape[:2]) < 1:
        raise DetectorError(
            f"picture: expected uint8 of shape (h, w, 3), got {picture.dtype} of shape {picture.shape}"
        )


def _scale_to_fit(picture: Picture, size_px: tuple[int, int]) -> tuple[Picture, float]:
    """Return an image scaled to fit (width, height), and the scale factor."""
    height_px, width_px = picture.shape[:2]
    scale = min(size_px[0] / width_px, size_px[1] / height_px)
    size = max(1, round(width_px * scale)), max(1, round(height_px * scale))
    scaled = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    return scaled.astype(np.uint8, copy=False), scale


def to_planes(canvas: Picture) -> NDArray[np.float32]:
    """Return an RGB image, shape ``(h, w, 3)``, as network input, shape ``(1, 3, h, w)``, in [0, 1]."""
    return np.ascontiguousarray(canvas.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255.0)


def _load_onnx(file: Path) -> onnxruntime.InferenceSession:
    """Open an ONNX file for inference on one thread.

    Raises:
        DetectorError: The file cannot be loaded.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common class
        raise DetectorError(f"{file}: cannot be loaded as an ONNX network: {error}") from error


def fit_picture(picture: Picture, size_px: tuple[int, int]) -> tuple[Picture, float]:
    """Return an image in the input format of `brink-det`, and its scale factor.

    The image is scaled with its aspect ratio kept and padded with grey on the right or below.

    Args:
        picture: RGB, uint8, shape ``(h, w, 3)``.
        size_px: Width and height of the input.

    Raises:
        DetectorError: It is not an RGB image.
    """
    _check_picture(picture)
    small, scale = _scale_to_fit(picture, size_px)
    canvas = np.full((size_px[1], size_px[0], 3), _OWN_PADDING, np.uint8)
    canvas[: small.shape[0], : small.shape[1]] = small
    return canvas, scale


def decode(heat: FloatArray, edges: FloatArray) -> Detections:
    """Decode a network's output to boxes in px of its input, best first.

    Args:
        heat: Logits of box centres, shape ``(classes, h, w)``.
        edges: Distances to the left, upper, right and lower edge in px, shape ``(classes, 4, h, w)``.
    """
    scores = (1.0 / (1.0 + np.exp(-heat))).astype(np.float32)
    peaks = np.stack([cv2.dilate(plane, np.ones((3, 3), np.uint8)) for plane in scores]) == scores
    labels, rows, columns = np.nonzero(peaks & (scores >= MIN_SCORE))
    peak_scores = scores[labels, rows, columns]
    best = np.argsort(-peak_scores, kind="stable")[:MAX_DETECTIONS]
    labels, rows, columns, peak_scores = labels[best], rows[best], columns[best], peak_scores[best]
    x, y = (columns + 0.5) * STRIDE, (rows + 0.5) * STRIDE
    left, upper, right, lower = edges[labels, :, rows, columns].T
    boxes = np.stack([x - left, y - upper, x + right, y + lower], axis=1).astype(np.float32)
    kept = non_maximum_suppression(boxes, peak_scores, labels, NMS_OVERLAP)
    return Detections(labels=labels[kept], boxes=boxes[kept], scores=peak_scores[kept])


def _own_input_px(session: onnxruntime.InferenceSession) -> tuple[int, int] | None:
    """Return width and height of the input of a network of `brink-det`; None for any other network."""
    shape = tuple(session.get_inputs()[0].shape)
    if len(shape) != 4 or not all(isinstance(size, int) and size > 0 for size in shape):
        return None
    height_px, width_px = shape[2:]
    if height_px % SIDE_PX or width_px % SIDE_PX:
        return None
    grid = height_px // STRIDE, width_px // STRIDE
    expected = [(1, 3, height_px, width_px), (1, len(LABELS), *grid), (1, len(LABELS), 4, *grid)]
    return (width_px, height_px) if _shapes(session) == expected else None


def _shapes(session: onnxruntime.InferenceSession) -> list[tuple[Any, ...]]:
    return [tuple(put.shape) for put in (*session.get_inputs(), *session.get_outputs())]


class NetworkDetector:
    """Runs a network of `brink-det` with onnxruntime on one thread.

    Args:
        session: A network with one input of shape ``(1, 3, h, w)``, h and w divisible by `SIDE_PX`, and the outputs
            that `decode` takes.
        source: Its file, named in messages.

    Raises:
        DetectorError: It is a different network.

    Attributes:
        labels: The labels that it may give.
        input_name: Name of the network's input.
        input_px: Its width and height.
    """

    labels = frozenset(range(len(LABELS)))

    def __init__(self, session: onnxruntime.InferenceSession, source: str) -> None:
        size_px = _own_input_px(session)
        if size_px is None:
            raise DetectorError(
                f"{source}: expected an input of shape (1, 3, h, w), h and w divisible by {SIDE_PX}, and outputs "
                f"(1, {len(LABELS)}, h / {STRIDE}, w / {STRIDE}) and (1, {len(LABELS)}, 4, h / {STRIDE}, "
                f"w / {STRIDE}); got shapes {_shapes(session)}"
            )
        self.input_px = size_px
        self._session = session
        self._source = source
        self.input_name = session.get_inputs()[0].name

    @classmethod
    def from_file(cls, weights: Path) -> Self:
        """Load the network from an ONNX file.

        Raises:
            DetectorError: The file cannot be loaded, or is a different network.
        """
        return cls(_load_onnx(weights), str(weights))

    def infer(self, canvas: Picture) -> tuple[FloatArray, FloatArray]:
        """Return the heat map and the edges for a fitted image."""
        heat, edges = self._session.run(None, {self.input_name: to_planes(canvas)})
        return heat[0], edges[0]

    def detect(self, picture: Picture) -> Detections:
        """Return the detections in an image."""
        canvas, scale = fit_picture(picture, self.input_px)
        heat, edges = self.infer(canvas)
        _check_finite(self._source, edges, heat)
        found = decode(heat, edges)
        boxes = np.clip(found.boxes / np.float32(scale), 0.0, _limits(picture))
        return Detections(labels=found.labels, boxes=boxes, scores=found.scores)


def _limits(picture: Picture) -> FloatArray:
    return np.array([picture.shape[1], picture.shape[0]] * 2, np.float32)


def load_brink_det_1() -> NetworkDetector:
    """Return `brink-det@1`, trained on earlier images with little augmentation; see `load_brink_det_2`."""
    return _load_own(1)


def load_brink_det_2() -> NetworkDetector:
    """Return `brink-det@2` with the weights that ship with the package."""
    return _load_own(2)


@cache
def _load_own(version: int) -> NetworkDetector:
    weights = files("brink.sim.perception").joinpath(f"weights/brink-det-{version}.onnx")
    return NetworkDetector.from_file(Path(str(weights)))


class LoadedNetwork(Protocol):
    """A network loaded from a user's file."""

    @property
    def input_px(self) -> tuple[int, int]:
        """Width and height of the network's input."""

    @property
    def names(self) -> Mapping[int, str]:
        """Class names by index; empty if unknown."""

    def infer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        """Return the outputs for an image, shape ``(1, 3, h, w)``."""


class FileDetector:
    """Runs a user's network.

    Args:
        network: The network.
        source: Its file, named in messages.

    Raises:
        DetectorError: It fails on a grey image of its input size, its output is not a detection, or it has none of
            the known classes.

    Attributes:
        labels: The labels that it may give.
    """

    def __init__(self, network: LoadedNetwork, source: str) -> None:
        self._network = network
        self._source = source
        known = _labels_by_name(network.names)
        if network.names and not known:
            raise DetectorError(
                f"{source}: expected a network with at least one of the classes {', '.join(CATEGORY_LABELS)}; got "
                f"{_some(network.names.values())}"
            )
        width_px, height_px = network.input_px
        grey = np.full((height_px, width_px, 3), _PADDING, np.uint8)
        try:
            outputs = network.infer(to_planes(grey))
        except Exception as error:  # neither onnxruntime's nor torch's errors have a common class
            raise DetectorError(
                f"{source}: cannot process an image of {width_px} x {height_px} px: {_one_line(error)}. If it "
                f'takes another size, name it in {Path(source).name}.json: {{"input_px": [width, height]}}'
            ) from error
        *_, default_labels = self._parse(outputs)
        self.labels = frozenset((known or default_labels).values())
        self.detect(grey)

    def detect(self, picture: Picture) -> Detections:
        """Return the detections in an image."""
        _check_picture(picture)
        canvas, scale, left, top = _letterbox(picture, self._network.input_px)
        boxes, scores, classes, default_labels = self._parse(self._network.infer(to_planes(canvas)))
        label_of = _labels_by_name(self._network.names) or default_labels
        labels = np.array([label_of.get(int(index), -1) for index in classes], np.int64)
        known = (labels >= 0) & (scores >= MIN_SCORE)
        _check_finite(self._source, boxes[known], scores)
        _check_scores(self._source, scores)
        boxes, scores, labels = boxes[known], scores[known], labels[known]
        best = np.argsort(-scores, kind="stable")[:MAX_DETECTIONS]
        boxes, scores, labels = boxes[best], scores[best], labels[best]
        boxes = (boxes - np.array([left, top, left, top], np.float32)) / np.float32(scale)
        boxes = np.clip(boxes, 0.0, _limits(picture))
        kept = non_maximum_suppression(boxes, scores, labels, NMS_OVERLAP)
        return Detections(labels=labels[kept], boxes=boxes[kept], scores=scores[kept])

    def _parse(
        self, outputs: Sequence[NDArray[Any]]
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64], Mapping[int, int]]:
        """Return boxes, scores, classes, and the labels to use if the network has no class names."""
        shapes = [array.shape for array in outputs]
        if (
            len(outputs) == 1
            and outputs[0].ndim == 3
            and outputs[0].shape[0] == 1
            and outputs[0].shape[1] > 4
        ):
            default_labels = self._check_classes(outputs[0].shape)
            rows = outputs[0][0].T.astype(np.float32)
            best = rows[:, 4:].argmax(axis=1)
            half = 0.5 * rows[:, 2:4]
            boxes = np.hstack([rows[:, :2] - half, rows[:, :2] + half]).astype(np.float32)
            return boxes, rows[np.arange(len(rows)), 4 + best], best.astype(np.int64), default_labels
        if len(outputs) == 3 and [a.ndim for a in outputs] == [2, 1, 1] and outputs[0].shape[1] == 4:
            boxes, scores, classes = outputs
            if len(boxes) == len(scores) == len(classes):
                if not np.isfinite(classes).all():  # as integers, they would be unknown classes
                    raise InvalidDetections(f"{self._source}: expected labels, got NaN or infinity")
                floats = boxes.astype(np.float32), scores.astype(np.float32)
                return *floats, classes.astype(np.int64), TORCHVISION_LABELS
        raise DetectorError(
            f"{self._source}: expected one output (1, 4 + classes, n), or boxes (n, 4), scores (n,) and labels "
            f"(n,); got outputs of shapes {shapes}"
        )

    def _check_classes(self, shape: tuple[int, ...]) -> Mapping[int, int]:
        """Return the labels of the classes in a single array, if the network has no class names.

        Raises:
            DetectorError: The array has another number of classes than there are names, or than can be known.
        """
        classes = shape[1] - 4
        names = self._network.names
        if names and len(names) != classes:
            raise DetectorError(
                f"{self._source}: expected an output (1, {4 + len(names)}, n): a box and a score for each of the "
                f"classes {_some(names.values())}; got shape {shape}"
            )
        if not names and classes not in (len(LABELS), COCO_CLASSES):
            raise DetectorError(
                f"{self._source}: expected an output (1, {4 + len(LABELS)}, n) of vehicle and person or "
                f"(1, {4 + COCO_CLASSES}, n) of COCO's classes, got shape {shape}; name any other classes in "
                f'{Path(self._source).name}.json: {{"names": ["vehicle", "person"]}}'
            )
        return {0: 0, 1: 1} if classes == len(LABELS) else COCO_LABELS


def _some(names: Iterable[str]) -> str:
    """Return the first names of a list, in words."""
    listed = list(names)
    return ", ".join(listed[:MAX_NAMED]) + (" and more" if len(listed) > MAX_NAMED else "")


def _one_line(error: Exception) -> str:
    """Return the last non-empty line of an error's message, or the error's type."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return (lines[-1] if lines else type(error).__name__)[:200]


def _labels_by_name(names: Mapping[int, str]) -> Mapping[int, int]:
    """Return the label of each class with a known name."""
    return {
        index: CATEGORY_LABELS[name.lower()]
        for index, name in names.items()
        if name.lower() in CATEGORY_LABELS
    }


def _letterbox(picture: Picture, size_px: tuple[int, int]) -> tuple[Picture, float, int, int]:
    """Return an image centred in the network's input, its scale factor, and the position of its left and top edge."""
    small, scale = _scale_to_fit(picture, size_px)
    high, wide = small.shape[:2]
    canvas = np.full((size_px[1], size_px[0], 3), _PADDING, np.uint8)
    left, top = (size_px[0] - wide) // 2, (size_px[1] - high) // 2
    canvas[top : top + high, left : left + wide] = small
    return canvas, scale, left, top


class _OnnxNetwork:
    def __init__(self, file: Path, session: onnxruntime.InferenceSession) -> None:
        self._session = session
        inputs = session.get_inputs()
        shape = list(inputs[0].shape) if inputs else []
        if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3:
            raise DetectorError(
                f"{file}: expected one input of shape (1, 3, h, w), got {[i.shape for i in inputs]}"
            )
        fixed = (shape[3], shape[2]) if isinstance(shape[2], int) and isinstance(shape[3], int) else None
        self._input = inputs[0].name
        outputs = [output.name for output in self._session.get_outputs()]
        by_name = ("boxes", "scores", "labels")
        self._outputs = list(by_name) if set(by_name) <= set(outputs) else outputs
        metadata = self._session.get_modelmeta().custom_metadata_map
        described = _read_description(file)
        self.names = described.names or _parse_names(metadata.get("names"))
        if fixed and described.input_px and fixed != described.input_px:
            raise DetectorError(
                f"{file}: takes images of {fixed[0]} x {fixed[1]} px, but {file.name}.json says "
                f"{described.input_px[0]} x {described.input_px[1]} px"
            )
        self.input_px = fixed or described.input_px or _exported_size(metadata) or FLEXIBLE_INPUT_PX

    def infer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        outputs: list[NDArray[Any]] = self._session.run(self._outputs, {self._input: planes})
        return outputs


class _TorchNetwork:
    def __init__(self, file: Path) -> None:
        torch = _import("torch", "torchscript", f"the torch extra ({install_command('torch')})")
        self._torch = torch
        torch.set_num_threads(1)
        extra = {"config.txt": ""}  # written by Ultralytics into its TorchScript files
        try:
            self._module = torch.jit.load(str(file), map_location="cpu", _extra_files=extra).eval()
        except Exception as error:  # torch raises several kinds
            line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise DetectorError(f"{file}: cannot be loaded as a TorchScript network: {line}") from error
        config = _parse_literal(extra["config.txt"])
        metadata = config if isinstance(config, dict) else {}
        described = _read_description(file)
        self.names = described.names or _parse_names(metadata.get("names"))
        self.input_px = described.input_px or _exported_size(metadata) or FLEXIBLE_INPUT_PX

    def infer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        with self._torch.no_grad():
            output = self._module(self._torch.from_numpy(planes))
        while isinstance(output, list | tuple) and len(output) == 1:
            output = output[0]
        if isinstance(output, dict):
            output = [output[name] for name in ("boxes", "scores", "labels") if name in output]
        parts = list(output) if isinstance(output, list | tuple) else [output]
        return [part.numpy() for part in parts if self._torch.is_tensor(part)]


class UltralyticsDetector:
    """Runs a YOLO model with the Ultralytics package, if the user has installed it.

    Raises:
        DetectorError: The package is not installed or cannot load the file.
    """

    def __init__(self, file: Path) -> None:
        package = _import(
            "ultralytics", "ultralytics", "the package ultralytics, which is not part of Brink (AGPL)"
        )
        try:
            self._model = package.YOLO(str(file))
        except Exception as error:  # its errors have no common class
            raise DetectorError(f"{file}: cannot be loaded by ultralytics: {error}") from error
        self._source = str(file)
        self._label_of = _labels_by_name(dict(self._model.names))
        self.labels = frozenset(self._label_of.values())
        if not self.labels:
            raise DetectorError(
                f"{file}: expected a network with at least one of the classes {', '.join(CATEGORY_LABELS)}"
            )
        self._find(np.full((64, 64, 3), _PADDING, np.uint8))
        # The package drops NaN when it selects by score, so the network's own output is checked.
        self._model.predictor.model.register_forward_hook(self._check_output)

    def detect(self, picture: Picture) -> Detections:
        """Return the detections in an image."""
        _check_picture(picture)
        found = self._find(picture)
        classes = found.cls.cpu().numpy().astype(int)
        labels = np.array([self._label_of.get(int(index), -1) for index in classes], np.int64)
        known = labels >= 0
        return Detections(
            labels=labels[known],
            boxes=found.xyxy.cpu().numpy().astype(np.float32)[known],
            scores=found.conf.cpu().numpy().astype(np.float32)[known],
        )

    def _find(self, picture: Picture) -> Any:
        return self._model.predict(
            picture[:, :, ::-1],
            conf=MIN_SCORE,
            iou=NMS_OVERLAP,
            max_det=MAX_DETECTIONS,
            device="cpu",
            verbose=False,
        )[0].boxes

    def _check_output(self, _module: Any, _inputs: Any, output: Any) -> None:
        """Check a network's output: an array (1, 4 + classes, n), or a tuple that begins with one."""
        while isinstance(output, list | tuple):
            output = output[0]
        rows = output.cpu().numpy()
        broken = int(np.count_nonzero(~np.isfinite(rows)))
        if broken:
            raise InvalidDetections(
                f"{self._source}: expected finite scores and boxes, got NaN or infinity in {broken} of {rows.size} "
                "numbers of the network's output"
            )


def load_file_detector(detector_id: str) -> FileDetector | NetworkDetector | UltralyticsDetector:
    """Load the detector with an id such as ``onnx:FILE``, once per process and content of the file.

    Raises:
        DetectorError: The kind is unknown, or the file is missing, not a detector, or changing.
    """
    file = weights_file(detector_id)
    if file is None:
        raise DetectorError(
            f"detector: expected {', '.join(f'{one}:FILE' for one in KINDS)}; got {detector_id!r}"
        )
    return _load_file(detector_id, file, weights_digest(detector_id))


@lru_cache(maxsize=4)
def _load_file(
    detector_id: str, file: Path, content: str
) -> FileDetector | NetworkDetector | UltralyticsDetector:
    found = _open_file(detector_id, file)
    if weights_digest(detector_id) != content:
        raise DetectorError(f"detector: {file} changed while it was loaded")
    return found


def _open_file(detector_id: str, file: Path) -> FileDetector | NetworkDetector | UltralyticsDetector:
    kind = detector_id.partition(":")[0]
    if kind == "ultralytics":
        return UltralyticsDetector(file)
    if kind == "torchscript":
        return FileDetector(_TorchNetwork(file), str(file))
    session = _load_onnx(file)
    if _own_input_px(session) is not None:
        return NetworkDetector(session, str(file))
    return FileDetector(_OnnxNetwork(file, session), str(file))


def _import(module: str, kind: str, requirement: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise DetectorError(f"detector: {kind} needs {requirement}") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Description:
    """A user's description of a network.

    Attributes:
        names: Class names by index; empty if not stated.
        input_px: Width and height of the network's input; None if not stated.
    """

    names: Mapping[int, str] = field(default_factory=dict)
    input_px: tuple[int, int] | None = None


def _read_description(file: Path) -> _Description:
    """Return the description in the JSON file beside the weights; an empty one if there is no such file.

    Raises:
        DetectorError: The file is invalid or has no known class.
    """
    beside = file.with_name(file.name + ".json")
    if not beside.is_file():
        return _Description()
    try:
        document = json.loads(read_text(beside, MAX_DESCRIPTION_BYTES))
        names = _parse_names(document.get("names"))
    except (OSError, ValueError, AttributeError, RecursionError):
        document, names = {}, {}
    size = document.get("input_px")
    if not _labels_by_name(names) and (size is None or "names" in document):
        raise DetectorError(
            f'{beside}: expected {{"names": ["vehicle", "person"]}} with at least one of these names'
        )
    if size is not None and not _is_size(size):
        raise DetectorError(f"{beside}: input_px: expected [width, height] in px, got {size!r:.80}")
    return _Description(names=names, input_px=None if size is None else (size[0], size[1]))


def _is_size(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(type(side) is int and 0 < side <= MAX_INPUT_PX for side in value)
    )


def _exported_size(metadata: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the width and height that YOLO's exporter wrote, as [height, width]; None if it wrote none."""
    value = metadata.get("imgsz")
    size: Any = _parse_literal(value) if isinstance(value, str) else value
    return (size[1], size[0]) if _is_size(size) else None


def _parse_names(value: object) -> dict[int, str]:
    parsed = _parse_literal(value) if isinstance(value, str) else value
    if isinstance(parsed, dict):
        return {int(index): str(name) for index, name in parsed.items()}
    return dict(enumerate(map(str, parsed))) if isinstance(parsed, list) else {}


def _parse_literal(text: object) -> Any:
    try:
        return ast.literal_eval(str(text))
    except (ValueError, SyntaxError):
        return None


def main(arguments: Sequence[str]) -> int:
    """Load the detector with the given id and print its labels; if that fails, print the reason and return 1."""
    try:
        labels = load_file_detector(arguments[0]).labels
    except DetectorError as error:
        print(" ".join(str(error).split()))  # noqa: T201
        return 1
    print(*sorted(labels))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
