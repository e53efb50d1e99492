"""The choice of unsimulated solutions that are likely to have partners."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from brink.search.algorithms.edge.brackets import cost
from brink.search.algorithms.edge.partners import REDRAWS, best_partners, possible_anchors, redrawn_rows
from brink.search.algorithms.edge.plan import Plan
from brink.search.algorithms.edge.prior import Prior, least_clear
from brink.search.algorithms.edge.state import (
    Draw,
    Draws,
    EdgeState,
    Purpose,
    Solutions,
    Status,
    varied_columns,
)
from brink.search.algorithms.ledger import row_keys
from brink.search.metric import Metric
from brink.search.space import BoolArray, FloatArray
from brink.search.streams import Stream, generator
from brink.search.surrogate import Surrogate

_MOST_PROPOSED: Final = 500
"""Known solutions, and as many new ones, drawn at random, from which the anchors of a generation are chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Proposals:
    """Solutions where a bracket may begin, none of them simulated by this search.

    Attributes:
        rows: The solutions, shape ``(n, d)``.
        unsafe: Their verdicts, as known or as the surrogate judges, shape ``(n,)``.
        certainty: How certain these are, shape ``(n,)``.
    """

    rows: FloatArray
    unsafe: BoolArray
    certainty: FloatArray


def plan_anchors(state: EdgeState, plan: Plan, count: int) -> None:
    """Plan to simulate solutions likely to have partners, where the search has no anchors of its own.

    Args:
        state: The state; its surrogate is up to date.
        plan: The generation that is being planned.
        count: Most anchors. With their partners and brackets they are expected to take no more than the allowance.
    """
    if count <= 0 or state.prior is None or state.surrogate is None:
        return
    space, config, metric = state.ledger.space, state.config, Metric.of_space(state.ledger.space)
    rng = generator(state.ledger.seed, Stream.EDGE, Draw.PROPOSED, state.ledger.planned_generation)
    proposals = _proposals(state, state.prior, state.surrogate, rng)
    rows, varied = proposals.rows, varied_columns(space, config)
    redrawn = [redrawn_rows(space, row, varied, REDRAWS, rng) for row in rows]
    draws = [
        Draws(0, some, metric.between(row[None], some)[0]) for row, some in zip(rows, redrawn, strict=True)
    ]
    partners = [
        replace(partner, flips=partner.flips * sure)
        for partner, sure in zip(
            best_partners(state.surrogate, proposals.unsafe, draws), proposals.certainty.tolist(), strict=True
        )
    ]
    chancy = np.zeros(len(rows)) if state.chance is None else state.chance.unsafe(rows)
    ranks = [partner.rank(risk) for partner, risk in zip(partners, chancy.tolist(), strict=True)]
    chosen: list[int] = []
    for place in sorted(range(len(rows)), key=lambda place: (ranks[place], place)):
        expected = 2 + partners[place].flips * cost(partners[place].length, config)
        if len(chosen) == count or plan.allowance < expected:
            break
        if (metric.between(rows[place][None], rows[chosen]) < config.d_th).any():
            continue
        chosen.append(place)
        plan.allowance -= expected
        plan.add(rows[place], None, (Purpose.ANCHOR, 0, 0))


def _proposals(state: EdgeState, prior: Prior, surrogate: Surrogate, rng: np.random.Generator) -> _Proposals:
    """Propose known and random solutions as new anchors.

    They are clear, not simulated by this search yet, and far from known pairs, from all brackets and from the anchors
    that the search has or waits for.
    """
    ledger, d_th = state.ledger, state.config.d_th
    safe, unsafe = least_clear(ledger.archive, ledger.known, state.config.margin)
    clear = np.flatnonzero(np.abs(prior.robustness) >= np.where(prior.unsafe, unsafe, safe))
    places = rng.permutation(clear)[:_MOST_PROPOSED]
    drawn = np.array([ledger.space.join(ledger.space.sample(rng)) for _ in range(_MOST_PROPOSED)])
    risk = surrogate.unsafe(drawn)
    rows = np.concatenate([prior.rows[places], drawn])
    in_flight = [candidate for generation in ledger.flight for candidate in generation]
    waiting = [
        ledger.space.join(candidate.vectors)
        for candidate, (purpose, _, _) in zip(in_flight, state.jobs, strict=True)
        if purpose is Purpose.ANCHOR
    ]
    asked = {*row_keys(ledger.archive.vectors), *row_keys(ledger.failed), *(row.tobytes() for row in waiting)}
    fresh = np.array([key not in asked for key in row_keys(rows)], np.bool_)
    brackets = [b for b in state.brackets if b.status not in (Status.GIVEN_UP, Status.NEAR)]
    solutions = Solutions(ledger.archive)
    ends = [solutions.row(number) for b in brackets for number in (b.safe, b.unsafe)]
    own = ledger.archive.vectors[possible_anchors(state)]
    taken = np.concatenate([prior.ends, own, np.reshape([*ends, *waiting], (-1, ledger.space.dimension))])
    new = fresh & (Metric.of_space(ledger.space).between(rows, taken) >= d_th).all(axis=1)
    return _Proposals(
        rows=rows[new],
        unsafe=np.concatenate([prior.unsafe[places], risk > 0.5])[new],
        certainty=np.concatenate([np.ones(len(places)), np.maximum(risk, 1 - risk)])[new],
    )
