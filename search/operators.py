"""Selection and variation: tournament, uniform crossover and mutation. Pure: parents are never modified.

The zeros of a dormant block become NaN before variation, so that crossover cannot mix them into an active block and
mutation cannot shift them. Repair then draws the missing numbers of active blocks and sets dormant ones back to 0.

Source: Sharifi et al. 2023, breeding of populations. Tournaments of three and the sigmas are not in the paper but in
the authors' code; dormant blocks are ours.
"""

import numpy as np

from brink.search.space import Categorical, Component, FloatArray


def tournament(fitness: FloatArray, size: int, rng: np.random.Generator) -> int:
    """Return the position of the best of `size` random contestants; on ties, the first drawn.

    Args:
        fitness: Minimised, infinite for unranked individuals, shape ``(n,)``.
        size: Number of contestants, drawn with replacement.
        rng: Draws the contestants.
    """
    contestants = rng.integers(fitness.size, size=size)
    return int(contestants[np.argmin(fitness[contestants])])


def crossed(
    mother: FloatArray, father: FloatArray, probability: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return two children with each gene swapped with the given probability (uniform crossover).

    Args:
        mother: Shape ``(d,)``.
        father: Shape ``(d,)``.
        probability: Probability that a gene is swapped.
        rng: Source of all randomness.
    """
    swap = rng.random(mother.size) < probability
    return np.where(swap, father, mother), np.where(swap, mother, father)


def mutated(
    component: Component, vector: FloatArray, probability: float | FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return a copy with each gene mutated with the given probability; it may need repair.

    Numbers get a Gaussian step with their parameter's sigma. Categories are redrawn uniformly, so one may stay the
    same. With probability 1, the category of a child is therefore an independent draw: nothing is inherited.

    Args:
        component: The component of the vector.
        vector: Shape ``(d,)``.
        probability: Probability that a gene mutates: one for all genes, or one for each, shape ``(d,)``.
        rng: Source of all randomness.
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
    mutation: float | FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return two children of two parents, repaired and read-only.

    Args:
        component: The component of the vectors.
        mother: A valid vector, shape ``(d,)``.
        father: A valid vector, shape ``(d,)``.
        crossover: Probability that a gene is swapped.
        mutation: Probability that a gene mutates: one for all genes, or one for each, shape ``(d,)``.
        rng: Source of all randomness.
    """
    parents = component.unset_dormant(mother), component.unset_dormant(father)
    children = crossed(*parents, crossover, rng)
    first, second = (component.repair(mutated(component, c, mutation, rng), rng) for c in children)
    return first, second
