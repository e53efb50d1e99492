"""Variation of participants: small and major changes, crossover of actions. Pure; what comes out may need repair.

Source: Tian et al., adaptive crossover and mutation.
"""

from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from brink.search.actions.participants import (
    FASTEST_MPS,
    LEAST_ACTIONS,
    LONGEST_S,
    MAGNITUDES,
    MOST_ACTIONS,
    OF_PEDESTRIANS,
    OF_VEHICLES,
    SHORTEST_S,
    Gene,
    Participant,
    magnitude_of,
)
from brink.search.actions.road import REACH_M

Solution: TypeAlias = tuple[Participant, ...]

STEP_SHARE: Final = 0.1
"""Standard deviation of a small change, as a share of a number's range."""

_CHANGED_SHARE: Final = 0.5
"""Share of the numbers that a small change touches."""


def random_gene(participant: Participant, rng: np.random.Generator) -> Gene:
    """Return an action that a participant can do, with random numbers."""
    actions = OF_PEDESTRIANS if participant.on_foot else OF_VEHICLES
    action = actions[int(rng.integers(len(actions)))]
    return Gene(
        action=action,
        duration_s=float(rng.uniform(SHORTEST_S, LONGEST_S)),
        magnitude=magnitude_of(action, float(rng.random())),
    )


def _nudged(value: float, low: float, high: float, rng: np.random.Generator) -> float:
    step = float(rng.standard_normal()) * STEP_SHARE * (high - low)
    if rng.random() >= _CHANGED_SHARE:
        return value
    return min(max(value + step, low), high)


def small_change(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant of which some numbers have changed a little; its actions stay what they are."""
    genes = []
    for gene in participant.genes:
        room = MAGNITUDES[gene.action]
        genes.append(
            replace(
                gene,
                duration_s=_nudged(gene.duration_s, SHORTEST_S, LONGEST_S, rng),
                magnitude=_nudged(gene.magnitude, room.least, room.most, rng),
            )
        )
    return replace(
        participant,
        ds_m=_nudged(participant.ds_m, -REACH_M, REACH_M, rng),
        speed_mps=_nudged(participant.speed_mps, 0.0, FASTEST_MPS[participant.kind], rng),
        genes=tuple(genes),
    )


def major_change(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant whose actions are in another order, one more, or other ones from a place on."""
    genes = list(participant.genes)
    choice = int(rng.integers(3))
    if choice == 0 and len(genes) > 1:
        genes = [genes[place] for place in rng.permutation(len(genes))]
    elif choice == 1 and len(genes) < MOST_ACTIONS:
        genes.insert(int(rng.integers(len(genes) + 1)), random_gene(participant, rng))
    else:
        start = int(rng.integers(len(genes)))
        genes[start:] = [random_gene(participant, rng) for _ in genes[start:]]
    return replace(
        participant,
        ds_m=min(max(participant.ds_m + float(rng.normal(0.0, 0.2 * REACH_M)), -REACH_M), REACH_M),
        genes=tuple(genes),
    )


def prolonged(participant: Participant, rng: np.random.Generator) -> Participant:
    """Return a participant that goes on with random actions after its own."""
    more = int(rng.integers(MOST_ACTIONS - len(participant.genes) + 1))
    return replace(
        participant, genes=(*participant.genes, *(random_gene(participant, rng) for _ in range(more)))
    )


def crossed_genes(
    first: Participant, second: Participant, rng: np.random.Generator
) -> tuple[Participant, Participant]:
    """Return two participants that have swapped their actions after a point of each (single-point crossover)."""
    here, there = (int(rng.integers(1, len(one.genes))) for one in (first, second))
    tails = first.genes[:here] + second.genes[there:], second.genes[:there] + first.genes[here:]
    return tuple(  # type: ignore[return-value]
        replace(one, genes=genes[:MOST_ACTIONS] if len(genes) >= LEAST_ACTIONS else one.genes)
        for one, genes in zip((first, second), tails, strict=True)
    )


def crossed_uniformly(
    first: Solution, second: Solution, rng: np.random.Generator
) -> tuple[Solution, Solution]:
    """Return two solutions that have swapped participants, and actions of those that they kept, by chance."""
    ones, others = list(first), list(second)
    for place in range(min(len(ones), len(others))):
        if rng.random() < 0.5:
            ones[place], others[place] = others[place], ones[place]
        elif ones[place].on_foot == others[place].on_foot:
            ones[place], others[place] = _genes_swapped(ones[place], others[place], rng)
    longer, shorter = (ones, others) if len(ones) > len(others) else (others, ones)
    for participant in longer[len(shorter) :]:
        if rng.random() < 0.5:
            longer.remove(participant)
            shorter.append(participant)
    return tuple(ones), tuple(others)


def _genes_swapped(
    first: Participant, second: Participant, rng: np.random.Generator
) -> tuple[Participant, Participant]:
    mine, yours = list(first.genes), list(second.genes)
    for place in range(min(len(mine), len(yours))):
        if rng.random() < 0.5:
            mine[place], yours[place] = yours[place], mine[place]
    return replace(first, genes=tuple(mine)), replace(second, genes=tuple(yours))


def mutated_randomly(solution: Solution, fresh: Participant, most: int, rng: np.random.Generator) -> Solution:
    """Return a solution with one random change: a small or a major one, or somebody added, replaced or gone.

    Args:
        solution: What changes.
        fresh: Who may come in.
        most: How many participants there may be.
        rng: All chance comes from it.
    """
    changed = list(solution)
    place = int(rng.integers(len(changed)))
    choice = int(rng.integers(5))
    if choice == 0:
        changed[place] = small_change(changed[place], rng)
    elif choice == 1:
        changed[place] = major_change(changed[place], rng)
    elif choice == 2 and len(changed) < most:
        changed.append(fresh)
    elif choice == 3 and len(changed) > 1:
        del changed[place]
    else:
        changed[place] = fresh
    return tuple(changed)
