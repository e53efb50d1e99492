"""Time of day and weather as OpenSCENARIO's environment.

The sun, the clouds and the haze are those of Brink's rendered images. Rain, brightness and wetness have no measure in
Brink: typical values stand for each word.
"""

import math
from collections.abc import Mapping
from typing import Final

from scenariogeneration import xosc

from brink.scenarios.opendrive import DRY_FRICTION
from brink.sim.rendering.light import make_lighting
from brink.sim.rendering.scene import Light
from brink.sim.world.scenario import TimeOfDay, Weather
from brink.sim.world.weather import conditions

FRICTION_PARAMETER: Final = "friction_scale"
"""Parameter of the scenario that scales the friction of the road."""
VISUAL_RANGE: Final = 3.0
"""Visual range in lengths at which 1/e of an object's own colour is left: there, 5% is left."""
NIGHT_SUN_RAD: Final = -0.5

_HOURS: Final[Mapping[TimeOfDay, tuple[int, int]]] = {
    TimeOfDay.NOON: (12, 0),
    TimeOfDay.SUNSET: (20, 30),
    TimeOfDay.NIGHT: (23, 30),
}
_SUN_LX: Final[Mapping[TimeOfDay, tuple[float, float]]] = {
    TimeOfDay.NOON: (100_000.0, 15_000.0),
    TimeOfDay.SUNSET: (10_000.0, 1_500.0),
    TimeOfDay.NIGHT: (0.0, 0.0),
}
"""Illuminance with a sunny and with an overcast sky."""
_RAIN_MMPH: Final[Mapping[Weather, float]] = {
    Weather.SOFT_RAIN: 2.0,
    Weather.MEDIUM_RAIN: 6.0,
    Weather.HARD_RAIN: 25.0,
}
_OKTAS: Final = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight")


def friction_scale(time_of_day: TimeOfDay, weather: Weather) -> float:
    """Return the friction of the road relative to a dry road."""
    return round(conditions(time_of_day, weather).friction / DRY_FRICTION, 6)


def environment(time_of_day: TimeOfDay, weather: Weather, seed: int) -> xosc.Environment:
    """Return the environment of a drive.

    Args:
        time_of_day: Time of day.
        weather: Weather.
        seed: The episode's seed, which selects the direction to the sun.
    """
    lighting = make_lighting(Light(time_of_day=time_of_day, weather=weather), seed)
    east, north, up = lighting.sun.tolist()
    night = time_of_day is TimeOfDay.NIGHT
    sunny = lighting.cloud_cover < 0.5
    sun = xosc.Sun(
        _SUN_LX[time_of_day][0 if sunny else 1],
        round(math.atan2(east, north) % (2.0 * math.pi), 6),
        NIGHT_SUN_RAD if night else round(math.asin(up), 6),
    )
    hour, minute = _HOURS[time_of_day]
    rain_mmph = _RAIN_MMPH.get(weather, 0.0)
    wetness = xosc.Wetness.dry if not lighting.wet else xosc.Wetness.moist
    if rain_mmph > _RAIN_MMPH[Weather.SOFT_RAIN]:
        wetness = xosc.Wetness.wetWithPuddles
    return xosc.Environment(
        f"{time_of_day.value} {weather.value}",
        # An arbitrary day near the longest: the sun is where the image shows it, not where a date puts it.
        xosc.TimeOfDay(False, 2024, 6, 21, hour, minute, 0),
        xosc.Weather(
            getattr(xosc.FractionalCloudCover, f"{_OKTAS[round(8.0 * lighting.cloud_cover)]}Oktas"),
            sun=sun,
            fog=xosc.Fog(round(VISUAL_RANGE * lighting.haze_m, 1)),
            precipitation=xosc.Precipitation(
                xosc.PrecipitationType.rain if rain_mmph else xosc.PrecipitationType.dry, rain_mmph
            ),
        ),
        xosc.RoadCondition(f"${FRICTION_PARAMETER}", wetness=wetness),
    )
