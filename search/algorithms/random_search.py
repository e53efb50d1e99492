"""Random search: random draws with duplicates rejected, the baseline for every comparison.

It supports any space. Source: Sharifi et al. 2023, baseline RS.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, BoundaryState, Ledger, WarmLedgerAlgorithm
from brink.search.document import Document
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, generator

_DRAWS_PER_CANDIDATE = 200
"""Draws per wanted candidate after which a finite space counts as exhausted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomSearchConfig(BoundaryConfig):
    """Settings of random search."""

    generation_size: int = setting(60, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        8, help="Generations in flight at a time; they do not depend on each other.", ge=1, le=1000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomSearchState(BoundaryState):
    """State of random search: the ledger alone."""

    config: RandomSearchConfig


class RandomSearch(WarmLedgerAlgorithm[RandomSearchConfig, RandomSearchState]):
    """Random draws from the space, with duplicates rejected."""

    id = "random@1"
    suggested = 3
    is_baseline = True
    summary = "Random search: independent draws from the space."
    config_type = RandomSearchConfig

    def _min_budget(self, space: SearchSpace, config: RandomSearchConfig) -> int:
        return 1

    def _first_state(self, ledger: Ledger, config: RandomSearchConfig) -> RandomSearchState:
        return _planned(config, ledger)

    def tell(self, state: RandomSearchState, evaluations: Mapping[int, Evaluation]) -> RandomSearchState:
        """Return the state after the pending generation was evaluated."""
        return _planned(state.config, state.ledger.tell(evaluations))

    def _refilled(self, state: RandomSearchState) -> RandomSearchState:
        return _planned(state.config, state.ledger)

    def _restored(self, ledger: Ledger, config: RandomSearchConfig, document: Document) -> RandomSearchState:
        return RandomSearchState(config=config, ledger=ledger)


def _planned(config: RandomSearchConfig, ledger: Ledger) -> RandomSearchState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow."""
    room = len(ledger.flight) < config.in_flight
    wanted = int(min(config.generation_size, ledger.left)) if room else 0
    rng = generator(ledger.seed, Stream.START, ledger.planned_generation)
    rows: tuple[FloatArray, ...] = ledger.points[:wanted]
    draws_left = _DRAWS_PER_CANDIDATE * wanted
    while len(rows) < wanted and draws_left > 0:
        batch = wanted - len(rows)
        draws_left -= batch
        rows = ledger.unseen([*rows, *(ledger.space.join(ledger.space.sample(rng)) for _ in range(batch))])
    return RandomSearchState(config=config, ledger=ledger.plan(rows))
