"""The drives of the next generation of `tolerance@1`."""

from dataclasses import replace
from typing import Final

import numpy as np

from brink.search.algorithms.tolerance.layout import Draw, Layout
from brink.search.algorithms.tolerance.plan import Plan
from brink.search.algorithms.tolerance.results import Results
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.algorithms.tolerance.state import ToleranceState
from brink.search.curves import LEVELS
from brink.search.streams import Stream, generator

FIRST_SCREENED: Final = 40
"""Drives of each group that are screened first."""

FIRST_DRIVES: Final = 8
"""Drives of a cell that a budget must allow."""


def planned(state: ToleranceState, layout: Layout) -> ToleranceState:
    """Return the state with the next generation queued, as budget, room in flight and results allow."""
    ledger, config = state.ledger, state.config
    if ledger.queue:
        return state
    room = int(min(config.generation_size, ledger.left)) if len(ledger.flight) < config.in_flight else 0
    if room <= 0:
        return state
    plan = Plan(state, layout, room)
    begun, first = len(state.jobs), len(layout.populations) * config.without_error
    for number in range(begun, min(first, begun + room)):
        plan.add_truth(number // config.without_error, number % config.without_error)
    for group in range(len(layout.groups)):
        while plan.room and plan.screened[group] < FIRST_SCREENED:
            plan.add_screening(group)
    if plan.room:
        rng = generator(ledger.seed, Stream.TOLERANCE, Draw.CHOICE, ledger.planned_generation)
        results = Results(state, layout)
        results.plan_truth(plan)
        if config.design == "uniform":
            _plan_uniform(plan, config)
        elif config.design == "random":
            _plan_random(plan, rng)
        elif not results.is_done():
            results.plan_adaptively(plan, rng)
    if not plan.rows:
        return state
    return replace(
        state, ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds), jobs=plan.jobs, roots=tuple(plan.roots)
    )


def _plan_uniform(plan: Plan, config: ToleranceConfig) -> None:
    """Plan equally many drives at equally spaced severities in every cell."""
    step = LEVELS // config.levels
    while plan.room:
        cell = int(np.argmin(plan.planned))
        plan.add_error(cell, step * (1 + int(plan.planned[cell]) % config.levels))


def _plan_random(plan: Plan, rng: np.random.Generator) -> None:
    """Plan equally many drives at random severities in every cell."""
    while plan.room:
        plan.add_error(int(np.argmin(plan.planned)), int(rng.integers(1, LEVELS, endpoint=True)))
