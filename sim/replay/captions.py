"""The words of a replay: the scenario in a sentence, requirements with their units."""

from collections.abc import Mapping
from typing import Final

from sim.episode import Json
from sim.trace import Trace

UNITS: Final = {"m": " m", "s": " s", "m/s": " m/s"}
REQUIREMENT_UNITS: Final = {
    "front-gap": "m",
    "no-collision": "m",
    "lane-keeping": "m",
    "red-light": "m",
    "speed-limit": "m/s",
    "progress": "s",
}
"""Units, by id without version, of the requirements that ship with the project; others are written without one."""

_LENGTHS: Final = {0: "short", 1: "medium", 2: "long"}
_ROADS: Final = {
    "straight": "straight road",
    "right": "right bend",
    "left": "left bend",
    "crossroad": "crossroad",
}
_TASKS: Final = {
    "follow_road": "follow the road",
    "first_exit": "take the first exit",
    "second_exit": "take the second exit",
}
_KNOWN: Final = frozenset(
    {"road_curve", "road_id", "road_length", "time_of_day", "weather", "pedestrians", "driving_task"}
)


def scenario_words(trace: Trace) -> str:
    """Return the scenario as a line of words, from what the trace says about itself; empty if it says nothing."""
    spec = trace.about.get("spec")
    scenario = spec.get("scenario") if isinstance(spec, Mapping) else None
    if not isinstance(scenario, Mapping):
        return ""
    parts = [*_road(scenario), *_conditions(scenario)]
    if "driving_task" in scenario:
        task = str(scenario["driving_task"])
        parts.append("task: " + _TASKS.get(task, _plain(task)))
    parts += [
        f"{_plain(name)} {_plain(str(value))}"
        for name, value in scenario.items()
        if name not in _KNOWN and isinstance(value, str | int | float) and not isinstance(value, bool)
    ]
    return ", ".join(parts)


def _road(scenario: Mapping[str, Json]) -> list[str]:
    if "road_curve" not in scenario:
        return []
    curve = str(scenario["road_curve"])
    words = _ROADS.get(curve, _plain(curve))
    length = scenario.get("road_length")
    if isinstance(length, int) and length in _LENGTHS:
        words = f"{_LENGTHS[length]} {words}"
    if "road_id" in scenario:
        words += f" (road {scenario['road_id']})"
    return [words[:1].upper() + words[1:]]


def _conditions(scenario: Mapping[str, Json]) -> list[str]:
    parts = [_plain(str(scenario[name])) for name in ("time_of_day", "weather") if name in scenario]
    people = scenario.get("pedestrians")
    if isinstance(people, int):
        parts.append(f"{people} pedestrians" if people else "no pedestrians")
    return parts


def _plain(word: str) -> str:
    return word.replace("_", " ").replace("-", " ")


def plain_name(plugin_id: str) -> str:
    """Return an id without its version: ``front-gap`` for ``front-gap@1``."""
    return plugin_id.partition("@")[0]


def with_unit(value: float, requirement: str) -> str:
    """Return a robustness with its sign and unit, such as ``−0.8 m``; close to zero, with two digits."""
    unit = UNITS.get(REQUIREMENT_UNITS.get(plain_name(requirement), ""), "")
    digits = 1 if abs(value) >= 0.1 else 2
    return f"{value:+.{digits}f}{unit}".replace("-", "−")
