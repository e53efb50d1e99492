"""Variation and selection: tournament, uniform crossover, mutation. Pure: parents are never touched.

A sleeping block has no numbers to give. Its zeros become NaN before variation, so that crossover cannot mix them
into a block that is awake and mutation cannot shift them; repair then draws afresh what an awake block misses and
puts everything else back to sleep.

Source: Sharifi et al. 2023, breeding of populations.
"""

import numpy as np

from brink.search.component import Component, FloatArray
from brink.search.parameters import Categorical


def tournament(fitness: FloatArray, size: int, rng: np.random.Generator) -> int:
    """Return the position of the best of `size` random contestants, the first drawn among equals.

    Args:
        fitness: Minimised, infinite for the unranked, shape ``(n,)``.
        size: Contestants, drawn with replacement; a ranked one is always preferred to an unranked one.
        rng: Draws the contestants.
    """
    contestants = rng.integers(fitness.size, size=size)
    return int(contestants[np.argmin(fitness[contestants])])


def crossed(
    mother: FloatArray, father: FloatArray, probability: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return two children that have swapped each gene with a probability (uniform crossover)."""
    swap = rng.random(mother.size) < probability
    return np.where(swap, father, mother), np.where(swap, mother, father)


def mutated(
    component: Component, vector: FloatArray, probability: float, rng: np.random.Generator
) -> FloatArray:
    """Return a copy in which each gene has mutated with a probability; it may need repair.

    Numbers get a Gaussian step of their parameter's sigma, categories are redrawn uniformly (and may stay).
    """
    hit = rng.random(vector.size) < probability
    steps = rng.standard_normal(vector.size)
    child = np.array(vector)
    for position, parameter in enumerate(component.parameters):
        if not hit[position]:
            continue
        if isinstance(parameter, Categorical):
            child[position] = parameter.draw(rng)
        else:
            child[position] += parameter.mutation_sigma * steps[position]
    return child


def offspring(
    component: Component,
    mother: FloatArray,
    father: FloatArray,
    *,
    crossover: float,
    mutation: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return two children of two parents, repaired and read-only.

    Args:
        component: What the vectors belong to.
        mother: Complies with the component.
        father: Complies with the component.
        crossover: Probability that a gene is swapped.
        mutation: Probability that a gene mutates.
        rng: All chance comes from it.
    """
    parents = component.unset_dormant(mother), component.unset_dormant(father)
    children = crossed(*parents, crossover, rng)
    first, second = (component.repair(mutated(component, c, mutation, rng), rng) for c in children)
    return first, second
