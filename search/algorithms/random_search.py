"""Random search: random draws with duplicates rejected, the baseline for every comparison.

With an operational distribution, it draws by that and keeps duplicates: they are as frequent as in operation.

It supports any space. Source: Sharifi et al. 2023, baseline RS.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from brink.search.algorithm import UNDECLARED, Draws, Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, BoundaryState, Ledger, WarmLedgerAlgorithm
from brink.search.archive import Archive
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
    honours_distribution = True
    finds: tuple[str, ...] = (*UNDECLARED, "rate")
    summary = "Random search: independent draws from the space."
    config_type = RandomSearchConfig

    def draws(self, document: Document, archive: Archive) -> Draws:
        """Return all candidates but known points, with a weight of 1; see `EstimatesRate`."""
        told = document.header["archived"] + sum(len(document.arrays[one]) for one in ("failed", "measured"))
        numbers = np.arange(min(len(document.arrays.get("points", ())), told), told)
        place = dict(zip(archive.numbers.tolist(), archive.unsafe.tolist(), strict=True))
        return Draws.plain(
            numbers,
            np.array([place.get(number, False) for number in numbers.tolist()], np.bool_),
            np.array([number not in place for number in numbers.tolist()], np.bool_),
        )

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
    if ledger.space.distribution is not None:
        wanted = int(min(config.generation_size, ledger.unspent)) if room else 0
        drawn = (ledger.space.join(ledger.space.draw(rng)) for _ in range(wanted - len(rows)))
        return RandomSearchState(config=config, ledger=ledger.plan([*rows, *drawn]))
    draws_left = _DRAWS_PER_CANDIDATE * wanted
    while len(rows) < wanted and draws_left > 0:
        batch = wanted - len(rows)
        draws_left -= batch
        rows = ledger.unseen([*rows, *(ledger.space.join(ledger.space.sample(rng)) for _ in range(batch))])
    return RandomSearchState(config=config, ledger=ledger.plan(rows))
