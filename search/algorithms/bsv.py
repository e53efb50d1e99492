"""`bsv@1`: Bayesian safety validation, a search for the region of failure and its boundary.

A Gaussian process learns the logits of the verdicts. Its mean gives the probability of a violation mu, its deviation
sigma how uncertain that is. Three acquisitions take turns, by the number of the candidate: where sigma is largest
(uncertainty exploration); where mu (1 - mu) + lambda sigma is largest (boundary refinement); at random where mu +
lambda sigma is at least one half (failure region sampling). Every solution is as likely as any other in operation.

No two solutions share an episode seed, and none is simulated again: pairs are what the archive happens to hold.

Source: Moss, Kochenderfer, Gariel and Dubois, "Bayesian Safety Validation for Failure Probability Estimation of
Black-Box Systems", 2024, arXiv:2305.02449. Pools of draws in place of a grid, batches, categories and units of length
are ours: docs/adr/0082.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerConfig, LedgerState
from brink.search.algorithms.pool import pool_draws, random_rows, unseen_rows
from brink.search.document import Document
from brink.search.gaussian_process import Covariance, Posterior, check_few, embedded, posterior
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, SearchSpace
from brink.search.streams import Stream, generator

COVARIANCE: Final = Covariance(
    twice_nu=1, length=math.exp(-0.1), deviation=math.exp(-0.1), noise=math.exp(-2.0)
)
"""The paper's covariance: Matérn with nu = 1/2. It is not estimated."""
STEEPNESS: Final = 0.1
"""Steepness of the logistic function."""
LEAST: Final = 1e-5
"""Probability that a safe verdict stands for; an unsafe one stands for 1 - LEAST."""
UNITS_PER_RANGE: Final = 10.0
"""The paper's length is in units of its problems' parameters, whose ranges are 4 to 15 units wide."""
_PAPER_DIMENSION: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class BsvConfig(LedgerConfig):
    """Settings of Bayesian safety validation."""

    confidence: float = setting(
        0.1,
        label="Weight of the deviation",
        help="Weight of the deviation beside the probability of a violation (lambda).",
        ge=0,
        le=10,
    )
    generation_size: int = setting(30, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(2, help="Generations in flight at a time.", ge=1, le=1000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BsvState(LedgerState):
    """State of the search; all but the ledger follows from it.

    Attributes:
        config: Settings.
        draws: The pool.
    """

    config: BsvConfig
    draws: Mapping[int, FloatArray] = field(default_factory=dict)


class Bsv(LedgerAlgorithm[BsvConfig, BsvState]):
    """Bayesian safety validation."""

    id = "bsv@1"
    finds = ("pairs",)
    minimises = ""
    summary = (
        "Bayesian safety validation: a Gaussian process of the verdicts, and three acquisitions in turn."
    )
    config_type = BsvConfig

    def _min_budget(self, space: SearchSpace, config: BsvConfig) -> int:
        return 1

    def check(self, space: SearchSpace, config: BsvConfig, *, budget: int) -> None:
        """Check that the algorithm can run with these arguments; see `Algorithm.check`."""
        super().check(space, config, budget=budget)
        check_few(self.id, budget)

    def _first_state(self, ledger: Ledger, config: BsvConfig) -> BsvState:
        return _planned(BsvState(config=config, ledger=ledger))

    def tell(self, state: BsvState, evaluations: Mapping[int, Evaluation]) -> BsvState:
        """Return the state after the pending generation was evaluated."""
        return _planned(replace(state, ledger=state.ledger.tell(evaluations)))

    def _refilled(self, state: BsvState) -> BsvState:
        return _planned(state)

    def _restored(self, ledger: Ledger, config: BsvConfig, document: Document) -> BsvState:
        return BsvState(config=config, ledger=ledger)


def logits(unsafe: BoolArray) -> FloatArray:
    """Return the logits that verdicts stand for."""
    probability = np.where(unsafe, 1 - LEAST, LEAST)
    values: FloatArray = np.log(probability / (1 - probability)) / STEEPNESS
    return values


def probabilities(values: FloatArray) -> FloatArray:
    """Return the probabilities of logits; the inverse of `logits` for verdicts."""
    probability = 1 / (1 + np.exp(-STEEPNESS * values))
    return np.clip((probability - LEAST) / (1 - 2 * LEAST), 0.0, 1.0)


def _points(space: SearchSpace, rows: FloatArray) -> FloatArray:
    """Return solutions as points, whose distance is the paper's for two parameters and no larger for more of them."""
    return UNITS_PER_RANGE * math.sqrt(_PAPER_DIMENSION) * embedded(space, rows)


def _planned(state: BsvState) -> BsvState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return state
    state = replace(state, draws=pool_draws(ledger, Stream.BSV, state.draws))
    pool, archive, space = unseen_rows(ledger, state.draws), ledger.archive, ledger.space
    wanted = int(min(config.generation_size, ledger.left))
    rng = generator(ledger.seed, Stream.BSV, 0, ledger.planned_generation)
    known = posterior(
        COVARIANCE,
        _points(space, archive.vectors),
        logits(archive.unsafe),
        _points(space, ledger.flying),
        _points(space, pool),
    )
    chosen: list[int] = []
    free = np.ones(len(pool), np.bool_)
    for number in range(ledger.spent + ledger.in_flight, ledger.spent + ledger.in_flight + wanted):
        if free.any():
            place = _acquired(number % 3, known, free, config.confidence, rng)
            free[place] = False
            chosen.append(place)
            known.choose(place)
    return replace(state, ledger=ledger.plan(random_rows(ledger, wanted, rng, list(pool[chosen]))))


def _acquired(
    turn: int, known: Posterior, free: BoolArray, confidence: float, rng: np.random.Generator
) -> int:
    """Return the position in the pool that an acquisition chooses.

    Args:
        turn: 0 for uncertainty exploration, 1 for boundary refinement, 2 for failure region sampling.
        known: What is known of the logits in the pool.
        free: Which positions may be chosen, at least one, shape ``(n,)``.
        confidence: Weight of the deviation.
        rng: Source of the draws.
    """
    deviation, risk = known.deviation, probabilities(known.mean)
    if turn == 0:
        return int(np.argmax(np.where(free, deviation, -np.inf)))
    if turn == 1:
        return int(np.argmax(np.where(free, risk * (1 - risk) + confidence * deviation, -np.inf)))
    upper = risk + confidence * deviation
    weights = (free & (upper >= 0.5)).astype(np.float64)
    if not weights.any():  # no failure is predicted anywhere: sample by how likely one is
        weights = np.where(free, upper + np.finfo(np.float64).tiny, 0.0)
    return int(rng.choice(len(weights), p=weights / weights.sum()))
