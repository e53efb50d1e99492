"""Solutions of participants as rows of a space: reading, writing, rolling out."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.actions.distance import RolledOut
from brink.search.actions.road import RoadLimits
from brink.search.actions.rollout import padded_waypoints
from brink.search.actions.rule import Participants, participants_of
from brink.search.actions.variation import Solution
from brink.search.component import FloatArray
from brink.search.operators import mutated
from brink.search.space import SearchSpace

_OTHERS_MUTATE: Final = 0.05
"""Probability that a parameter of another component mutates in a child."""


@dataclass(frozen=True, slots=True)
class Genome:
    """Where participants lie in a space.

    Attributes:
        space: The space.
        index: Of the component of participants.
        rule: Its constraint.
    """

    space: SearchSpace
    index: int
    rule: Participants

    @classmethod
    def of(cls, space: SearchSpace) -> "Genome":
        """Return where participants lie in a space.

        Raises:
            UnsupportedSpace: It has none.
        """
        return cls(space, *participants_of(space))

    @property
    def road(self) -> RoadLimits:
        """Where participants are."""
        return self.rule.road

    @property
    def most(self) -> int:
        """How many participants there may be."""
        return self.rule.count

    def solution(self, row: FloatArray) -> Solution:
        """Return the participants of a row."""
        return self.rule.read(row[self.space.slices[self.index]])

    def random(self, rng: np.random.Generator) -> Solution:
        """Return random participants."""
        return self.rule.read(self.space.sample_component(self.index, rng))

    def repaired(self, solution: Solution, rng: np.random.Generator) -> Solution:
        """Return the nearest solution that complies."""
        vector = self.rule.written(solution[: self.most])
        return self.rule.read(self.space.repair_component(self.index, vector, rng))

    def row(self, solution: Solution, like: FloatArray | None, rng: np.random.Generator) -> FloatArray:
        """Return a row with these participants, mended.

        Args:
            solution: The participants.
            like: Row whose other components are taken over, slightly mutated; drawn at random if None.
            rng: All chance comes from it.
        """
        participants = self.space.repair_component(self.index, self.rule.written(solution[: self.most]), rng)
        vectors = []
        for index, component in enumerate(self.space.components):
            if index == self.index:
                vectors.append(participants)
            elif like is None:
                vectors.append(component.sample(rng))
            else:
                parent = component.unset_dormant(like[self.space.slices[index]])
                vectors.append(component.repair(mutated(component, parent, _OTHERS_MUTATE, rng), rng))
        return self.space.join(vectors)

    def rolled_out(self, solutions: Iterable[Solution]) -> RolledOut:
        """Return where participants of solutions are at the ends of their actions."""
        points, actions = padded_waypoints(solutions, self.most, self.road)
        return RolledOut(points=points, actions=actions)
