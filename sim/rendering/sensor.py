"""The camera's sensor: darker corners, grain, and a tone curve.

Grain is added before the tone curve, which is steep where the image is dark, so shadows are grainier than highlights
as in a camera. It is slight (a standard deviation of about 1.5 by day and 2.5 at night, of 255), because noise,
contrast and brightness are also perturbations that a search varies.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Picture, PictureCamera

_GRAIN_STREAM: Final = 78
_GRAIN_DAY: Final = 1.5
_GRAIN_DUSK: Final = 1.8
_GRAIN_NIGHT: Final = 2.2
_COLOURED: Final = 0.45
"""Strength of the grain that differs between the channels, relative to the grain that they share."""
_CORNER: Final = 0.84
"""Brightness in the corners, relative to the middle."""
_MARGIN_PX: Final = 96
_TURNS_PER_S: Final = 30.0


class Sensor:
    """Turns a finished image into the camera's picture; the time moves the grain.

    Args:
        lighting: The light.
        camera: The camera.
        seed: Seed of the grain.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        self._gain = _vignette(camera.width_px, camera.height_px)
        strength = _GRAIN_DAY if lighting.sun_strength > 0.3 else _GRAIN_DUSK
        if lighting.night:
            strength = _GRAIN_NIGHT
        rng = np.random.default_rng((seed, _GRAIN_STREAM))
        self._lighter, self._darker = _grain(rng, camera.width_px, camera.height_px, strength)

    def apply(self, image: Picture, time_s: float) -> None:
        """Apply vignetting, grain and the tone curve to an image in place."""
        turn = round(time_s * _TURNS_PER_S)
        top, left = (turn * 131) % (_MARGIN_PX + 1), (turn * 57 + turn // 97) % (_MARGIN_PX + 1)
        part = slice(top, top + image.shape[0]), slice(left, left + image.shape[1])
        cv2.multiply(image, self._gain, dst=image, scale=1 / 255)
        cv2.add(image, self._lighter[part], dst=image)
        cv2.subtract(image, self._darker[part], dst=image)
        cv2.LUT(image, _TONES, dst=image)


def _tone_curve() -> Picture:
    """Return the picture's value for each value of the sensor: lifted shadows and a soft shoulder."""
    level = np.arange(256) / 255
    lifted = 0.018 + 0.982 * level
    curved = lifted + 0.10 * np.sin(np.pi * lifted) * (1 - lifted)
    return np.clip(np.rint(255 * curved), 0, 255).astype(np.uint8)


_TONES: Final = _tone_curve()


@lru_cache(maxsize=4)
def _vignette(width_px: int, height_px: int) -> Picture:
    x = (np.arange(width_px) + 0.5) / width_px * 2 - 1
    y = ((np.arange(height_px) + 0.5) / height_px * 2 - 1) * height_px / width_px
    reach = (x[None, :] ** 2 + y[:, None] ** 2) / (1 + (height_px / width_px) ** 2)
    gain = 255 * (1 - (1 - _CORNER) * reach**1.3)
    return np.repeat(np.rint(gain).astype(np.uint8)[..., None], 3, axis=2)


def _grain(
    rng: np.random.Generator, width_px: int, height_px: int, strength: float
) -> tuple[Picture, Picture]:
    """Return what the grain adds and what it takes away, each larger than the image by a margin."""
    shape = (height_px + _MARGIN_PX, width_px + _MARGIN_PX)
    coloured = rng.standard_normal((*shape, 3), dtype=np.float32) * np.float32(_COLOURED)
    coloured += rng.standard_normal(shape, dtype=np.float32)[..., None]
    # Neighbouring pixels share some of the noise, because a sensor interpolates colours between them.
    smooth = cv2.GaussianBlur(coloured, (3, 3), 0.45)
    noise = np.rint(smooth * np.float32(strength / float(smooth.std())))
    return np.maximum(noise, 0).astype(np.uint8), np.maximum(-noise, 0).astype(np.uint8)
