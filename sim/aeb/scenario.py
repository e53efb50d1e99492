"""What an emergency-braking episode is like: when, in which weather, who steps out where.

Friction in medium and hard rain is too low to stop in time for somebody who steps out at this distance, however
well the detector sees; such weather would say nothing of the detector and is left out.

Source: Ferreira et al. 2022, the experiment's scenario.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Self, TypeVar

from brink.sim.episode import Json, JsonObject, nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.world.scenario import TimeOfDay, Weather

TIMES = tuple(TimeOfDay)
WEATHERS = (Weather.CLEAR, Weather.CLOUDY, Weather.WET, Weather.WET_CLOUDY, Weather.SOFT_RAIN)


class Occluder(StrEnum):
    """What is parked next to the gap from which the pedestrian comes."""

    CAR = "car"
    VAN = "van"


class Obstacle(StrEnum):
    """A body on the road that no detector was trained on."""

    NONE = "none"
    NOVELTY = "novelty"
    """A fallen tree: a class never seen."""
    ANOMALY = "anomaly"
    """An overturned vehicle: a known class, as never seen."""


_Word = TypeVar("_Word", bound=StrEnum)

CROSSING_M = (45.0, 65.0)
ARRIVAL_S = (-0.2, 0.2)
ONCOMING_M = (40.0, 90.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class AebScenario:
    """What the street is like.

    Attributes:
        time_of_day: Acts on the picture.
        weather: Acts on the picture and on friction.
        occluder: What hides the pedestrian.
        crossing_m: Way of the ego's front bumper to the pedestrian's line.
        arrival_s: When the pedestrian is in the middle of the lane, after an ego that does not brake is there.
        oncoming_m: How far ahead the first oncoming vehicle is at the start.
        obstacle: What lies on the road, if anything does.
    """

    time_of_day: TimeOfDay
    weather: Weather
    occluder: Occluder
    crossing_m: float
    arrival_s: float
    oncoming_m: float
    obstacle: Obstacle = Obstacle.NONE

    def to_json(self) -> JsonObject:
        """Return the scenario as a JSON object."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        known = tuple(field.name for field in fields(cls))
        for name in document:
            if name not in known:
                raise InvalidEpisode(f"scenario: unknown field {name!r}{nearest(name, known)}")
        for name in known:
            if name not in document and name != "obstacle":
                raise InvalidEpisode(f"scenario.{name}: missing")
        return cls(
            time_of_day=_word(document, "time_of_day", TIMES),
            weather=_word(document, "weather", WEATHERS),
            occluder=_word(document, "occluder", tuple(Occluder)),
            crossing_m=_number(document, "crossing_m", CROSSING_M),
            arrival_s=_number(document, "arrival_s", ARRIVAL_S),
            oncoming_m=_number(document, "oncoming_m", ONCOMING_M),
            obstacle=_word({"obstacle": "none", **document}, "obstacle", tuple(Obstacle)),
        )


def _word(document: Mapping[str, Json], name: str, known: tuple[_Word, ...]) -> _Word:
    value = document[name]
    for word in known:
        if word.value == value:
            return word
    raise InvalidEpisode(
        f"scenario.{name}: expected one of {', '.join(known)}{nearest(value, tuple(known))}; got {value!r}"
    )


def _number(document: Mapping[str, Json], name: str, bounds: tuple[float, float]) -> float:
    value = document[name]
    low, high = bounds
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidEpisode(f"scenario.{name}: expected a number, got {value!r}")
    if not low <= value <= high:
        raise InvalidEpisode(f"scenario.{name}: expected a number in [{low:g}, {high:g}], got {value!r}")
    return float(value)
