"""A guard's training data: digests of the scenarios, behaviours and solutions of its drives.

They are stored in the guard, so that drives on which it is judged can be told from those that it was fitted to, by
whatever campaign or seed they came about. The same solution with another seed is not a fresh drive, unless the
detector reports nothing: that is the behaviour of every ninth random drive, and chance and scenario alone tell these
apart.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from brink.guard.drives import Drive, behaviour_of, reports_anything, scenario_of
from brink.search.space import BoolArray
from brink.server.errors import Conflict
from brink.sim.episode import EpisodeSpec

ABOUT: Final = "seen"
"""Its key in a guard's `about`."""
_HEX: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenDrives:
    """The training data of a guard, as digests.

    Attributes:
        solutions: Its complete solutions; those that report nothing with their episode seeds.
        scenarios: Its scenarios.
        behaviours: Its behaviours.
    """

    solutions: frozenset[str]
    scenarios: frozenset[str]
    behaviours: frozenset[str]

    @classmethod
    def of(cls, drives: Iterable[Drive]) -> Self:
        """Return the training data from some drives."""
        given = list(drives)
        return cls(
            solutions=frozenset(_solution(one.scenario, one.behaviour, one.seed) for one in given),
            scenarios=frozenset(_digest(one.scenario) for one in given),
            behaviours=frozenset(_digest(one.behaviour) for one in given),
        )

    @classmethod
    def by(cls, about: Mapping[str, Any]) -> Self | None:
        """Return the training data of the guard with this `about`; None if it is not recorded."""
        stored = about.get(ABOUT)
        if not isinstance(stored, Mapping):
            return None
        names = ("solutions", "scenarios", "behaviours")
        if not all(isinstance(stored.get(name), list) for name in names):
            return None
        return cls(**{name: frozenset(map(str, stored[name])) for name in names})

    def to_json(self) -> dict[str, list[str]]:
        """Return this as a JSON object."""
        return {name: sorted(getattr(self, name)) for name in self.__slots__}

    def repeats(self, specs: Sequence[EpisodeSpec]) -> int:
        """Return how many of some episodes are in the training data."""
        return sum(
            _solution(scenario_of(spec), behaviour_of(spec), spec.seed) in self.solutions for spec in specs
        )

    def parts(self, specs: Sequence[EpisodeSpec]) -> dict[str, BoolArray]:
        """Return masks of episodes by whether their scenarios and behaviours were seen; empty ones are left out.

        Args:
            specs: The episodes.
        """
        scenario = np.array([_digest(scenario_of(spec)) in self.scenarios for spec in specs], np.bool_)
        behaviour = np.array([_digest(behaviour_of(spec)) in self.behaviours for spec in specs], np.bool_)
        masks = {
            "scenario and behaviour seen": scenario & behaviour,
            "scenario seen, behaviour unseen": scenario & ~behaviour,
            "scenario unseen, behaviour seen": ~scenario & behaviour,
            "scenario and behaviour unseen": ~scenario & ~behaviour,
        }
        return {name: mask for name, mask in masks.items() if mask.any()}


def check_unseen(
    about: Mapping[str, Any],
    drives: Iterable[tuple[str, Sequence[EpisodeSpec]]],
    *,
    name: str,
    seeds: Collection[int],
    option: str,
) -> None:
    """Check that a guard was not fitted to drives on which it is to be evaluated.

    Args:
        about: The provenance of the guard.
        drives: Whose drives they are, such as ``campaign 3f2a``, and their episodes.
        name: The guard, for messages.
        seeds: Seeds of those that are random.
        option: The option that sets these seeds, for messages.

    Raises:
        Conflict: It was fitted to some of them.
    """
    drawn = about.get("random")
    if isinstance(drawn, Mapping) and drawn.get("seed") in seeds:
        raise Conflict(f"{name} was fitted to random drives of seed {drawn['seed']}: choose another {option}")
    seen = SeenDrives.by(about)
    if seen is None:
        return
    for whose, specs in drives:
        if repeated := seen.repeats(specs):
            raise Conflict(
                f"{name} was fitted to {repeated:,} of the {len(specs):,} solutions of {whose}: evaluate it on other "
                f"drives, ideally fresh random ones with another {option}"
            )


def _solution(scenario: str, behaviour: str, seed: int) -> str:
    return _digest(f"{scenario}\n{behaviour}\n{seed if not reports_anything(behaviour) else ''}")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_HEX]
