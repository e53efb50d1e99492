"""Owns the numbers of the light: what a time of day and a weather mean for sun, sky, haze, road and lamps."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.sim.rendering.scene import FloatArray, Light
from brink.sim.world.scenario import TimeOfDay, Weather

_SUN_STREAM: Final = 71


@dataclass(frozen=True, slots=True, kw_only=True)
class Lighting:
    """The light of a picture. Colours are RGB in 0 to 255, strengths shares of full daylight.

    Attributes:
        sun: Unit vector to the sun, shape ``(3,)``.
        sun_share: Strength of direct sunlight on a face that looks at the sun.
        ambient_share: Strength of the light from everywhere.
        tint: What the light does to red, green and blue, shape ``(3,)``.
        haze_rgb: Colour in which far things vanish.
        haze_m: Distance at which all but 1/e is haze.
        sky_top_rgb: High in the sky.
        sky_low_rgb: Above the horizon.
        cloud_share: How much of the sky is cloud.
        cloud_rgb: Bright side of the clouds.
        shadow_share: How much light a cast shadow takes.
        wet: Whether the ground mirrors.
        rain_share: Streaks in the air, 0 to 1.
        night: Whether lamps, headlights and windows light the street.
        lights_on: Whether vehicles drive with their lights on.
    """

    sun: FloatArray
    sun_share: float
    ambient_share: float
    tint: FloatArray
    haze_rgb: tuple[float, float, float]
    haze_m: float
    sky_top_rgb: tuple[float, float, float]
    sky_low_rgb: tuple[float, float, float]
    cloud_share: float
    cloud_rgb: tuple[float, float, float]
    shadow_share: float
    wet: bool
    rain_share: float
    night: bool
    lights_on: bool

    def haze(self, distance_m: FloatArray) -> FloatArray:
        """Return how much of what is seen at a distance is haze, in [0, 1)."""
        return 1.0 - np.exp(-np.asarray(distance_m, dtype=np.float64) / self.haze_m)


_HAZE_M: Final = {
    Weather.CLEAR: 520.0,
    Weather.CLOUDY: 380.0,
    Weather.WET: 380.0,
    Weather.WET_CLOUDY: 300.0,
    Weather.SOFT_RAIN: 190.0,
    Weather.MEDIUM_RAIN: 120.0,
    Weather.HARD_RAIN: 65.0,
}
_RAIN: Final = {Weather.SOFT_RAIN: 0.35, Weather.MEDIUM_RAIN: 0.65, Weather.HARD_RAIN: 1.0}
_CLOUDS: Final = {Weather.CLEAR: 0.30, Weather.WET: 0.45}
_DIMMER: Final = {Weather.HARD_RAIN: 0.72, Weather.MEDIUM_RAIN: 0.82, Weather.SOFT_RAIN: 0.9}


def lighting_of(light: Light, seed: int) -> Lighting:
    """Return the numbers of a light; the seed turns the sun around the sky."""
    rng = np.random.default_rng((seed, _SUN_STREAM))
    azimuth = float(rng.uniform(-math.pi, math.pi))
    sunny = light.weather in _CLOUDS
    low = light.time_of_day is TimeOfDay.SUNSET
    elevation = math.radians(11.0 if low else 52.0)
    sun = np.array(
        [
            math.cos(azimuth) * math.cos(elevation),
            math.sin(azimuth) * math.cos(elevation),
            math.sin(elevation),
        ]
    )
    sun_share, ambient, tint, haze, top, low_rgb, cloud = _colours(light.time_of_day, sunny)
    dim = _DIMMER.get(light.weather, 1.0)
    night = light.time_of_day is TimeOfDay.NIGHT
    rain = _RAIN.get(light.weather, 0.0)
    return Lighting(
        sun=sun,
        sun_share=sun_share * dim,
        ambient_share=ambient * dim,
        tint=np.array(tint),
        haze_rgb=_scaled(haze, dim),
        haze_m=_HAZE_M[light.weather] * (0.8 if night else 1.0),
        sky_top_rgb=_scaled(top, dim),
        sky_low_rgb=_scaled(low_rgb, dim),
        cloud_share=_CLOUDS.get(light.weather, 0.95),
        cloud_rgb=_scaled(cloud, dim),
        shadow_share=0.0 if night else ((0.36 if low else 0.46) if sunny else 0.08),
        wet=light.weather not in (Weather.CLEAR, Weather.CLOUDY),
        rain_share=rain,
        night=night,
        lights_on=night or rain > 0.5 or (low and not sunny),
    )


_Rgb = tuple[float, float, float]


def _colours(time: TimeOfDay, sunny: bool) -> tuple[float, float, _Rgb, _Rgb, _Rgb, _Rgb, _Rgb]:
    """Return sun, ambient, tint, haze, top of the sky, foot of the sky, cloud."""
    if time is TimeOfDay.NIGHT:
        return 0.0, 0.13, (0.86, 0.92, 1.12), (20, 23, 32), (7, 9, 19), (30, 31, 40), (26, 27, 35)
    if time is TimeOfDay.SUNSET:
        if sunny:
            return (
                0.60,
                0.48,
                (1.16, 0.93, 0.76),
                (216, 160, 118),
                (92, 112, 158),
                (248, 178, 110),
                (250, 190, 150),
            )
        return (
            0.10,
            0.58,
            (1.06, 0.96, 0.90),
            (158, 140, 130),
            (112, 112, 124),
            (184, 154, 136),
            (160, 142, 136),
        )
    if sunny:
        return (
            0.60,
            0.52,
            (1.04, 1.00, 0.94),
            (196, 208, 220),
            (70, 122, 196),
            (182, 206, 228),
            (246, 247, 250),
        )
    return 0.14, 0.72, (0.97, 0.99, 1.02), (184, 190, 196), (148, 156, 166), (200, 205, 210), (206, 209, 213)


def _scaled(rgb: _Rgb, share: float) -> _Rgb:
    return rgb[0] * share, rgb[1] * share, rgb[2] * share
