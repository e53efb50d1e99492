"""The candidates of the next generation of `edge@1`: checks, probes, partners, anchors, and random draws."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from brink.search.algorithms.edge.anchors import plan_anchors
from brink.search.algorithms.edge.brackets import checks_left, cost
from brink.search.algorithms.edge.partners import plan_partners
from brink.search.algorithms.edge.plan import Plan
from brink.search.algorithms.edge.prior import FEW
from brink.search.algorithms.edge.state import Draw, EdgeState, Purpose, Solutions, Status
from brink.search.algorithms.ledger import Ledger
from brink.search.algorithms.pool import random_rows
from brink.search.pairs import Steps
from brink.search.streams import Stream, generator

_EXPECTED_HITS: Final = 0.8
"""Share of the partners that is expected to open a bracket, before results are available."""


def planned(state: EdgeState) -> EdgeState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return state
    plan = Plan(int(min(config.generation_size, ledger.left)), [], [], [])
    rng = generator(ledger.seed, Stream.EDGE, Draw.GENERATION, ledger.planned_generation)
    for row in ledger.points[: plan.wanted]:
        plan.add(row, None, (Purpose.EXPLORE, 0, 0))
    explored = len(ledger.known) + ledger.spent + ledger.in_flight + len(plan.rows)
    to_explore = max(0, round(config.explore * _reachable(ledger)) - explored)
    if to_explore < plan.wanted:
        _plan_checks(state, plan)
        _plan_probes(state, plan, rng)
        plan.allowance = ledger.left - len(plan.rows) - _reserve(state)
        state = plan_partners(state, plan, plan.room - to_explore)
        plan_anchors(state, plan, plan.room - to_explore)
        if plan.rows or ledger.flight:
            # What the open brackets need is not spent on exploring meanwhile.
            more = min(max(0, plan.room - to_explore), max(0, math.floor(plan.allowance)))
            plan.wanted = len(plan.rows) + min(plan.room, to_explore) + more
    for row in random_rows(ledger, plan.room, rng):
        plan.add(row, None, (Purpose.EXPLORE, 0, 0))
    return replace(
        state, ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds), jobs=(*state.jobs, *plan.jobs)
    )


def _hits(state: EdgeState) -> float:
    """Return the expected share of partners that open a bracket, estimated from those already simulated."""
    return (_EXPECTED_HITS * FEW + len(state.brackets)) / (FEW + state.partnered)


def _reachable(ledger: Ledger) -> int:
    """Return how many different solutions can be simulated."""
    return int(min(ledger.budget, ledger.space.size))


def _reserve(state: EdgeState) -> float:
    """Return the number of simulations that the open brackets are expected to take until they are checked."""
    solutions, steps, config = Solutions(state.ledger.archive), Steps(state.ledger.space), state.config
    total, hits = 0.0, _hits(state)
    for bracket in state.brackets:
        if bracket.status is Status.OPEN:
            total += cost(steps.distance(solutions.row(bracket.safe), solutions.row(bracket.unsafe)), config)
        elif bracket.status is Status.TIGHT:
            total += checks_left(bracket, config)
    in_flight = [candidate for generation in state.ledger.flight for candidate in generation]
    for candidate, (purpose, of, _) in zip(in_flight, state.jobs, strict=True):
        if purpose is Purpose.PARTNER:
            length = steps.distance(solutions.row(of), state.ledger.space.join(candidate.vectors))
            total += hits * cost(length, config)
        elif purpose is Purpose.ANCHOR:
            total += 1 + hits * cost(config.d_th, config)
        elif purpose is not Purpose.EXPLORE:
            total -= 1
    return total


def _busy(state: EdgeState, *purposes: Purpose) -> set[tuple[int, int]]:
    """Return the subjects and sides of the candidates in flight that have one of the purposes."""
    return {(of, side) for purpose, of, side in state.jobs if purpose in purposes}


def _plan_checks(state: EdgeState, plan: Plan) -> None:
    """Plan the checks of tight pairs, those that need fewest first.

    The unsafe side is checked before the safe one, because it fails more often.
    """
    solutions = Solutions(state.ledger.archive)
    busy = _busy(state, Purpose.CHECK)
    tight = [index for index, b in enumerate(state.brackets) if b.status is Status.TIGHT]
    for index in sorted(tight, key=lambda index: (checks_left(state.brackets[index], state.config), index)):
        bracket = state.brackets[index]
        if not {(index, 0), (index, 1)} & busy and plan.room:
            side = int(bracket.unsafe_checks <= bracket.safe_checks)
            plan.add(solutions.row((bracket.safe, bracket.unsafe)[side]), None, (Purpose.CHECK, index, side))


def _plan_probes(state: EdgeState, plan: Plan, rng: np.random.Generator) -> None:
    """Plan a probe of each open bracket; if the budget does not suffice for all, of the cheapest to finish."""
    solutions, steps, config = Solutions(state.ledger.archive), Steps(state.ledger.space), state.config
    busy = _busy(state, Purpose.PROBE)
    left = state.ledger.left + sum(purpose in (Purpose.PROBE, Purpose.CHECK) for purpose, _, _ in state.jobs)
    left -= sum(checks_left(b, config) for b in state.brackets if b.status is Status.TIGHT)
    costs = {
        index: cost(steps.distance(solutions.row(b.safe), solutions.row(b.unsafe)), config)
        for index, b in enumerate(state.brackets)
        if b.status is Status.OPEN
    }
    for index in sorted(costs, key=lambda index: (costs[index], index)):
        left -= costs[index]
        if left < 0 or not plan.room:
            break
        if (index, 0) not in busy:
            bracket = state.brackets[index]
            row = steps.between(
                solutions.row(bracket.safe), solutions.row(bracket.unsafe), rng, eps=config.eps
            )
            if row is not None:
                plan.add(row, bracket.seed, (Purpose.PROBE, index, 0))
