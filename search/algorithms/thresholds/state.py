"""The settings and the state of `edge@2`: its hunts, and the purpose of each candidate."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, NamedTuple

from brink.search.algorithms.ledger import LedgerConfig, LedgerState
from brink.search.archive import Archive
from brink.search.exploration import RobustnessSurrogate
from brink.search.settings import setting
from brink.search.space import FloatArray
from brink.search.thresholds.estimation import MOST, Estimate

MAX_FAILURES: Final = 3
"""Simulations of a hunt that may fail before it is given up."""


class Draw(IntEnum):
    """What is drawn, as the first index of the stream."""

    GENERATION = 0
    SURROGATE = 1
    EXPLORE = 2
    MOVE = 3
    ESTIMATE = 4
    PLACES = 5


class Purpose(IntEnum):
    """Why a candidate is simulated. The numbers are stored."""

    EXPLORE = 0
    """To find unsafe solutions."""
    SCREEN = 1
    """The anchor without any error: is the scenario alone unsafe?"""
    DROP = 2
    """The anchor with one error less."""
    MOVE = 3
    """With one unit moved: is it safe then?"""
    FAR = 4
    """With this unit moved on to the other end of its range: is it safe again?"""
    PROBE = 5
    """Half-way between the safe and the unsafe end, under the same seed."""
    TRIAL = 6
    """Somewhere along the unit, under a seed of its own."""
    APPROACH = 7
    """With one unit set to the value of a safe solution: is it safe then?"""
    CHECK = 8
    """An end of a line under a seed of its own: does its verdict depend on the seed?"""


class Stage(IntEnum):
    """How far a hunt has come. Archives store the numbers, so they must not change."""

    SCREEN = 0
    """Does the scenario alone have the same verdict?"""
    REDUCE = 1
    """Which errors does the verdict take?"""
    MOVE = 2
    """Which unit changes the verdict?"""
    SPAN = 3
    """Is it safe again further on, and where between the two ends does it turn?"""
    BRACKET = 4
    """Where between the two ends of the bracket does it turn?"""
    ESTIMATE = 5
    """How does the probability of a violation rise along the unit?"""
    THRESHOLD = 6
    """Ended: the probability of a violation passes from 20 to 80% within a fifth of the unit's range."""
    CHANCY = 7
    """Ended: it does not."""
    CATEGORY = 8
    """Ended: only a category changes the verdict."""
    ALONE = 9
    """Ended: the scenario has the same verdict without any error."""
    FIXED = 10
    """Ended: no single unit that was tried changes the verdict."""
    GIVEN_UP = 11
    """Ended: too many simulations failed."""
    READY = 12
    """Waits: the unit is known to make it safe, and its line begins if the budget suffices."""
    REPEATED = 13
    """Ended: another hunt along the same unit has a threshold close by."""


OPEN: Final = (Stage.SCREEN, Stage.REDUCE, Stage.MOVE, Stage.SPAN, Stage.BRACKET, Stage.ESTIMATE)
"""Stages of hunts that go on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdConfig(LedgerConfig):
    """Settings of the search for thresholds."""

    trials: int = setting(
        MOST,
        label="Simulations of a threshold",
        main=True,
        help="Most simulations with fresh seeds along a unit; 0 for problems without chance.",
        ge=0,
        le=1000,
    )
    explore: float = setting(
        0.15, help="Share of the budget that looks for unsafe solutions at the start.", ge=0.01, le=1
    )
    chance: float = setting(
        0.25, help="Share of these that are drawn at random, whatever the surrogate proposes.", ge=0, le=1
    )
    moves: int = setting(6, help="Units that are moved, each alone, until the verdict changes.", ge=1, le=100)
    units: int = setting(
        3,
        help="Units that are moved at a time; a threshold is looked for along each that changes the verdict.",
        ge=1,
        le=100,
    )
    batch: int = setting(
        6,
        help="Fewest simulations along a unit at a time, and eight at first. With more candidates in flight, more of "
        "these at a time let the search end what it begins.",
        ge=1,
        le=1000,
    )
    generation_size: int = setting(20, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        3,
        help="Full generations in flight at a time, or more smaller ones. With more, more workers are busy; with "
        "fewer, each choice is based on more results.",
        ge=1,
        le=1000,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Hunt:
    """The hunt for a threshold near a solution; solutions by their numbers, -1 for none.

    Attributes:
        anchor: The solution that it began with.
        seed: Number of the candidate whose episode seed its stages share.
        held: The solution as reduced so far; it has the verdict of the anchor under the seed.
        stage: How far it is.
        from_safe: Whether the anchor is safe. Errors may protect, such as an injected detection where there is none.
        needed: Blocks without which it has the other verdict, as indices.
        unit: Index of the unit that decides, -1 before it is known.
        moved: Indices of the units moved so far, in this hunt and earlier ones of the same anchor.
        opposite: Solution of the other verdict that it approaches, one unit after the other.
        safe: Safe end of the bracket.
        unsafe: Unsafe end of the bracket.
        start: Safe end of the line.
        end: Unsafe end of the line.
        window: Whether it is safe again further on.
        trials: Simulations along the line, or of the held solution, with seeds of their own.
        failures: Simulations that failed.
        told: Simulations of the current stage that have a verdict, each with its purpose and subject.
    """

    anchor: int
    seed: int
    held: int
    stage: Stage
    from_safe: bool = False
    needed: tuple[int, ...] = ()
    unit: int = -1
    moved: tuple[int, ...] = ()
    opposite: int = -1
    safe: int = -1
    unsafe: int = -1
    start: int = -1
    end: int = -1
    window: bool = False
    trials: tuple[int, ...] = ()
    failures: int = 0
    told: tuple[tuple[int, int, int], ...] = ()


class Job(NamedTuple):
    """Why a candidate is simulated.

    Attributes:
        purpose: The purpose.
        hunt: Index of its hunt; 0 for exploring.
        subject: Index of the block that is dropped, or of the unit that is moved; 0 otherwise.
    """

    purpose: Purpose
    hunt: int = 0
    subject: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThresholdState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        hunts: All hunts, in the order in which they began.
        jobs: The purpose of each candidate in flight or queued, in the order of asking.
        explored: Numbers of the simulated solutions that were explored and have a verdict.
        surrogate: Estimates robustness; None until it is needed.
        estimates: The estimates of hunts in the stage `Stage.ESTIMATE`, by index, as far as computed.
        alone: Explored solutions without any error, by number, as far as computed; None where there is none.
    """

    config: ThresholdConfig
    hunts: tuple[Hunt, ...] = ()
    jobs: tuple[Job, ...] = ()
    explored: tuple[int, ...] = ()
    surrogate: RobustnessSurrogate | None = None
    estimates: Mapping[int, Estimate] = field(default_factory=dict)
    alone: dict[int, FloatArray | None] = field(default_factory=dict)


class Simulated:
    """The simulated solutions, by number."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._places = {number: place for place, number in enumerate(archive.numbers.tolist())}

    def row(self, number: int) -> FloatArray:
        """Return a solution, shape ``(d,)``."""
        row: FloatArray = self._archive.vectors[self._places[number]]
        return row

    def unsafe(self, number: int) -> bool:
        """Return the verdict on a solution."""
        return bool(self._archive.unsafe[self._places[number]])

    def robustness(self, number: int) -> float:
        """Return the distance of a solution to violation."""
        return float(self._archive.robustness[self._places[number]])
