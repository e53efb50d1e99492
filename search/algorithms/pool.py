"""Random solutions from which a search with a surrogate chooses what to simulate.

Repairing a draw takes longer than judging it. The pool therefore keeps the draws of the last generations and adds
some in each, all of them addressed by position: a restored search draws the same ones again.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from brink.search.algorithms.ledger import Ledger
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator

FRESH: Final = 100
"""Solutions that each generation adds."""
KEPT: Final = 5
"""Generations whose solutions are in the pool."""
_ROUNDS: Final = 200
"""Rounds of draws after which a finite space counts as exhausted."""


def random_rows(
    ledger: Ledger, count: int, rng: np.random.Generator, first: Sequence[FloatArray] = ()
) -> list[FloatArray]:
    """Return solutions that were never asked for, each once; fewer if the space has no more.

    Args:
        ledger: All candidates so far.
        count: Number of solutions.
        rng: Source of the draws.
        first: Solutions to begin with; random ones follow.
    """
    rows = ledger.unseen(first) if first else ()
    for _ in range(_ROUNDS):
        if len(rows) >= count:
            break
        drawn = [ledger.space.join(ledger.space.sample(rng)) for _ in range(count - len(rows))]
        rows = ledger.unseen([*rows, *drawn])
    return list(rows[:count])


def pool_draws(ledger: Ledger, stream: Stream, draws: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
    """Return the draws that the next generation is chosen from, by the generation that added them.

    Args:
        ledger: All candidates so far.
        stream: Purpose of the draws.
        draws: Those of an earlier generation, which are not drawn again.
    """
    space, last = ledger.space, ledger.planned_generation

    def drawn(generation: int) -> FloatArray:
        rng = generator(ledger.seed, stream, 1, generation)
        return np.array([space.join(space.sample(rng)) for _ in range(FRESH)])

    generations = range(max(0, last - KEPT + 1), last + 1)
    return {one: draws[one] if one in draws else drawn(one) for one in generations}


def unseen_rows(ledger: Ledger, draws: Mapping[int, FloatArray]) -> FloatArray:
    """Return the solutions of a pool that were never asked for, each once, shape ``(n, d)``."""
    rows = ledger.unseen(row for some in draws.values() for row in some)
    return np.reshape(rows, (-1, ledger.space.dimension))
