"""Routes of pairs: two solutions that are almost the same, one safe and one unsafe, and the change between them."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Final, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from sqlalchemy import Connection, Row

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.analysis.pairs import Pair, Side
from brink.server.api.boundary_table import Cell, table_bytes
from brink.server.api.context import Services
from brink.server.api.responses import NOT_MODIFIED, etag_of, matches, not_modified
from brink.server.api.schemas import ActivityView, View
from brink.server.api.solutions import MEDIA, activity_view
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.outcomes import SolutionOutcome, outcome_of
from brink.server.campaigns.pairs import CampaignPairs, PairSettings, shares_of
from brink.server.campaigns.repeats import StoredRepeats, read_repeats
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.db.engine import read
from brink.server.problems.base import (
    InProcessProblem,
    NamesRequirements,
    Problem,
    SimulatedSolution,
    activity_of,
    describe_candidate,
)
from brink.server.problems.changes import Change, change_words, changes_between
from brink.server.states import CampaignStatus, OutcomeKind, SolutionVerdict
from brink.sim.verdict import drives_held, unsafe_words

router = APIRouter(prefix="/campaigns/{campaign_id}/pairs", tags=["pairs"])

MOST_PAIRS: Final = 1_000
DEFAULT_PAIRS: Final = 100


class FollowUpKind(StrEnum):
    """What a follow-up of pairs asks."""

    CONFIRM = "confirm"
    """Do both sides keep their verdicts with other seeds?"""
    COMPONENT = "component"
    """Is the unsafe side safe with ground truth in place of the component?"""
    MINIMISE = "minimise"
    """Which of the differences matter?"""


class ShareView(View):
    """How often one side was unsafe when it was simulated again with other seeds."""

    evaluated: Annotated[int, Field(description="Simulations with a verdict.")]
    unsafe: int
    probability: Annotated[float | None, Field(description="Unsafe share; null without a verdict.")]
    low: Annotated[float, Field(description="Lower limit of its Wilson interval.")]
    high: float


class ConfirmationView(View):
    """Whether both sides keep their verdicts with other seeds."""

    state: Annotated[
        Confirmation,
        Field(
            description="Confirmed if the safe side was unsafe in at most 20% and the unsafe side in at least 80% of "
            "the simulations with other seeds, at least five each."
        ),
    ]
    safe: ShareView
    unsafe: ShareView


class ComponentPart(StrEnum):
    """What an unsafe drive with ground truth in place of the component says."""

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


class ChangeView(View):
    """A parameter in which the sides differ, or two that a constraint ties together."""

    names: Annotated[list[str], Field(description="Names as component.parameter, of those that differ.")]
    units: list[str]
    safe: Annotated[list[Any], Field(description="Value of each in the safe side, as it was chosen.")]
    unsafe: list[Any]
    active: Annotated[
        bool | None,
        Field(description="Whether it had a part in either drive; null if that was not recorded."),
    ]
    words: str


class Minimality(StrEnum):
    """Whether every difference between the sides matters."""

    MINIMAL = "minimal"
    NOT_MINIMAL = "not minimal"
    """Some of the differences can be taken back."""
    UNDECIDED = "undecided"
    """Some simulations failed."""
    PENDING = "pending"
    NOT_TRIED = "not tried"


class MinimisedView(View):
    """The unsafe side after differences were taken back, simulated with the episode seed of the unsafe side."""

    number: Annotated[int, Field(description="Number of the solution in the campaign of the follow-up.")]
    robustness: float | None
    outcome: str
    parameters: dict[str, dict[str, Any]]
    distance: Annotated[float, Field(description="Distance from the safe side.")]
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
    parameters: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values by component, then by name, as they were chosen."),
    ]
    activity: Annotated[
        ActivityView | None,
        Field(description="Which of them had a part in the episode; null if that was not recorded."),
    ]


class PairView(View):
    """A safe and an unsafe solution that are almost the same."""

    place: Annotated[int, Field(description="Place in the list, from 1.")]
    words: Annotated[str, Field(description="The change and what the unsafe side did, in one sentence.")]
    change: Annotated[str, Field(description="The change, in words.")]
    distance: float
    checked: Annotated[
        bool,
        Field(description="Whether both sides kept their verdicts in a further simulation of the search."),
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
    safe: SideView
    unsafe: SideView


class NearestView(View):
    """The nearest solutions with opposite verdicts."""

    safe: int
    unsafe: int
    distance: float


class FollowUpView(View):
    """A campaign that simulated sides of pairs again."""

    kind: FollowUpKind
    campaign: str
    status: CampaignStatus
    status_reason: str
    simulations: int
    budget: int


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
    computed: Annotated[
        bool, Field(description="Whether verdicts are computed, not simulated: seeds have no part in them.")
    ]
    note: Annotated[
        str, Field(description="The result in one sentence; why there is no pair, if there is none.")
    ]
    safe: Annotated[int, Field(description="Safe solutions, each counted once.")]
    unsafe: Annotated[int, Field(description="Unsafe solutions, each counted once.")]
    chancy: Annotated[int, Field(description="Solutions whose simulations had different verdicts.")]
    tight: Annotated[int, Field(description="Pairs, distinct or not.")]
    distinct: Annotated[int, Field(description="Distinct pairs.")]
    checked: Annotated[int, Field(description="Distinct pairs that are checked.")]
    confirmed: Annotated[int, Field(description="Distinct pairs that are confirmed.")]
    not_confirmed: Annotated[
        int, Field(description="Distinct pairs that simulations with other seeds refuted.")
    ]
    nearest: Annotated[
        NearestView | None,
        Field(description="Nearest solutions with opposite verdicts, if there is no pair."),
    ]
    follow_ups: Annotated[list[FollowUpView], Field(description="Oldest first.")]
    pairs: Annotated[list[PairView], Field(description="Checked ones first, then by distance.")]


Eps = Annotated[
    float | None,
    Query(
        ge=0, le=1,
        description="Largest distance between the sides of a pair; by default that of the search for pairs, or 0.02.",
    ),
]  # fmt: skip
PairDistance = Annotated[
    float | None,
    Query(
        ge=0, le=1,
        description="Smallest distance between two distinct pairs; by default that of the search for pairs, or 0.2.",
    ),
]  # fmt: skip
Limit = Annotated[int, Query(ge=1, le=MOST_PAIRS, description="Maximum number of pairs to return.")]


@router.get("", responses={200: {"content": {media: {} for media in MEDIA.values()}}, **NOT_MODIFIED})
async def get_pairs(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    eps: Eps = None,
    d_th: PairDistance = None,
    limit: Limit = DEFAULT_PAIRS,
    format: Literal["json", "csv", "jsonl", "parquet"] = "json",  # noqa: A002  (the name of the query parameter)
) -> PairsView:
    """Return the distinct pairs of a campaign; table formats have one row for each pair."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    stored = await read(services.engines, lambda c: read_repeats(c, campaign.id))
    settings = PairSettings.of(found.plan, eps, d_th)
    states = [(one.campaign.id, one.campaign.sequence) for one in stored]
    etag = etag_of(campaign.id, campaign.sequence, found.generation, settings, limit, format, states)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    pairs = await services.pairs.get(campaign, found, settings)
    view = await read(services.engines, lambda c: pairs_view(c, campaign, found, pairs, stored, limit))
    if format == "json":
        response.headers["ETag"] = etag
        return view
    table = await asyncio.get_running_loop().run_in_executor(None, pairs_table, view, format)
    headers = {"Content-Disposition": f'attachment; filename="pairs-{campaign.id}.{format}"', "ETag": etag}
    return Response(table, media_type=MEDIA[format], headers=headers)  # type: ignore[return-value]


def pairs_view(
    connection: Connection,
    campaign: Campaign,
    found: ReadArchive,
    pairs: CampaignPairs,
    stored: Sequence[StoredRepeats],
    limit: int,
) -> PairsView:
    """Return the distinct pairs of a campaign.

    Args:
        connection: Read connection.
        campaign: The campaign.
        found: Its archive.
        pairs: Its pairs.
        stored: Its repeats.
        limit: Maximum number of pairs to return.
    """
    problem = found.plan.problem
    shown = pairs.found.pairs[:limit]
    numbers = {side.number for pair in shown for side in (pair.safe, pair.unsafe)}
    some = set(found.archive.numbers[:1].tolist())  # tells the requirement where there is no pair
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers | some)}
    shares = shares_of(stored, found.plan.neighbourhood.z)
    states = [_confirmation(pair, shares).state for pair in pairs.found.pairs]
    deciding = _deciding(problem, next(iter(rows.values()), None))
    counts = {
        "confirmed": states.count(Confirmation.CONFIRMED),
        "not_confirmed": states.count(Confirmation.NOT_CONFIRMED),
    }
    return PairsView(
        campaign=campaign.id, name=campaign.body.name, status=campaign.status,
        complete=campaign.status in ENDED, generation=found.generation, evaluated=len(found.archive),
        eps=pairs.settings.eps, d_th=pairs.settings.d_th, computed=isinstance(problem, InProcessProblem),
        note=_note(campaign, found, pairs, deciding, counts),
        safe=pairs.found.safe, unsafe=pairs.found.unsafe, chancy=pairs.found.chancy,
        tight=pairs.found.tight, distinct=len(pairs.found.pairs), checked=pairs.found.checked, **counts,
        nearest=None if pairs.nearest is None else NearestView(
            safe=pairs.nearest.safe, unsafe=pairs.nearest.unsafe, distance=pairs.nearest.distance
        ),
        follow_ups=[_follow_up(one) for one in stored],
        pairs=[
            _pair(place, pair, problem, rows, shares) for place, pair in enumerate(shown, start=1)
        ],
    )  # fmt: skip


def _follow_up(stored: StoredRepeats) -> FollowUpView:
    campaign = stored.campaign
    return FollowUpView(
        kind=FollowUpKind.CONFIRM, campaign=campaign.id, status=campaign.status,
        status_reason=campaign.status_reason, simulations=campaign.completed, budget=campaign.budget,
    )  # fmt: skip


def _pair(
    place: int, pair: Pair, problem: Problem, rows: Mapping[int, Row[Any]], shares: Mapping[int, Share]
) -> PairView:
    safe, unsafe = (_simulated(problem, rows[side.number]) for side in (pair.safe, pair.unsafe))
    changes = sorted(
        changes_between(problem, safe, unsafe, pair.units), key=lambda change: change.active is False
    )
    change = change_words(problem, safe, unsafe, changes)
    sides = [
        _side(side, problem, solution, rows[side.number])
        for side, solution in ((pair.safe, safe), (pair.unsafe, unsafe))
    ]
    minimal = len(pair.units) == 1
    return PairView(
        place=place, words=f"{_sentence(change)}: {sides[1].outcome}", change=change, distance=pair.distance,
        checked=pair.checked, same_seed=sides[0].seed == sides[1].seed,
        confirmation=_confirmation(pair, shares),
        component=ComponentView(state=ComponentPart.NOT_TRIED),
        minimality=MinimalityView(state=Minimality.MINIMAL if minimal else Minimality.NOT_TRIED),
        changes=[_change(change) for change in changes], safe=sides[0], unsafe=sides[1],
    )  # fmt: skip


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _change(change: Change) -> ChangeView:
    return ChangeView(
        names=list(change.names), units=list(change.units), safe=list(change.safe),
        unsafe=list(change.unsafe), active=change.active, words=change.words,
    )  # fmt: skip


def _confirmation(pair: Pair, shares: Mapping[int, Share]) -> ConfirmationView:
    none = Share.of(0, 0)
    safe, unsafe = (shares.get(side.number, none) for side in (pair.safe, pair.unsafe))
    return ConfirmationView(
        state=confirmation_of(safe, unsafe), safe=_share(safe), unsafe=_share(unsafe)
    )  # fmt: skip


def _share(share: Share) -> ShareView:
    return ShareView(
        evaluated=share.evaluated, unsafe=share.unsafe, probability=share.probability, low=share.low,
        high=share.high,
    )  # fmt: skip


def _simulated(problem: Problem, row: Row[Any]) -> SimulatedSolution:
    vectors = problem.space.split(np.frombuffer(row.vector, dtype="<f8"))
    result = _result(row)
    return SimulatedSolution(vectors=vectors, activity=activity_of(problem, vectors, result), result=result)


def _result(row: Row[Any] | None) -> dict[str, Any] | None:
    return json.loads(row.result) if row is not None and row.result else None


def _side(side: Side, problem: Problem, solution: SimulatedSolution, row: Row[Any]) -> SideView:
    activity, outcome = solution.activity, _outcome(problem, row)
    return SideView(
        number=side.number, evaluated=side.evaluated, robustness=side.robustness, seed=row.seed,
        outcome=outcome.words(), kind=outcome.kind, words=describe_candidate(problem, solution.vectors, activity),
        parameters=problem.space.decode(tuple(solution.vectors)),
        activity=None if activity is None else activity_view(problem.space, activity),
    )  # fmt: skip


def _outcome(problem: Problem, row: Row[Any]) -> SolutionOutcome:
    """Return what a simulation showed."""
    safe = row.verdict == SolutionVerdict.SAFE
    return outcome_of(problem, _result(row), safe=safe, robustness=row.robustness)


def _deciding(problem: Problem, row: Row[Any] | None) -> tuple[str, ...]:
    """Return the requirements that decide the verdict; empty if they are unknown."""
    if isinstance(problem, NamesRequirements):
        return problem.requirements
    episode = None if row is None else _outcome(problem, row).episode
    return () if episode is None else episode.deciding


def _note(
    campaign: Campaign,
    found: ReadArchive,
    pairs: CampaignPairs,
    deciding: tuple[str, ...],
    counts: Mapping[str, int],
) -> str:
    """Return the result in one sentence."""
    words = _result_words(pairs, deciding, counts)
    if campaign.status in ENDED:
        return words
    return f"so far, after {len(found.archive):,} of {campaign.budget:,} simulations: {words}"


def _result_words(pairs: CampaignPairs, deciding: tuple[str, ...], counts: Mapping[str, int]) -> str:
    found, settings = pairs.found, pairs.settings
    if found.pairs:
        words = f"{len(found.pairs):,} distinct pairs, {found.checked:,} checked"
        if len(found.pairs) == 1:
            words = f"1 distinct pair, {'checked' if found.checked else 'not checked'}"
        if any(counts.values()):
            words += f", {counts['confirmed']:,} confirmed, {counts['not_confirmed']:,} not confirmed"
        return words
    if not found.safe and not found.unsafe and not found.chancy:
        return "no solution has been evaluated: no pair"
    if pairs.nearest is None:
        if not found.safe and not found.unsafe:
            return f"every solution had both verdicts ({found.chancy:,}): no pair"
        both = f"; {found.chancy:,} had both verdicts" if found.chancy else ""
        if found.safe:
            did = drives_held(deciding) if deciding else "are safe"
        else:
            did = unsafe_words(deciding) if deciding else "are unsafe"
        return f"all {found.safe + found.unsafe:,} solutions {did}{both}: no pair"
    return (
        f"no pair within eps {settings.eps:g}: the nearest solutions with opposite verdicts, "
        f"{pairs.nearest.safe} and {pairs.nearest.unsafe}, are {pairs.nearest.distance:.3g} apart"
    )


def pairs_table(view: PairsView, form: str) -> bytes:
    """Encode pairs as a file: JSON Lines with all details of each pair, or a flat table.

    Args:
        view: The pairs.
        form: ``csv``, ``jsonl`` or ``parquet``.

    Raises:
        InvalidInput: The format is Parquet, and pyarrow is not installed.
    """
    if form == "jsonl":
        return b"".join(pair.model_dump_json().encode() + b"\n" for pair in view.pairs)
    return table_bytes([_flat(view, pair) for pair in view.pairs], form)


def _flat(view: PairsView, pair: PairView) -> dict[str, Cell]:
    row: dict[str, Cell] = {
        "campaign": view.campaign, "pair": pair.place, "words": pair.words, "change": pair.change,
        "distance": pair.distance, "checked": pair.checked, "same_seed": pair.same_seed,
        "confirmation": str(pair.confirmation.state), "component": str(pair.component.state),
        "minimality": str(pair.minimality.state),
        "differing": "; ".join(change.words for change in pair.changes),
    }  # fmt: skip
    for name, side, share in (
        ("safe", pair.safe, pair.confirmation.safe), ("unsafe", pair.unsafe, pair.confirmation.unsafe),
    ):  # fmt: skip
        row.update({
            f"{name}.number": side.number, f"{name}.robustness": side.robustness,
            f"{name}.evaluated": side.evaluated, f"{name}.seed": side.seed, f"{name}.outcome": side.outcome,
            f"{name}.words": side.words, f"{name}.again_evaluated": share.evaluated,
            f"{name}.again_unsafe": share.unsafe, f"{name}.again_low": share.low,
            f"{name}.again_high": share.high,
        })  # fmt: skip
        for component, values in side.parameters.items():
            row.update({f"{name}.{component}.{parameter}": value for parameter, value in values.items()})
    return row
