"""Owns what is between the camera and the street: streaks of rain, and the grain of a picture taken in the dark."""

from typing import Final

import cv2
import numpy as np

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Picture, PictureCamera

_SHEETS: Final = 3
_AIR_STREAM: Final = 77
_TURNS_PER_S: Final = 30.0


class Air:
    """Lays rain and grain over a finished picture; which of a few sheets, and how shifted, comes from the time.

    Args:
        lighting: The light.
        camera: Whose picture.
        seed: Of streaks and grain.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        rng = np.random.default_rng((seed, _AIR_STREAM))
        shape = (camera.height_px, camera.width_px)
        self._rain = [_streaks(rng, lighting, shape) for _ in range(_SHEETS if lighting.rain_share else 0)]
        self._grain = [_grain(rng, shape) for _ in range(_SHEETS if lighting.night else 0)]

    def lay(self, image: Picture, time_s: float) -> None:
        """Change the picture in place."""
        turn = round(time_s * _TURNS_PER_S)
        for sheets, operation in ((self._rain, cv2.add), (self._grain, cv2.subtract)):
            if not sheets:
                continue
            sheet = sheets[turn % len(sheets)]
            height = image.shape[0]
            down = (turn * 131) % height
            operation(image[down:], sheet[: height - down], dst=image[down:])
            if down:
                operation(image[:down], sheet[height - down :], dst=image[:down])


def _streaks(rng: np.random.Generator, lighting: Lighting, shape: tuple[int, int]) -> Picture:
    """Return slanting streaks: near ones long and pale, far ones short and fine, shape ``(height, width, 3)``."""
    height, width = shape
    sheet = np.zeros(shape, np.uint8)
    bright = 0.35 if lighting.night else 1.0
    slant = float(rng.uniform(-0.16, 0.16))
    for count, length, value, thick in ((520, 0.035, 30, 1), (260, 0.07, 40, 1), (46, 0.14, 26, 2)):
        layer = np.zeros(shape, np.uint8)
        for _ in range(round(count * lighting.rain_share)):
            x, y = float(rng.uniform(-0.1, 1.1)) * width, float(rng.uniform(-0.1, 1.0)) * height
            reach = length * height * float(rng.uniform(0.6, 1.3))
            ends = ((round(x), round(y)), (round(x + slant * reach), round(y + reach)))
            across = max(round(thick * height / 720), 1)
            cv2.line(layer, *ends, value * bright * float(rng.uniform(0.5, 1.0)), across, cv2.LINE_AA)
        sheet = np.maximum(sheet, layer)
    return cv2.cvtColor(sheet, cv2.COLOR_GRAY2RGB).astype(np.uint8, copy=False)


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Picture:
    noise = np.abs(rng.normal(0.0, 2.6, (*shape, 3)))
    return np.clip(noise, 0, 12).astype(np.uint8)
