"""The settings and the state of `edge@1`: its brackets, and the purpose of each candidate."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from brink.search.algorithms.edge.prior import Prior
from brink.search.algorithms.ledger import LedgerState, PairConfig
from brink.search.archive import Archive
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, SearchSpace
from brink.search.surrogate import Surrogate

LIKELY: Final = 0.75
"""Probability of the opposite verdict from which on a nearer partner is better than a likelier one."""


class Draw(IntEnum):
    """What is drawn, as the first index of the stream."""

    GENERATION = 0
    SURROGATE = 1
    PARTNER = 2
    MORE = 3
    CHANCE = 4
    PROPOSED = 5


class Purpose(IntEnum):
    """Why a candidate is simulated. The numbers are stored."""

    EXPLORE = 0
    PARTNER = 1
    PROBE = 2
    CHECK = 3
    ANCHOR = 4
    """A solution, known or new, that is simulated so that a bracket may begin there."""


class Status(IntEnum):
    """Progress of a bracket. The numbers are stored."""

    OPEN = 0
    """Not tight yet."""
    TIGHT = 1
    """Tight, and to be checked."""
    KEPT = 2
    """Tight, and both sides kept their verdicts under other seeds."""
    CHANCY = 3
    """Tight, but a side changed its verdict under another seed."""
    GIVEN_UP = 4
    """Too many simulations failed."""
    NEAR = 5
    """Not tight yet, and probably too close to a tight pair to be distinct, wherever it ends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeConfig(PairConfig):
    """Settings of the search for pairs."""

    explore: float = setting(0.4, help="Share of the budget for random draws at the start.", ge=0.01, le=1)
    margin: float = setting(
        0.2,
        help="Share of each verdict's solutions, those nearest to the other verdict, that neither anchor nor open "
        "brackets: where chance matters, they are too close to call.",
        ge=0,
        lt=1,
    )
    checks: int = setting(
        1,
        help="Fresh seeds under which each side of a pair is simulated again; 0 for deterministic problems.",
        ge=0,
        le=100,
    )
    vary: str = setting(
        "all", help="What the two sides of a pair may differ in: the name of a component, or all of them."
    )
    generation_size: int = setting(20, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        3,
        help="Generations in flight at a time. With more, more workers are busy; with fewer, each choice is "
        "based on more results.",
        ge=1,
        le=1000,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Bracket:
    """A safe and an unsafe solution, by their numbers.

    Attributes:
        safe: Number of the safe side.
        unsafe: Number of the unsafe side.
        seed: Number of the candidate whose episode seed both share.
        status: How far it is.
        failures: Simulations for it that failed.
        safe_checks: Checks in which the safe side was safe.
        unsafe_checks: Checks in which the unsafe side was unsafe.
    """

    safe: int
    unsafe: int
    seed: int
    status: Status = Status.OPEN
    failures: int = 0
    safe_checks: int = 0
    unsafe_checks: int = 0


Job = tuple[Purpose, int, int]
"""Purpose, anchor or bracket, and side of a check: 0 for the safe one, 1 for the unsafe one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        brackets: All brackets, in the order in which they were opened.
        jobs: The purpose of each candidate in flight or queued, in the order of asking.
        seeds: Number of the candidate whose episode seed a solution shares, for those that have none of their own.
        tries: How often a partner of a solution was looked for, by its number. Not each was simulated: where numbers
            are few, the best draw may be known already.
        partnered: Number of partners that were simulated, also those that failed.
        resolved: Positions of the brackets that were kept or found chancy, in the order in which that was known.
        surrogate: Estimates how likely a solution is unsafe; None until it is needed.
        chance: Estimates how likely a pair is a chancy place; None until enough is known.
        partners: The best partner drawn for each anchor, by its number.
        draws: What partners are chosen from, by the anchor's number: judging again is cheaper than drawing again.
        prior: What the known results say; None if there are none.
    """

    config: EdgeConfig
    brackets: tuple[Bracket, ...] = ()
    jobs: tuple[Job, ...] = ()
    seeds: Mapping[int, int]
    tries: Mapping[int, int]
    partnered: int = 0
    resolved: tuple[int, ...] = ()
    surrogate: Surrogate | None = None
    chance: Surrogate | None = None
    partners: Mapping[int, "Partner"] = field(default_factory=dict)
    draws: Mapping[int, "Draws"] = field(default_factory=dict)
    prior: "Prior | None" = None


def varied_columns(space: SearchSpace, config: EdgeConfig) -> BoolArray:
    """Return which columns the two sides of a bracket may differ in, shape ``(d,)``.

    Numbers alone if the varied components have any: two solutions in the same categories are easier to compare.

    Raises:
        SpaceError: There is no such component.
    """
    varied = np.ones(space.dimension, np.bool_)
    if config.vary != "all":
        varied[:] = False
        varied[space.slices[space.index(config.vary)]] = True
    numbers = varied & ~space.categorical
    return numbers if numbers.any() else varied


class Solutions:
    """The simulated solutions, by number."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive

    def place(self, number: int) -> int:
        """Return the position of a solution in the archive."""
        return int(np.searchsorted(self._archive.numbers, number))

    def row(self, number: int) -> FloatArray:
        """Return a solution."""
        row: FloatArray = self._archive.vectors[self.place(number)]
        return row


class Draws(NamedTuple):
    """Possible partners of an anchor.

    Attributes:
        attempt: How many partners of the anchor were simulated before.
        rows: The draws before repair, shape ``(n, d)``.
        lengths: Their distances from the anchor, shape ``(n,)``.
    """

    attempt: int
    rows: FloatArray
    lengths: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Partner:
    """The best partner drawn for an anchor.

    Attributes:
        row: The partner before repair, shape ``(d,)``.
        attempt: How many partners of the anchor were simulated before.
        flips: Probability that it has the opposite verdict, as the surrogate judges.
        length: Its distance from the anchor.
    """

    row: FloatArray
    attempt: int
    flips: float
    length: float

    def rank(self, chancy: float) -> tuple[float, float]:
        """Return a key that is smaller for a better partner: likely to open a pair that holds, and then near.

        Args:
            chancy: Probability that the pair is a chancy place.
        """
        return -min(self.flips, LIKELY) * (1.0 - chancy), self.length
