"""The contract of a kind of follow-up, and the discovery of kinds."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, cast

from brink.search.analysis.pairs import Pair
from brink.search.archive import Archive
from brink.server.campaigns.follow_ups.follow_up import FollowUp, PlannedFollowUp, StoredFollowUp
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.errors import InvalidInput
from brink.server.states import FollowUpKind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AskedPairs:
    """The pairs that a follow-up asks about.

    Attributes:
        campaign: Their campaign, which has ended.
        plan: Its plan.
        archive: Its archive.
        pairs: At least one pair.
    """

    campaign: Campaign
    plan: Plan
    archive: Archive
    pairs: Sequence[Pair]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reducible:
    """What reverting the differences of pairs takes.

    Attributes:
        pairs: Those of which a difference can be reverted, by the numbers of their two sides.
        most_trials: Largest number of simulations.
    """

    pairs: Collection[tuple[int, int]]
    most_trials: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """What it takes to ask about pairs.

    Attributes:
        simulations: Number of simulations, in each repeat if there are several.
        reason: Why it cannot be asked; empty if it can.
        left_out: Pairs that are not asked about, because their sides were simulated with different seeds.
    """

    simulations: int = 0
    reason: str = ""
    left_out: int = 0


class Question(ABC):
    """A kind of follow-up.

    Attributes:
        kind: Its kind.
        title: What it asks about pairs, as a heading.
        label: Label of the button that asks it.
        option: Option of `brink pairs` that asks it.
        words: What it simulates of pairs, in a sentence.
        simulates: The same, in a few words.
        purpose: What it did, for people who have never seen Brink, with ``{many}`` drives and the campaign ``{of}``.
        showed: What it showed, with ``{counts}`` unsafe drives; empty with repeats, whose shares are told instead.
        repeats: Default for the most simulations of each side; None if sides are simulated with their own seeds.
        is_exact: Whether it takes exactly the simulations that are offered, rather than at most these.
        is_asked_by_experiments: Whether it is asked about the pairs of all campaigns of an experiment.
        has_findings: Whether its campaign has findings of its own, so that its results are theirs.
    """

    kind: ClassVar[FollowUpKind]
    title: ClassVar[str]
    label: ClassVar[str]
    option: ClassVar[str]
    words: ClassVar[str]
    simulates: ClassVar[str]
    purpose: ClassVar[str]
    showed: ClassVar[str] = ""
    repeats: ClassVar[int | None] = None
    is_exact: ClassVar[bool] = False
    is_asked_by_experiments: ClassVar[bool] = False
    has_findings: ClassVar[bool] = False

    @abstractmethod
    def fits(self, plan: Plan, asks: FollowUp) -> bool:
        """Return whether the campaign with a plan can be such a follow-up."""

    @abstractmethod
    def plan(self, asked: AskedPairs, seeds: Mapping[int, int], repeats: int) -> PlannedFollowUp:
        """Plan a follow-up of pairs.

        Args:
            asked: The pairs.
            seeds: Episode seed of each unsafe side, by number.
            repeats: Most simulations of each side, if the kind has repeats.

        Raises:
            InvalidInput: The problem does not allow it.
            Conflict: There is nothing to ask about these pairs.
        """

    @abstractmethod
    def offer(self, asked: AskedPairs, reducible: Reducible, finished: Sequence[StoredFollowUp]) -> Offer:
        """Return the cost of the follow-up for some pairs.

        Args:
            asked: The pairs.
            reducible: What reverting their differences takes.
            finished: The follow-ups of this kind that have finished.
        """

    def brief(self, evaluated: int, unsafe: int) -> str:
        """Summarise a follow-up in a few words; empty if its answers appear with the campaign that it is about."""
        return ""


@cache
def question_of(kind: FollowUpKind) -> Question:
    """Return the kind of follow-up of a name."""
    module = importlib.import_module(f"{__package__}.kinds.{kind}")
    return cast(Question, module.QUESTION)


def questions() -> list[Question]:
    """Return all kinds of follow-ups."""
    return [question_of(kind) for kind in FollowUpKind]


def sides_of(pairs: Sequence[Pair]) -> list[int]:
    """Return the numbers of both sides of pairs, each once."""
    return list(dict.fromkeys(side.number for pair in pairs for side in (pair.safe, pair.unsafe)))


def refusal(check: Callable[[], object]) -> str:
    """Return the reason why a check fails; empty if it passes."""
    try:
        check()
    except InvalidInput as error:
        return "; ".join(one.message for one in error.errors)
    return ""
