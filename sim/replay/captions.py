"""The words of a replay: the scenario in a sentence, requirements with their units."""

from collections.abc import Mapping
from typing import Final

from brink.sim.aeb.words import words_of_perturbations, words_of_street
from brink.sim.episode import Json
from brink.sim.trace import Trace
from brink.sim.world.scenario import words_of_scenario

UNITS: Final = {"m": " m", "s": " s", "m/s": " m/s"}
REQUIREMENT_UNITS: Final = {
    "front-gap": "m",
    "no-collision": "m",
    "no-dangerous-stop": "m/s",
    "lane-keeping": "m",
    "red-light": "m",
    "speed-limit": "m/s",
    "progress": "s",
}
"""Units, by id without version, of the requirements that ship with the project; others are written without one."""


def scenario_words(trace: Trace) -> str:
    """Return the scenario as a line of words, from what the trace says about itself; empty if it says nothing."""
    spec = trace.about.get("spec")
    scenario = spec.get("scenario") if isinstance(spec, Mapping) else None
    words = ""
    if isinstance(scenario, Mapping):
        words = words_of_street(scenario) if "crossing_m" in scenario else words_of_scenario(scenario)
    if _behaviour(trace).get("trajectories") and not len(trace.given_boxes.rows):
        words += "; it ends before anything is injected"
    return words


def perturbation_words(trace: Trace) -> str:
    """Return the perturbations that the camera's pictures went through, in order; empty if there were none."""
    steps = _behaviour(trace).get("perturbations")
    if not isinstance(steps, list):
        return ""
    return words_of_perturbations([step for step in steps if isinstance(step, Mapping)])


def report_word(trace: Trace) -> str:
    """Return what the boxes are that the driving system was told: injected, detected by a camera, or simply seen."""
    mode = _behaviour(trace).get("mode")
    if trace.film is not None or mode == "detector":
        return "detected"
    return "seen" if mode == "oracle" else "injected"


def _behaviour(trace: Trace) -> Mapping[str, Json]:
    spec = trace.about.get("spec")
    behaviour = spec.get("behaviour") if isinstance(spec, Mapping) else None
    return behaviour if isinstance(behaviour, Mapping) else {}


def plain_name(plugin_id: str) -> str:
    """Return an id without its version: ``front-gap`` for ``front-gap@1``."""
    return plugin_id.partition("@")[0]


def with_unit(value: float, requirement: str) -> str:
    """Return a robustness with its sign and unit, such as ``−0.8 m``; close to zero, with two digits."""
    unit = UNITS.get(REQUIREMENT_UNITS.get(plain_name(requirement), ""), "")
    digits = 1 if abs(value) >= 0.1 else 2
    return f"{value:+.{digits}f}{unit}".replace("-", "−")
