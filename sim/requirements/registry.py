"""Makes requirements by id, from the entry-point group `brink.requirements`."""

import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import cast

from brink.sim.catalogue import REQUIREMENTS, load_plugin, plugin_ids
from brink.sim.episode import Json, Verdict
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.requirements.requirement import Requirement


def requirement_ids() -> tuple[str, ...]:
    """Return the ids of all registered requirements, sorted."""
    return plugin_ids(REQUIREMENTS)


def make_requirement(requirement_id: str) -> Requirement:
    """Return a new requirement, for one episode.

    Raises:
        InvalidEpisode: No requirement of that id is registered; the message names the nearest id.
    """
    try:
        factory = load_plugin(REQUIREMENTS, requirement_id)
    except KeyError:
        known = requirement_ids()
        near = difflib.get_close_matches(requirement_id, known, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise InvalidEpisode(
            f"requirements: unknown id {requirement_id!r}; {hint}registered here: {', '.join(known) or 'none'}"
        ) from None
    return cast(Callable[[], Requirement], factory)()


def make_requirements(requirement_ids_: Sequence[str]) -> dict[str, Requirement]:
    """Return new requirements by id, in order, for one episode.

    Raises:
        InvalidEpisode: An id is unknown, or named twice.
    """
    made: dict[str, Requirement] = {}
    for requirement_id in requirement_ids_:
        if requirement_id in made:
            raise InvalidEpisode(f"requirements: {requirement_id!r} is named twice")
        made[requirement_id] = make_requirement(requirement_id)
    return made


def verdicts_of(requirements: Mapping[str, Requirement]) -> dict[str, Verdict]:
    """Return what requirements say at the end of an episode.

    Raises:
        SimulationCrashed: A robustness is not finite.
    """
    verdicts = {name: requirement.verdict() for name, requirement in requirements.items()}
    for name, verdict in verdicts.items():
        if not math.isfinite(verdict.robustness):
            raise SimulationCrashed(f"{name}: expected a finite robustness, got {verdict.robustness}")
    return verdicts


def features_of(requirements: Mapping[str, Requirement]) -> dict[str, Json]:
    """Return what requirements know besides, each name led by the requirement's id."""
    return {
        f"{name}:{key}": value
        for name, requirement in requirements.items()
        for key, value in requirement.features().items()
    }
