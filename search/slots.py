"""Ordered slots: each holds one of several techniques at one of its levels.

A slot is two parameters: the technique, a category, and its intensity, a real number. Techniques have different
numbers of levels. Level i of a technique with n levels has the intensity i / (n - 1), so intensities of different
techniques are comparable. Level 0 means "no effect": the slot is empty. The techniques of one vector all differ.

`Slots` is the constraint on a component; `ChainGenome` samples, varies and ablates its vectors, the *individuals*. A
*chain* is what an individual applies: its steps in order, without empty slots.

Source: Ferreira et al. 2022 (individuals of m distinct techniques with a level each; intensity eta).
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.parameters import Categorical, Parameter, Real, Values
from brink.search.space import Component, FloatArray, SearchSpace, frozen_array

_MAX_ATTEMPTS: Final = 100
"""Number of mutations tried before an individual is drawn afresh; only a tiny catalogue needs so many."""


class Step(NamedTuple):
    """A technique at a level, both as indices."""

    technique: int
    level: int


Chain: TypeAlias = tuple[Step, ...]


def parts_of(chain: Chain) -> list[Chain]:
    """Return every proper part of a chain but the empty one, shortest first, with the steps in their order."""
    return [part for size in range(1, len(chain)) for part in itertools.combinations(chain, size)]


@dataclass(frozen=True, slots=True)
class Slots:
    """Constraint on a component made of slots: techniques are distinct, and each intensity is that of a level.

    Attributes:
        pairs: Names of technique and intensity, slot by slot, in the order in which techniques are applied.
        levels: Number of levels of each technique, level 0 included, in the order of the choices; each >= 2.
    """

    pairs: tuple[tuple[str, str], ...]
    levels: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the constraint owns."""
        return tuple(name for pair in self.pairs for name in pair)

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint does not fit the component's parameters."""
        if not self.pairs or len(self.pairs) > len(self.levels):
            raise SpaceError(f"Slots: expected 1 to {len(self.levels)} slots, got {len(self.pairs)}")
        if any(levels < 2 for levels in self.levels):
            raise SpaceError(f"Slots: expected at least 2 levels of each technique, got {self.levels!r}")
        choices = set()
        for technique, intensity in self.pairs:
            category, number = parameters.get(technique), parameters.get(intensity)
            if not isinstance(category, Categorical) or len(category.choices) != len(self.levels):
                raise SpaceError(
                    f"Slots: expected {technique!r} to be categorical with {len(self.levels)} choices"
                )
            if not isinstance(number, Real) or (number.low, number.high) != (0.0, 1.0):
                raise SpaceError(f"Slots: expected {intensity!r} to be a real number in [0, 1]")
            choices.add(category.choices)
        if len(choices) > 1:
            raise SpaceError("Slots: expected the same choices in every slot")

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Replace each repeated technique with the next free one, and round every intensity to that of a level."""
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
    """Return the index of the component made of slots, and the component's `Slots` constraint.

    Raises:
        UnsupportedSpace: The space has no such component.
    """
    for index, component in enumerate(space.components):
        for rule in component.constraints:
            if isinstance(rule, Slots) and len(rule.names) == component.dimension:
                return index, rule
    raise UnsupportedSpace(
        "expected a space with a component of ordered slots, each a technique and its intensity"
    )


@dataclass(frozen=True, slots=True)
class ChainGenome:
    """The slots of a space as a genome: sampling, variation and ablation of individuals, without side effects.

    Attributes:
        space: The space.
        index: Position of the component made of slots.
        slots: Its constraint.
    """

    space: SearchSpace
    index: int
    slots: Slots

    @classmethod
    def of(cls, space: SearchSpace) -> "ChainGenome":
        """Return the genome of a space.

        Raises:
            UnsupportedSpace: The space has no slots.
        """
        return cls(space, *slots_of(space))

    @property
    def component(self) -> Component:
        """The component made of slots."""
        return self.space.components[self.index]

    @property
    def ablation_count(self) -> int:
        """Number of variants that `ablations` returns."""
        count = len(self.slots.pairs)
        return (1 << count) - 1 + count - 1

    def columns(self, slot: int) -> list[int]:
        """Return the columns of a slot's technique and intensity."""
        names = [parameter.name for parameter in self.component.parameters]
        return [names.index(name) for name in self.slots.pairs[slot]]

    @property
    def single_count(self) -> int:
        """Number of chains of one step."""
        return sum(levels - 1 for levels in self.slots.levels)

    def chain(self, individual: FloatArray) -> Chain:
        """Return the chain that an individual applies."""
        slots = [self.columns(slot) for slot in range(len(self.slots.pairs))]
        steps = [(int(individual[technique]), float(individual[intensity])) for technique, intensity in slots]
        chain = (Step(technique, self.slots.level(technique, intensity)) for technique, intensity in steps)
        return tuple(step for step in chain if step.level)

    def row(self, chain: Chain) -> FloatArray:
        """Return the individual that applies a chain: its steps in the first slots, the other slots empty.

        Empty slots hold the first free techniques, so equal chains are equal rows.
        """
        individual = np.zeros(self.component.dimension)
        for slot, (technique, level) in enumerate(chain):
            individual[self.columns(slot)] = technique, self.slots.intensity(technique, level)
        free = sorted(set(range(len(self.slots.levels))) - {step.technique for step in chain})
        for slot, technique in zip(range(len(chain), len(self.slots.pairs)), free, strict=False):
            individual[self.columns(slot)] = technique, 0.0
        return frozen_array(individual)

    def eta(self, individuals: FloatArray) -> FloatArray:
        """Return the mean intensity of each individual, shape ``(n, d)`` to ``(n,)``."""
        columns = [self.columns(slot)[1] for slot in range(len(self.slots.pairs))]
        return np.asarray(individuals[:, columns].mean(axis=1), dtype=np.float64)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw an individual: uniform distinct techniques, then a uniform level >= 1 of each."""
        count = len(self.slots.pairs)
        individual = np.zeros(self.component.dimension)
        for slot, choice in enumerate(rng.permutation(len(self.slots.levels))[:count].tolist()):
            self._draw_level(individual, slot, choice, rng)
        return frozen_array(individual)

    def _draw_level(self, individual: FloatArray, slot: int, choice: int, rng: np.random.Generator) -> None:
        level = int(rng.integers(1, self.slots.levels[choice]))
        individual[self.columns(slot)] = choice, self.slots.intensity(choice, level)

    def mutated(self, individual: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a different individual with one slot redrawn and no technique repeated."""
        for _ in range(_MAX_ATTEMPTS):
            copy = np.array(individual)
            slot = int(rng.integers(len(self.slots.pairs)))
            self._draw_level(copy, slot, int(rng.integers(len(self.slots.levels))), rng)
            if not self.has_repeats(copy) and not np.array_equal(copy, individual):
                return copy
        return self.draw(rng)

    def has_repeats(self, individual: FloatArray) -> bool:
        """Return whether two slots hold the same technique."""
        chosen = [individual[self.columns(slot)[0]] for slot in range(len(self.slots.pairs))]
        return len(set(chosen)) < len(chosen)

    def crossed(
        self, mother: FloatArray, father: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return two children by single-point crossover between slots; with one slot, copies.

        Args:
            mother: An individual, shape ``(d,)``.
            father: An individual, shape ``(d,)``.
            rng: Draws the crossover point.
        """
        first, second = np.array(mother), np.array(father)
        if len(self.slots.pairs) > 1:
            for slot in range(int(rng.integers(1, len(self.slots.pairs))), len(self.slots.pairs)):
                columns = self.columns(slot)
                first[columns], second[columns] = father[columns], mother[columns]
        return first, second

    def ablations(self, individual: FloatArray) -> list[FloatArray]:
        """Return every proper part of an individual, the empty one first, then each swap of adjacent slots.

        Parts are rows as `row` returns them: a part that two individuals share, in whatever slots, is one row.
        """
        variants = [self.row(part) for part in ((), *parts_of(self.chain(individual)))]
        slots = [self.columns(slot) for slot in range(len(self.slots.pairs))]
        for left, right in itertools.pairwise(slots):
            swapped = np.array(individual)
            swapped[left], swapped[right] = individual[right], individual[left]
            variants.append(swapped)
        return variants
