"""Boxes in pictures, as arrays: overlap, and the suppression of doubles.

A row is x_min, y_min, x_max, y_max in pixels; maxima lie just beyond the box.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float32]
IndexArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


def overlaps(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return intersection over union of all pairs, shape ``(n, 4)`` and ``(m, 4)`` to ``(n, m)``."""
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0.0, None), axis=2)
    area = _area(one)[:, None] + _area(other)[None, :] - shared
    return np.asarray(np.where(area > 0, shared / np.where(area > 0, area, 1.0), 0.0), dtype=np.float32)


def _area(boxes: FloatArray) -> FloatArray:
    return np.asarray(np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0.0, None), axis=1), dtype=np.float32)


def suppressed(boxes: FloatArray, scores: FloatArray, labels: NDArray[np.int64], most: float) -> IndexArray:
    """Return the boxes that stay, best first, once each has removed all worse ones of its label that overlap it.

    Args:
        boxes: Shape ``(n, 4)``.
        scores: Shape ``(n,)``.
        labels: Shape ``(n,)``.
        most: Largest overlap of two boxes that both stay, in [0, 1].
    """
    order = np.argsort(-scores, kind="stable")
    overlap = overlaps(boxes, boxes)
    kept: list[int] = []
    removed = np.zeros(len(boxes), np.bool_)
    for index in order.tolist():
        if removed[index]:
            continue
        kept.append(index)
        removed |= (overlap[index] > most) & (labels == labels[index])
    return np.array(kept, dtype=np.intp)
