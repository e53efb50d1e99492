"""Which boxes of a rendered image count: one policy for training, evaluation and episodes.

A box covers the visible pixels of a body, because hidden parts cannot be detected and say nothing about how near the
body is to the lane. Bodies that are almost hidden and boxes that are too small are *ignored*: a detection on them
counts neither for nor against a detector, and training leaves them out. The geometric ground truth of
`brink.sim.driving.camera` applies the same limits to whole boxes, since it has no pixels.
"""

import numpy as np

from brink.sim.driving.camera import LEAST_VISIBLE
from brink.sim.perception.boxes import (
    MIN_HEIGHT_SHARE,
    MIN_WIDTH_SHARE,
    GroundTruth,
    LabelledFrame,
    too_small,
)
from brink.sim.perception.detector import LABELS
from brink.sim.rendering.canvas import seen_bodies, visible_bodies
from brink.sim.rendering.scene import BodyKind, Frame

VEHICLE, PERSON = (LABELS.index(name) for name in ("vehicle", "person"))


def label_frame(frame: Frame) -> LabelledFrame:
    """Return a rendered image with the boxes of all visible bodies, sorted by the bodies' ids.

    All bodies other than people are labelled as vehicles; so is a fallen tree, since it blocks the road like one.
    """
    seen = [(body, body.box) for body in visible_bodies(frame) if body.box is not None]
    boxes = np.array([box for _, box in seen], np.float32).reshape(len(seen), 4)
    visible = np.array([body.visible_share for body, _ in seen], np.float32)
    height_px, width_px = frame.image.shape[:2]
    return LabelledFrame(
        picture=frame.image,
        truth=GroundTruth(
            labels=np.array([_label(body.kind) for body, _ in seen], np.int64),
            boxes=boxes,
            ignored=too_small(boxes, width_px, height_px) | (visible < LEAST_VISIBLE),
        ),
        depths_m=np.array([body.depth_m for body, _ in seen], np.float32),
        visible=visible,
    )


def label_boxes(frame: Frame) -> GroundTruth:
    """Return the ground truth of `label_frame` in less than half its time."""
    height_px, width_px = frame.image.shape[:2]
    least_px = MIN_WIDTH_SHARE * width_px, MIN_HEIGHT_SHARE * height_px
    seen = seen_bodies(frame, least_px=least_px, least_share=LEAST_VISIBLE)
    return GroundTruth(
        labels=np.array([_label(body.kind) for body in seen], np.int64),
        boxes=np.array([body.box for body in seen], np.float32).reshape(len(seen), 4),
        ignored=np.array([not body.clear for body in seen], np.bool_),
    )


def _label(kind: BodyKind) -> int:
    return PERSON if kind is BodyKind.PERSON else VEHICLE
