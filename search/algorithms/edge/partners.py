"""The choice of the partners most likely to have the opposite verdict to simulated solutions."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from brink.search.algorithms.edge.brackets import clear_solutions, cost, ends
from brink.search.algorithms.edge.plan import Plan
from brink.search.algorithms.edge.prior import FEW
from brink.search.algorithms.edge.state import (
    LIKELY,
    Draw,
    Draws,
    EdgeState,
    Partner,
    Purpose,
    Solutions,
    Status,
    varied_columns,
)
from brink.search.algorithms.ledger import row_keys
from brink.search.features import units_of
from brink.search.metric import Metric
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.surrogate import Surrogate, learning_size

MAX_TRIES: Final = 3
"""Partners tried for an anchor."""

REDRAWS: Final = 20
"""Draws anywhere, and as many on the way there, from which the surrogate chooses the partner of each anchor."""

MORE_REDRAWS: Final = 30
"""Further draws of each kind for the most promising anchors of a generation."""

_PROMISING: Final = 3
"""Anchors that get further draws, as a multiple of the partners wanted."""

_MOST_KEPT: Final = 2_000
"""Anchors whose draws are kept."""


def _with_surrogate(state: EdgeState) -> EdgeState:
    """Return the state with an up-to-date surrogate, which is refitted whenever there are 10% more solutions."""
    archive, known = state.ledger.archive, state.ledger.known
    size = learning_size(len(known) + len(archive), one_in=10)
    rows = np.concatenate([known.rows, archive.vectors])[:size]
    unsafe = np.concatenate([known.unsafe, archive.unsafe])[:size]
    if (state.surrogate is not None and state.surrogate.size == size) or unsafe.all() or not unsafe.any():
        return state
    rng = generator(state.ledger.seed, Stream.EDGE, Draw.SURROGATE, size)
    surrogate = Surrogate(state.ledger.space, rows, unsafe, seed=int(rng.integers(2**32, dtype=np.uint64)))
    return replace(state, surrogate=surrogate, partners={})


def _with_chance(state: EdgeState) -> EdgeState:
    """Return the state with an estimate, from checked pairs, of where pairs depend on chance."""
    size = learning_size(len(state.resolved), one_in=10)
    if size < FEW or (state.chance is not None and state.chance.size == size):
        return state
    brackets = [state.brackets[place] for place in state.resolved[:size]]
    chancy = np.array([bracket.status is Status.CHANCY for bracket in brackets])
    if chancy.all() or not chancy.any():
        return state
    _, rows = ends(brackets, Solutions(state.ledger.archive))
    rng = generator(state.ledger.seed, Stream.EDGE, Draw.CHANCE, size)
    chance = Surrogate(state.ledger.space, rows, chancy, seed=int(rng.integers(2**32, dtype=np.uint64)))
    return replace(state, chance=chance)


def plan_partners(state: EdgeState, plan: Plan, count: int) -> EdgeState:
    """Plan the partners most likely to have the opposite verdict; return the state with the tries counted.

    Args:
        state: The state.
        plan: The generation that is being planned.
        count: Most partners. With the brackets that they are expected to open they take no more than the allowance.
    """
    if count <= 0:
        return state
    state = _with_chance(_with_surrogate(state))
    places = possible_anchors(state)
    if state.surrogate is None or not places.size:
        return state
    archive, space = state.ledger.archive, state.ledger.space
    numbers = archive.numbers[places].tolist()
    archive_place = dict(zip(numbers, places.tolist(), strict=True))
    partners, draws = _drawn_partners(state, state.surrogate, archive_place)
    tries = dict(state.tries)
    seen = set(row_keys(archive.vectors))
    chosen: list[int] = []
    chancy = np.zeros(len(places)) if state.chance is None else state.chance.unsafe(archive.vectors[places])
    risk = dict(zip(numbers, chancy.tolist(), strict=True))
    best = sorted(numbers, key=lambda number: (partners[number].rank(risk[number]), number))
    promising = {number: int(archive_place[number]) for number in best[: _PROMISING * count]}
    further = _drawn(state, promising, MORE_REDRAWS, Draw.MORE, state.ledger.planned_generation)
    more = _best_of_draws(state, state.surrogate, promising, further)
    kept = partners
    partners = partners | {n: p for n, p in more.items() if p.rank(0.0) < partners[n].rank(0.0)}
    for number in sorted(numbers, key=lambda number: (partners[number].rank(risk[number]), number)):
        place = archive_place[number]
        partner = partners[number]
        expected = 1 + partner.flips * cost(partner.length, state.config)
        if len(chosen) == count or plan.allowance < expected:
            break
        if chosen and (archive.distances([place], chosen) < state.config.d_th).any():
            continue
        row = _repaired(space, partner.row)
        tries[number] = tries.get(number, 0) + 1
        if row.tobytes() in seen:
            continue
        chosen.append(place)
        plan.allowance -= expected
        plan.add(row, state.seeds.get(number, number), (Purpose.PARTNER, number, 0))
    return replace(state, tries=tries, partners=kept, draws=draws)


def _drawn_partners(
    state: EdgeState, surrogate: Surrogate, anchors: Mapping[int, int]
) -> tuple[dict[int, Partner], dict[int, Draws]]:
    """Return the best partner drawn for each anchor, and the draws.

    Partners are kept until their anchor has been tried or the surrogate has learnt anew.

    Args:
        state: The state.
        surrogate: Judges the draws.
        anchors: Positions in the archive by number.
    """
    attempts = {number: state.tries.get(number, 0) for number in anchors}
    partners = {n: p for n, p in state.partners.items() if attempts.get(n) == p.attempt}
    draws = {n: d for n, d in state.draws.items() if attempts.get(n) == d.attempt}
    missing = {number: place for number, place in anchors.items() if number not in partners}
    undrawn = {number: place for number, place in missing.items() if number not in draws}
    draws |= _drawn(state, undrawn, REDRAWS, Draw.PARTNER)
    partners |= _best_of_draws(state, surrogate, missing, draws)
    return partners, dict(itertools.islice(draws.items(), _MOST_KEPT))


def _drawn(state: EdgeState, anchors: Mapping[int, int], draws: int, *index: int) -> dict[int, Draws]:
    """Draw possible partners of each anchor.

    Args:
        state: The state.
        anchors: Positions in the archive by number.
        draws: Half the number of draws for each anchor.
        index: Position of the draws in the stream, before the anchor's number and its attempts.
    """
    archive, space = state.ledger.archive, state.ledger.space
    varied, metric = varied_columns(space, state.config), Metric.of_space(space)
    drawn = {}
    for number, place in anchors.items():
        attempt = state.tries.get(number, 0)
        row = archive.vectors[place]
        rng = generator(state.ledger.seed, Stream.EDGE, *index, number, attempt)
        rows = redrawn_rows(space, row, varied, draws, rng)
        drawn[number] = Draws(attempt, rows, metric.between(row[None], rows)[0])
    return drawn


def _best_of_draws(
    state: EdgeState, surrogate: Surrogate, anchors: Mapping[int, int], draws: Mapping[int, Draws]
) -> dict[int, Partner]:
    """Return the best of the partners drawn for each anchor.

    Args:
        state: The state.
        surrogate: Judges the draws.
        anchors: Positions in the archive by number.
        draws: As many for each anchor.
    """
    chosen = [draws[number] for number in anchors]
    unsafe = state.ledger.archive.unsafe[list(anchors.values())]
    return dict(zip(anchors, best_partners(surrogate, unsafe, chosen), strict=True))


def best_partners(surrogate: Surrogate, unsafe: BoolArray, draws: Sequence[Draws]) -> list[Partner]:
    """Return the best of the partners drawn for each of several anchors.

    Args:
        surrogate: Judges the draws.
        unsafe: Verdicts of the anchors, shape ``(n,)``.
        draws: As many for each anchor.
    """
    if not draws:
        return []
    rows = np.concatenate([draw.rows for draw in draws])
    risk = surrogate.unsafe(rows).reshape(len(draws), -1)
    flips = np.where(unsafe[:, None], 1 - risk, risk)
    partners = []
    for one, chances in zip(draws, flips, strict=True):
        best = int(np.lexsort((one.lengths, -np.minimum(chances, LIKELY)))[0])
        partners.append(
            Partner(
                row=one.rows[best],
                attempt=one.attempt,
                flips=float(chances[best]),
                length=float(one.lengths[best]),
            )
        )
    return partners


def possible_anchors(state: EdgeState) -> IntArray:
    """Return the positions of possible anchors: clear, not tried too often, far from all brackets."""
    archive, config = state.ledger.archive, state.config
    tried = np.array([state.tries.get(number, 0) for number in archive.numbers.tolist()])
    eligible = (tried < MAX_TRIES) & clear_solutions(state)
    in_flight = {of for purpose, of, _ in state.jobs if purpose is Purpose.PARTNER}
    eligible &= ~np.isin(archive.numbers, list(in_flight))
    places = np.flatnonzero(eligible)
    solutions = Solutions(archive)
    kept = [b for b in state.brackets if b.status not in (Status.GIVEN_UP, Status.NEAR)]
    ends = [solutions.place(number) for b in kept for number in (b.safe, b.unsafe)]
    if ends and places.size:
        places = places[(archive.distances(places, ends) >= config.d_th).all(axis=1)]
    if state.prior is not None and places.size:
        apart = archive.metric.between(archive.vectors[places], state.prior.ends) >= config.d_th
        places = places[apart.all(axis=1)]
    return places


def redrawn_rows(
    space: SearchSpace, row: FloatArray, varied: BoolArray, draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return rows with the varied columns drawn again: anywhere in one half, on the way there in the other half.

    Args:
        space: The space.
        row: A valid solution, shape ``(d,)``.
        varied: Which columns may change, shape ``(d,)``; dormant numbers do not.
        draws: Half the number of rows.
        rng: Source of the draws.

    Returns:
        The rows before repair, shape ``(2 * draws, d)``.
    """
    free = varied & ~space.dormant(row)
    anywhere = np.where(free, space.draw_unrepaired(draws, rng), row)
    on_the_way = row + rng.random((draws, 1)) * (anywhere - row)
    taken = rng.random(anywhere.shape) < 0.5
    on_the_way = np.where(space.categorical, np.where(taken, anywhere, row), on_the_way)
    rows = np.concatenate([anywhere, on_the_way])
    low, high = np.array([unit for unit in units_of(space) if len(unit) == 2], np.int64).reshape(-1, 2).T
    both = free[low] & free[high]
    low, high = low[both], high[both]
    first, second = rows[:, low], rows[:, high]
    rows[:, low], rows[:, high] = np.minimum(first, second), np.maximum(first, second)
    return rows


def _repaired(space: SearchSpace, row: FloatArray) -> FloatArray:
    """Return the nearest valid solution; no number of `row` is missing, so nothing is drawn."""
    return space.join(space.repair(space.split(row), np.random.Generator(np.random.PCG64(0))))
