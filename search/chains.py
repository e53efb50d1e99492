"""Ordered chains of techniques at levels as genes: drawing, varying and crossing them, and taking them apart.

Pure: nothing is changed in place. `brink.search.levels` says what slots are. Source: Ferreira et al., PRDC 2022.
"""

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.component import Component, FloatArray, frozen_array
from brink.search.levels import Slots, slots_of
from brink.search.space import SearchSpace

_TRIES: Final = 100
"""Mutations without a valid one, as only a tiny catalogue has, after which an individual is drawn afresh."""


@dataclass(frozen=True, slots=True)
class ChainGenome:
    """Where individuals lie in a space, and what can be done with them.

    Attributes:
        space: The space.
        index: Of the component that has the slots.
        slots: Its slots.
    """

    space: SearchSpace
    index: int
    slots: Slots

    @classmethod
    def of(cls, space: SearchSpace) -> "ChainGenome":
        """Return where chains lie in a space.

        Raises:
            UnsupportedSpace: It has no slots.
        """
        return cls(space, *slots_of(space))

    @property
    def component(self) -> Component:
        """The component that has the slots."""
        return self.space.components[self.index]

    def columns(self, slot: int) -> list[int]:
        """Return the two columns of a slot in an individual: technique and intensity."""
        names = [parameter.name for parameter in self.component.parameters]
        return [names.index(name) for name in self.slots.pairs[slot]]

    def eta(self, individuals: FloatArray) -> FloatArray:
        """Return the mean intensity of each individual."""
        columns = [self.columns(slot)[1] for slot in range(len(self.slots.pairs))]
        return np.asarray(individuals[:, columns].mean(axis=1), dtype=np.float64)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return a random individual: distinct techniques, then a level of each, both uniform."""
        count = len(self.slots.pairs)
        individual = np.zeros(self.component.dimension)
        for slot, choice in enumerate(rng.permutation(len(self.slots.levels))[:count].tolist()):
            self._put(individual, slot, choice, rng)
        return frozen_array(individual)

    def _put(self, individual: FloatArray, slot: int, choice: int, rng: np.random.Generator) -> None:
        level = int(rng.integers(1, self.slots.levels[choice]))
        individual[self.columns(slot)] = choice, self.slots.intensity(choice, level)

    @property
    def variants(self) -> int:
        """How many variants `taken_apart` gives."""
        count = len(self.slots.pairs)
        return (1 << count) - 1 + count - 1

    def taken_apart(self, individual: FloatArray) -> list[FloatArray]:
        """Return an individual's parts, from nothing at all up, and what comes of swapping two neighbours."""
        slots = [self.columns(slot) for slot in range(len(self.slots.pairs))]
        variants = []
        for size in range(len(slots)):
            for kept in itertools.combinations(range(len(slots)), size):
                part = np.array(individual)
                free = iter(
                    sorted(set(range(len(self.slots.levels))) - {int(part[slots[slot][0]]) for slot in kept})
                )
                for slot in set(range(len(slots))) - set(kept):
                    part[slots[slot]] = next(free), 0.0  # equal parts of two individuals are one
                variants.append(part)
        for left, right in itertools.pairwise(slots):
            swapped = np.array(individual)
            swapped[left], swapped[right] = individual[right], individual[left]
            variants.append(swapped)
        return variants

    def varied(self, individual: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a copy with one slot redrawn, so that it is another one and no technique comes twice."""
        for _ in range(_TRIES):
            copy = np.array(individual)
            slot = int(rng.integers(len(self.slots.pairs)))
            self._put(copy, slot, int(rng.integers(len(self.slots.levels))), rng)
            if not self.repeats(copy) and not np.array_equal(copy, individual):
                return copy
        return self.draw(rng)

    def repeats(self, individual: FloatArray) -> bool:
        """Return whether a technique comes twice."""
        chosen = [individual[self.columns(slot)[0]] for slot in range(len(self.slots.pairs))]
        return len(set(chosen)) < len(chosen)

    def crossed(
        self, mother: FloatArray, father: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return two children that have swapped all slots after a point; of one slot, copies."""
        first, second = np.array(mother), np.array(father)
        if len(self.slots.pairs) > 1:
            for slot in range(int(rng.integers(1, len(self.slots.pairs))), len(self.slots.pairs)):
                columns = self.columns(slot)
                first[columns], second[columns] = father[columns], mother[columns]
        return first, second
