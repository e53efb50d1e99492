"""`minimise@1`: reverts the differences between the two sides of a pair one by one while the verdict stays the same.

A trial is the unsafe side of a pair with one unit set to the value of the safe side, simulated under the episode seed
of the pair. If it is unsafe, it replaces the unsafe side, and all other differences are tried again. A pair is
*minimal* when none of its differences can be reverted: every trial was safe, or no valid solution lies there.

All pairs are worked on at the same time, each generation holds one trial of each. Nothing is drawn at random, so the
trials follow from the verdicts alone: `Reductions` can be replayed from a stored campaign.

Source: ours; docs/explanation/pairs.md. Reverting differences one by one is the last stage of delta debugging
(Zeller and Hildebrandt 2002, "Simplifying and isolating failure-inducing input").
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.algorithms.ledger import (
    Ledger,
    LedgerAlgorithm,
    LedgerConfig,
    LedgerState,
    check_given_rows,
    check_seed_numbers,
    stored_rows,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.features import Unit
from brink.search.pairs import Steps
from brink.search.space import BoolArray, FloatArray, SearchSpace, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True)
class MinimiseConfig(LedgerConfig):
    """Settings of the reduction of pairs."""

    safe: list[list[float]] = field(
        default_factory=list, metadata={"help": "Safe sides of the pairs, each as a row of its numbers."}
    )
    unsafe: list[list[float]] = field(
        default_factory=list, metadata={"help": "Unsafe sides of the pairs, in the same order."}
    )
    seed_numbers: list[int] = field(
        default_factory=list,
        metadata={
            "help": "For each pair, the number of the candidate whose episode seed its trials share; empty for seeds "
            "of their own."
        },
    )


class Trial(NamedTuple):
    """An unsafe side with one unit set to the value of the safe side.

    Attributes:
        pair: Index of the pair.
        unit: Index of the unit.
        row: The solution, shape ``(d,)``.
    """

    pair: int
    unit: int
    row: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reductions:
    """n pairs while their differences are reverted.

    Attributes:
        steps: The geometry of pairs in their space.
        safe: Safe sides, shape ``(n, d)``.
        unsafe: Unsafe sides as reduced so far, shape ``(n, d)``.
        needed: Whether the verdict is lost when a unit is reverted, shape ``(n, units)``.
        failed: Whether the simulation that would tell failed, shape ``(n, units)``.
    """

    steps: Steps
    safe: FloatArray
    unsafe: FloatArray
    needed: BoolArray
    failed: BoolArray

    @classmethod
    def of(cls, space: SearchSpace, safe: FloatArray, unsafe: FloatArray) -> Self:
        """Return pairs with nothing reverted yet, from their sides of shape ``(n, d)``."""
        steps = Steps(space)
        nothing = frozen_array(np.zeros((len(safe), len(steps.units)), np.bool_), np.bool_)
        return cls(
            steps=steps, safe=frozen_array(safe), unsafe=frozen_array(unsafe), needed=nothing, failed=nothing
        )

    def __len__(self) -> int:
        return len(self.safe)

    def trials(self) -> tuple[Trial, ...]:
        """Return the next trial of each pair that has one left."""
        candidates = (self.trial(pair) for pair in range(len(self)))
        return tuple(trial for trial in candidates if trial is not None)

    def trial(self, pair: int) -> Trial | None:
        """Return the next trial of a pair: the untried unit with the largest share of the distance; None if none."""
        safe, unsafe = self.safe[pair], self.unsafe[pair]
        units = self.steps.differing(safe, unsafe)
        shares = self.steps.lengths(safe, unsafe, units)
        for place in np.argsort(-shares, kind="stable").tolist():
            unit = self.steps.units.index(units[place])
            if not self.needed[pair, unit] and not self.failed[pair, unit]:
                row = self._without(pair, units[place])
                if row is not None:
                    return Trial(pair, unit, row)
        return None

    def is_minimal(self, pair: int) -> bool:
        """Return whether none of the differences of a pair can be reverted."""
        units = self.steps.differing(self.safe[pair], self.unsafe[pair])
        open_units = [self.steps.units.index(unit) for unit in units]
        return self.trial(pair) is None and not self.failed[pair, open_units].any()

    def is_undecided(self, pair: int) -> bool:
        """Return whether nothing is left to try, but a simulation that could have decided failed."""
        return self.trial(pair) is None and not self.is_minimal(pair)

    def after(self, trials: Sequence[Trial], unsafe: Sequence[bool | None]) -> Self:
        """Return the pairs, narrowed by the results of trials.

        Args:
            trials: At most one of each pair.
            unsafe: Their verdicts; None for one that failed.
        """
        rows, needed, failed = (np.array(each) for each in (self.unsafe, self.needed, self.failed))
        for trial, verdict in zip(trials, unsafe, strict=True):
            if verdict is None:
                failed[trial.pair, trial.unit] = True
            elif verdict:
                rows[trial.pair] = trial.row
                needed[trial.pair] = failed[trial.pair] = False
            else:
                needed[trial.pair, trial.unit] = True
        return replace(
            self,
            unsafe=frozen_array(rows),
            needed=frozen_array(needed, np.bool_),
            failed=frozen_array(failed, np.bool_),
        )

    def _without(self, pair: int, unit: Unit) -> FloatArray | None:
        """Return the unsafe side without a difference; None if no valid solution lies there, or only the safe side.

        A unit that wakes others, such as a label, takes them along: their numbers mean nothing without it.
        """
        safe, unsafe = self.safe[pair], self.unsafe[pair]
        space = self.steps.space
        row = np.array(unsafe)
        row[list(unit)] = safe[list(unit)]
        woken = space.dormant(unsafe) & ~space.dormant(row)
        row[woken] = safe[woken]
        rng = np.random.Generator(np.random.PCG64(0))  # not drawn from: no number is missing
        reverted = space.join(space.repair(space.split(row), rng))
        left = set(self.steps.differing(reverted, safe))
        if not left or not left < set(self.steps.differing(unsafe, safe)):
            return None
        return reverted


def most_trials(reductions: Reductions) -> int:
    """Return the largest number of trials that pairs can take."""
    total = 0
    for pair in range(len(reductions)):
        units = len(reductions.steps.differing(reductions.safe[pair], reductions.unsafe[pair]))
        total += units * (units + 1) // 2
    return total


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced:
    """Progress of the reduction of a campaign's pairs.

    Attributes:
        reductions: The pairs.
        latest: For each pair, the number of the candidate that is its unsafe side now; None if it is the given one.
        tried: Number of trials of each pair that were told.
    """

    reductions: Reductions
    latest: tuple[int | None, ...]
    tried: tuple[int, ...]


def replay(reductions: Reductions, verdicts: Mapping[int, bool | None], budget: int) -> Reduced:
    """Return the progress of a campaign, from the verdicts of its candidates.

    Args:
        reductions: The pairs before anything was reverted.
        verdicts: Whether each evaluated candidate was unsafe, by number; None for one that failed.
        budget: The campaign's budget.
    """
    latest: list[int | None] = [None] * len(reductions)
    tried = [0] * len(reductions)
    number = 0
    while trials := reductions.trials()[: budget - number]:
        numbers = range(number, number + len(trials))
        if any(one not in verdicts for one in numbers):
            break
        outcomes = [verdicts[one] for one in numbers]
        for trial, one, unsafe in zip(trials, numbers, outcomes, strict=True):
            tried[trial.pair] += 1
            if unsafe:
                latest[trial.pair] = one
        reductions = reductions.after(trials, outcomes)
        number += len(trials)
    return Reduced(reductions=reductions, latest=tuple(latest), tried=tuple(tried))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MinimiseState(LedgerState):
    """State of the reduction of pairs.

    Attributes:
        config: Settings.
        reductions: The pairs as reduced so far.
    """

    config: MinimiseConfig
    reductions: Reductions


class Minimise(LedgerAlgorithm[MinimiseConfig, MinimiseState]):
    """The reduction of pairs to the differences that matter."""

    id = "minimise@1"
    finds = ()
    minimises = ""
    internal = True
    summary = (
        "No search: reverts the differences of given pairs one by one, as long as the unsafe side is unsafe."
    )
    config_type = MinimiseConfig

    def _min_budget(self, space: SearchSpace, config: MinimiseConfig) -> int:
        if not config.safe or len(config.safe) != len(config.unsafe):
            raise ConfigError(
                "unsafe",
                f"expected as many as safe ones and at least one, got {len(config.unsafe)} for {len(config.safe)}",
            )
        check_seed_numbers(config.seed_numbers, len(config.safe), "pairs")
        check_given_rows(space, "safe", config.safe)
        check_given_rows(space, "unsafe", config.unsafe)
        if not _given(space, config).trials():
            raise ConfigError(
                "unsafe", "expected a pair that differs in more than one unit: these are minimal"
            )
        return 1

    def _first_state(self, ledger: Ledger, config: MinimiseConfig) -> MinimiseState:
        return _planned(MinimiseState(config=config, ledger=ledger, reductions=_given(ledger.space, config)))

    def tell(self, state: MinimiseState, evaluations: Mapping[int, Evaluation]) -> MinimiseState:
        """Return the state after the pending generation was evaluated."""
        pending = state.ledger.pending
        ledger = state.ledger.tell(evaluations)
        verdicts = [
            one.unsafe if isinstance(one := evaluations[candidate.number], Scored) else None
            for candidate in pending
        ]
        trials = state.reductions.trials()[: len(pending)]
        reductions = state.reductions.after(trials, verdicts)
        return _planned(replace(state, ledger=ledger, reductions=reductions))

    def _content(self, state: MinimiseState) -> tuple[dict[str, Any], dict[str, Any]]:
        reductions = state.reductions
        return {}, {
            "unsafe": reductions.unsafe,
            "needed": reductions.needed.astype(np.float64),
            "undecided": reductions.failed.astype(np.float64),
        }

    def _restored(self, ledger: Ledger, config: MinimiseConfig, document: Document) -> MinimiseState:
        given = _given(ledger.space, config)
        units = given.needed.shape[1]
        rows = stored_rows(document, "unsafe", ledger.space.dimension)
        needed, failed = (stored_rows(document, name, units) != 0 for name in ("needed", "undecided"))
        if not len(rows) == len(needed) == len(failed) == len(given):
            raise DocumentError(f"unsafe, needed, undecided: expected {len(given)} rows, one for each pair")
        reductions = replace(
            given, unsafe=rows, needed=frozen_array(needed, np.bool_), failed=frozen_array(failed, np.bool_)
        )
        return MinimiseState(config=config, ledger=ledger, reductions=reductions)


def _given(space: SearchSpace, config: MinimiseConfig) -> Reductions:
    return Reductions.of(space, np.asarray(config.safe, np.float64), np.asarray(config.unsafe, np.float64))


def _planned(state: MinimiseState) -> MinimiseState:
    """Return the state with the next trials queued, as far as the budget allows."""
    trials = state.reductions.trials()[: max(0, state.ledger.budget - state.ledger.spent)]
    seeds = [state.config.seed_numbers[trial.pair] if state.config.seed_numbers else None for trial in trials]
    return replace(state, ledger=state.ledger.plan([one.row for one in trials], seed_numbers=seeds))
