"""Wrong exposure: too bright, or too much contrast."""

from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.gene import Frame


def brightness(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with ``255 value`` added and clipped."""
    added = round(255 * value)
    return cast(Frame, cv2.add(frame, np.full(4, added, dtype=np.float64)))


def contrast(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame multiplied by ``1 + value``, rounded and clipped."""
    return cast(Frame, cv2.convertScaleAbs(frame, alpha=1 + value))
