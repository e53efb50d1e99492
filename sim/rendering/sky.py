"""The sky panorama behind the street, and the rain and image noise in front of it."""

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
    """Panorama coordinates of the pixels of a reduced sky image, for one pitch."""

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    lines_px: int


class Sky:
    """Paints the part of the image above the horizon.

    Args:
        lighting: The light.
        camera: The camera.
        seed: Seed of clouds and skyline.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        self._camera = camera
        self.panorama = _panorama(lighting, seed)
        self._rays: dict[float, _Rays] = {}

    def paint(self, image: Picture, view: View) -> None:
        """Paint the sky from the top row to the horizon."""
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
    """Return a sky panorama of two clockwise turns, ``(rows, columns, 3)``; yaw 0 is a quarter of the way across."""
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
    if lighting.sun_strength < 0.3:
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
    cut = 1.9 - 3.4 * lighting.cloud_cover
    cover = np.clip((field - cut) / 0.9, 0, 1) * np.clip(np.degrees(elevation) / 9.0, 0, 1)[:, None]
    cover *= 0.55 if lighting.night else 0.92
    shade = np.clip(0.92 + 0.07 * relief - 0.05 * np.maximum(field, 0.0), 0.55, 1.06)
    cloud = shade[..., None] * np.array(lighting.cloud_rgb)
    clouded: FloatArray = sky * (1 - cover[..., None]) + cloud * cover[..., None]
    return clouded


def _with_town(
    rng: np.random.Generator, lighting: Lighting, sky: FloatArray, elevation: FloatArray
) -> FloatArray:
    """Add distant trees and roofs along the horizon, half hidden in haze."""
    trees = 1.7 + 0.55 * smooth_noise(rng, (1, _WIDTH_PX), (1, 60), 4)[0]
    roofs = np.zeros(_WIDTH_PX)
    for _ in range(90):
        start, wide = int(rng.integers(0, _WIDTH_PX)), int(rng.integers(12, 46))
        top = float(rng.uniform(1.6, 4.6))
        roofs[start : start + wide] = np.maximum(roofs[start : start + wide], top)
    degrees = np.degrees(elevation)[:, None]
    light = lighting.ambient_strength + 0.5 * lighting.sun_strength
    haze = np.array(lighting.haze_rgb)
    far = float(lighting.haze(np.array(260.0)))
    for skyline, rgb in ((roofs, (126, 118, 112)), (trees, (72, 88, 62))):
        cover = np.clip((skyline[None, :] - degrees) / 0.25 + 0.5, 0, 1)[..., None]
        colour = np.array(rgb) * lighting.tint * light * (1 - far) + haze * far
        sky = sky * (1 - cover) + colour * cover
    return sky


_SHEETS: Final = 3
_AIR_STREAM: Final = 77
_TURNS_PER_S: Final = 30.0


class RainAndGrain:
    """Adds rain streaks and image noise to a finished image; the time selects a layer and its offset.

    Args:
        lighting: The light.
        camera: The camera.
        seed: Seed of streaks and noise.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        rng = np.random.default_rng((seed, _AIR_STREAM))
        shape = (camera.height_px, camera.width_px)
        self._rain = [
            _streaks(rng, lighting, shape) for _ in range(_SHEETS if lighting.rain_intensity else 0)
        ]
        self._grain = [_grain(rng, shape) for _ in range(_SHEETS if lighting.night else 0)]

    def apply(self, image: Picture, time_s: float) -> None:
        """Add rain streaks and noise to an image in place."""
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
    """Return slanted streaks, long and pale nearby, short and fine far away, shape ``(height, width, 3)``."""
    height, width = shape
    sheet = np.zeros(shape, np.uint8)
    bright = 0.35 if lighting.night else 1.0
    slant = float(rng.uniform(-0.16, 0.16))
    for count, length, value, thick in ((520, 0.035, 30, 1), (260, 0.07, 40, 1), (46, 0.14, 26, 2)):
        layer = np.zeros(shape, np.uint8)
        for _ in range(round(count * lighting.rain_intensity)):
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
