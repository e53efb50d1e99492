"""Repeated simulation of given solutions with different seeds, without any search.

One episode tells whether a solution was unsafe once. Estimating the probability that it is unsafe takes repeated
episodes with other seeds: other pedestrians, other noise, another phase of the traffic lights. Each round is
completed before the next begins, so a stopped campaign has equally many episodes of each solution, to within one:
candidate number i is solution ``i mod n`` of the n given ones.

With verdicts to confirm (`keep`), a solution is left out of further rounds once its verdict is confirmed or refuted
(`brink.search.sequential`). `schedule` says which candidate is which solution; nothing is drawn at random, so it
follows from the verdicts alone, also of a stored campaign.

The archive holds every solution many times, so its neighbourhoods and boundary are meaningless; use `tallied`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import (
    Ledger,
    LedgerAlgorithm,
    LedgerConfig,
    LedgerState,
    check_given_rows,
    check_seed_numbers,
)
from brink.search.conclusions import Conclusion
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.fitness import Z_95, fitness_of_interval
from brink.search.sequential import Verdict, drives_to_confirm, exact_interval, verdict_of
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, SearchSpace

GENERATION_SIZE: Final = 120


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatsConfig(LedgerConfig):
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
    keep: list[bool] = field(
        default_factory=list,
        metadata={
            "help": "For each solution, whether it is unsafe. Then each is simulated until that is confirmed or "
            "refuted, and at most budget / n times; empty to simulate all of them equally often."
        },
    )
    generation_size: int = setting(
        GENERATION_SIZE, help="Candidates per generation; at least one round.", ge=1, le=10_000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RepeatsState(LedgerState):
    """State of repeats: the ledger alone."""

    config: RepeatsConfig


class Repeats(LedgerAlgorithm[RepeatsConfig, RepeatsState]):
    """Repeated simulation of the given solutions with different seeds."""

    id = "repeat@1"
    finds = ()
    minimises = ""
    internal = True
    summary = "No search: given solutions, each simulated with many seeds."
    config_type = RepeatsConfig

    def _min_budget(self, space: SearchSpace, config: RepeatsConfig) -> int:
        if not config.solutions:
            raise ConfigError("solutions", "expected at least one solution, as a row of its numbers")
        check_given_rows(space, "solutions", config.solutions)
        check_seed_numbers(config.seed_numbers, len(config.solutions), "solutions")
        if config.keep and len(config.keep) != len(config.solutions):
            raise ConfigError(
                "keep",
                f"expected one for each of {len(config.solutions)} solutions, or none; got {len(config.keep)}",
            )
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
    given, first = np.asarray(config.solutions, np.float64), ledger.spent
    if config.keep:
        planned = schedule(config.keep, ledger.ended, ledger.budget, config.generation_size)[first:]
    else:
        rounds = max(1, config.generation_size // len(given))
        last = min(first - first % len(given) + rounds * len(given), ledger.budget)
        planned = [number % len(given) for number in range(first, last)]
    seeds: list[int | None] = [
        config.seed_numbers[position] if config.seed_numbers else None for position in planned
    ]
    return RepeatsState(
        config=config, ledger=ledger.plan([given[position] for position in planned], seed_numbers=seeds)
    )


def schedule(
    keep: Sequence[bool],
    ended: Mapping[int, bool | None],
    budget: int,
    generation_size: int = GENERATION_SIZE,
) -> list[int]:
    """Return the index of the solution of each candidate, up to the first generation that has not ended.

    Args:
        keep: The verdict of each solution that is to be confirmed: whether it is unsafe.
        ended: Whether each candidate that has ended was unsafe, by number; None for one that failed.
        budget: The campaign's budget.
        generation_size: Its setting.
    """
    most, done = budget // len(keep), 0
    tallies = [_Tally(unsafe=unsafe) for unsafe in keep]
    active = list(range(len(keep)))
    planned: list[int] = []
    while active and done < most:
        first = len(planned)
        needed = min(tallies[position].needed for position in active)
        rounds = min(max(1, generation_size // len(active)), most - done, needed)
        planned += active * rounds
        if any(number not in ended for number in range(first, len(planned))):
            break
        for number in range(first, len(planned)):
            tallies[planned[number]].add(ended[number])
        done += rounds
        active = [position for position in active if tallies[position].verdict is Verdict.UNDECIDED]
    return planned


@dataclass(slots=True)
class _Tally:
    """Drives of a solution with other seeds, and the verdict to confirm."""

    unsafe: bool
    other: int = 0
    evaluated: int = 0
    failed: int = 0

    def add(self, unsafe: bool | None) -> None:
        self.failed += unsafe is None
        self.evaluated += unsafe is not None
        self.other += unsafe is not None and unsafe != self.unsafe

    @property
    def verdict(self) -> Verdict:
        return verdict_of(self.other, self.evaluated, self.failed)

    @property
    def needed(self) -> int:
        """Minimum number of further drives that confirm its verdict."""
        return drives_to_confirm(self.other + self.failed) - self.evaluated - self.failed


def simulations_to_clear(p_th: float, z: float = Z_95) -> int:
    """Return how many simulations, all of them safe, put the interval of a solution below `p_th`."""
    # With k = 0, the upper limit is 1 - beyond^(1/n).
    return math.floor(math.log(_beyond(z)) / math.log1p(-p_th)) + 1


def _beyond(z: float) -> float:
    """Return the probability beyond `z` standard deviations on one side."""
    return math.erfc(z / math.sqrt(2)) / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tallies:
    """Estimated unsafe probability of each of n solutions, from its own simulations.

    Attributes:
        evaluated: Simulations with a verdict, shape ``(n,)``.
        unsafe: Unsafe simulations, shape ``(n,)``.
        probability: Unsafe share; NaN without a verdict, shape ``(n,)``.
        low: Lower limit of its exact interval; 0 without a verdict, shape ``(n,)``.
        high: Upper limit of its exact interval; 1 without a verdict, shape ``(n,)``.
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
        """Return the conclusion on each solution; None without a verdict.

        An interval that contains `p_th` is not evidence for a boundary by itself: with few simulations, every
        interval does. A solution is near the boundary only if its own simulations meet the criterion of the strict
        boundary.

        Args:
            p_th: Unsafe probability that defines the boundary.
            t_b: Maximum fitness of the interval of a solution near the boundary.
        """
        inside = self.contains(p_th)
        mixed = (self.unsafe > 0) & (self.unsafe < self.evaluated)
        near = inside & mixed & (fitness_of_interval(self.low, self.high, p_th) <= t_b)
        return [
            None
            if not self.evaluated[place]
            else Conclusion.NEAR
            if near[place]
            else Conclusion.INCONCLUSIVE
            if inside[place]
            else Conclusion.BELOW
            if self.high[place] < p_th
            else Conclusion.ABOVE
            for place in range(len(self.evaluated))
        ]


def tallied(which: Sequence[int], unsafe: Sequence[bool], solutions: int, z: float = Z_95) -> Tallies:
    """Count the verdicts of a `Repeats` campaign by solution.

    Args:
        which: Index of the solution of each evaluated candidate.
        unsafe: Their verdicts.
        solutions: Number of given solutions.
        z: Quantile of the standard normal that gives the confidence of the intervals.
    """
    solution = np.asarray(which, np.int64)
    n = np.bincount(solution, minlength=solutions)
    k = np.bincount(solution[np.asarray(unsafe, np.bool_)], minlength=solutions)
    counts, confidence = zip(k.tolist(), n.tolist(), strict=True), 1 - 2 * _beyond(z)
    limits = [exact_interval(unsafe_ones, all_ones, confidence) for unsafe_ones, all_ones in counts]
    low, high = np.array(limits, np.float64).reshape(-1, 2).T
    known = n > 0
    share = np.full(solutions, np.nan)
    share[known] = k[known] / n[known]
    return Tallies(
        evaluated=n.astype(np.float64), unsafe=k.astype(np.float64), probability=share, low=low, high=high
    )
