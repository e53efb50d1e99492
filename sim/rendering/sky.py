"""Owns what lies behind everything, as one panorama: sky, sun, clouds, and the far edge of the town."""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import FloatArray, Picture, PictureCamera
from brink.sim.rendering.textures import smooth_noise
from brink.sim.rendering.view import View

_WIDTH_PX: Final = 2048
_LOW: Final = math.radians(-3.0)
_HIGH: Final = math.radians(80.0)
_ROWS: Final = 472
_SKY_STREAM: Final = 74


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Where in the panorama the pixels of a small picture of the sky lie, for one pitch."""

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    lines_px: int


class Sky:
    """Paints the part of the picture above the horizon.

    Args:
        lighting: The light.
        camera: Whose picture.
        seed: Of the clouds and of the far edge of the town.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        self._camera = camera
        self.panorama = _panorama(lighting, seed)
        self._rays: dict[float, _Rays] = {}

    def paint(self, image: Picture, view: View) -> None:
        """Paint sky from the top row to the horizon."""
        pitch = math.atan2(view.sin_pitch, view.cos_pitch)
        rays = self._rays.get(pitch)
        if rays is None:
            if len(self._rays) > 8:
                self._rays.clear()
            rays = self._rays[pitch] = self._rays_at(view, pitch)
        if rays.lines_px == 0:
            return
        turn = (-view.yaw_rad / (2 * math.pi) * _WIDTH_PX) % _WIDTH_PX
        columns = rays.columns + np.float32(turn + _WIDTH_PX // 2)
        small = cv2.remap(
            self.panorama, columns, rays.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        target = image[: rays.lines_px]
        cv2.resize(small, (image.shape[1], rays.lines_px), dst=target, interpolation=cv2.INTER_LINEAR)

    def _rays_at(self, view: View, pitch: float) -> _Rays:
        lines = min(max(math.ceil(view.horizon_px) + 1, 0), view.height_px)
        wide, high = math.ceil(view.width_px / 2), max(math.ceil(lines / 2), 1)
        x = (np.arange(wide) + 0.5) * view.width_px / wide - view.width_px / 2
        y = view.height_px / 2 - (np.arange(high) + 0.5) * lines / high
        left, up = np.meshgrid(-x / view.focal_px, y / view.focal_px)
        ahead = view.cos_pitch - up * view.sin_pitch
        rise = view.sin_pitch + up * view.cos_pitch
        azimuth = np.arctan2(left, ahead)
        elevation = np.arctan2(rise, np.hypot(ahead, left))
        columns = -azimuth / (2 * math.pi) * _WIDTH_PX
        rows = np.clip((_HIGH - elevation) / (_HIGH - _LOW) * _ROWS, 0, _ROWS - 1)
        return _Rays(columns.astype(np.float32), rows.astype(np.float32), lines)


def _panorama(lighting: Lighting, seed: int) -> Picture:
    """Return two turns, shape ``(rows, columns, 3)``: clockwise, yaw 0 a quarter of the way along."""
    rng = np.random.default_rng((seed, _SKY_STREAM))
    elevation = _HIGH - (np.arange(_ROWS) + 0.5) / _ROWS * (_HIGH - _LOW)
    azimuth = -(np.arange(_WIDTH_PX) + 0.5) / _WIDTH_PX * 2 * math.pi
    high = np.clip(np.sin(np.maximum(elevation, 0.0)), 0, 1) ** 0.55
    sky = (1 - high)[:, None] * np.array(lighting.sky_low_rgb) + high[:, None] * np.array(
        lighting.sky_top_rgb
    )
    sky = np.repeat(sky[:, None, :], _WIDTH_PX, axis=1)
    sky += _sun_glow(lighting, elevation, azimuth)
    sky = _clouded(rng, lighting, sky, elevation)
    sky = _with_town(rng, lighting, sky, elevation)
    turn = np.clip(sky, 0, 255).astype(np.uint8)
    half = _WIDTH_PX // 2
    return np.concatenate((turn[:, half:], turn, turn[:, :half]), axis=1)


def _sun_glow(lighting: Lighting, elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    if lighting.sun_share < 0.3:
        return np.zeros((len(elevation), len(azimuth), 3))
    sun_elevation = math.asin(float(lighting.sun[2]))
    sun_azimuth = math.atan2(float(lighting.sun[1]), float(lighting.sun[0]))
    cosine = np.sin(elevation)[:, None] * math.sin(sun_elevation) + np.cos(elevation)[:, None] * math.cos(
        sun_elevation
    ) * np.cos(azimuth - sun_azimuth)
    apart = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    glow = 90 * np.exp(-apart / 7.0) + 46 * np.exp(-apart / 28.0) + 300 * (apart < 1.3)
    warm = np.array([1.0, 0.86, 0.62]) if sun_elevation < 0.4 else np.array([1.0, 0.98, 0.9])
    glowing: FloatArray = glow[..., None] * warm
    return glowing


def _clouded(
    rng: np.random.Generator, lighting: Lighting, sky: FloatArray, elevation: FloatArray
) -> FloatArray:
    half = (_ROWS // 2, _WIDTH_PX // 2)
    field, relief = (
        cv2.resize(noise, (_WIDTH_PX, _ROWS), interpolation=cv2.INTER_LINEAR)
        for noise in (smooth_noise(rng, half, (7, 12), 5), smooth_noise(rng, half, (9, 14), 4))
    )
    cut = 1.9 - 3.4 * lighting.cloud_share
    cover = np.clip((field - cut) / 0.9, 0, 1) * np.clip(np.degrees(elevation) / 9.0, 0, 1)[:, None]
    cover *= 0.55 if lighting.night else 0.92
    shade = np.clip(0.92 + 0.07 * relief - 0.05 * np.maximum(field, 0.0), 0.55, 1.06)
    cloud = shade[..., None] * np.array(lighting.cloud_rgb)
    clouded: FloatArray = sky * (1 - cover[..., None]) + cloud * cover[..., None]
    return clouded


def _with_town(
    rng: np.random.Generator, lighting: Lighting, sky: FloatArray, elevation: FloatArray
) -> FloatArray:
    """Put far trees and roofs along the horizon, already half haze."""
    trees = 1.7 + 0.55 * smooth_noise(rng, (1, _WIDTH_PX), (1, 60), 4)[0]
    roofs = np.zeros(_WIDTH_PX)
    for _ in range(90):
        start, wide = int(rng.integers(0, _WIDTH_PX)), int(rng.integers(12, 46))
        top = float(rng.uniform(1.6, 4.6))
        roofs[start : start + wide] = np.maximum(roofs[start : start + wide], top)
    degrees = np.degrees(elevation)[:, None]
    light = lighting.ambient_share + 0.5 * lighting.sun_share
    haze = np.array(lighting.haze_rgb)
    far = float(lighting.haze(np.array(260.0)))
    for skyline, rgb in ((roofs, (126, 118, 112)), (trees, (72, 88, 62))):
        cover = np.clip((skyline[None, :] - degrees) / 0.25 + 0.5, 0, 1)[..., None]
        colour = np.array(rgb) * lighting.tint * light * (1 - far) + haze * far
        sky = sky * (1 - cover) + colour * cover
    return sky
