"""Effects of time of day and weather on friction, on perception, and on the behaviour of other road users.

Friction follows common figures for asphalt; the rest are modelling choices, collected here.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from brink.sim.world.scenario import TimeOfDay, Weather


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Driving conditions that result from time of day and weather.

    Attributes:
        friction: Tyre-road friction coefficient.
        position_noise_m: Standard deviation of lane-position errors.
        position_bias_m: Standard deviation of the position error that is constant during an episode.
        light_range_m: Range of the light detector.
        light_miss_share: Share of readings in which it detects nothing.
        light_confusion_share: Share of readings with the wrong colour.
        speed_share: Desired speed of other drivers, as a share of the limit.
        headway_s: Time gap that other drivers keep.
        braking_mps2: Their hardest braking outside emergencies.
        walking_mps: Walking speed of pedestrians.
        patience_s: How long pedestrians wait at the kerb.
    """

    friction: float
    position_noise_m: float
    position_bias_m: float
    light_range_m: float
    light_miss_share: float
    light_confusion_share: float
    speed_share: float
    headway_s: float
    braking_mps2: float
    walking_mps: float
    patience_s: float


@dataclass(frozen=True, slots=True)
class _Sky:
    friction: float
    rain: float
    wet: float
    overcast: float


_SKIES: Mapping[Weather, _Sky] = {
    Weather.CLEAR: _Sky(friction=0.9, rain=0.0, wet=0.0, overcast=0.0),
    Weather.CLOUDY: _Sky(friction=0.9, rain=0.0, wet=0.0, overcast=1.0),
    Weather.WET: _Sky(friction=0.6, rain=0.0, wet=1.0, overcast=0.0),
    Weather.WET_CLOUDY: _Sky(friction=0.6, rain=0.0, wet=1.0, overcast=1.0),
    Weather.SOFT_RAIN: _Sky(friction=0.55, rain=0.3, wet=1.0, overcast=1.0),
    Weather.MEDIUM_RAIN: _Sky(friction=0.5, rain=0.6, wet=1.0, overcast=1.0),
    Weather.HARD_RAIN: _Sky(friction=0.4, rain=1.0, wet=1.0, overcast=1.0),
}
_DARKNESS: Mapping[TimeOfDay, float] = {TimeOfDay.NOON: 0.0, TimeOfDay.SUNSET: 0.35, TimeOfDay.NIGHT: 0.9}


def conditions(time_of_day: TimeOfDay, weather: Weather) -> Conditions:
    """Return the driving conditions for a given time of day and weather.

    A low sun dazzles only in a clear sky, and most on a wet road; clouds remove glare and make it darker.
    """
    sky = _SKIES[weather]
    dark = _DARKNESS[time_of_day] + 0.1 * sky.overcast
    glare = (1.0 - sky.overcast) * (1.0 + 0.5 * sky.wet) if time_of_day is TimeOfDay.SUNSET else 0.0
    murk = sky.rain + 0.5 * dark + 0.5 * glare
    return Conditions(
        friction=sky.friction,
        position_noise_m=0.02 + 0.03 * murk + 0.01 * sky.wet,
        position_bias_m=0.02 + 0.04 * murk,
        light_range_m=max(70.0 - 18.0 * sky.rain - 8.0 * dark - 14.0 * glare, 20.0),
        light_miss_share=0.02 + 0.08 * sky.rain + 0.04 * dark + 0.12 * glare,
        light_confusion_share=0.002 + 0.006 * sky.rain + 0.012 * glare,
        speed_share=1.06 - 0.14 * sky.rain - 0.03 * sky.wet - 0.08 * dark - 0.08 * glare,
        headway_s=1.2 + 0.4 * sky.rain + 0.2 * dark,
        braking_mps2=2.8 - 0.8 * sky.rain - 0.3 * sky.wet,
        walking_mps=1.25 + 0.35 * sky.rain + 0.1 * sky.wet,
        patience_s=2.0 - 1.0 * sky.rain,
    )


def rain_wet_dark(time_of_day: TimeOfDay, weather: Weather) -> tuple[float, float, float]:
    """Return how hard it rains, how wet the road is and how dark it is, as fractions that any observer could tell."""
    sky = _SKIES[weather]
    return sky.rain, sky.wet, min(_DARKNESS[time_of_day] + 0.1 * sky.overcast, 1.0)
