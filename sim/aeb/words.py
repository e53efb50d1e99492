"""Emergency-braking episodes in words: for captions, tables and lists."""

from collections.abc import Mapping, Sequence
from typing import Final

from brink.sim.episode import Json
from brink.sim.perturbations import CATALOGUE

_OBSTACLES: Final = {"novelty": "a fallen tree", "anomaly": "an overturned vehicle"}


def words_of_street(scenario: Mapping[str, Json]) -> str:
    """Return a scenario as words, such as ``night, wet cloudy, somebody from behind a van after 52 m``."""
    crossing_m = scenario.get("crossing_m")
    way = f" after {crossing_m:.0f} m" if isinstance(crossing_m, int | float) else ""
    words = (
        f"{scenario.get('time_of_day')}, {str(scenario.get('weather')).replace('_', ' ')}, "
        f"somebody from behind a {scenario.get('occluder')}{way}"
    )
    obstacle = str(scenario.get("obstacle", "none"))
    return f"{words}, {_OBSTACLES[obstacle]} on the road" if obstacle in _OBSTACLES else words


def words_of_perturbations(steps: Sequence[Mapping[str, Json]]) -> str:
    """Return perturbations as words in their order, such as ``snow 3/5, then brightness 10/10``; empty for none.

    Args:
        steps: Each ``{"gene": name, "level": index}``; those at level 0 are left out.
    """
    words = []
    for step in steps:
        gene = str(step.get("gene"))
        if step.get("level"):
            most = f"/{CATALOGUE[gene].levels - 1}" if gene in CATALOGUE else ""
            words.append(f"{gene.replace('_', ' ')} {step['level']}{most}")
    return ", then ".join(words)
