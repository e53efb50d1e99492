"""A toy algorithm of pairs, ``bisection@1``: everything that it takes for its pairs to be shown, in one file."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerState
from brink.search.document import Document
from brink.search.pairs import Steps
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator


@dataclass(frozen=True, slots=True, kw_only=True)
class BisectionConfig:
    """Settings of the bisection."""

    draws: int = setting(20, help="Random solutions at the start.", ge=1, le=1000)
    eps: float = setting(0.05, help="Largest distance of a pair.", gt=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BisectionState(LedgerState):
    """State of the bisection: the ledger alone."""

    config: BisectionConfig


class Bisection(LedgerAlgorithm[BisectionConfig, BisectionState]):
    """Halves the way from each unsafe solution to the nearest safe one, until the two are a pair."""

    id = "bisection@1"
    finds = ("pairs",)
    summary = "Bisection between random safe and unsafe solutions."
    config_type = BisectionConfig

    def _min_budget(self, space: SearchSpace, config: BisectionConfig) -> int:
        return config.draws

    def _first_state(self, ledger: Ledger, config: BisectionConfig) -> BisectionState:
        rng = generator(ledger.seed, Stream.START)
        rows = [ledger.space.join(ledger.space.sample(rng)) for _ in range(config.draws)]
        return self._planned(ledger, config, rows)

    def tell(self, state: BisectionState, evaluations: Mapping[int, Evaluation]) -> BisectionState:
        """Return the state with the middle between each unsafe solution and the nearest safe one planned."""
        ledger, config = state.ledger.tell(evaluations), state.config
        archive, steps = ledger.archive, Steps(ledger.space)
        rng = generator(ledger.seed, Stream.BREEDING, ledger.generation)
        safe, unsafe = archive.vectors[~archive.unsafe], archive.vectors[archive.unsafe]
        nearest = steps.metric.between(unsafe, safe).argmin(axis=1) if len(safe) else np.empty(0, int)
        pairs = [(safe[place], row) for place, row in zip(nearest, unsafe, strict=False)]
        wide = [pair for pair in pairs if not steps.is_tight(*pair, config.eps)]
        middles = [steps.between(*pair, rng, eps=config.eps) for pair in wide]
        return self._planned(ledger, config, [row for row in middles if row is not None])

    def _restored(self, ledger: Ledger, config: BisectionConfig, document: Document) -> BisectionState:
        return BisectionState(config=config, ledger=ledger)

    def _planned(self, ledger: Ledger, config: BisectionConfig, rows: list[FloatArray]) -> BisectionState:
        rows = list(ledger.unseen(rows))[: int(max(0, ledger.left))]
        seeds = [
            0 if ledger.spent + place else None for place in range(len(rows))
        ]  # all share one episode seed
        return BisectionState(config=config, ledger=ledger.plan(rows, seed_numbers=seeds))
