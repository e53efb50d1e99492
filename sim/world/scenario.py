"""The urban scenario: seven categorical parameters, their JSON form, and their description in words.

This module has no heavy imports, so that code that builds a search space can read the parameters from here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.sim.episode import Json, JsonObject, check_fields, parse_choice
from brink.sim.errors import InvalidEpisode


class TimeOfDay(StrEnum):
    """Time of day, which determines the light."""

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
    """Where the ego is to go; at a crossroads, the first exit leads right and the second left."""

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
"""All values of each scenario parameter, in the order of the genome."""

_LENGTH_WORDS: Final = {0: "short", 1: "medium", 2: "long"}
_ROAD_WORDS: Final = {
    "straight": "straight road",
    "right": "right bend",
    "left": "left bend",
    "crossroad": "crossroad",
}
_TASK_WORDS: Final = {
    "follow_road": "follow the road",
    "first_exit": "take the first exit",
    "second_exit": "take the second exit",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanScenario:
    """The parameters of an urban world.

    Attributes:
        time_of_day: Affects visibility, lane-position and light detection, and how others drive.
        weather: Affects the same and, in addition, friction.
        pedestrians: Number of pedestrians, 0 or 18.
        road_curve: Shape of the road.
        road_id: One of three roads of that shape, which differ in radius or slope, lane width and roadside.
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
        values = {name: getattr(self, name) for name in SCENARIO_CHOICES}
        return {name: item.value if isinstance(item, StrEnum) else item for name, item in values.items()}

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Parse a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing or unknown, or its value is not one of its choices.
        """
        check_fields("scenario", document, tuple(SCENARIO_CHOICES))
        return cls(
            time_of_day=parse_choice("scenario.time_of_day", document["time_of_day"], TimeOfDay),
            weather=parse_choice("scenario.weather", document["weather"], Weather),
            pedestrians=_integer("pedestrians", document["pedestrians"], PEDESTRIAN_COUNTS),
            road_curve=parse_choice("scenario.road_curve", document["road_curve"], RoadCurve),
            road_id=_integer("road_id", document["road_id"], ROAD_IDS),
            road_length=_integer("road_length", document["road_length"], ROAD_LENGTHS),
            driving_task=parse_choice("scenario.driving_task", document["driving_task"], DrivingTask),
        )


def _integer(name: str, value: Json, choices: tuple[int, ...]) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value not in choices:
        raise InvalidEpisode(
            f"scenario.{name}: expected one of {', '.join(map(str, choices))}; got {value!r}"
        )
    return value


def words_of_scenario(scenario: Mapping[str, Json]) -> str:
    """Return a one-line description of a scenario; fields that a plug-in added appear under their own names."""
    parts = [*_road_words(scenario), *_condition_words(scenario)]
    if "driving_task" in scenario:
        task = str(scenario["driving_task"])
        parts.append("task: " + _TASK_WORDS.get(task, _plain(task)))
    parts += [
        f"{_plain(name)} {_plain(str(value))}"
        for name, value in scenario.items()
        if name not in SCENARIO_CHOICES
        and isinstance(value, str | int | float)
        and not isinstance(value, bool)
    ]
    return ", ".join(parts)


def _road_words(scenario: Mapping[str, Json]) -> list[str]:
    if "road_curve" not in scenario:
        return []
    curve = str(scenario["road_curve"])
    words = _ROAD_WORDS.get(curve, _plain(curve))
    length = scenario.get("road_length")
    if isinstance(length, int) and length in _LENGTH_WORDS:
        words = f"{_LENGTH_WORDS[length]} {words}"
    if "road_id" in scenario:
        words += f" (road {scenario['road_id']})"
    return [words[:1].upper() + words[1:]]


def _condition_words(scenario: Mapping[str, Json]) -> list[str]:
    parts = [_plain(str(scenario[name])) for name in ("time_of_day", "weather") if name in scenario]
    people = scenario.get("pedestrians")
    if isinstance(people, int):
        parts.append(f"{people} pedestrians" if people else "no pedestrians")
    return parts


def _plain(word: str) -> str:
    return word.replace("_", " ").replace("-", " ")
