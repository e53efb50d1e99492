"""Ordered slots, each with one of several techniques at one of its levels.

A slot is two parameters: the technique, a category, and its intensity, a real number. Techniques have different
numbers of levels; level index i of a technique with n levels has the intensity i / (n - 1), so that intensities of
different techniques compare. Level 0 is "no effect": a slot at it is empty. The techniques of a vector differ.

Source: Ferreira et al. 2022, individuals of m distinct techniques with a level each; intensity eta.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from brink.search.constraints import Values
from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.parameters import Categorical, Parameter, Real
from brink.search.space import SearchSpace


@dataclass(frozen=True, slots=True)
class Slots:
    """Owns the parameters of all slots of a component: distinct techniques, intensities on their levels.

    Attributes:
        pairs: Names of technique and intensity, slot by slot, in the order in which techniques are applied.
        levels: How many levels each technique has, "no effect" included, in the order of the choices; each >= 2.
    """

    pairs: tuple[tuple[str, str], ...]
    levels: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that it owns."""
        return tuple(name for pair in self.pairs for name in pair)

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        if not self.pairs or len(self.pairs) > len(self.levels):
            raise SpaceError(f"Slots: expected 1 to {len(self.levels)} slots, got {len(self.pairs)}")
        if any(levels < 2 for levels in self.levels):
            raise SpaceError(f"Slots: expected at least 2 levels of each technique, got {self.levels!r}")
        choices = set()
        for technique, intensity in self.pairs:
            category, number = parameters.get(technique), parameters.get(intensity)
            if not isinstance(category, Categorical) or len(category.choices) != len(self.levels):
                raise SpaceError(
                    f"Slots: expected {technique!r} to be a category of {len(self.levels)} choices"
                )
            if not isinstance(number, Real) or (number.low, number.high) != (0.0, 1.0):
                raise SpaceError(f"Slots: expected {intensity!r} to be a real number in [0, 1]")
            choices.add(category.choices)
        if len(choices) > 1:
            raise SpaceError("Slots: expected the same choices in every slot")

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Give a repeated technique the next free choice, and every intensity its nearest level."""
        taken: set[int] = set()
        for technique, intensity in self.pairs:
            choice = int(values[technique])
            while choice in taken:
                choice = (choice + 1) % len(self.levels)
            taken.add(choice)
            values[technique] = float(choice)
            values[intensity] = self.intensity(choice, self.level(choice, values[intensity]))

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""
        chosen = [int(values[technique]) for technique, _ in self.pairs]
        if len(set(chosen)) < len(chosen):
            return "expected different techniques in the slots"
        for choice, (_, intensity) in zip(chosen, self.pairs, strict=True):
            nearest = self.intensity(choice, self.level(choice, values[intensity]))
            if values[intensity] != nearest:
                return (
                    f"expected {intensity} on a level, the nearest is {nearest!r}, got {values[intensity]!r}"
                )
        return None

    def level(self, choice: int, intensity: float) -> int:
        """Return the index of the level nearest to an intensity."""
        return round(min(max(intensity, 0.0), 1.0) * (self.levels[choice] - 1))

    def intensity(self, choice: int, level: int) -> float:
        """Return the intensity of a level, in [0, 1]."""
        return level / (self.levels[choice] - 1)

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {"type": "slots", "pairs": [list(pair) for pair in self.pairs], "levels": list(self.levels)}


def slots_of(space: SearchSpace) -> tuple[int, Slots]:
    """Return which component is made of slots, and the slots.

    Raises:
        UnsupportedSpace: None is.
    """
    for index, component in enumerate(space.components):
        for rule in component.constraints:
            if isinstance(rule, Slots) and len(rule.names) == component.dimension:
                return index, rule
    raise UnsupportedSpace("expected a component of ordered slots, each a technique and its intensity")
