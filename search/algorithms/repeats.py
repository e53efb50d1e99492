"""Repeated simulation of given solutions with different seeds, without any search.

One episode tells whether a solution was unsafe once. Estimating the probability that it is unsafe takes repeated
episodes with other seeds: other pedestrians, other noise, another phase of the traffic lights. Candidate number i is
solution ``i mod n`` of the n given ones. Each round is completed before the next begins, so a stopped campaign has
equally many episodes of each solution, to within one.

The archive holds every solution many times, so its neighbourhoods and boundary are meaningless; use `tallied`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import (
    BoundaryConfig,
    Ledger,
    LedgerAlgorithm,
    LedgerState,
    check_given_rows,
    check_seed_numbers,
)
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.fitness import Z_95, fitness_of_interval, wilson_interval
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, SearchSpace


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatsConfig(BoundaryConfig):
    """Settings of repeats."""

    solutions: list[list[float]] = field(
        default_factory=list,
        metadata={"help": "Complete solutions to simulate, each as a row of its numbers."},
    )
    seed_numbers: list[int] = field(
        default_factory=list,
        metadata={
            "help": "For each solution, the number of the candidate whose episode seed it shares; empty for seeds of "
            "their own. Then each is simulated once."
        },
    )
    generation_size: int = setting(
        120, help="Candidates per generation; at least one round.", ge=1, le=10_000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RepeatsState(LedgerState):
    """State of repeats: the ledger alone."""

    config: RepeatsConfig

    @property
    def fitness(self) -> FloatArray:
        """An empty array, as nothing is minimised."""
        return np.empty(0)


class Repeats(LedgerAlgorithm[RepeatsConfig, RepeatsState]):
    """Repeated simulation of the given solutions with different seeds."""

    id = "repeat@1"
    summary = "No search: given solutions, each simulated with many seeds."
    config_type = RepeatsConfig

    def _min_budget(self, space: SearchSpace, config: RepeatsConfig) -> int:
        if not config.solutions:
            raise ConfigError("solutions", "expected at least one solution, as a row of its numbers")
        check_given_rows(space, "solutions", config.solutions)
        check_seed_numbers(config.seed_numbers, len(config.solutions), "solutions")
        return len(config.solutions)

    def check(self, space: SearchSpace, config: RepeatsConfig, *, budget: int) -> None:
        """Check that the algorithm can run with these arguments; see `LedgerAlgorithm.check`."""
        super().check(space, config, budget=budget)
        if config.seed_numbers and budget > len(config.solutions):
            raise ConfigError(
                "budget",
                f"expected {len(config.solutions)} simulations, one of each solution, since seed_numbers fixes their "
                f"seeds; got {budget}",
            )

    def _first_state(self, ledger: Ledger, config: RepeatsConfig) -> RepeatsState:
        return _planned(config, ledger)

    def tell(self, state: RepeatsState, evaluations: Mapping[int, Evaluation]) -> RepeatsState:
        """Return the state after the pending generation was evaluated."""
        return _planned(state.config, state.ledger.tell(evaluations))

    def _restored(self, ledger: Ledger, config: RepeatsConfig, document: Document) -> RepeatsState:
        return RepeatsState(config=config, ledger=ledger)


def _planned(config: RepeatsConfig, ledger: Ledger) -> RepeatsState:
    """Return the state with complete rounds queued; the budget may cut the last one short."""
    given = np.asarray(config.solutions, np.float64)
    rounds = max(1, config.generation_size // len(given))
    first = ledger.spent
    last = min(first - first % len(given) + rounds * len(given), ledger.budget)
    rows = [given[number % len(given)] for number in range(first, last)]
    seeds: list[int | None] = [
        config.seed_numbers[number] if config.seed_numbers else None for number in range(first, last)
    ]
    return RepeatsState(config=config, ledger=ledger.plan(rows, seed_numbers=seeds))


class Conclusion(StrEnum):
    """What the repeats of one solution show about its unsafe probability."""

    BELOW = "below"
    """Its interval lies below p_th: safer than the boundary."""
    ABOVE = "above"
    """Its interval lies above p_th: less safe than the boundary."""
    NEAR = "near"
    """It meets the criterion of the boundary itself: both verdicts, and an interval close to p_th."""
    INCONCLUSIVE = "inconclusive"
    """Its interval contains p_th, but shows no more than that, for example after few simulations."""


def simulations_to_clear(p_th: float, z: float = Z_95) -> int:
    """Return how many simulations, all of them safe, put the interval of a solution below `p_th`."""
    # With k = 0, the upper limit is z^2 / (n + z^2).
    return math.floor(z * z * (1 - p_th) / p_th) + 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tallies:
    """Estimated unsafe probability of each of n solutions, from its own simulations.

    Attributes:
        evaluated: Simulations with a verdict, shape ``(n,)``.
        unsafe: Unsafe simulations, shape ``(n,)``.
        probability: Unsafe share; NaN without a verdict, shape ``(n,)``.
        low: Lower limit of its Wilson interval; 0 without a verdict, shape ``(n,)``.
        high: Upper limit of its Wilson interval; 1 without a verdict, shape ``(n,)``.
    """

    evaluated: FloatArray
    unsafe: FloatArray
    probability: FloatArray
    low: FloatArray
    high: FloatArray

    def contains(self, p_th: float) -> BoolArray:
        """Return which intervals contain `p_th`, shape ``(n,)``."""
        inside: BoolArray = (self.low <= p_th) & (p_th <= self.high)
        return inside

    def conclusions(self, p_th: float, t_b: float) -> list[Conclusion | None]:
        """Return what is known of each solution; None without a verdict.

        An interval that contains `p_th` is no evidence for a boundary by itself: with few simulations, every interval
        does. A solution is near the boundary only if its own simulations meet the criterion of the strict boundary.

        Args:
            p_th: Unsafe probability that defines the boundary.
            t_b: Maximum fitness of the interval of a solution near the boundary.
        """
        inside = self.contains(p_th)
        mixed = (self.unsafe > 0) & (self.unsafe < self.evaluated)
        near = inside & mixed & (fitness_of_interval(self.low, self.high, p_th) <= t_b)
        return [
            None if not self.evaluated[place]
            else Conclusion.NEAR if near[place]
            else Conclusion.INCONCLUSIVE if inside[place]
            else Conclusion.BELOW if self.high[place] < p_th
            else Conclusion.ABOVE
            for place in range(len(self.evaluated))
        ]  # fmt: skip


def tallied(numbers: Sequence[int], unsafe: Sequence[bool], solutions: int, z: float = Z_95) -> Tallies:
    """Count the verdicts of a `Repeats` campaign by solution.

    Args:
        numbers: Numbers of the evaluated candidates.
        unsafe: Their verdicts.
        solutions: Number of given solutions.
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
