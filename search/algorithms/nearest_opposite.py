"""`nearest-opposite@1`: each unsafe solution and the nearest safe one, bisected until they nearly coincide.

The simplest search for pairs. It explores at random, takes each unsafe solution with the safe one nearest to it, in
whatever category, simulates the safe one under the episode seed of the unsafe one, and then goes half the way between
the two, under the same seed: while several units differ, it takes over some of them; at last it halves one. It learns
nothing and checks no pair. Unsafe solutions come in the order of the distance to their opposite; those whose middle
would be too close to another pair are left out. The rest of the budget explores further.

Source: ours, as a baseline; `Steps.between` has the steps.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerState, PairConfig, stored_rows
from brink.search.algorithms.pool import random_rows
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.pairs import Steps, midpoints
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator

_NOBODY = -1


class Status(IntEnum):
    """Progress of a bracket. The numbers are stored."""

    PENDING = 0
    """The safe side is being simulated under the seed of the unsafe one."""
    OPEN = 1
    """Not tight yet."""
    TIGHT = 2
    CLOSED = 3
    """The safe side is unsafe under the other seed, a simulation failed, or no step is left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestOppositeConfig(PairConfig):
    """Settings of the search."""

    explore: float = setting(0.4, help="Share of the budget for random draws at the start.", ge=0.01, le=1)
    generation_size: int = setting(20, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(3, help="Generations in flight at a time.", ge=1, le=1000)


class Bracket(NamedTuple):
    """A safe and an unsafe solution, by their numbers.

    Attributes:
        safe: Number of the safe side; while it is being simulated again, that of its first simulation.
        unsafe: Number of the unsafe side.
        seed: Number of the candidate whose episode seed both share.
        status: How far it is.
    """

    safe: int
    unsafe: int
    seed: int
    status: Status


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NearestOppositeState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        brackets: All brackets, in the order in which they were opened.
        jobs: The bracket that each candidate in flight or queued is for, in the order of asking; -1 for none.
        drawn: Numbers of the random solutions with a verdict.
    """

    config: NearestOppositeConfig
    brackets: tuple[Bracket, ...] = ()
    jobs: tuple[int, ...] = ()
    drawn: frozenset[int] = frozenset()


class NearestOpposite(LedgerAlgorithm[NearestOppositeConfig, NearestOppositeState]):
    """Bisection between unsafe solutions and the nearest safe ones."""

    id = "nearest-opposite@1"
    finds = ("pairs",)
    minimises = ""
    summary = "Nearest opposite: bisection between random unsafe solutions and the safe ones nearest to them."
    config_type = NearestOppositeConfig

    def _min_budget(self, space: SearchSpace, config: NearestOppositeConfig) -> int:
        return 1

    def _first_state(self, ledger: Ledger, config: NearestOppositeConfig) -> NearestOppositeState:
        return _planned(NearestOppositeState(config=config, ledger=ledger))

    def tell(
        self, state: NearestOppositeState, evaluations: Mapping[int, Evaluation]
    ) -> NearestOppositeState:
        """Return the state after the pending generation was evaluated."""
        told = state.ledger.pending
        jobs = state.jobs[: len(told)]
        evaluated = replace(state, ledger=state.ledger.tell(evaluations), jobs=state.jobs[len(told) :])
        scored = {number: one for number, one in evaluations.items() if isinstance(one, Scored)}
        drawn = {one.number for one, job in zip(told, jobs, strict=True) if job == _NOBODY} & scored.keys()
        answers = {job: one.number for one, job in zip(told, jobs, strict=True) if job != _NOBODY}
        return _planned(_narrowed(replace(evaluated, drawn=evaluated.drawn | drawn), answers, scored))

    def _refilled(self, state: NearestOppositeState) -> NearestOppositeState:
        return _planned(state)

    def _content(self, state: NearestOppositeState) -> tuple[dict[str, Any], dict[str, Any]]:
        arrays = {
            "brackets": np.reshape(state.brackets, (-1, 4)).astype(np.float64),
            "jobs": np.reshape(state.jobs, (-1, 1)).astype(np.float64),
            "drawn": np.reshape(sorted(state.drawn), (-1, 1)).astype(np.float64),
        }
        return {}, arrays

    def _restored(
        self, ledger: Ledger, config: NearestOppositeConfig, document: Document
    ) -> NearestOppositeState:
        def table(name: str, width: int) -> list[list[int]]:
            rows: list[list[int]] = stored_rows(document, name, width).astype(np.int64).tolist()
            return rows

        try:
            brackets = tuple(Bracket(a, b, c, Status(d)) for a, b, c, d in table("brackets", 4))
        except ValueError as error:
            raise DocumentError(f"brackets: {error}") from None
        jobs, drawn = tuple(job for (job,) in table("jobs", 1)), frozenset(n for (n,) in table("drawn", 1))
        simulated = set(ledger.archive.numbers.tolist())
        sides = {number for bracket in brackets for number in (bracket.safe, bracket.unsafe, bracket.seed)}
        if unknown := (sides | drawn) - simulated:
            raise DocumentError(f"brackets, drawn: {min(unknown)} is none of the solutions of this campaign")
        waiting = ledger.in_flight + len(ledger.queue)
        if len(jobs) != waiting or not set(jobs) <= {_NOBODY, *range(len(brackets))}:
            raise DocumentError(
                f"jobs: expected a bracket, or -1, for each of {waiting} candidates, got {jobs}"
            )
        return NearestOppositeState(config=config, ledger=ledger, brackets=brackets, jobs=jobs, drawn=drawn)


def _narrowed(
    state: NearestOppositeState, answers: Mapping[int, int], scored: Mapping[int, Scored]
) -> NearestOppositeState:
    """Return the state with brackets narrowed.

    Args:
        state: The state whose ledger has been told the generation.
        answers: Number of the candidate that was simulated for a bracket, by the bracket's place.
        scored: The evaluations that have verdicts, by number.
    """
    brackets, steps = list(state.brackets), Steps(state.ledger.space)
    for place, number in answers.items():
        bracket, answer = brackets[place], scored.get(number)
        if answer is None or (bracket.status is Status.PENDING and answer.unsafe):
            brackets[place] = bracket._replace(status=Status.CLOSED)
            continue
        narrower = bracket._replace(unsafe=number) if answer.unsafe else bracket._replace(safe=number)
        ends = _row(state.ledger, narrower.safe), _row(state.ledger, narrower.unsafe)
        status = Status.TIGHT if steps.is_tight(*ends, state.config.eps) else Status.OPEN
        brackets[place] = narrower._replace(status=status)
    return replace(state, brackets=tuple(brackets))


def _row(ledger: Ledger, number: int) -> FloatArray:
    row: FloatArray = ledger.archive.vectors[int(np.searchsorted(ledger.archive.numbers, number))]
    return row


def _planned(state: NearestOppositeState) -> NearestOppositeState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return state
    wanted = int(min(config.generation_size, ledger.left))
    rng = generator(ledger.seed, Stream.NEAREST_OPPOSITE, ledger.planned_generation)
    rows: list[FloatArray] = []
    seeds: list[int | None] = []
    jobs: list[int] = []
    reachable = min(ledger.budget, ledger.space.size)
    unexplored = max(0, round(config.explore * reachable) - ledger.spent - ledger.in_flight)
    if unexplored < wanted:
        state, probes = _probes(state, wanted - unexplored, rng)
        state, opposites = _opened(state, wanted - unexplored - len(probes))
        for job, row in (probes | opposites).items():
            rows.append(row)
            seeds.append(state.brackets[job].seed)
            jobs.append(job)
        if rows or ledger.flight:  # what the open brackets need is not spent on exploring meanwhile
            spare = max(unexplored, math.floor(ledger.left - len(rows) - _needed(state)))
            wanted = min(wanted, len(rows) + max(0, spare))
    more = random_rows(ledger, wanted - len(rows), rng)
    seeds += [None] * len(more)
    jobs += [_NOBODY] * len(more)
    return replace(state, ledger=ledger.plan([*rows, *more], seed_numbers=seeds), jobs=(*state.jobs, *jobs))


def _probes(
    state: NearestOppositeState, most: int, rng: np.random.Generator
) -> tuple[NearestOppositeState, dict[int, FloatArray]]:
    """Return the state, and a solution between the sides of each open bracket that waits for none, by its place."""
    steps, brackets = Steps(state.ledger.space), list(state.brackets)
    probes: dict[int, FloatArray] = {}
    busy = set(state.jobs)
    for place, bracket in enumerate(brackets):
        if bracket.status is not Status.OPEN or place in busy or len(probes) == most:
            continue
        ends = _row(state.ledger, bracket.safe), _row(state.ledger, bracket.unsafe)
        row = steps.between(*ends, rng, eps=state.config.eps)
        if row is None:
            brackets[place] = bracket._replace(status=Status.CLOSED)
        else:
            probes[place] = row
    return replace(state, brackets=tuple(brackets)), probes


def _opened(state: NearestOppositeState, most: int) -> tuple[NearestOppositeState, dict[int, FloatArray]]:
    """Return the state with brackets opened, as far as the budget is expected to finish them, and their safe sides.

    Args:
        state: The state.
        most: Most brackets.
    """
    ledger, config, steps = state.ledger, state.config, Steps(state.ledger.space)
    allowance = ledger.left - _needed(state)
    brackets, opposites = list(state.brackets), dict[int, FloatArray]()
    kept = [b for b in brackets if b.status is not Status.CLOSED]
    taken = [_middle(ledger, b.safe, b.unsafe) for b in kept]
    for distance, safe, unsafe in _nearest_opposites(state):
        middle = _middle(ledger, safe, unsafe)
        cost = 1 + _steps_left(distance, config.eps)
        if len(opposites) == most or allowance < cost:
            break
        if taken and (steps.metric.between(middle[None], np.array(taken)) < config.d_th).any():
            continue
        allowance -= cost
        taken.append(middle)
        opposites[len(brackets)] = _row(ledger, safe)
        brackets.append(Bracket(safe, unsafe, unsafe, Status.PENDING))
    return replace(state, brackets=tuple(brackets)), opposites


def _needed(state: NearestOppositeState) -> int:
    """Return how many probes the brackets that are not tight yet are expected to need."""
    ledger, steps = state.ledger, Steps(state.ledger.space)
    return sum(
        _steps_left(
            steps.distance(_row(ledger, bracket.safe), _row(ledger, bracket.unsafe)), state.config.eps
        )
        for bracket in state.brackets
        if bracket.status in (Status.PENDING, Status.OPEN)
    )


def _steps_left(distance: float, eps: float) -> int:
    """Return how many probes a bracket is expected to need."""
    return max(0, math.ceil(math.log2(distance / eps))) if distance > 0 else 0


def _middle(ledger: Ledger, safe: int, unsafe: int) -> FloatArray:
    middle: FloatArray = midpoints(_row(ledger, safe)[None], _row(ledger, unsafe)[None], ledger.space)[0]
    return middle


def _nearest_opposites(state: NearestOppositeState) -> list[tuple[float, int, int]]:
    """Return each unsafe random solution that was not tried yet with the nearest safe one.

    Returns:
        Distance, number of the safe one, number of the unsafe one; ascending.
    """
    archive = state.ledger.archive
    tried = {bracket.seed for bracket in state.brackets}
    is_drawn = np.isin(archive.numbers, sorted(state.drawn))
    untried = is_drawn & ~np.isin(archive.numbers, sorted(tried))
    safe, unsafe = np.flatnonzero(is_drawn & ~archive.unsafe), np.flatnonzero(untried & archive.unsafe)
    if not safe.size or not unsafe.size:
        return []
    distances = archive.distances(unsafe, safe)
    nearest = distances.argmin(axis=1)
    numbers = archive.numbers
    return sorted(
        zip(
            distances[np.arange(len(unsafe)), nearest].tolist(),
            numbers[safe[nearest]].tolist(),
            numbers[unsafe].tolist(),
            strict=True,
        )
    )
