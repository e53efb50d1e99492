"""Owns the words of an urban scenario: seven categorical parameters and their JSON.

Imports nothing heavy, so that whoever builds a search space can read the parameters from here.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Self, TypeVar

from brink.sim.episode import Json, JsonObject
from brink.sim.errors import InvalidEpisode


class TimeOfDay(StrEnum):
    """When it happens."""

    NOON = "noon"
    SUNSET = "sunset"
    NIGHT = "night"


class Weather(StrEnum):
    """Sky, rain and road surface."""

    CLEAR = "clear"
    CLOUDY = "cloudy"
    WET = "wet"
    WET_CLOUDY = "wet_cloudy"
    MEDIUM_RAIN = "medium_rain"
    HARD_RAIN = "hard_rain"
    SOFT_RAIN = "soft_rain"


class RoadCurve(StrEnum):
    """Shape of the road."""

    STRAIGHT = "straight"
    RIGHT = "right"
    LEFT = "left"
    CROSSROAD = "crossroad"


class DrivingTask(StrEnum):
    """Where the ego is to go; at a crossroad: straight on, right, left."""

    FOLLOW_ROAD = "follow_road"
    FIRST_EXIT = "first_exit"
    SECOND_EXIT = "second_exit"


PEDESTRIAN_COUNTS = (0, 18)
ROAD_IDS = (0, 1, 2)
ROAD_LENGTHS = (0, 1, 2)

SCENARIO_CHOICES: Mapping[str, tuple[str | int, ...]] = {
    "time_of_day": tuple(item.value for item in TimeOfDay),
    "weather": tuple(item.value for item in Weather),
    "pedestrians": PEDESTRIAN_COUNTS,
    "road_curve": tuple(item.value for item in RoadCurve),
    "road_id": ROAD_IDS,
    "road_length": ROAD_LENGTHS,
    "driving_task": tuple(item.value for item in DrivingTask),
}
"""Every parameter of a scenario with all its values, in the order of the genome."""

_Word = TypeVar("_Word", bound=StrEnum)


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanScenario:
    """What the world is.

    Attributes:
        time_of_day: Acts on sight, on lane-position and light detection, and on how others drive.
        weather: Acts on the same, and on friction.
        pedestrians: How many are about, 0 or 18.
        road_curve: Shape of the road.
        road_id: One of three roads of that shape: they differ in radius or slope, lane width and roadside.
        road_length: 0 short, 1 medium, 2 long.
        driving_task: Where the ego is to go.
    """

    time_of_day: TimeOfDay
    weather: Weather
    pedestrians: int
    road_curve: RoadCurve
    road_id: int
    road_length: int
    driving_task: DrivingTask

    def to_json(self) -> JsonObject:
        """Return the scenario as a JSON object."""
        return {
            "time_of_day": self.time_of_day.value,
            "weather": self.weather.value,
            "pedestrians": self.pedestrians,
            "road_curve": self.road_curve.value,
            "road_id": self.road_id,
            "road_length": self.road_length,
            "driving_task": self.driving_task.value,
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown, or has a value that is not among its choices.
        """
        check_fields("scenario", document, tuple(SCENARIO_CHOICES))
        return cls(
            time_of_day=_word("time_of_day", document["time_of_day"], TimeOfDay),
            weather=_word("weather", document["weather"], Weather),
            pedestrians=_integer("pedestrians", document["pedestrians"], PEDESTRIAN_COUNTS),
            road_curve=_word("road_curve", document["road_curve"], RoadCurve),
            road_id=_integer("road_id", document["road_id"], ROAD_IDS),
            road_length=_integer("road_length", document["road_length"], ROAD_LENGTHS),
            driving_task=_word("driving_task", document["driving_task"], DrivingTask),
        )


def nearest(word: object, known: tuple[str, ...]) -> str:
    """Return `` (did you mean '...'?)`` for a word close to a known one, else nothing."""
    close = difflib.get_close_matches(str(word), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def check_fields(where: str, document: Mapping[str, Json], expected: tuple[str, ...]) -> None:
    """Refuse a JSON object that lacks a field or has one too many.

    Raises:
        InvalidEpisode: Names the field and what is expected.
    """
    for name in document:
        if name not in expected:
            raise InvalidEpisode(
                f"{where}: unknown field {name!r}{nearest(name, expected)}; expected {', '.join(expected)}"
            )
    for name in expected:
        if name not in document:
            raise InvalidEpisode(f"{where}.{name}: missing; expected {', '.join(expected)}")


def _word(name: str, value: Json, words: type[_Word]) -> _Word:
    known = tuple(item.value for item in words)
    if not isinstance(value, str) or value not in known:
        raise InvalidEpisode(
            f"scenario.{name}: expected one of {', '.join(known)}; got {value!r}{nearest(value, known)}"
        )
    return words(value)


def _integer(name: str, value: Json, choices: tuple[int, ...]) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value not in choices:
        raise InvalidEpisode(
            f"scenario.{name}: expected one of {', '.join(map(str, choices))}; got {value!r}"
        )
    return value
