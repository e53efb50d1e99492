"""Response schemas of pairs: two neighbouring solutions, one safe and one unsafe, and the change between them."""

from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import Field

from brink.search.analysis.confirmation import Confirmation
from brink.search.sequential import ERROR, FIRST, FURTHER, INTERVAL, LIMIT
from brink.server.findings.follow_ups import FollowUpView, ShareView
from brink.server.findings.table import Table
from brink.server.states import CampaignStatus, FollowUpKind, OutcomeKind
from brink.server.views import ActivityView, View

MOST_PAIRS: Final = 1_000
DEFAULT_PAIRS: Final = 100


class PairNature(StrEnum):
    """What differs between the sides of a pair."""

    NUMBERS = "numbers"
    """Numbers move, or several categories change."""
    CATEGORY = "category"
    """A category, or one step of a whole number, is changed and nothing else: a categorical pair."""
    SCENARIO = "scenario category"
    """The same, and it belongs to the scenario: the component has no part in the change."""


class ConfirmationView(View):
    """Whether both sides keep their verdicts with other seeds."""

    state: Annotated[
        Confirmation,
        Field(
            description="Confirmed: with other seeds, each side has the other verdict with a probability of at most "
            "20%. Refuted: a side has it with a larger one. The error rate of either claim is 5%. Undecided if the "
            "simulations show neither; pending while follow-ups simulate more."
        ),
    ]
    safe: ShareView
    unsafe: ShareView


class ConfirmationRule(View):
    """When a pair is confirmed."""

    safe_at_most: Annotated[
        float, Field(description="Largest probability that a safe side which holds is unsafe.")
    ] = LIMIT
    unsafe_at_least: Annotated[
        float, Field(description="Smallest probability that an unsafe side which holds is unsafe.")
    ] = 1 - LIMIT
    error: Annotated[
        float, Field(description="Largest probability that a pair is confirmed, or refuted, wrongly.")
    ] = ERROR
    least_drives: Annotated[
        int, Field(description="Simulations of a side, all with its own verdict, that confirm it.")
    ] = FIRST
    further_drives: Annotated[
        int, Field(description="Further ones that it takes for each simulation with the other verdict.")
    ] = FURTHER
    interval: Annotated[float, Field(description="Confidence of the intervals of shares.")] = INTERVAL


class ComponentPart(StrEnum):
    """What an unsafe drive with ground truth in place of the component shows."""

    COMPONENT = "component"
    """It is safe: without the component's output there is no hazard."""
    SCENARIO = "scenario"
    """It is unsafe, too: the scenario alone is to blame."""
    FAILED = "failed"
    """It has no verdict."""
    PENDING = "pending"
    NOT_TRIED = "not tried"


class ComponentView(View):
    """Whether the scenario alone is to blame for the unsafe side: its episode with ground truth."""

    state: ComponentPart
    campaign: Annotated[str | None, Field(description="Campaign that simulated it.")] = None
    number: Annotated[int | None, Field(description="Number of the solution in that campaign.")] = None
    robustness: float | None = None
    outcome: Annotated[str, Field(description="What the drive with ground truth showed, in words.")] = ""


class ChangeView(View):
    """A parameter in which the sides differ, or two that a constraint ties together."""

    names: Annotated[list[str], Field(description="Names as component.parameter, of those that differ.")]
    titles: Annotated[list[str], Field(description="Display name of each.")]
    units: list[str]
    safe: Annotated[list[Any], Field(description="Value of each in the safe side, as it was chosen.")]
    unsafe: list[Any]
    active: Annotated[
        bool | None,
        Field(description="Whether it was active in either drive; null if that was not recorded."),
    ]
    moved: Annotated[
        float | None,
        Field(
            description="How far it moved as a share of its range, in (0, 1]: the larger of the two, if a constraint "
            "ties two together. Null for a category."
        ),
    ]
    words: str


class Minimality(StrEnum):
    """Whether every difference between the sides matters."""

    MINIMAL = "minimal"
    NOT_MINIMAL = "not minimal"
    """Some of the differences can be reverted."""
    UNDECIDED = "undecided"
    """Some simulations failed."""
    DIFFERENT_SEEDS = "different seeds"
    """The sides were simulated with different episode seeds, so chance may decide rather than a difference."""
    PENDING = "pending"
    NOT_TRIED = "not tried"
    """Not tried, or not finished."""


class MinimisedView(View):
    """The unsafe side after differences were reverted, simulated with the episode seed of the unsafe side."""

    number: Annotated[int, Field(description="Number of the solution in the campaign of the follow-up.")]
    robustness: float | None
    outcome: str
    parameters: dict[str, dict[str, Any]]
    distance: Annotated[float, Field(description="Distance from the safe side.")]
    minimal: Annotated[
        bool | None,
        Field(description="Whether none of the remaining differences can be reverted; null if unknown."),
    ]
    changes: list[ChangeView]
    change: str


class MinimalityView(View):
    """Whether every difference between the sides matters."""

    state: Minimality
    campaign: Annotated[str | None, Field(description="Campaign that tried.")] = None
    tried: Annotated[int, Field(description="Simulations for it.")] = 0
    unsafe: Annotated[
        MinimisedView | None, Field(description="Unsafe side without the differences that did not matter.")
    ] = None


class SideView(View):
    """One side of a pair."""

    number: int
    evaluated: Annotated[
        int, Field(description="Simulations of these parameters in the campaign, all with this verdict.")
    ]
    robustness: Annotated[float, Field(description="Robustness in the first of them.")]
    seed: Annotated[int, Field(description="Episode seed of the first of them.")]
    outcome: Annotated[
        str, Field(description="What it showed, in words: the requirement and every violation, with moments.")
    ]
    kind: OutcomeKind
    words: Annotated[str, Field(description="Description of the solution.")]
    again: Annotated[
        str,
        Field(description="How often it was unsafe with other seeds, in words; empty if that was not tried."),
    ] = ""
    parameters: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values by component, then by name, as they were chosen."),
    ]
    activity: Annotated[
        ActivityView | None,
        Field(description="Which of them were active in the episode; null if that was not recorded."),
    ]


class PairView(View):
    """A safe and an unsafe solution that are neighbours."""

    place: Annotated[
        int,
        Field(
            description="Number of the pair, from 1: checked ones first, then by distance. Once the campaign has "
            "ended it stays the same, whatever follow-ups show, for the same eps and d_th."
        ),
    ]
    words: Annotated[str, Field(description="The change and what the unsafe side did, in one sentence.")]
    change: Annotated[str, Field(description="The change, in words.")]
    moved: Annotated[
        str,
        Field(
            description="How far the active parameters moved, as shares of their ranges, in words: close "
            "sides are close on average, and one number may still move far."
        ),
    ]
    common: Annotated[
        str,
        Field(
            description="What the descriptions of both sides share: clauses, such as the scenario, and steps of a "
            "chain of perturbations. Empty if that is nothing."
        ),
    ]
    distance: float
    nature: Annotated[
        PairNature,
        Field(
            description="What differs: `numbers`, or in a categorical pair a `category` or a step and nothing else; "
            "`scenario category` if that belongs to the scenario."
        ),
    ] = PairNature.NUMBERS
    checked: Annotated[
        bool, Field(description="Whether both sides kept their verdicts with another seed during the search.")
    ]
    same_seed: Annotated[
        bool,
        Field(
            description="Whether both sides were simulated with the same episode seed: then nothing else differs."
        ),
    ]
    confirmation: ConfirmationView
    component: ComponentView
    minimality: MinimalityView
    changes: Annotated[list[ChangeView], Field(description="All differences; the first active ones matter.")]
    evidence: Annotated[
        tuple[str, ...],
        Field(
            description="The evidence beyond one simulation of each side, a few words each, such as `checked` "
            "and `confirmed 0/15 15/15`."
        ),
    ] = ()
    shown: Annotated[tuple[str, ...], Field(description="Results of its follow-ups, in sentences.")] = ()
    facts: Annotated[tuple[str, ...], Field(description="Further facts about it, in sentences.")] = ()
    safe: SideView
    unsafe: SideView


class NearestView(View):
    """The nearest solutions with opposite verdicts."""

    safe: int
    unsafe: int
    distance: float


class FollowUpOffer(View):
    """A follow-up that is available for all of these pairs, and its cost."""

    kind: FollowUpKind
    title: Annotated[str, Field(description="What it asks, as a heading.")]
    label: Annotated[str, Field(description="Label of a button that asks it.")]
    words: Annotated[str, Field(description="What it simulates, in a sentence.")]
    repeats: Annotated[
        int | None,
        Field(
            description="Default for the most simulations of each side with other seeds; null for a kind of "
            "follow-up that simulates sides with their own seeds."
        ),
    ]
    exact: Annotated[
        bool, Field(description="Whether it takes exactly these simulations rather than at most these.")
    ]
    simulations: Annotated[
        int, Field(description="Simulations that it takes, in each repeat if there are repeats.")
    ]
    reason: Annotated[str, Field(description="Why it is unavailable; empty if it is available.")]
    left_out: Annotated[
        int,
        Field(
            description="Pairs that are left out, because their sides were simulated with different seeds."
        ),
    ] = 0


class PairsView(View):
    """The distinct pairs of a campaign."""

    campaign: str
    name: str
    status: CampaignStatus
    complete: Annotated[
        bool, Field(description="Whether the campaign has ended; if not, these are the pairs so far.")
    ]
    generation: Annotated[int, Field(description="Generations completed.")]
    evaluated: Annotated[int, Field(description="Evaluated solutions.")]
    eps: Annotated[float, Field(description="Largest distance between the sides of a pair.")]
    d_th: Annotated[float, Field(description="Smallest distance between two distinct pairs.")]
    searched: Annotated[
        bool,
        Field(
            description="Whether the campaign searches for pairs; other searches hold those they happen to find."
        ),
    ]
    computed: Annotated[
        bool, Field(description="Whether verdicts are computed, not simulated, so that seeds have no effect.")
    ]
    replayable: Annotated[
        bool,
        Field(description="Whether the simulator records drives, so that pairs can be drawn and filmed."),
    ] = True
    sentence: Annotated[
        str, Field(description="The result in one sentence; why there is no pair, if there is none.")
    ]
    note: Annotated[
        str, Field(description="The same, with the progress of the campaign if it has not ended.")
    ]
    blame: Annotated[
        str,
        Field(
            description="For how many pairs the component is to blame, in a sentence without a full stop; "
            "empty without that follow-up."
        ),
    ] = ""
    terms: Annotated[
        str, Field(description="What a term in the descriptions of changes means; empty if none needs it.")
    ] = ""
    caveat: Annotated[
        str,
        Field(
            description="What pairs show about the component and what they do not, in sentences; may be empty."
        ),
    ] = ""
    safe: Annotated[int, Field(description="Safe solutions, each counted once.")]
    unsafe: Annotated[int, Field(description="Unsafe solutions, each counted once.")]
    chancy: Annotated[
        int,
        Field(description="Solutions that the search simulated with different seeds and different verdicts."),
    ]
    without_part: Annotated[
        int,
        Field(
            description="How often two near solutions with opposite verdicts differ in no parameter that was "
            "active in either drive: chance decides there, so they are not a pair."
        ),
    ] = 0
    tight: Annotated[int, Field(description="Pairs, distinct or not.")]
    distinct: Annotated[int, Field(description="Distinct pairs.")]
    categorical: Annotated[
        int,
        Field(
            description="Distinct pairs that are categorical: a category or a step is changed and nothing else."
        ),
    ] = 0
    scenario_only: Annotated[
        int, Field(description="Categorical pairs whose category or step belongs to the scenario.")
    ] = 0
    checked: Annotated[int, Field(description="Distinct pairs that are checked.")]
    tried: Annotated[
        int,
        Field(
            description="Distinct pairs of which a side was simulated again with other seeds, without pending ones."
        ),
    ]
    pending: Annotated[
        int, Field(description="Distinct pairs that are being simulated again and are undecided so far.")
    ]
    repeated: Annotated[
        int, Field(description="Sides of distinct pairs that were simulated again with other seeds.")
    ] = 0
    changed: Annotated[
        int, Field(description="Of these, sides that did not always keep the verdict of the search.")
    ] = 0
    confirmed: Annotated[int, Field(description="Distinct pairs that are confirmed.")]
    refuted: Annotated[int, Field(description="Distinct pairs that are refuted.")]
    undecided: Annotated[
        int, Field(description="Distinct pairs that were tried and are neither confirmed nor refuted.")
    ]
    component: Annotated[
        int,
        Field(
            description="Distinct pairs whose unsafe side is safe with ground truth in place of the component."
        ),
    ]
    scenario: Annotated[int, Field(description="Distinct pairs whose unsafe side is unsafe with it, too.")]
    component_confirmed: Annotated[
        int, Field(description="Confirmed pairs among those that `component` counts.")
    ] = 0
    scenario_confirmed: Annotated[
        int, Field(description="Confirmed pairs among those that `scenario` counts.")
    ] = 0
    nearest: Annotated[
        NearestView | None,
        Field(description="Nearest solutions with opposite verdicts, if none are near enough for a pair."),
    ]
    follow_ups: Annotated[list[FollowUpView], Field(description="Oldest first.")]
    offers: Annotated[
        list[FollowUpOffer], Field(description="Follow-ups that are available for the distinct pairs.")
    ]
    rule: ConfirmationRule = ConfirmationRule()
    chance: Annotated[
        tuple[str, ...], Field(description="The role of chance, in sentences without a full stop.")
    ] = ()
    pairs: Annotated[
        list[PairView],
        Field(
            description="Confirmed ones first, refuted ones last; among these, categorical ones last; otherwise in "
            "the order of their numbers."
        ),
    ]
    legend: Annotated[
        tuple[str, ...],
        Field(description="The meaning of the words about these pairs, in sentences without a full stop."),
    ] = ()
    table: Annotated[Table | None, Field(description="The pairs as a table.")] = None


class BestPair(View):
    """One of the best pairs."""

    place: int
    safe: Annotated[int, Field(description="Number of the safe solution.")]
    unsafe: int
    words: Annotated[str, Field(description="The change and what the unsafe side did, in one sentence.")]
    state: Annotated[
        Confirmation, Field(description="Whether it is confirmed; see `confirmation` of a pair.")
    ]
    evidence: Annotated[
        str, Field(description="The same in a few words, with the number of drives that kept their verdicts.")
    ]
    shares: Annotated[
        str,
        Field(
            description="How often each side was unsafe with other seeds, in a sentence; empty if not tried."
        ),
    ]


class PairsFound(View):
    """Details that only pairs have: the solutions of each pair, and the best pairs for pictures."""

    replayable: Annotated[bool, Field(description="Whether drives are recorded, so that they can be drawn.")]
    best: Annotated[
        list[BestPair],
        Field(
            description="The first pairs: confirmed ones, then undecided ones and those not tried, refuted ones last."
        ),
    ]
    rule: Annotated[str, Field(description="What it takes for a pair to hold, in a sentence.")]
