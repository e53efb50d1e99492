"""Parameters that all problems with the ego's camera have: latency, pitch and the least visible share."""

from typing import Any

from brink.search.settings import setting
from brink.sim.driving.camera import LEAST_VISIBLE
from brink.sim.driving.interface import LATENCY_S
from brink.sim.urban.options import MAX_LATENCY_S


def latency_setting() -> Any:
    """Return the field ``latency_s`` of a problem's parameters, annotated ``float``."""
    return setting(
        LATENCY_S,
        ge=0.0,
        le=MAX_LATENCY_S,
        unit="s",
        help="Time from an image to the arrival of what was detected in it.",
    )


def pitch_setting() -> Any:
    """Return the field ``pitch`` of a problem's parameters, annotated ``bool``."""
    return setting(True, help="Whether the camera pitches with the car's body.")


def least_visible_setting() -> Any:
    """Return the field ``least_visible`` of a problem's parameters, annotated ``float``."""
    return setting(
        LEAST_VISIBLE,
        ge=0.0,
        le=1.0,
        help="Road users of which a smaller share is visible are hidden from the camera.",
    )
