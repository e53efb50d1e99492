"""`suite@1`: simulates the drives of a suite again until it is clear whether each is safe or unsafe.

Each drive is simulated with as many seeds as a sequential test takes (`brink.search.wald`): in rounds, each with as
many simulations of every undecided drive as the test needs at least. Seeds belong to a drive, not to its place in the
suite or to the verdicts of others: its k-th simulation has the episode seed of candidate ``seeds[drive] + k``. Suites
that share a drive, and versions of a system that do not differ for it, therefore share its episodes.

`schedule` says which candidate is which simulation; it follows from the verdicts alone, also of a stored campaign.
"""

from collections.abc import Mapping
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
)
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.wald import CLEAR, MOST, Decision, decide, further_drives

VERDICTS: Final = ("safe", "unsafe")


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteConfig(LedgerConfig):
    """Settings of the simulation of a suite; every list but `solutions` may be empty."""

    solutions: list[list[float]] = field(
        default_factory=list, metadata={"help": "The drives to simulate, each as a row of its numbers."}
    )
    seeds: list[int] = field(
        default_factory=list,
        metadata={
            "help": "For each drive, the number of the candidate whose episode seed its first simulation has; the "
            "next one has that of the next number. 0 by default."
        },
    )
    names: list[str] = field(default_factory=list, metadata={"help": "For each drive, its name."})
    expect: list[str] = field(
        default_factory=list, metadata={"help": "For each drive, safe or unsafe: what passes."}
    )
    reproduce: list[str] = field(
        default_factory=list,
        metadata={
            "help": "For each drive, safe or unsafe if nothing has changed since it was found so; empty if something "
            "has."
        },
    )
    episodes: list[str] = field(
        default_factory=list,
        metadata={"help": "For each drive, the digest of its first episode, which tells versions apart."},
    )
    most: int = setting(
        MOST, help="Most simulations of a drive; 1 for problems without chance.", ge=1, le=1000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SuiteState(LedgerState):
    """State of a suite: the ledger alone."""

    config: SuiteConfig


class Suite(LedgerAlgorithm[SuiteConfig, SuiteState]):
    """The simulation of a suite."""

    id = "suite@1"
    finds = ("suite",)
    minimises = ""
    internal = True
    summary = "No search: given drives, each simulated until it is clear whether it is safe or unsafe."
    config_type = SuiteConfig

    def _min_budget(self, space: SearchSpace, config: SuiteConfig) -> int:
        count = len(config.solutions)
        if not count:
            raise ConfigError("solutions", "expected at least one drive, as a row of its numbers")
        check_given_rows(space, "solutions", config.solutions)
        for name in ("seeds", "names", "expect", "reproduce", "episodes"):
            if len(getattr(config, name)) not in (0, count):
                raise ConfigError(
                    name,
                    f"expected one for each of {count} drives, or none; got {len(getattr(config, name))}",
                )
        if min(config.seeds, default=0) < 0:
            raise ConfigError("seeds", f"expected numbers >= 0, got {min(config.seeds)}")
        for name, allowed in (("expect", VERDICTS), ("reproduce", ("", *VERDICTS))):
            for value in getattr(config, name):
                if value not in allowed:
                    raise ConfigError(name, f"expected safe or unsafe, got {value!r}")
        return count

    def flight(self, config: SuiteConfig) -> tuple[int, int]:
        """Return the most candidates of one generation, and that there is one generation in flight."""
        return len(config.solutions) * min(CLEAR, config.most), 1

    def _first_state(self, ledger: Ledger, config: SuiteConfig) -> SuiteState:
        return _planned(config, ledger)

    def tell(self, state: SuiteState, evaluations: Mapping[int, Evaluation]) -> SuiteState:
        """Return the state after the pending generation was evaluated."""
        return _planned(state.config, state.ledger.tell(evaluations))

    def _restored(self, ledger: Ledger, config: SuiteConfig, document: Document) -> SuiteState:
        return SuiteState(config=config, ledger=ledger)


def _planned(config: SuiteConfig, ledger: Ledger) -> SuiteState:
    """Return the state with the next round queued; the budget may cut it short."""
    planned = schedule(len(config.solutions), ledger.ended, most=config.most)[ledger.spent : ledger.budget]
    seeds = config.seeds or [0] * len(config.solutions)
    rows = np.asarray(config.solutions, np.float64)
    return SuiteState(
        config=config,
        ledger=ledger.plan(
            [rows[drive] for drive, _ in planned], seed_numbers=[seeds[drive] + nth for drive, nth in planned]
        ),
    )


@dataclass(slots=True)
class Tally:
    """The simulations of a drive that have ended.

    Attributes:
        most: Most simulations of it.
        unsafe: Those that violated.
        evaluated: Those with a verdict.
        failed: Those without one.
        examples: Number of the first candidate with each verdict, by whether that is unsafe.
    """

    most: int = MOST
    unsafe: int = 0
    evaluated: int = 0
    failed: int = 0
    examples: dict[bool, int] = field(default_factory=dict)

    def add(self, number: int, unsafe: bool | None) -> None:
        """Count the simulation of a candidate: whether it was unsafe; None if it failed."""
        if unsafe is None:
            self.failed += 1
            return
        self.unsafe += unsafe
        self.evaluated += 1
        self.examples.setdefault(unsafe, number)

    @property
    def decision(self) -> Decision:
        """What they show."""
        if self.most == 1 and self.evaluated:  # without chance, the only verdict is that of every seed
            return Decision.UNSAFE if self.unsafe else Decision.SAFE
        return decide(self.unsafe, self.evaluated, self.failed, most=self.most)

    @property
    def needed(self) -> int:
        """Smallest number of further simulations that may decide."""
        if self.decision is not Decision.OPEN:
            return 0
        return further_drives(self.unsafe, self.evaluated, self.failed, most=self.most)


def schedule(drives: int, ended: Mapping[int, bool | None], *, most: int = MOST) -> list[tuple[int, int]]:
    """Return the drive of each candidate and which of its simulations it is, up to the first unfinished round.

    Args:
        drives: Number of drives.
        ended: Whether each candidate that has ended was unsafe, by number; None for one that failed.
        most: Most simulations of a drive.
    """
    return _replayed(drives, ended, most)[0]


def tallied(drives: int, ended: Mapping[int, bool | None], *, most: int = MOST) -> list[Tally]:
    """Return the tally of each drive of a stored campaign; arguments as in `schedule`."""
    return _replayed(drives, ended, most)[1]


def _replayed(
    drives: int, ended: Mapping[int, bool | None], most: int
) -> tuple[list[tuple[int, int]], list[Tally]]:
    """Return the schedule and the tallies that follow from the verdicts."""
    tallies = [Tally(most=most) for _ in range(drives)]
    planned: list[tuple[int, int]] = []
    while True:
        first = len(planned)
        for drive, tally in enumerate(tallies):
            done = tally.evaluated + tally.failed
            planned += [(drive, done + further) for further in range(tally.needed)]
        new = range(first, len(planned))
        for number in new:
            if number in ended:
                tallies[planned[number][0]].add(number, ended[number])
        if not all(number in ended for number in new) or not new:
            return planned, tallies
