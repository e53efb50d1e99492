"""Random search: independent draws from the space, none of them twice. The baseline of every comparison.

It takes any space. Source: Sharifi et al. 2023, baseline RS.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerState, check_budget
from brink.search.archive import Archive
from brink.search.component import FloatArray
from brink.search.document import Document
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

_VERSION = 1
_DRAWS_A_CANDIDATE = 200
"""Draws without anything new, for each candidate wanted, after which a finite space counts as exhausted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomSearchConfig(BoundaryConfig):
    """Settings of random search."""

    generation_size: int = setting(60, help="Candidates asked at a time.", ge=1, le=10_000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomSearchState(LedgerState):
    """State of random search: the ledger is all there is."""

    config: RandomSearchConfig


class RandomSearch:
    """Independent draws."""

    id = "random@1"
    summary = "Random search: independent draws from the space."
    config_type = RandomSearchConfig

    def check(self, space: SearchSpace, config: RandomSearchConfig, *, budget: int) -> None:
        """Raise ConfigError if the budget is not positive; any space will do."""
        check_budget(budget, 1)

    def start(
        self, space: SearchSpace, config: RandomSearchConfig, *, seed: int, budget: int
    ) -> RandomSearchState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        return _planned(config, Ledger.opened(space, config, seed=seed, budget=budget))

    def ask(self, state: RandomSearchState) -> tuple[RandomSearchState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        ledger = state.ledger.handed_out()
        return RandomSearchState(config=state.config, ledger=ledger), ledger.pending

    def tell(self, state: RandomSearchState, evaluations: Mapping[int, Evaluation]) -> RandomSearchState:
        """Return the state after the pending generation was evaluated."""
        return _planned(state.config, state.ledger.told(evaluations))

    def finished(self, state: RandomSearchState) -> bool:
        """Return whether the budget is spent, or nothing new was found in many draws."""
        return not state.ledger.queue

    def dump(self, state: RandomSearchState) -> Document:
        """Return the state without its archive, as a versioned document."""
        return state.ledger.dump(self.id, _VERSION, {}, {})

    def load(
        self, space: SearchSpace, config: RandomSearchConfig, document: Document, archive: Archive
    ) -> RandomSearchState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        ledger = Ledger.load(space, config, document.expect(self.id, _VERSION), archive)
        return RandomSearchState(config=config, ledger=ledger)


def _planned(config: RandomSearchConfig, ledger: Ledger) -> RandomSearchState:
    """Return the state with the next generation queued, cut to what is left of budget and space."""
    wanted = int(min(config.generation_size, ledger.left))
    rng = generator(ledger.seed, Stream.START, ledger.generation)
    rows: tuple[FloatArray, ...] = ()
    draws_left = _DRAWS_A_CANDIDATE * wanted
    while len(rows) < wanted and draws_left > 0:
        batch = wanted - len(rows)
        draws_left -= batch
        rows = ledger.unseen([*rows, *(ledger.space.join(ledger.space.sample(rng)) for _ in range(batch))])
    return RandomSearchState(config=config, ledger=ledger.planned(rows))
