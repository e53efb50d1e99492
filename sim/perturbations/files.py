"""Reads and writes pictures as RGB arrays."""

from pathlib import Path
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.errors import InvalidFrame
from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.pipeline import check_frame


def read_picture(path: Path) -> Frame:
    """Return a picture file as RGB, uint8, shape ``(height, width, 3)``; what is transparent in it is dropped.

    Raises:
        InvalidFrame: It is not a picture, or too small.
        OSError: The file cannot be read.
    """
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    try:
        decoded = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
    except cv2.error:  # more pixels than it agrees to decode
        decoded = None
    if decoded is None:
        raise InvalidFrame(f"{path}: expected a picture (PNG, JPEG, WebP, TIFF, BMP), got something else")
    picture = cast(Frame, cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))
    check_frame(picture, f"{path}: ")
    return picture


def write_picture(picture: Frame, path: Path) -> None:
    """Write an RGB picture in the format that the file's name ends in, such as ``.png``.

    Raises:
        InvalidFrame: OpenCV cannot write this picture in this format, or knows no such format.
        OSError: The file cannot be written.
    """
    try:
        written, content = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    except cv2.error as error:
        raise InvalidFrame(f"{path}: cannot be written as {path.suffix}: {error.err}") from error
    if not written:
        raise InvalidFrame(f"{path}: cannot be written as {path.suffix}")
    path.write_bytes(content.tobytes())
