"""`straddle@1`: estimation of a level set, where the robustness is 0.

The next solutions are those of a random pool where 1.96 sigma - abs(mu) is largest: where it is least certain whether
they are safe. In a space of numbers, a Gaussian process expects the robustness mu with the deviation sigma; solutions
in flight reduce sigma, so that those of one generation are apart. In a space with categories, trees expect the
probability of a violation, mu is what exceeds one half, and sigma is the deviation over the trees.

No two solutions share an episode seed, and none is simulated again: pairs are what the archive happens to hold.

Source: Bryan, Schneider, Nichol, Miller, Genovese and Wasserman, "Active Learning For Identifying Function Threshold
Boundaries", NIPS 2005. Trees, batches and the covariance are ours: docs/adr/0082.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from brink.extras import install_command
from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerConfig, LedgerState
from brink.search.algorithms.pool import pool_draws, random_rows, unseen_rows
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.gaussian_process import Covariance, check_few, embedded, posterior
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.surrogate import EXTRA, Surrogate, is_available, learning_size

DEVIATIONS: Final = 1.96
"""Weight of the deviation: half the width of a 95% interval."""
_ONE_IN: Final = 4
"""The model learns anew whenever there are a quarter more solutions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StraddleConfig(LedgerConfig):
    """Settings of the estimation of the level set."""

    initial: int = setting(60, help="Random solutions at the start.", ge=2, le=100_000)
    generation_size: int = setting(30, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(2, help="Generations in flight at a time.", ge=1, le=1000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraddleState(LedgerState):
    """State of the search; all but the ledger follows from it.

    Attributes:
        config: Settings.
        covariance: That of the Gaussian process, as last estimated; None before, and with categories.
        surrogate: The trees, as last grown; None before, and without categories.
        learnt: Solutions that either has learnt from.
        draws: The pool.
    """

    config: StraddleConfig
    covariance: Covariance | None = None
    surrogate: Surrogate | None = None
    learnt: int = 0
    draws: Mapping[int, FloatArray] = field(default_factory=dict)


class Straddle(LedgerAlgorithm[StraddleConfig, StraddleState]):
    """The estimation of the level set by the straddle heuristic."""

    id = "straddle@1"
    finds = ("pairs",)
    minimises = ""
    summary = "Straddle: simulates where it is least certain whether a solution is safe."
    config_type = StraddleConfig

    def _min_budget(self, space: SearchSpace, config: StraddleConfig) -> int:
        if space.categorical.any() and not is_available():
            raise ConfigError(
                "id", f"straddle@1 needs scikit-learn where there are categories: {install_command(EXTRA)}"
            )
        return 1

    def check(self, space: SearchSpace, config: StraddleConfig, *, budget: int) -> None:
        """Check that the algorithm can run with these arguments; see `Algorithm.check`."""
        super().check(space, config, budget=budget)
        if not space.categorical.any():
            check_few(self.id, budget)

    def _first_state(self, ledger: Ledger, config: StraddleConfig) -> StraddleState:
        return _planned(StraddleState(config=config, ledger=ledger))

    def tell(self, state: StraddleState, evaluations: Mapping[int, Evaluation]) -> StraddleState:
        """Return the state after the pending generation was evaluated."""
        return _planned(replace(state, ledger=state.ledger.tell(evaluations)))

    def _refilled(self, state: StraddleState) -> StraddleState:
        return _planned(state)

    def _restored(self, ledger: Ledger, config: StraddleConfig, document: Document) -> StraddleState:
        return StraddleState(config=config, ledger=ledger)


def _planned(state: StraddleState) -> StraddleState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if len(ledger.flight) >= config.in_flight or ledger.left <= 0:
        return state
    wanted = int(min(config.generation_size, ledger.left))
    rows: list[FloatArray] = []
    unexplored = max(0, config.initial - ledger.spent - ledger.in_flight)
    if unexplored < wanted:
        state = _learnt(state)
        state, rows = _chosen(state, wanted - unexplored)
    rng = generator(ledger.seed, Stream.STRADDLE, 0, ledger.planned_generation)
    return replace(state, ledger=ledger.plan(random_rows(ledger, wanted, rng, rows)))


def _learnt(state: StraddleState) -> StraddleState:
    """Return the state with a model that has learnt from most solutions; without one if there is nothing to learn."""
    archive, space = state.ledger.archive, state.ledger.space
    size = learning_size(len(archive), one_in=_ONE_IN)
    if size == state.learnt:
        return state
    rows, unsafe, values = archive.vectors[:size], archive.unsafe[:size], archive.robustness[:size]
    if space.categorical.any():
        if unsafe.all() or not unsafe.any():
            return state
        rng = generator(state.ledger.seed, Stream.STRADDLE, 2, size)
        seed = int(rng.integers(2**32, dtype=np.uint64))
        return replace(state, surrogate=Surrogate(space, rows, unsafe, seed=seed), learnt=size)
    if len(values) < 2 or np.ptp(values) == 0:
        return state
    centred = _finite(values) - _finite(values).mean()
    return replace(
        state, covariance=Covariance.fitted(embedded(space, rows), centred, twice_nu=5), learnt=size
    )


def _finite(values: FloatArray) -> FloatArray:
    """Return values of which infinite ones became the largest finite ones."""
    most = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    return np.clip(values, -most, most)


def _chosen(state: StraddleState, count: int) -> tuple[StraddleState, list[FloatArray]]:
    """Return the state with its pool, and the solutions of the pool that straddle the boundary most."""
    ledger = state.ledger
    if state.surrogate is None and state.covariance is None:
        return state, []
    state = replace(state, draws=pool_draws(ledger, Stream.STRADDLE, state.draws))
    pool = unseen_rows(ledger, state.draws)
    if state.surrogate is not None:
        risk, deviation = state.surrogate.unsafe_and_deviation(pool)
        best = np.argsort(-(DEVIATIONS * deviation - np.abs(risk - 0.5)), kind="stable")
        return state, list(pool[best[:count]])
    assert state.covariance is not None
    archive, space = ledger.archive, ledger.space
    values = _finite(archive.robustness)
    level = float(values.mean())
    known = posterior(
        state.covariance,
        embedded(space, archive.vectors),
        values - level,
        embedded(space, ledger.flying),
        embedded(space, pool),
    )
    chosen: list[int] = []
    free = np.ones(len(pool), np.bool_)
    while len(chosen) < min(count, len(pool)):
        score = DEVIATIONS * known.deviation - np.abs(known.mean + level)
        place = int(np.argmax(np.where(free, score, -np.inf)))
        free[place] = False
        chosen.append(place)
        known.choose(place)
    return state, list(pool[chosen])
