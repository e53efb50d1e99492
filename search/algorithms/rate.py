"""`rate@1`: how often solutions are unsafe in operation, with an interval that holds.

The rate p is the probability that a solution drawn from the operational distribution (`brink.search.distribution`),
with an episode seed of its own, is unsafe. Simulation i adds a term X_i whose expectation is p whatever was simulated
before and however wrong the surrogate is, so that the interval (`brink.search.rates`) needs no model to be right.

How a candidate is drawn: a pool of its own is drawn from the distribution, and one of the pool is simulated. With the
probability alpha that is any of them; otherwise each is as likely as its importance g. The weight of the one with
importance g is w = 1 / (alpha + (1 - alpha) g / mean g), with the mean over its own pool: at most 1 / alpha, and
unbiased exactly, since given the pool the expectation of w times any function is its mean over the pool. That works
in any space, and no density is ever computed.

The surrogate's unsafe probability q is also a control variate: X = w (y - lambda q) + lambda mean q, where y is 1 if
the simulation is unsafe, and the mean is over the pool. Given the pool, the expectation of w q is mean q, so that X
is as unbiased as w y, and varies less if q predicts y. As g increases with q, w q <= 1: X is at least -lambda, and at
most 1 / alpha + lambda.

1. The first part of the budget is drawn as it occurs in operation, but for a small share that is spread over the
   choices of categories which the distribution makes rare.
2. Then a surrogate estimates q of each member of a pool, from earlier results only, and g = sqrt(q + a little), the
   best choice where the verdict is a matter of chance. alpha and lambda are chosen by how well earlier surrogates
   would have done with them on results that they had not seen: 1 and 0, plain Monte Carlo, if nothing helps. Their
   variance on these results also sets the pace at which the interval counts what comes next.
3. With a claim, the search ends as soon as that is shown or refuted.

What is known from before teaches the surrogate and never enters the estimate.

Sources: Owen and Zhou 2000 (defensive mixtures and control variates); Waudby-Smith and Ramdas 2024.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Final

import numpy as np

from brink.search.algorithm import Draws, Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerConfig, LedgerState, WarmLedgerAlgorithm
from brink.search.archive import Archive
from brink.search.conclusions import Decision
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.rates import Terms, Wealth, best_growth
from brink.search.settings import check_settings, setting
from brink.search.space import FloatArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator
from brink.search.surrogate import Surrogate, is_available, learning_size

AT_MOST: Final = "at_most"
CONFIDENCE: Final = "confidence"
ALPHAS: Final = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.2)
"""Shares of the distribution in the mixture; the largest weight is the inverse."""
LAMBDAS: Final = (0.0, 0.5, 1.0)
"""Coefficients of the control variate."""
SPREAD_ALPHA: Final = 0.8
"""The share in the first part, if rare choices get more than their share."""
MOST_PACE: Final = 16.0
"""How many times as much the interval may count a simulation as a plain one."""
FEWEST: Final = 5
"""Solutions of each verdict from which a surrogate learns."""
JUDGED: Final = 10
"""Unsafe solutions by which designs are compared."""
_LATEST: Final = 2_000
"""Simulations, the latest ones, by which designs are compared."""
_FLOOR: Final = 0.1
"""What is added to the surrogate's probability, as a share of the rate so far."""
_LOG_WEALTH: Final = 10.0
"""About twice the logarithm of the wealth that excludes a mean, with what it costs not to know the best stake."""
_PILOT: Final = 500
"""Draws that show how frequent the choices of categories are."""
_PLAIN, _SURROGATE, _NOT_DRAWN = 0.0, 1.0, 2.0


class Column(IntEnum):
    """What is stored of how a candidate was drawn."""

    RATIO = 0
    """Its importance over the mean of its pool."""
    ALPHA = 1
    KIND = 2
    """Whether the importance is a surrogate's, or the candidate was not drawn at all."""
    PREDICTED = 3
    """The surrogate's unsafe probability q."""
    POOL = 4
    """The mean of q over its pool."""
    LAMBDA = 5
    PACE = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """How the next candidates are drawn and counted; see the module."""

    alpha: float
    control: float
    pace: float


PLAIN: Final = Design(alpha=1.0, control=0.0, pace=1.0)
FIRST: Final = Design(alpha=0.5, control=0.5, pace=1.0)
"""The first design with a surrogate, before there are results to choose one by."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RateConfig(LedgerConfig):
    """Settings of the estimate of a rate."""

    claim: dict[str, float] = field(
        default_factory=dict,
        metadata={
            "help": "A claim to show or refute: at_most, the largest acceptable rate, and confidence, by default "
            "0.95. The campaign ends as soon as it is decided.",
            "main": True,
        },
    )
    first: float = setting(
        0.2, help="Share of the budget that is drawn by the distribution alone.", gt=0, le=1
    )
    pool: int = setting(
        20, help="Draws from which each simulation is chosen; 1 is plain Monte Carlo.", ge=1, le=10_000
    )
    generation_size: int = setting(60, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(8, help="Generations in flight at a time.", ge=1, le=1000)

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.claim:
            return
        unknown = sorted(set(self.claim) - {AT_MOST, CONFIDENCE})
        if unknown or AT_MOST not in self.claim:
            raise ConfigError(
                "claim", f"expected {AT_MOST}, and {CONFIDENCE} if it is not 0.95, got {dict(self.claim)!r}"
            )
        for name, value in self.claim.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
                raise ConfigError("claim", f"{name}: expected a number between 0 and 1, got {value!r}")

    @property
    def at_most(self) -> float | None:
        """The limit of the claim; None without a claim."""
        return self.claim.get(AT_MOST)

    @property
    def confidence(self) -> float:
        """The confidence of the claim and of intervals."""
        return self.claim.get(CONFIDENCE, 0.95)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateState(LedgerState):
    """State of the estimate.

    Attributes:
        config: Settings.
        drawn: How each candidate was drawn, in the order of their numbers, shape ``(n, len(Column))``.
        wealth: The bettors on the claim; None without one.
        surrogate: The last surrogate; it follows from the rest.
    """

    config: RateConfig
    drawn: FloatArray
    wealth: Wealth | None
    surrogate: Surrogate | None = None


def weights_of(drawn: FloatArray) -> FloatArray:
    """Return the importance weights of candidates; see `RateState.drawn`."""
    return _weights(drawn[:, Column.RATIO], drawn[:, Column.ALPHA])


def _weights(ratio: FloatArray, alpha: FloatArray | float) -> FloatArray:
    weights: FloatArray = 1.0 / (alpha + (1.0 - alpha) * ratio)
    return weights


def _base(drawn: FloatArray, weights: FloatArray, control: FloatArray | float) -> FloatArray:
    """Return the terms of safe candidates: the control variate less its expectation."""
    base: FloatArray = control * (drawn[:, Column.POOL] - weights * drawn[:, Column.PREDICTED])
    return base


class Rate(WarmLedgerAlgorithm[RateConfig, RateState]):
    """Estimates the rate of unsafe solutions by defensive importance sampling."""

    id = "rate@1"
    finds = ("rate",)
    minimises = ""
    summary = "How often solutions are unsafe in operation, with an interval that is valid at any time."
    config_type = RateConfig
    honours_distribution = True
    layout = 2

    def _min_budget(self, space: SearchSpace, config: RateConfig) -> int:
        return 1

    def _first_state(self, ledger: Ledger, config: RateConfig) -> RateState:
        wealth = None if config.at_most is None else Wealth.of(config.at_most, config.confidence)
        state = RateState(
            config=config, ledger=ledger, drawn=frozen_array(np.empty((0, len(Column)))), wealth=wealth
        )
        return _planned(state)

    def tell(self, state: RateState, evaluations: Mapping[int, Evaluation]) -> RateState:
        """Return the state after the pending generation was evaluated."""
        before = state.ledger.spent
        ledger = state.ledger.tell(evaluations)
        state = replace(state, ledger=ledger)
        if state.wealth is not None:
            draws = _draws(state.drawn[: ledger.spent], ledger.archive, since=before)
            # A failure counts against showing the claim, and not for refuting it.
            wealth = state.wealth.after(draws.terms(failed=True), draws.terms())
            state = replace(state, wealth=wealth)
        return _planned(state)

    def _refilled(self, state: RateState) -> RateState:
        return _planned(state)

    def _content(self, state: RateState) -> tuple[dict[str, Any], dict[str, Any]]:
        arrays: dict[str, Any] = {"drawn": state.drawn}
        if state.wealth is not None:
            arrays |= {"below": state.wealth.below, "above": state.wealth.above}
        decided = None if state.wealth is None else state.wealth.decided
        header = {} if decided is None else {"decision": decided.decision.value, "after": decided.after}
        return header, arrays

    def _restored(self, ledger: Ledger, config: RateConfig, document: Document) -> RateState:
        drawn = _stored_drawn(document)
        planned = ledger.spent + ledger.in_flight + len(ledger.queue)
        if len(drawn) != planned:
            raise DocumentError(f"drawn: expected {planned} candidates, got {len(drawn)}")
        wealth = None
        if config.at_most is not None:
            told = int(np.count_nonzero(drawn[: ledger.spent, Column.KIND] != _NOT_DRAWN))
            wealth = Wealth.restored(
                config.at_most, config.confidence, told, document.header, document.arrays
            )
        return RateState(config=config, ledger=ledger, drawn=drawn, wealth=wealth)

    def draws(self, document: Document, archive: Archive) -> Draws:
        """Return the weighted draws of which a rate is the mean; see `EstimatesRate`."""
        told = document.header["archived"] + sum(len(document.arrays[one]) for one in ("failed", "measured"))
        return _draws(_stored_drawn(document)[:told], archive)


def _stored_drawn(document: Document) -> FloatArray:
    drawn = document.arrays.get("drawn")
    if drawn is None or drawn.ndim != 2 or drawn.shape[1] != len(Column) or drawn.dtype != np.float64:
        raise DocumentError(f"drawn: expected float64 rows of {len(Column)} numbers")
    if not ((drawn >= 0).all() and (drawn[:, [Column.ALPHA, Column.PACE]] > 0).all()):
        raise DocumentError("drawn: expected numbers >= 0, and shares and paces above 0")
    if not (drawn[:, [Column.ALPHA, Column.PREDICTED, Column.POOL, Column.LAMBDA]] <= 1).all():
        raise DocumentError("drawn: expected shares, probabilities and coefficients of at most 1")
    return frozen_array(drawn)


def _draws(drawn: FloatArray, archive: Archive, *, since: int = 0) -> Draws:
    """Return the candidates from number `since` on that count, with their verdicts.

    Args:
        drawn: How each candidate that was told was drawn.
        archive: Those with a verdict.
        since: The first number.
    """
    numbers = np.arange(since, len(drawn))
    numbers = numbers[drawn[since:, Column.KIND] != _NOT_DRAWN]
    unsafe, scored = np.zeros(len(drawn), np.bool_), np.zeros(len(drawn), np.bool_)
    unsafe[archive.numbers] = archive.unsafe
    scored[archive.numbers] = True
    mine = drawn[numbers]
    weights = weights_of(mine)
    return Draws(
        numbers=numbers,
        weights=weights,
        bounds=1.0 / mine[:, Column.ALPHA],
        unsafe=unsafe[numbers],
        failed=~scored[numbers],
        base=_base(mine, weights, mine[:, Column.LAMBDA]),
        reach=mine[:, Column.LAMBDA],
        pace=mine[:, Column.PACE],
    )


def _rows_of(count: int, kind: float) -> FloatArray:
    """Return how candidates are drawn that have no importance, as in `RateState.drawn`."""
    return np.tile([1.0, 1.0, kind, 0.0, 0.0, 0.0, 1.0], (count, 1))


def _planned(state: RateState) -> RateState:
    """Return the state with the next generation queued, unless that is full, or budget or claim end the search."""
    ledger, config = state.ledger, state.config
    wanted = min(config.generation_size, ledger.unspent)
    decided = state.wealth is not None and state.wealth.decided.decision is not Decision.NOT_SHOWN
    if ledger.queue or len(ledger.flight) >= config.in_flight or wanted <= 0 or decided:
        return state
    points = list(ledger.points[:wanted])
    first = ledger.spent + ledger.in_flight < config.first * ledger.budget
    state = state if first else _with_surrogate(state)
    rng = generator(ledger.seed, Stream.RATE, 0, ledger.planned_generation)
    rows, drawn = _drawn(state, wanted - len(points), None if first else state.surrogate, rng)
    return replace(
        state,
        ledger=ledger.plan([*points, *rows]),
        drawn=frozen_array(np.concatenate([state.drawn, _rows_of(len(points), _NOT_DRAWN), drawn])),
    )


def _with_surrogate(state: RateState) -> RateState:
    """Return the state with an up-to-date surrogate, which is refitted whenever there are 20% more solutions."""
    archive, known = state.ledger.archive, state.ledger.known
    size = learning_size(len(known) + len(archive), one_in=5)
    if not is_available() or (state.surrogate is not None and state.surrogate.size == size):
        return state
    rows = np.concatenate([known.rows, archive.vectors])[:size]
    unsafe = np.concatenate([known.unsafe, archive.unsafe])[:size]
    if min(np.count_nonzero(unsafe), np.count_nonzero(~unsafe)) < FEWEST:
        return state
    rng = generator(state.ledger.seed, Stream.RATE, 1, size)
    surrogate = Surrogate(state.ledger.space, rows, unsafe, seed=int(rng.integers(2**32, dtype=np.uint64)))
    return replace(state, surrogate=surrogate)


def _drawn(
    state: RateState, count: int, surrogate: Surrogate | None, rng: np.random.Generator
) -> tuple[list[FloatArray], FloatArray]:
    """Draw candidates, each from a pool of its own.

    Args:
        state: The state.
        count: Number of candidates.
        surrogate: What importance is judged by; None in the first part, or without one.
        rng: Source of the draws.

    Returns:
        The candidates, and how they were drawn, as in `RateState.drawn`.
    """
    space, size, count = state.ledger.space, state.config.pool, max(count, 0)
    rarity = Rarity.of(space, state.ledger.seed) if size > 1 and surrogate is None else None
    if not count or size == 1 or (surrogate is None and rarity is None):
        return [frozen_array(row) for row in space.draw_rows(count, rng)], _rows_of(count, _PLAIN)
    pools = space.draw_rows(count * size, rng)
    design, predicted = replace(PLAIN, alpha=SPREAD_ALPHA), np.zeros(count * size)
    if surrogate is not None:
        design, predicted = _best_design(state), np.clip(surrogate.unsafe(pools), 0.0, 1.0)
        seen = np.concatenate([state.ledger.known.unsafe, state.ledger.archive.unsafe])
        importance = np.sqrt(predicted + _FLOOR * (np.count_nonzero(seen) + 1) / (len(seen) + 2))
    elif rarity is not None:
        importance = rarity.importance(pools)
    ratio = importance.reshape(count, size)
    ratio = ratio / ratio.mean(axis=1, keepdims=True)
    chances = np.cumsum((design.alpha + (1.0 - design.alpha) * ratio) / size, axis=1)
    chosen = np.minimum((rng.random(count)[:, None] * chances[:, -1:] >= chances).sum(axis=1), size - 1)
    each, by_pool = np.arange(count), predicted.reshape(count, size)
    drawn = _rows_of(count, _PLAIN if surrogate is None else _SURROGATE)
    drawn[:, Column.RATIO] = ratio[each, chosen]
    drawn[:, Column.PREDICTED], drawn[:, Column.POOL] = by_pool[each, chosen], by_pool.mean(axis=1)
    drawn[:, [Column.ALPHA, Column.LAMBDA, Column.PACE]] = design.alpha, design.control, design.pace
    return [frozen_array(row) for row in pools.reshape(count, size, -1)[each, chosen]], drawn


def _best_design(state: RateState) -> Design:
    """Return the design that promises the narrowest interval.

    Designs are judged by results of candidates that earlier surrogates chose without having seen them. A smaller
    share of the distribution lowers the variance, but also the stakes that a bettor can afford, since a single weight
    may be larger.
    """
    draws = _draws(state.drawn[: state.ledger.spent], state.ledger.archive)
    judged = np.flatnonzero((state.drawn[draws.numbers, Column.KIND] == _SURROGATE) & ~draws.failed)[
        -_LATEST:
    ]
    if np.count_nonzero(draws.unsafe[judged]) < JUDGED:
        return FIRST
    drawn, claim, ones = state.drawn[draws.numbers[judged]], state.config.at_most, np.ones(len(judged))
    unsafe, rate = draws.unsafe[judged], min(max(draws.terms().mean(), 1e-9), 1 - 1e-9)
    tried = []  # design, terms had it been used, and their probabilities then
    for alpha in ALPHAS:
        weights = _weights(drawn[:, Column.RATIO], alpha)
        chances = draws.weights[judged] / weights / len(judged)
        for control in LAMBDAS:
            values = _base(drawn, weights, control) + np.where(unsafe, weights, 0.0)
            terms = Terms(values=values, low=-control * ones, high=ones / alpha + control, pace=ones)
            variance = max(float(chances @ values**2) - rate**2, 1e-12)
            pace = min(max(2.0 ** round(math.log2(rate * (1 - rate) / variance)), 1.0), MOST_PACE)
            tried.append((variance, Design(alpha=alpha, control=control, pace=pace), terms, chances))
    half = min(0.9 * rate, math.sqrt(_LOG_WEALTH * min(one[0] for one in tried) / state.ledger.budget))
    sides = [(min(rate + half, 0.999), True), (rate - half, False)]
    if claim is not None:
        sides = [(claim, rate < claim)]

    def cost(terms: Terms, chances: FloatArray) -> float:
        growths = (best_growth(terms, chances, mean, below=side) for mean, side in sides)
        return math.fsum(max(growth, 1e-12) ** -0.5 for growth in growths)

    return min(tried, key=lambda one: cost(one[2], one[3]))[1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rarity:
    """How rare the choices of categories are in operation.

    Attributes:
        columns: The columns of categories with a rare choice, k of them.
        rarity: For each of them and each of its codes, the share of the code if all were as frequent, over its own.
    """

    columns: tuple[int, ...]
    rarity: tuple[FloatArray, ...]

    @classmethod
    def of(cls, space: SearchSpace, seed: int) -> "Rarity | None":
        """Return the rarity of choices in a space; None without a distribution, or if it makes none rare."""
        if space.distribution is None:
            return None
        rng = generator(seed, Stream.RATE, 2)
        pilot = space.draw_rows(_PILOT, rng)
        columns, rarity = [], []
        for column, parameter in enumerate(space.parameters):
            if not space.categorical[column]:
                continue
            codes, counts = np.unique(pilot[:, column], return_counts=True)
            if len(codes) > 1 and counts.min() < 0.5 * _PILOT / len(codes):
                width = len(getattr(parameter, "choices", ())) + 1  # the code -1 of an absent one is the last
                most = np.full(width, _PILOT / len(codes))
                most[codes.astype(np.int64)] = _PILOT / len(codes) / counts
                columns.append(column)
                rarity.append(most)
        return cls(columns=tuple(columns), rarity=tuple(rarity)) if columns else None

    def importance(self, rows: FloatArray) -> FloatArray:
        """Return the mean rarity of the choices of rows, shape ``(n,)``."""
        importance: FloatArray = np.mean(
            [
                rare[rows[:, column].astype(np.int64)]
                for column, rare in zip(self.columns, self.rarity, strict=True)
            ],
            axis=0,
        )
        return importance
