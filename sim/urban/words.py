"""Episodes in words: for replays, tables and lists."""

from collections.abc import Mapping
from typing import Final

from brink.sim.episode import Json
from brink.sim.urban.behaviour import PERCEPTION_STEP_S

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


def words_of_scenario(scenario: Mapping[str, Json]) -> str:
    """Return a scenario as a line of words; what a plug-in added to it is named as it is."""
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


def words_of_behaviour(trajectories: Json) -> str:
    """Return injected detections as words: what is seen from when to when, such as ``person 17.4-26.7 s``."""
    if not isinstance(trajectories, list) or not trajectories:
        return "nothing detected"
    seen = []
    for trajectory in trajectories:
        if isinstance(trajectory, Mapping):
            start, end = (float(str(trajectory[name])) * PERCEPTION_STEP_S for name in ("t0_step", "t1_step"))
            seen.append(f"{trajectory['label']} {start:.1f}-{end:.1f} s")
    return "detected: " + ", ".join(seen)


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
