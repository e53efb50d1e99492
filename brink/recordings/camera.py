"""The camera of a recording: pixels to rays, and rays to the driving system's image."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.errors import SimulatorError

_FIELDS: Final = ("width", "height", "fx", "fy", "cx", "cy", "above_m", "pitch_deg")


class CameraError(SimulatorError):
    """An invalid camera; the message says what was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A pinhole camera without distortion that looks along the road.

    Attributes:
        width_px: Width of the images.
        height_px: Height of the images.
        fx_px: Focal length across.
        fy_px: Focal length down.
        cx_px: Column of the optical axis.
        cy_px: Row of the optical axis.
        above_m: Height above the ground.
        pitch_deg: How far the optical axis points below the horizon.
    """

    width_px: float
    height_px: float
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    above_m: float
    pitch_deg: float = 0.0

    def __post_init__(self) -> None:
        sizes = (self.width_px, self.height_px, self.fx_px, self.fy_px, self.above_m)
        if not all(math.isfinite(size) and size > 0.0 for size in sizes):
            raise CameraError(
                f"camera: expected positive sizes, focal lengths and height, got {self.width_px:g} x "
                f"{self.height_px:g} px, {self.fx_px:g} and {self.fy_px:g} px, {self.above_m:g} m"
            )
        if not (0.0 <= self.cx_px <= self.width_px and 0.0 <= self.cy_px <= self.height_px):
            raise CameraError(
                f"camera: expected the optical axis within the image of {self.width_px:g} x {self.height_px:g} px, "
                f"got {self.cx_px:g}, {self.cy_px:g}"
            )
        if not abs(self.pitch_deg) < 45.0:
            raise CameraError(f"camera: expected a pitch between -45 and 45 degrees, got {self.pitch_deg:g}")

    @classmethod
    def level(cls, width_px: float, height_px: float, fov_deg: float, above_m: float) -> Self:
        """Return a level camera with its optical axis in the middle of the image.

        Args:
            width_px: Width of the images.
            height_px: Height of the images.
            fov_deg: Horizontal field of view.
            above_m: Height above the ground.

        Raises:
            CameraError: A size is not positive, or the angle not between 0 and 180 degrees.
        """
        if not 0.0 < fov_deg < 180.0:
            raise CameraError(f"camera: expected a field of view below 180 degrees, got {fov_deg:g}")
        focal_px = 0.5 * width_px / math.tan(math.radians(fov_deg) / 2.0)
        return cls(
            width_px=width_px,
            height_px=height_px,
            fx_px=focal_px,
            fy_px=focal_px,
            cx_px=0.5 * width_px,
            cy_px=0.5 * height_px,
            above_m=above_m,
        )

    @classmethod
    def own(cls) -> Self:
        """Return the driving system's own camera."""
        camera = Camera()
        return cls.level(camera.width_px, camera.height_px, camera.fov_deg, camera.height_m)

    @classmethod
    def from_document(cls, where: str, document: Any) -> Self:
        """Parse a camera of a calibration file.

        Args:
            where: Where it stands, for messages.
            document: The numbers ``width``, ``height``, ``fx``, ``cx``, ``cy`` in px and ``above_m``, optionally
                ``fy`` (default: ``fx``) and ``pitch_deg``.

        Raises:
            CameraError: A number is missing, unknown, or out of range.
        """
        if not isinstance(document, Mapping):
            raise CameraError(f"{where}: expected a camera with {', '.join(_FIELDS)}; got {document!r:.80}")
        given = {"fy": document.get("fx"), "pitch_deg": 0.0, **document}
        unknown = [f"unknown: {name!r:.40}" for name in given if name not in _FIELDS]
        wrong = [f"{name}: {given.get(name)!r:.40}" for name in _FIELDS if not is_number(given.get(name))]
        if unknown or wrong:
            raise CameraError(
                f"{where}: expected the numbers {', '.join(_FIELDS)} (fy and pitch_deg are optional); "
                + "; ".join(unknown + wrong)
            )
        width, height, fx, fy, cx, cy, above, pitch = (float(given[name]) for name in _FIELDS)
        return cls(
            width_px=width,
            height_px=height,
            fx_px=fx,
            fy_px=fy,
            cx_px=cx,
            cy_px=cy,
            above_m=above,
            pitch_deg=pitch,
        )

    def box(self, label: ObstacleLabel, sides: Sequence[float], camera: Camera) -> Box:
        """Return a box in the driving system's image: the same rays and the same ground.

        Args:
            label: Its label.
            sides: x_min, x_max, y_min, y_max in this camera's pixels.
            camera: The driving system's camera.
        """
        x_min, x_max, y_min, y_max = sides
        # Below the horizon, a camera at another height sees the same ground in another row.
        down = camera.focal_px * camera.height_m / self.above_m
        top, _ = self._slopes(y_min)
        bottom, depth = self._slopes(y_max)
        across = camera.focal_px / (self.fx_px * depth)
        return Box(
            label=label,
            x_min_px=camera.centre_x_px + (x_min - self.cx_px) * across,
            x_max_px=camera.centre_x_px + (x_max - self.cx_px) * across,
            y_min_px=camera.horizon_px + top * down,
            y_max_px=camera.horizon_px + bottom * down,
        )

    def _slopes(self, y_px: float) -> tuple[float, float]:
        """Return the vertical slope of a pixel's ray, and the distance ahead for each metre along the axis."""
        pitch_rad = math.radians(self.pitch_deg)
        down = (y_px - self.cy_px) / self.fy_px
        ahead = max(math.cos(pitch_rad) - down * math.sin(pitch_rad), 1e-6)
        return (down * math.cos(pitch_rad) + math.sin(pitch_rad)) / ahead, ahead


def is_number(value: object) -> bool:
    """Return whether a value of a document is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond those of floating point
        return False
