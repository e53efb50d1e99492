"""Lighting: how time of day and weather affect sun, sky, haze, road and lamps, as numbers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.sim.rendering.scene import FloatArray, Light, Rgb, scaled
from brink.sim.rendering.view import View
from brink.sim.world.scenario import TimeOfDay, Weather

_SUN_STREAM: Final = 71


@dataclass(frozen=True, slots=True, kw_only=True)
class Lighting:
    """The lighting of an image. Colours are RGB in 0 to 255; strengths are shares of full daylight.

    Attributes:
        sun: Unit vector to the sun, shape ``(3,)``.
        sun_strength: Direct light on a face that is turned to the sun.
        ambient_strength: Light from all directions.
        tint: Factors for red, green and blue, shape ``(3,)``.
        haze_rgb: Colour of distant haze.
        haze_m: Distance at which 1/e of an object's own colour is left.
        sky_top_rgb: Colour high in the sky.
        sky_low_rgb: Colour above the horizon.
        cloud_cover: Share of the sky covered by clouds.
        cloud_rgb: Bright side of the clouds.
        shadow_strength: Share of the light that a cast shadow takes away.
        wet: Whether the ground is reflective.
        rain_intensity: Density of rain streaks, in [0, 1].
        night: Whether lamps, headlights and windows light the street.
        lights_on: Whether vehicles drive with their lights on.
    """

    sun: FloatArray
    sun_strength: float
    ambient_strength: float
    tint: FloatArray
    haze_rgb: tuple[float, float, float]
    haze_m: float
    sky_top_rgb: tuple[float, float, float]
    sky_low_rgb: tuple[float, float, float]
    cloud_cover: float
    cloud_rgb: tuple[float, float, float]
    shadow_strength: float
    wet: bool
    rain_intensity: float
    night: bool
    lights_on: bool

    def haze(self, distance_m: FloatArray) -> FloatArray:
        """Return the share of haze in the colour of an object at a given distance, in [0, 1)."""
        return 1.0 - np.exp(-np.asarray(distance_m, dtype=np.float64) / self.haze_m)

    def shade(self, rgb: FloatArray, at_m: FloatArray, view: View, lit: FloatArray) -> list[Rgb]:
        """Return colours as they appear under this light and through haze.

        Args:
            rgb: Surface colours, shape ``(n, 3)``.
            at_m: World positions, shape ``(n, 3)``.
            view: The camera.
            lit: Artificial light on each position, in [0, 1], shape ``(n,)``.
        """
        haze = self.haze(np.hypot(at_m[:, 0] - view.x_m, at_m[:, 1] - view.y_m))[:, None]
        share = (self.ambient_strength + 0.5 * self.sun_strength + 0.8 * lit)[:, None]
        mixed = rgb * self.tint * share * (1 - haze) + np.array(self.haze_rgb) * haze
        return [(red, green, blue) for red, green, blue in np.clip(mixed, 0, 255).tolist()]


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
_DIMMING: Final = {Weather.HARD_RAIN: 0.72, Weather.MEDIUM_RAIN: 0.82, Weather.SOFT_RAIN: 0.9}

_NIGHT = 0.0, 0.13, (0.86, 0.92, 1.12), (20, 23, 32), (7, 9, 19), (30, 31, 40), (26, 27, 35)
_COLOURS: Final[Mapping[tuple[TimeOfDay, bool], tuple[float, float, Rgb, Rgb, Rgb, Rgb, Rgb]]] = {
    (TimeOfDay.NOON, True):
        (0.60, 0.52, (1.04, 1.00, 0.94), (196, 208, 220), (70, 122, 196), (182, 206, 228), (246, 247, 250)),
    (TimeOfDay.NOON, False):
        (0.14, 0.72, (0.97, 0.99, 1.02), (184, 190, 196), (148, 156, 166), (200, 205, 210), (206, 209, 213)),
    (TimeOfDay.SUNSET, True):
        (0.60, 0.48, (1.16, 0.93, 0.76), (216, 160, 118), (92, 112, 158), (248, 178, 110), (250, 190, 150)),
    (TimeOfDay.SUNSET, False):
        (0.10, 0.58, (1.06, 0.96, 0.90), (158, 140, 130), (112, 112, 124), (184, 154, 136), (160, 142, 136)),
    (TimeOfDay.NIGHT, True): _NIGHT,
    (TimeOfDay.NIGHT, False): _NIGHT,
}  # fmt: skip
"""Sun and ambient strength, tint, colours of haze, upper sky, lower sky and clouds, by time and sunshine."""


def make_lighting(light: Light, seed: int) -> Lighting:
    """Return the lighting for a time of day and weather; the seed selects the sun's azimuth."""
    rng = np.random.default_rng((seed, _SUN_STREAM))
    azimuth = float(rng.uniform(-math.pi, math.pi))
    sunny = light.weather in _CLOUDS
    low = light.time_of_day is TimeOfDay.SUNSET
    elevation = math.radians(11.0 if low else 52.0)
    level = math.cos(elevation)
    sun = np.array([math.cos(azimuth) * level, math.sin(azimuth) * level, math.sin(elevation)])
    sun_strength, ambient, tint, haze, top, low_rgb, cloud = _COLOURS[light.time_of_day, sunny]
    dim = _DIMMING.get(light.weather, 1.0)
    night = light.time_of_day is TimeOfDay.NIGHT
    rain = _RAIN.get(light.weather, 0.0)
    return Lighting(
        sun=sun,
        sun_strength=sun_strength * dim,
        ambient_strength=ambient * dim,
        tint=np.array(tint),
        haze_rgb=scaled(haze, dim),
        haze_m=_HAZE_M[light.weather] * (0.8 if night else 1.0),
        sky_top_rgb=scaled(top, dim),
        sky_low_rgb=scaled(low_rgb, dim),
        cloud_cover=_CLOUDS.get(light.weather, 0.95),
        cloud_rgb=scaled(cloud, dim),
        shadow_strength=0.0 if night else ((0.36 if low else 0.46) if sunny else 0.08),
        wet=light.weather not in (Weather.CLEAR, Weather.CLOUDY),
        rain_intensity=rain,
        night=night,
        lights_on=night or rain > 0.5 or (low and not sunny),
    )
