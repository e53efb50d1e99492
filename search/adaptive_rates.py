"""How probable crossover and mutation are, and the threshold that they must reach, by fitness in the population.

Fitness here is maximised, in [0, 1]: w (1 - F_c) + (1 - w) F_d, both objectives scaled by bounds that run over the
whole history. Bounds of the generation alone would fix its range at 1 and so defeat the threshold, which falls as a
population converges.

Where the paper prints the mutation rate a second time in the place of the crossover rate, its prose asks for a rate
that grows as the better parent nears the best fitness. Three readings are offered (`Crossover`).

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems";
Srinivas and Patnaik, "Adaptive probabilities of crossover and mutation in genetic algorithms", 1994.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import assert_never

import numpy as np

from brink.search.component import FloatArray


class Crossover(StrEnum):
    """Readings of the crossover rate."""

    MIRROR = "mirror"
    RECIPROCAL = "reciprocal"
    SRINIVAS = "srinivas"
    """The classical form, which falls as the better parent nears the best."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Population:
    """What the rates depend on.

    Attributes:
        least: Smallest fitness (f_min).
        mean: Mean fitness (f_mean).
        most: Largest fitness (f_max).
    """

    least: float
    mean: float
    most: float

    @classmethod
    def of(cls, fitness: FloatArray) -> "Population":
        """Return the figures of a population's fitness, shape ``(n,)``, n >= 1."""
        return cls(least=float(fitness.min()), mean=float(fitness.mean()), most=float(fitness.max()))

    @property
    def degenerate(self) -> bool:
        """Whether nobody is better than the mean: rates are at their caps then."""
        return not self.least < self.mean < self.most

    def threshold(self, c1: float = 0.5, m1: float = 0.5) -> float:
        """Return what a probability must reach for its operator to be applied."""
        return c1 * (self.most - self.mean) + m1 * (self.mean - self.least)


def scalar_fitness(criticality: FloatArray, diversity: FloatArray, weight: float = 0.5) -> FloatArray:
    """Return the fitness of solutions, maximised, in [0, 1].

    Args:
        criticality: F_c, 0 for the most critical ever seen and 1 for the least, shape ``(n,)``.
        diversity: F_d, 1 for the most different ever seen and 0 for the least, shape ``(n,)``.
        weight: Of criticality, in [0, 1] (w).
    """
    return np.asarray(weight * (1.0 - criticality) + (1.0 - weight) * diversity)


def scaled(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return values as shares of the way from one bound to the other, clipped to [0, 1]; 0 if the bounds meet."""
    if not high > low:
        return np.zeros(len(values))
    return np.asarray(np.clip((values - low) / (high - low), 0.0, 1.0))


def mutation_probability(fitness: FloatArray, k2: float = 0.6, k4: float = 1.0) -> FloatArray:
    """Return PM of each solution: none for the best, the cap for the worst.

    Args:
        fitness: Of the population, maximised, shape ``(n,)``.
        k2: Rate of a solution with the mean fitness.
        k4: The cap.
    """
    population = Population.of(fitness)
    if population.degenerate:
        return np.full(len(fitness), k4)
    return np.asarray(np.minimum(k2 * (population.most - fitness) / (population.most - population.mean), k4))


def crossover_probability(
    better: FloatArray,
    population: Population,
    form: Crossover = Crossover.MIRROR,
    k1: float = 0.6,
    k3: float = 1.0,
) -> FloatArray:
    """Return PC of pairs.

    Args:
        better: Fitness of the better parent of each pair (f'), any shape.
        population: Of which the parents are.
        form: Which reading of the rate.
        k1: Rate of a pair whose better parent has the mean fitness.
        k3: The cap.
    """
    least, mean, most = population.least, population.mean, population.most
    if population.degenerate:
        return np.full(np.shape(better), k3)
    match form:
        case Crossover.MIRROR:
            rate = k1 * (better - least) / (mean - least)
        case Crossover.RECIPROCAL:
            with np.errstate(divide="ignore"):  # the best parent itself: the cap
                rate = k1 * (most - mean) / (most - better)
        case Crossover.SRINIVAS:
            rate = np.where(better >= mean, k1 * (most - better) / (most - mean), k3)
        case _:
            assert_never(form)
    return np.asarray(np.minimum(rate, k3))
