"""`edge@1`: pairs of solutions across the boundary, one safe, one unsafe, narrowed until little is left between them.

The search explores at random, then looks for *partners*: the numbers of a simulated solution, its *anchor*, are drawn
again, and the draw that a surrogate considers most likely to change the verdict is simulated under the anchor's
episode seed. If the verdict changes, the two are a *bracket*. A *probe* between them, under the same seed, replaces
the end whose verdict it shares, until the bracket is a tight pair. *Checks* then simulate both sides again, each
under a seed of its own; a pair that does not keep its verdicts is a chancy place.

The sides of a bracket share an episode seed: otherwise chance would decide where the verdict changes. When the budget
only just suffices to finish the open brackets, no more are opened, and generations become smaller.

A search that starts from known results explores less by as many. The surrogate learns from them, and then proposes
anchors, known solutions and new ones. No bracket rests on a known result: a known solution is simulated again under a
seed of this search. Where known results are a pair already, the search looks for no further one.

Source: ours; see docs/explanation/pairs.md.
"""

import itertools
import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np

from brink.extras import install_command
from brink.search.algorithm import Candidate, Evaluation, Known, Scored
from brink.search.algorithms.ledger import (
    BoundaryConfig,
    Ledger,
    LedgerState,
    WarmLedgerAlgorithm,
    row_keys,
    stored_rows,
)
from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, SpaceError
from brink.search.features import units_of
from brink.search.metric import Metric
from brink.search.pairs import Steps, midpoints
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.surrogate import EXTRA, Surrogate, is_available

MAX_TRIES: Final = 3
"""Partners tried for an anchor."""
REDRAWS: Final = 20
"""Draws anywhere, and as many on the way there, from which the surrogate chooses the partner of each anchor."""
MORE_REDRAWS: Final = 30
"""Further draws of each kind for the most promising anchors of a generation."""
MAX_FAILURES: Final = 3
"""Probes or checks of a bracket that may fail before it is given up."""
_FEW: Final = 20
"""Solutions of each verdict below which nothing is too close to call."""
_EXPECTED_HITS: Final = 0.8
"""Share of the partners that is expected to open a bracket until results tell."""
_PROMISING: Final = 3
"""Anchors that get further draws, as a multiple of the partners wanted."""
_MOST_KEPT: Final = 2_000
"""Anchors whose draws are kept."""
_LIKELY: Final = 0.75
"""Probability of the opposite verdict from which on a nearer partner is better than a likelier one."""
_MOST_PROPOSED: Final = 500
"""Known solutions, and as many new ones, drawn at random, from which the anchors of a generation are chosen."""
# What is drawn, as the first index of the stream.
_GENERATION, _SURROGATE, _PARTNER, _MORE, _CHANCE, _PROPOSED = range(6)


class Purpose(IntEnum):
    """Why a candidate is simulated. The numbers are stored."""

    EXPLORE = 0
    PARTNER = 1
    PROBE = 2
    CHECK = 3
    ANCHOR = 4
    """A solution, known or new, that is simulated so that a bracket may begin there."""


class Status(IntEnum):
    """How far a bracket is. The numbers are stored."""

    OPEN = 0
    """Not tight yet."""
    TIGHT = 1
    """Tight, and to be checked."""
    KEPT = 2
    """Tight, and both sides kept their verdicts under other seeds."""
    CHANCY = 3
    """Tight, but a side changed its verdict under another seed."""
    GIVEN_UP = 4
    """Too many simulations failed."""
    NEAR = 5
    """Not tight yet, and probably too close to a tight pair to be distinct, wherever it ends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeConfig(BoundaryConfig):
    """Settings of the search for pairs."""

    eps: float = setting(
        0.02,
        label="Distance within a pair",
        main=True,
        help="Largest distance of a tight pair.",
        ge=1e-6,
        le=1,
    )
    d_th: float = setting(
        0.2,
        label="Distance between pairs",
        main=True,
        help="Smallest distance between two distinct pairs.",
        ge=0,
        le=1,
    )
    explore: float = setting(0.4, help="Share of the budget for random draws at the start.", ge=0.01, le=1)
    margin: float = setting(
        0.2,
        help="Share of each verdict's solutions, those nearest to the other verdict, that neither anchor nor open "
        "brackets: where chance matters, they are too close to call.",
        ge=0,
        lt=1,
    )
    checks: int = setting(
        1,
        help="Fresh seeds under which each side of a tight pair is simulated again; 0 where chance has no part.",
        ge=0,
        le=100,
    )
    vary: str = setting(
        "all", help="What the two sides of a pair may differ in: the name of a component, or all of them."
    )
    generation_size: int = setting(20, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        3,
        help="Generations in flight at a time. More keep more workers busy; fewer let every choice know more.",
        ge=1,
        le=1000,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Bracket:
    """A safe and an unsafe solution, by their numbers.

    Attributes:
        safe: Number of the safe side.
        unsafe: Number of the unsafe side.
        seed: Number of the candidate whose episode seed both share.
        status: How far it is.
        failures: Simulations for it that failed.
        safe_checks: Checks in which the safe side was safe.
        unsafe_checks: Checks in which the unsafe side was unsafe.
    """

    safe: int
    unsafe: int
    seed: int
    status: Status = Status.OPEN
    failures: int = 0
    safe_checks: int = 0
    unsafe_checks: int = 0


Job = tuple[Purpose, int, int]
"""Purpose, anchor or bracket, and side of a check: 0 for the safe one, 1 for the unsafe one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        brackets: All brackets, in the order in which they were opened.
        jobs: The purpose of each candidate in flight or queued, in the order of asking.
        seeds: Number of the candidate whose episode seed a solution shares, for those that have none of their own.
        tries: How often a partner of a solution was looked for, by its number. Not each was simulated: where numbers
            are few, the best draw may be known already.
        partnered: Number of partners that were simulated, also those that failed.
        resolved: Positions of the brackets that were kept or found chancy, in the order in which that was known.
        surrogate: Estimates how likely a solution is unsafe; None until it is needed.
        chance: Estimates how likely a pair is a chancy place; None until enough is known.
        partners: The best partner drawn for each anchor, by its number.
        draws: What partners are chosen from, by the anchor's number: judging again is cheaper than drawing again.
        prior: What the known results say; None if there are none.
    """

    config: EdgeConfig
    brackets: tuple[Bracket, ...] = ()
    jobs: tuple[Job, ...] = ()
    seeds: Mapping[int, int]
    tries: Mapping[int, int]
    partnered: int = 0
    resolved: tuple[int, ...] = ()
    surrogate: Surrogate | None = None
    chance: Surrogate | None = None
    partners: Mapping[int, "_Partner"] = field(default_factory=dict)
    draws: Mapping[int, "_Draws"] = field(default_factory=dict)
    prior: "_Prior | None" = None


class Edge(WarmLedgerAlgorithm[EdgeConfig, EdgeState]):
    """The search for pairs across the boundary."""

    id = "edge@1"
    summary = (
        "Pairs across the boundary: one safe, one unsafe solution, and the smallest change between them."
    )
    config_type = EdgeConfig
    layout = 2

    def _min_budget(self, space: SearchSpace, config: EdgeConfig) -> int:
        if not is_available():
            raise ConfigError("id", f"edge@1 needs scikit-learn: {install_command(EXTRA)}")
        try:
            _varied(space, config)
        except SpaceError as error:
            raise ConfigError("vary", f"expected all or the name of a component; {error}") from None
        return 1

    def _first_state(self, ledger: Ledger, config: EdgeConfig) -> EdgeState:
        prior = _Prior.of(ledger.known, Steps(ledger.space), config.eps)
        return _planned(EdgeState(config=config, ledger=ledger, seeds={}, tries={}, prior=prior))

    def _refilled(self, state: EdgeState) -> EdgeState:
        return _planned(state)

    def tell(self, state: EdgeState, evaluations: Mapping[int, Evaluation]) -> EdgeState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        told = replace(state, ledger=state.ledger.tell(evaluations), jobs=state.jobs[len(pending) :])
        return _planned(_learnt(told, pending, state.jobs[: len(pending)], evaluations))

    def _content(self, state: EdgeState) -> tuple[dict[str, Any], dict[str, Any]]:
        brackets = [
            (b.safe, b.unsafe, b.seed, b.status, b.failures, b.safe_checks, b.unsafe_checks)
            for b in state.brackets
        ]
        arrays = {
            "brackets": np.reshape(brackets, (-1, 7)).astype(np.float64),
            "jobs": np.reshape(state.jobs, (-1, 3)).astype(np.float64),
            "seeds": np.reshape(sorted(state.seeds.items()), (-1, 2)).astype(np.float64),
            "tries": np.reshape(sorted(state.tries.items()), (-1, 2)).astype(np.float64),
            "resolved": np.reshape(state.resolved, (-1, 1)).astype(np.float64),
        }
        return {"partnered": state.partnered}, arrays

    def _restored(self, ledger: Ledger, config: EdgeConfig, document: Document) -> EdgeState:
        def table(name: str, width: int) -> list[tuple[int, ...]]:
            return [tuple(row) for row in stored_rows(document, name, width).astype(np.int64).tolist()]

        try:
            brackets = tuple(
                Bracket(
                    safe=a, unsafe=b, seed=c, status=Status(d), failures=e, safe_checks=f, unsafe_checks=g
                )
                for a, b, c, d, e, f, g in table("brackets", 7)
            )
            jobs = tuple((Purpose(a), b, c) for a, b, c in table("jobs", 3))
        except ValueError as error:
            raise DocumentError(f"brackets, jobs: {error}") from None
        if len(jobs) != ledger.in_flight + len(ledger.queue):
            raise DocumentError(
                f"jobs: expected one for each of {ledger.in_flight + len(ledger.queue)} candidates, got {len(jobs)}"
            )
        seeds, tries = ({a: b for a, b in table(name, 2)} for name in ("seeds", "tries"))  # noqa: C416
        resolved = tuple(place for (place,) in table("resolved", 1))
        partnered = document.header.get("partnered")
        if not isinstance(partnered, int) or not 0 <= partnered <= ledger.spent:
            raise DocumentError(
                f"partnered: expected a number from 0 to {ledger.spent}, got {partnered!r:.80}"
            )
        known = set(ledger.archive.numbers.tolist())
        unsafe = set(ledger.archive.numbers[ledger.archive.unsafe].tolist())
        numbered = set(range(ledger.spent + ledger.in_flight + len(ledger.queue)))
        _check_references("brackets", {n for b in brackets for n in (b.safe, b.unsafe)}, known)
        _check_references("brackets", {b.seed for b in brackets}, numbered)
        if any(b.safe in unsafe or b.unsafe not in unsafe for b in brackets):
            raise DocumentError("brackets: a side does not have the verdict of its side")
        _check_references("seeds", {n for both in seeds.items() for n in both}, numbered)
        _check_references("tries", tries.keys(), known)
        _check_references("resolved", set(resolved), set(range(len(brackets))))
        for purpose, of, side in jobs:
            if purpose is Purpose.PARTNER:
                _check_references("jobs", {of}, known)
            elif purpose in (Purpose.PROBE, Purpose.CHECK):
                _check_references("jobs", {of}, set(range(len(brackets))))
                _check_references("jobs", {side}, {0, 1})
        return EdgeState(
            config=config,
            ledger=ledger,
            brackets=brackets,
            jobs=jobs,
            seeds=seeds,
            tries=tries,
            partnered=partnered,
            resolved=resolved,
            prior=_Prior.of(ledger.known, Steps(ledger.space), config.eps),
        )


def _check_references(name: str, named: Set[int], known: Set[int]) -> None:
    if unknown := named - known:
        raise DocumentError(f"{name}: {min(unknown)} is none of the solutions or brackets of this campaign")


def _varied(space: SearchSpace, config: EdgeConfig) -> BoolArray:
    """Return which columns the two sides of a bracket may differ in, shape ``(d,)``.

    Numbers alone if the varied components have any: two solutions in the same categories are easier to compare.

    Raises:
        SpaceError: There is no such component.
    """
    varied = np.ones(space.dimension, np.bool_)
    if config.vary != "all":
        varied[:] = False
        varied[space.slices[space.index(config.vary)]] = True
    numbers = varied & ~space.categorical
    return numbers if numbers.any() else varied


class _Known:
    """What is known of the simulated solutions, by their numbers."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive

    def place(self, number: int) -> int:
        """Return the position of a solution in the archive."""
        return int(np.searchsorted(self._archive.numbers, number))

    def row(self, number: int) -> FloatArray:
        """Return a solution."""
        row: FloatArray = self._archive.vectors[self.place(number)]
        return row


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prior:
    """What the known results say.

    Attributes:
        rows: Possible anchors: solutions whose known results agree, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
        robustness: The robustness of the first known result of each, shape ``(n,)``.
        ends: Solutions that are a tight pair with another one, whether or not it holds, shape ``(m, d)``.
        middles: The middles of these pairs, shape ``(p, d)``.
    """

    rows: FloatArray
    unsafe: BoolArray
    robustness: FloatArray
    ends: FloatArray
    middles: FloatArray

    @classmethod
    def of(cls, known: Known, steps: Steps, eps: float) -> "_Prior | None":
        """Return what known results say; None if there are none.

        Args:
            known: The known results.
            steps: Geometry of their space.
            eps: Largest distance of a tight pair.
        """
        if not len(known):
            return None
        _, first, which = np.unique(known.rows, axis=0, return_index=True, return_inverse=True)
        which = which.reshape(-1)
        times, unsafe = np.bincount(which), np.bincount(which, weights=known.unsafe)
        agree = np.sort(first[(unsafe == 0) | (unsafe == times)])
        sides = _tight_sides(known, steps, eps)
        return cls(
            rows=known.rows[agree],
            unsafe=known.unsafe[agree],
            robustness=known.robustness[agree],
            ends=np.concatenate(sides),
            middles=midpoints(*sides, steps.space),
        )


def _tight_sides(known: Known, steps: Steps, eps: float) -> tuple[FloatArray, FloatArray]:
    """Return the sides of tight pairs among known results: each unsafe one with the safe one nearest to it.

    Returns:
        The safe and the unsafe sides, both of shape ``(p, d)``.
    """
    safe, unsafe = known.rows[~known.unsafe], known.rows[known.unsafe]
    if not len(safe) or not len(unsafe):
        return known.rows[:0], known.rows[:0]
    distances = steps.metric.between(unsafe, safe)
    nearest = distances.argmin(axis=1)
    close = np.flatnonzero(distances[np.arange(len(unsafe)), nearest] <= steps.largest_tight(eps))
    places = [p for p in close.tolist() if steps.is_tight(safe[nearest[p]], unsafe[p], eps)]
    return safe[nearest[places]], unsafe[places]


def _least_clear(archive: Archive, known: Known, margin: float) -> tuple[float, float]:
    """Return the least size of robustness at which a safe, and an unsafe solution is not too close to call."""
    size = np.abs(np.concatenate([archive.robustness, known.robustness]))
    unsafe = np.concatenate([archive.unsafe, known.unsafe])

    def least(mine: FloatArray) -> float:
        return float(np.quantile(mine, margin)) if len(mine) >= _FEW else 0.0

    return least(size[~unsafe]), least(size[unsafe])


def _clear(state: EdgeState) -> BoolArray:
    """Return which solutions of the archive are not too close to call, shape ``(n,)``."""
    archive = state.ledger.archive
    safe, unsafe = _least_clear(archive, state.ledger.known, state.config.margin)
    clear: BoolArray = np.abs(archive.robustness) >= np.where(archive.unsafe, unsafe, safe)
    return clear


def _learnt(
    state: EdgeState, told: Sequence[Candidate], jobs: Sequence[Job], evaluations: Mapping[int, Evaluation]
) -> EdgeState:
    """Return the state with brackets opened, narrowed and checked by a generation's evaluations."""
    archive, known = state.ledger.archive, _Known(state.ledger.archive)
    steps = Steps(state.ledger.space)
    clear = _clear(state)
    brackets, seeds, resolved = list(state.brackets), dict(state.seeds), list(state.resolved)
    for candidate, (purpose, of, side) in zip(told, jobs, strict=True):
        evaluation = evaluations[candidate.number]
        if candidate.seed_number is not None:
            seeds[candidate.number] = candidate.seed_number
        scored = evaluation if isinstance(evaluation, Scored) else None
        if purpose is Purpose.PARTNER and scored is not None:
            anchor = known.place(of)
            flipped = scored.unsafe != archive.unsafe[anchor]
            if flipped and clear[known.place(candidate.number)]:
                ends = (of, candidate.number) if scored.unsafe else (candidate.number, of)
                opened = Bracket(safe=ends[0], unsafe=ends[1], seed=seeds.get(of, of))
                brackets.append(_narrowed(opened, steps, known, state.config))
        elif purpose is Purpose.PROBE and brackets[of].status is Status.OPEN:
            bracket = brackets[of]
            if scored is None:
                brackets[of] = _failed(bracket)
            else:
                safe, unsafe = (
                    (bracket.safe, candidate.number) if scored.unsafe else (candidate.number, bracket.unsafe)
                )
                narrower = replace(bracket, safe=safe, unsafe=unsafe)
                brackets[of] = _narrowed(narrower, steps, known, state.config)
        elif purpose is Purpose.CHECK:
            bracket = brackets[of]
            if scored is None:
                brackets[of] = _failed(bracket)
            else:
                brackets[of] = _checked(bracket, side, scored.unsafe, state.config.checks)
                if brackets[of].status in (Status.KEPT, Status.CHANCY):
                    resolved.append(of)
    _drop_near(brackets, known, steps, state)
    partnered = state.partnered + sum(purpose is Purpose.PARTNER for purpose, _, _ in jobs)
    return replace(
        state, brackets=tuple(brackets), seeds=seeds, partnered=partnered, resolved=tuple(resolved)
    )


def _drop_near(brackets: list[Bracket], known: _Known, steps: Steps, state: EdgeState) -> None:
    """Drop the open brackets that will probably end closer to a tight pair than distinct pairs may be.

    Tight pairs among the known results count as well.

    Their middle may still move by almost half their length. One that was dropped because of a pair that turned out
    chancy is opened again as soon as some other pair is tight.
    """
    tight = [b for b in brackets if b.status in (Status.TIGHT, Status.KEPT)]
    places = [place for place, b in enumerate(brackets) if b.status in (Status.OPEN, Status.NEAR)]
    middles = [midpoints(*_ends(tight, known), steps.space)] if tight else []
    if state.prior is not None and len(state.prior.middles):
        middles.append(state.prior.middles)
    if not middles or not places:
        return
    safe, unsafe = _ends([brackets[place] for place in places], known)
    lengths = np.array([steps.distance(a, b) for a, b in zip(safe, unsafe, strict=True)])
    towards = steps.metric.between(midpoints(safe, unsafe, steps.space), np.concatenate(middles))
    near: BoolArray = towards + 0.25 * lengths[:, None] < state.config.d_th
    for place, drop in zip(places, near, strict=True):
        brackets[place] = replace(brackets[place], status=Status.NEAR if drop.any() else Status.OPEN)


def _ends(brackets: Sequence[Bracket], known: _Known) -> tuple[FloatArray, FloatArray]:
    """Return the safe and the unsafe sides of brackets, both shape ``(n, d)``."""
    return (
        np.array([known.row(b.safe) for b in brackets]),
        np.array([known.row(b.unsafe) for b in brackets]),
    )


def _failed(bracket: Bracket) -> Bracket:
    failures = bracket.failures + 1
    status = Status.GIVEN_UP if failures >= MAX_FAILURES else bracket.status
    return replace(bracket, failures=failures, status=status)


def _narrowed(bracket: Bracket, steps: Steps, known: _Known, config: EdgeConfig) -> Bracket:
    if not steps.is_tight(known.row(bracket.safe), known.row(bracket.unsafe), config.eps):
        return replace(bracket, status=Status.OPEN)
    return replace(bracket, status=Status.TIGHT if config.checks else Status.KEPT)


def _checked(bracket: Bracket, side: int, unsafe: bool, checks: int) -> Bracket:
    if unsafe != bool(side):
        return replace(bracket, status=Status.CHANCY)
    if side:
        bracket = replace(bracket, unsafe_checks=bracket.unsafe_checks + 1)
    else:
        bracket = replace(bracket, safe_checks=bracket.safe_checks + 1)
    done = min(bracket.safe_checks, bracket.unsafe_checks) >= checks
    return replace(bracket, status=Status.KEPT) if done else bracket


@dataclass(slots=True)
class _Plan:
    """The generation that is being planned.

    Attributes:
        wanted: Its size.
        rows: Its candidates so far.
        seeds: Number of the candidate whose episode seed each shares; None for a seed of its own.
        jobs: Their purposes.
        allowance: Simulations that are left beyond what open brackets are expected to need.
    """

    wanted: int
    rows: list[FloatArray]
    seeds: list[int | None]
    jobs: list[Job]
    allowance: float = 0.0

    @property
    def room(self) -> int:
        """How many more candidates fit."""
        return self.wanted - len(self.rows)

    def add(self, row: FloatArray, seed: int | None, job: Job) -> None:
        """Add a candidate."""
        self.rows.append(row)
        self.seeds.append(seed)
        self.jobs.append(job)


def _planned(state: EdgeState) -> EdgeState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return state
    plan = _Plan(int(min(config.generation_size, ledger.left)), [], [], [])
    rng = generator(ledger.seed, Stream.EDGE, _GENERATION, ledger.planned_generation)
    for row in ledger.points[: plan.wanted]:
        plan.add(row, None, (Purpose.EXPLORE, 0, 0))
    explored = len(ledger.known) + ledger.spent + ledger.in_flight + len(plan.rows)
    to_explore = max(0, round(config.explore * _reachable(ledger)) - explored)
    if to_explore < plan.wanted:
        _checks(state, plan)
        _probes(state, plan, rng)
        plan.allowance = ledger.left - len(plan.rows) - _reserve(state)
        state = _partners(state, plan, plan.room - to_explore)
        _propose_anchors(state, plan, plan.room - to_explore)
        if plan.rows or ledger.flight:
            # What the open brackets need is not spent on exploring meanwhile.
            more = min(max(0, plan.room - to_explore), max(0, math.floor(plan.allowance)))
            plan.wanted = len(plan.rows) + min(plan.room, to_explore) + more
    for row in _random_rows(ledger, plan.room, rng):
        plan.add(row, None, (Purpose.EXPLORE, 0, 0))
    return replace(
        state, ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds), jobs=(*state.jobs, *plan.jobs)
    )


def _cost(length: float, config: EdgeConfig) -> float:
    """Return how many simulations a bracket of the given length is expected to take until it is checked."""
    return math.ceil(math.log2(max(length / config.eps, 1.0))) + 2.0 * config.checks


def _checks_left(bracket: Bracket, config: EdgeConfig) -> int:
    """Return how many checks a tight pair still needs."""
    return 2 * config.checks - bracket.safe_checks - bracket.unsafe_checks


def _hits(state: EdgeState) -> float:
    """Return the expected share of partners that open a bracket, estimated from those already simulated."""
    return (_EXPECTED_HITS * _FEW + len(state.brackets)) / (_FEW + state.partnered)


def _reachable(ledger: Ledger) -> int:
    """Return how many different solutions can be simulated."""
    return int(min(ledger.budget, ledger.space.size))


def _reserve(state: EdgeState) -> float:
    """Return the number of simulations that the open brackets are expected to take until they are checked."""
    known, steps, config = _Known(state.ledger.archive), Steps(state.ledger.space), state.config
    total, hits = 0.0, _hits(state)
    for bracket in state.brackets:
        if bracket.status is Status.OPEN:
            total += _cost(steps.distance(known.row(bracket.safe), known.row(bracket.unsafe)), config)
        elif bracket.status is Status.TIGHT:
            total += _checks_left(bracket, config)
    in_flight = [candidate for generation in state.ledger.flight for candidate in generation]
    for candidate, (purpose, of, _) in zip(in_flight, state.jobs, strict=True):
        if purpose is Purpose.PARTNER:
            length = steps.distance(known.row(of), state.ledger.space.join(candidate.vectors))
            total += hits * _cost(length, config)
        elif purpose is Purpose.ANCHOR:
            total += 1 + hits * _cost(config.d_th, config)
        elif purpose is not Purpose.EXPLORE:
            total -= 1
    return total


class _Draws(NamedTuple):
    """Possible partners of an anchor.

    Attributes:
        attempt: How many partners of the anchor were simulated before.
        rows: The draws before repair, shape ``(n, d)``.
        lengths: Their distances from the anchor, shape ``(n,)``.
    """

    attempt: int
    rows: FloatArray
    lengths: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Partner:
    """The best partner drawn for an anchor.

    Attributes:
        row: The partner before repair, shape ``(d,)``.
        attempt: How many partners of the anchor were simulated before.
        flips: Probability that it has the opposite verdict, as the surrogate judges.
        length: Its distance from the anchor.
    """

    row: FloatArray
    attempt: int
    flips: float
    length: float

    def rank(self, chancy: float) -> tuple[float, float]:
        """Return a key that is smaller for a better partner: likely to open a pair that holds, and then near.

        Args:
            chancy: Probability that the pair is a chancy place.
        """
        return -min(self.flips, _LIKELY) * (1.0 - chancy), self.length


def _with_surrogate(state: EdgeState) -> EdgeState:
    """Return the state with a surrogate that has learnt from nearly all solutions; it learns anew with 10% more."""
    archive, known = state.ledger.archive, state.ledger.known
    size = _learning_size(len(known) + len(archive))
    rows = np.concatenate([known.rows, archive.vectors])[:size]
    unsafe = np.concatenate([known.unsafe, archive.unsafe])[:size]
    if (state.surrogate is not None and state.surrogate.size == size) or unsafe.all() or not unsafe.any():
        return state
    rng = generator(state.ledger.seed, Stream.EDGE, _SURROGATE, size)
    surrogate = Surrogate(state.ledger.space, rows, unsafe, seed=int(rng.integers(2**32, dtype=np.uint64)))
    return replace(state, surrogate=surrogate, partners={})


def _with_chance(state: EdgeState) -> EdgeState:
    """Return the state with an estimate of where pairs are chancy, from those that were checked."""
    size = _learning_size(len(state.resolved))
    if size < _FEW or (state.chance is not None and state.chance.size == size):
        return state
    brackets = [state.brackets[place] for place in state.resolved[:size]]
    chancy = np.array([bracket.status is Status.CHANCY for bracket in brackets])
    if chancy.all() or not chancy.any():
        return state
    _, rows = _ends(brackets, _Known(state.ledger.archive))
    rng = generator(state.ledger.seed, Stream.EDGE, _CHANCE, size)
    chance = Surrogate(state.ledger.space, rows, chancy, seed=int(rng.integers(2**32, dtype=np.uint64)))
    return replace(state, chance=chance)


def _learning_size(solutions: int) -> int:
    size = 1
    while (larger := size + max(1, size // 10)) <= solutions:
        size = larger
    return size


def _random_rows(ledger: Ledger, count: int, rng: np.random.Generator) -> list[FloatArray]:
    rows: tuple[FloatArray, ...] = ()
    for _ in range(200):
        if len(rows) >= count:
            break
        drawn = [ledger.space.join(ledger.space.sample(rng)) for _ in range(count - len(rows))]
        rows = ledger.unseen([*rows, *drawn])
    return list(rows[:count])


def _busy(state: EdgeState, *purposes: Purpose) -> set[tuple[int, int]]:
    """Return what the candidates in flight with one of the purposes are for, with the side."""
    return {(of, side) for purpose, of, side in state.jobs if purpose in purposes}


def _checks(state: EdgeState, plan: _Plan) -> None:
    """Plan the checks of tight pairs, of those that need fewest first.

    The unsafe side is checked before the safe one, because it fails more often.
    """
    known = _Known(state.ledger.archive)
    busy = _busy(state, Purpose.CHECK)
    tight = [index for index, b in enumerate(state.brackets) if b.status is Status.TIGHT]
    for index in sorted(tight, key=lambda index: (_checks_left(state.brackets[index], state.config), index)):
        bracket = state.brackets[index]
        if not {(index, 0), (index, 1)} & busy and plan.room:
            side = int(bracket.unsafe_checks <= bracket.safe_checks)
            plan.add(known.row((bracket.safe, bracket.unsafe)[side]), None, (Purpose.CHECK, index, side))


def _probes(state: EdgeState, plan: _Plan, rng: np.random.Generator) -> None:
    """Plan a probe of each open bracket; if the budget does not suffice for all, of the cheapest to finish."""
    known, steps, config = _Known(state.ledger.archive), Steps(state.ledger.space), state.config
    busy = _busy(state, Purpose.PROBE)
    left = state.ledger.left + sum(purpose in (Purpose.PROBE, Purpose.CHECK) for purpose, _, _ in state.jobs)
    left -= sum(_checks_left(b, config) for b in state.brackets if b.status is Status.TIGHT)
    costs = {
        index: _cost(steps.distance(known.row(b.safe), known.row(b.unsafe)), config)
        for index, b in enumerate(state.brackets)
        if b.status is Status.OPEN
    }
    for index in sorted(costs, key=lambda index: (costs[index], index)):
        left -= costs[index]
        if left < 0 or not plan.room:
            break
        if (index, 0) not in busy:
            bracket = state.brackets[index]
            row = steps.between(known.row(bracket.safe), known.row(bracket.unsafe), rng, eps=config.eps)
            if row is not None:
                plan.add(row, bracket.seed, (Purpose.PROBE, index, 0))


def _partners(state: EdgeState, plan: _Plan, count: int) -> EdgeState:
    """Plan the partners most likely to have the opposite verdict; return the state with the tries counted.

    Args:
        state: The state.
        plan: The generation that is being planned.
        count: Most partners. With the brackets that they are expected to open they take no more than the allowance.
    """
    if count <= 0:
        return state
    state = _with_chance(_with_surrogate(state))
    places = _anchors(state)
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
    further = _drawn(state, promising, MORE_REDRAWS, _MORE, state.ledger.planned_generation)
    more = _best_of_draws(state, state.surrogate, promising, further)
    kept = partners
    partners = partners | {n: p for n, p in more.items() if p.rank(0.0) < partners[n].rank(0.0)}
    for number in sorted(numbers, key=lambda number: (partners[number].rank(risk[number]), number)):
        place = archive_place[number]
        partner = partners[number]
        expected = 1 + partner.flips * _cost(partner.length, state.config)
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
) -> tuple[dict[int, _Partner], dict[int, _Draws]]:
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
    draws |= _drawn(state, undrawn, REDRAWS, _PARTNER)
    partners |= _best_of_draws(state, surrogate, missing, draws)
    return partners, dict(itertools.islice(draws.items(), _MOST_KEPT))


def _drawn(state: EdgeState, anchors: Mapping[int, int], draws: int, *index: int) -> dict[int, _Draws]:
    """Draw possible partners of each anchor.

    Args:
        state: The state.
        anchors: Positions in the archive by number.
        draws: Half the number of draws for each anchor.
        index: Position of the draws in the stream, before the anchor's number and its attempts.
    """
    archive, space = state.ledger.archive, state.ledger.space
    varied, metric = _varied(space, state.config), Metric.of_space(space)
    found = {}
    for number, place in anchors.items():
        attempt = state.tries.get(number, 0)
        row = archive.vectors[place]
        rng = generator(state.ledger.seed, Stream.EDGE, *index, number, attempt)
        rows = _redrawn(space, row, varied, draws, rng)
        found[number] = _Draws(attempt, rows, metric.between(row[None], rows)[0])
    return found


def _best_of_draws(
    state: EdgeState, surrogate: Surrogate, anchors: Mapping[int, int], draws: Mapping[int, _Draws]
) -> dict[int, _Partner]:
    """Return the best of the partners drawn for each anchor.

    Args:
        state: The state.
        surrogate: Judges the draws.
        anchors: Positions in the archive by number.
        draws: As many for each anchor.
    """
    chosen = [draws[number] for number in anchors]
    unsafe = state.ledger.archive.unsafe[list(anchors.values())]
    return dict(zip(anchors, _best_partners(surrogate, unsafe, chosen), strict=True))


def _best_partners(surrogate: Surrogate, unsafe: BoolArray, draws: Sequence[_Draws]) -> list[_Partner]:
    """Return the best of the partners drawn for each of several anchors.

    Args:
        surrogate: Judges the draws.
        unsafe: Verdicts of the anchors, shape ``(n,)``.
        draws: As many for each anchor.
    """
    if not draws:
        return []
    rows = np.concatenate([one.rows for one in draws])
    risk = surrogate.unsafe(rows).reshape(len(draws), -1)
    flips = np.where(unsafe[:, None], 1 - risk, risk)
    partners = []
    for one, chances in zip(draws, flips, strict=True):
        best = int(np.lexsort((one.lengths, -np.minimum(chances, _LIKELY)))[0])
        partners.append(
            _Partner(
                row=one.rows[best],
                attempt=one.attempt,
                flips=float(chances[best]),
                length=float(one.lengths[best]),
            )
        )
    return partners


def _anchors(state: EdgeState) -> IntArray:
    """Return the positions of possible anchors: clear, not tried too often, far from all brackets."""
    archive, config = state.ledger.archive, state.config
    tried = np.array([state.tries.get(number, 0) for number in archive.numbers.tolist()])
    eligible = (tried < MAX_TRIES) & _clear(state)
    in_flight = {of for purpose, of, _ in state.jobs if purpose is Purpose.PARTNER}
    eligible &= ~np.isin(archive.numbers, list(in_flight))
    places = np.flatnonzero(eligible)
    known = _Known(archive)
    kept = [b for b in state.brackets if b.status not in (Status.GIVEN_UP, Status.NEAR)]
    ends = [known.place(number) for b in kept for number in (b.safe, b.unsafe)]
    if ends and places.size:
        places = places[(archive.distances(places, ends) >= config.d_th).all(axis=1)]
    if state.prior is not None and places.size:
        apart = archive.metric.between(archive.vectors[places], state.prior.ends) >= config.d_th
        places = places[apart.all(axis=1)]
    return places


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


def _propose_anchors(state: EdgeState, plan: _Plan, count: int) -> None:
    """Plan to simulate solutions that promise partners, where the search has no anchors of its own.

    Args:
        state: The state; its surrogate is up to date.
        plan: The generation that is being planned.
        count: Most anchors. With their partners and brackets they are expected to take no more than the allowance.
    """
    if count <= 0 or state.prior is None or state.surrogate is None:
        return
    space, config, metric = state.ledger.space, state.config, Metric.of_space(state.ledger.space)
    rng = generator(state.ledger.seed, Stream.EDGE, _PROPOSED, state.ledger.planned_generation)
    proposals = _proposals(state, state.prior, state.surrogate, rng)
    rows, varied = proposals.rows, _varied(space, config)
    redrawn = [_redrawn(space, row, varied, REDRAWS, rng) for row in rows]
    draws = [
        _Draws(0, some, metric.between(row[None], some)[0]) for row, some in zip(rows, redrawn, strict=True)
    ]
    partners = [
        replace(partner, flips=partner.flips * sure)
        for partner, sure in zip(
            _best_partners(state.surrogate, proposals.unsafe, draws),
            proposals.certainty.tolist(),
            strict=True,
        )
    ]
    chancy = np.zeros(len(rows)) if state.chance is None else state.chance.unsafe(rows)
    ranks = [partner.rank(risk) for partner, risk in zip(partners, chancy.tolist(), strict=True)]
    chosen: list[int] = []
    for place in sorted(range(len(rows)), key=lambda place: (ranks[place], place)):
        expected = 2 + partners[place].flips * _cost(partners[place].length, config)
        if len(chosen) == count or plan.allowance < expected:
            break
        if (metric.between(rows[place][None], rows[chosen]) < config.d_th).any():
            continue
        chosen.append(place)
        plan.allowance -= expected
        plan.add(rows[place], None, (Purpose.ANCHOR, 0, 0))


def _proposals(state: EdgeState, prior: _Prior, surrogate: Surrogate, rng: np.random.Generator) -> _Proposals:
    """Return known and random solutions where an anchor would be new.

    They are clear, not simulated by this search yet, and far from known pairs, from all brackets and from the anchors
    that the search has or waits for.
    """
    ledger, d_th = state.ledger, state.config.d_th
    safe, unsafe = _least_clear(ledger.archive, ledger.known, state.config.margin)
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
    known = _Known(ledger.archive)
    ends = [known.row(number) for b in brackets for number in (b.safe, b.unsafe)]
    own = ledger.archive.vectors[_anchors(state)]
    taken = np.concatenate([prior.ends, own, np.reshape([*ends, *waiting], (-1, ledger.space.dimension))])
    new = fresh & (Metric.of_space(ledger.space).between(rows, taken) >= d_th).all(axis=1)
    return _Proposals(
        rows=rows[new],
        unsafe=np.concatenate([prior.unsafe[places], risk > 0.5])[new],
        certainty=np.concatenate([np.ones(len(places)), np.maximum(risk, 1 - risk)])[new],
    )


def _redrawn(
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
