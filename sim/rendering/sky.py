"""The sky panorama behind the street, and the rain in front of it."""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Picture, PictureCamera
from brink.sim.rendering.textures import Noise, smooth_noise
from brink.sim.rendering.view import PITCHES_KEPT, View

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
        rays = self._rays.get(view.pitch_rad)
        if rays is None:
            if len(self._rays) == PITCHES_KEPT:
                del self._rays[next(iter(self._rays))]
            rays = self._rays[view.pitch_rad] = self._rays_at(view)
        if rays.lines_px == 0:
            return
        turn = (-view.yaw_rad / (2 * math.pi) * _WIDTH_PX) % _WIDTH_PX
        columns = rays.columns + np.float32(turn + _WIDTH_PX // 2)
        small = cv2.remap(
            self.panorama, columns, rays.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        target = image[: rays.lines_px]
        cv2.resize(small, (image.shape[1], rays.lines_px), dst=target, interpolation=cv2.INTER_LINEAR)

    def _rays_at(self, view: View) -> _Rays:
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
    # Sky and clouds are smooth, so half the resolution is enough for them.
    elevation = (_HIGH - (np.arange(_ROWS // 2) + 0.5) / (_ROWS // 2) * (_HIGH - _LOW)).astype(np.float32)
    azimuth = (-(np.arange(_WIDTH_PX // 2) + 0.5) / (_WIDTH_PX // 2) * 2 * math.pi).astype(np.float32)
    high = np.clip(np.sin(np.maximum(elevation, 0.0)), 0, 1) ** 0.55
    low_rgb, top_rgb = np.array(lighting.sky_low_rgb), np.array(lighting.sky_top_rgb)
    column = (1 - high)[:, None] * low_rgb + high[:, None] * top_rgb
    if lighting.night:
        column += np.exp(-np.maximum(elevation, 0.0) / 0.16)[:, None] * np.array(
            (16.0, 11.0, 6.0), np.float32
        )
    sky = np.repeat(column.astype(np.float32)[:, None, :], len(azimuth), axis=1)
    _add_sun_glow(sky, lighting, elevation, azimuth)
    _add_clouds(rng, sky, lighting, elevation, azimuth)
    turn = cv2.resize(
        np.clip(sky, 0, 255).astype(np.uint8), (_WIDTH_PX, _ROWS), interpolation=cv2.INTER_LINEAR
    ).astype(np.uint8, copy=False)
    _add_town(rng, lighting, turn)
    half = _WIDTH_PX // 2
    return np.concatenate((turn[:, half:], turn, turn[:, :half]), axis=1)


def _add_sun_glow(sky: Noise, lighting: Lighting, elevation: Noise, azimuth: Noise) -> None:
    if lighting.sun_strength < 0.3:
        return
    sun_elevation = math.asin(float(lighting.sun[2]))
    sun_azimuth = math.atan2(float(lighting.sun[1]), float(lighting.sun[0]))
    cosine = np.sin(elevation)[:, None] * math.sin(sun_elevation) + np.cos(elevation)[:, None] * math.cos(
        sun_elevation
    ) * np.cos(azimuth - sun_azimuth)
    apart = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    glow = 90 * np.exp(-apart / 7.0) + 46 * np.exp(-apart / 28.0) + 300 * (apart < 1.3)
    warm = (1.0, 0.86, 0.62) if sun_elevation < 0.4 else (1.0, 0.98, 0.9)
    sky += glow.astype(np.float32)[..., None] * np.array(warm, np.float32)


_CLOUD_PX: Final = 512
_CLOUD_PX_PER_HEIGHT: Final = 46.0
"""Scale of the clouds: pixels of their texture in one height of the clouds above the ground."""


def _add_clouds(
    rng: np.random.Generator, sky: Noise, lighting: Lighting, elevation: Noise, azimuth: Noise
) -> None:
    """Lay clouds over the sky: a flat layer seen in perspective, brighter on the side of the sun."""
    field = smooth_noise(rng, (_CLOUD_PX, _CLOUD_PX), (7, 7), 6)
    shift_x, shift_y = rng.uniform(0, _CLOUD_PX, 2).tolist()
    # The layer curves down to the horizon, so that distant clouds stay apart from each other.
    reach = np.cos(elevation) / np.maximum(np.sin(np.maximum(elevation, 0.0)) + 0.10, 0.02)
    spread = (reach * _CLOUD_PX_PER_HEIGHT).astype(np.float32)[:, None]
    across, along = np.cos(azimuth)[None, :], np.sin(azimuth)[None, :]
    seen = cv2.remap(
        field,
        (spread * across + shift_x).astype(np.float32),
        (spread * along + shift_y).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
    lift = np.clip(elevation / 0.5, 0, 1)[:, None]
    cut = 1.9 - 3.4 * lighting.cloud_cover
    cover = np.clip((seen - cut) / 0.9, 0, 1) * np.clip(np.degrees(elevation) / 5.0, 0, 1)[:, None]
    cover *= 0.55 if lighting.night else 0.94
    dense = np.clip(seen - cut - 0.4, 0, 2.2)
    shade = np.clip(1.04 - 0.13 * dense - 0.05 * (1 - lift) + 0.03 * seen, 0.62, 1.08)
    cloud = shade[..., None] * np.array(lighting.cloud_rgb, np.float32)
    cloud -= sky
    cloud *= cover[..., None].astype(np.float32)
    sky += cloud


def _add_town(rng: np.random.Generator, lighting: Lighting, turn: Picture) -> None:
    """Add distant trees and roofs along the horizon, half hidden in haze."""
    trees = 1.7 + 0.55 * smooth_noise(rng, (1, _WIDTH_PX), (1, 60), 4)[0]
    roofs = np.zeros(_WIDTH_PX, np.float32)
    for _ in range(90):
        start, wide = int(rng.integers(0, _WIDTH_PX)), int(rng.integers(12, 46))
        top = float(rng.uniform(1.6, 4.6))
        roofs[start : start + wide] = np.maximum(roofs[start : start + wide], top)
    first = int((_HIGH - math.radians(6.0)) / (_HIGH - _LOW) * _ROWS)
    rows = _HIGH - (np.arange(first, _ROWS) + 0.5) / _ROWS * (_HIGH - _LOW)
    degrees = np.degrees(rows).astype(np.float32)[:, None]
    light = lighting.ambient_strength + 0.5 * lighting.sun_strength
    haze = np.array(lighting.haze_rgb)
    far = float(lighting.haze(np.array(260.0)))
    low = turn[first:].astype(np.float32)
    for skyline, rgb in ((roofs, (126, 118, 112)), (trees, (72, 88, 62))):
        cover = np.clip((skyline[None, :] - degrees) / 0.25 + 0.5, 0, 1)[..., None]
        colour = (np.array(rgb) * lighting.tint * light * (1 - far) + haze * far).astype(np.float32)
        low += (colour - low) * cover
    if lighting.night:
        lit = rng.random(low.shape[:2]) < 0.02
        lit &= (degrees < roofs[None, :] - 0.3) & (degrees > 0.4)
        low[lit] += np.array((110.0, 92.0, 56.0), np.float32) * (1 - far)
    turn[first:] = np.clip(low, 0, 255)


_SHEETS: Final = 3
_AIR_STREAM: Final = 77
_TURNS_PER_S: Final = 30.0


class Rain:
    """Adds rain streaks to a finished image; the time selects a layer and its offset.

    Args:
        lighting: The light.
        camera: The camera.
        seed: Seed of the streaks.
    """

    def __init__(self, lighting: Lighting, camera: PictureCamera, seed: int) -> None:
        rng = np.random.default_rng((seed, _AIR_STREAM))
        shape = (camera.height_px, camera.width_px)
        self._sheets = [
            _streaks(rng, lighting, shape) for _ in range(_SHEETS if lighting.rain_intensity else 0)
        ]

    def apply(self, image: Picture, time_s: float) -> None:
        """Add rain streaks to an image in place."""
        if not self._sheets:
            return
        turn = round(time_s * _TURNS_PER_S)
        sheet = self._sheets[turn % len(self._sheets)]
        height = image.shape[0]
        down = (turn * 131) % height
        cv2.add(image[down:], sheet[: height - down], dst=image[down:])
        if down:
            cv2.add(image[:down], sheet[height - down :], dst=image[:down])


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
