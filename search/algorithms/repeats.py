"""Given solutions again and again: no search, but each of them simulated with many seeds.

One episode says whether it went wrong that time. How likely a solution is unsafe is known only by running it again
with other seeds: other pedestrians, other noise, another phase of the lights. Candidate number i is solution
``i mod n`` of the n given; a whole round of all of them comes before the next, so that whatever is there when a
campaign is stopped says as much of each.

Its archive holds every solution many times. The archive's neighbourhoods, and a boundary made of them, mean nothing;
``tallied`` says what was found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerState, check_budget
from brink.search.archive import Archive
from brink.search.component import BoolArray, FloatArray
from brink.search.document import Document
from brink.search.errors import ConfigError, SpaceError
from brink.search.fitness import Z_95, wilson_interval
from brink.search.settings import setting
from brink.search.space import SearchSpace

_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatsConfig(BoundaryConfig):
    """Settings of repeats."""

    solutions: list[list[float]] = field(
        default_factory=list,
        metadata={"help": "What is simulated: complete solutions, each as a row of its numbers."},
    )
    generation_size: int = setting(
        120, help="Candidates asked at a time, or a round if it is larger.", ge=1, le=10_000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RepeatsState(LedgerState):
    """State of repeats: how far it is."""

    config: RepeatsConfig

    @property
    def fitness(self) -> FloatArray:
        """Nothing: there is nothing to minimise."""
        return np.empty(0)


class Repeats:
    """The same solutions with other seeds."""

    id = "repeat@1"
    summary = "No search: given solutions, each simulated with many seeds."
    config_type = RepeatsConfig

    def check(self, space: SearchSpace, config: RepeatsConfig, *, budget: int) -> None:
        """Raise ConfigError if a solution is not of the space, or the budget does not cover a round of them."""
        if not config.solutions:
            raise ConfigError("solutions", "expected at least one solution, as a row of its numbers")
        for place, row in enumerate(config.solutions):
            try:
                space.check(space.split(np.asarray(row, np.float64)))
            except SpaceError as error:
                raise ConfigError("solutions", f"row {place}: {error}") from None
        check_budget(budget, len(config.solutions))

    def start(self, space: SearchSpace, config: RepeatsConfig, *, seed: int, budget: int) -> RepeatsState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        return _planned(config, Ledger.opened(space, config, seed=seed, budget=budget))

    def ask(self, state: RepeatsState) -> tuple[RepeatsState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(self, state: RepeatsState, evaluations: Mapping[int, Evaluation]) -> RepeatsState:
        """Return the state after the pending generation was evaluated."""
        return _planned(state.config, state.ledger.told(evaluations))

    def finished(self, state: RepeatsState) -> bool:
        """Return whether the budget is spent."""
        return not state.ledger.queue

    def dump(self, state: RepeatsState) -> Document:
        """Return the state without its archive, as a versioned document."""
        return state.ledger.dump(self.id, _VERSION, {}, {})

    def load(
        self, space: SearchSpace, config: RepeatsConfig, document: Document, archive: Archive
    ) -> RepeatsState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        ledger = Ledger.load(space, config, document.expect(self.id, _VERSION), archive)
        return RepeatsState(config=config, ledger=ledger)


def _planned(config: RepeatsConfig, ledger: Ledger) -> RepeatsState:
    """Return the state with whole rounds queued, the last one cut to the budget."""
    given = np.asarray(config.solutions, np.float64)
    rounds = max(1, config.generation_size // len(given))
    first = ledger.spent
    last = min(first - first % len(given) + rounds * len(given), ledger.budget)
    return RepeatsState(
        config=config, ledger=ledger.planned(given[number % len(given)] for number in range(first, last))
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tallies:
    """How likely given solutions are unsafe, each by its own simulations.

    Attributes:
        evaluated: Simulations of each that gave a verdict, shape ``(n,)``.
        unsafe: Of them, unsafe, shape ``(n,)``.
        probability: Unsafe share; NaN where nothing was evaluated, shape ``(n,)``.
        low: Lower limit of its Wilson interval; 0 where nothing was evaluated, shape ``(n,)``.
        high: Upper limit; 1 where nothing was evaluated, shape ``(n,)``.
    """

    evaluated: FloatArray
    unsafe: FloatArray
    probability: FloatArray
    low: FloatArray
    high: FloatArray

    def holds(self, p_th: float) -> BoolArray:
        """Return of which solutions the interval contains a probability, shape ``(n,)``."""
        inside: BoolArray = (self.low <= p_th) & (p_th <= self.high)
        return inside


def tallied(numbers: Sequence[int], unsafe: Sequence[bool], solutions: int, z: float = Z_95) -> Tallies:
    """Return how likely given solutions are unsafe.

    Args:
        numbers: Of evaluated candidates of `Repeats`.
        unsafe: Their verdicts.
        solutions: How many solutions were given.
        z: Quantile of the standard normal for the interval.
    """
    which = np.asarray(numbers, np.int64) % solutions
    n = np.bincount(which, minlength=solutions)
    k = np.bincount(which[np.asarray(unsafe, np.bool_)], minlength=solutions)
    low, high = np.zeros(solutions), np.ones(solutions)
    known = n > 0
    if known.any():
        low[known], high[known] = wilson_interval(k[known], n[known], z)
    share = np.full(solutions, np.nan)
    share[known] = k[known] / n[known]
    return Tallies(
        evaluated=n.astype(np.float64), unsafe=k.astype(np.float64), probability=share, low=low, high=high
    )
