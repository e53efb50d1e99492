"""Follow-ups of a campaign, each a separate campaign: above all repeats, which simulate solutions with other seeds.

A campaign provides all that repeats need: workers, progress, resuming, no lost result. Its algorithm is
`brink.search.algorithms.repeats`.

The solutions are either the distinct boundary at two thresholds, or named by number. Named solutions are stored with
the thresholds `EVERY_T_B` and `EVERY_D_TH`, which exclude none. Two repeats are equal if they have the same numbers.

Other follow-ups ask about pairs of solutions (`brink.server.campaigns.follow_ups`). They are stored in the same way,
with the number of repeats that `FollowUpKind` states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, insert, select

from brink.search.algorithms.minimise import MinimiseConfig
from brink.search.algorithms.repeats import (
    GENERATION_SIZE,
    Repeats,
    RepeatsConfig,
    Tallies,
    schedule,
    tallied,
)
from brink.search.archive import Archive
from brink.search.errors import BoundaryTooLarge
from brink.search.streams import Stream, generator
from brink.server.campaigns.body import Budget, CampaignBody, PluginChoice
from brink.server.campaigns.plan import (
    Plan,
    PreparedCampaign,
    find_boundary,
    prepare_campaign,
    store_campaign,
)
from brink.server.campaigns.store import Campaign, campaigns_of
from brink.server.db.models import CampaignRow, RepeatsRow, SolutionRow
from brink.server.db.sql import note_change
from brink.server.errors import FieldError, InvalidInput
from brink.server.queue.job_store import is_told
from brink.server.states import CampaignStatus, SolutionVerdict

MOST = 1_000
"""Maximum number of repeated solutions, best first; limited because they are part of a campaign's parameters."""
EVERY_T_B = 1.0
EVERY_D_TH = 0.0
"""Thresholds that every solution meets."""
_NAME_LENGTH = 200
_MOST_ERRORS = 20


class FollowUpKind(StrEnum):
    """The question that a follow-up asks."""

    CONFIRM = "confirm"
    """How often is each solution unsafe with other seeds? At least two repeats."""
    COMPONENT = "component"
    """Is each solution unsafe with ground truth in place of the component, in the same episode? One repeat."""
    MINIMISE = "minimise"
    """Which differences between two solutions matter? The numbers are those of pairs; stored with 0 repeats."""


SINGLE: Final = 1
REDUCTION: Final = 0
"""Stored numbers of repeats of the follow-ups that are not repeats with other seeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRepeats:
    """Repeats that are checked but not stored yet.

    Attributes:
        of: Id of the campaign whose solutions are repeated.
        t_b: Maximum fitness of the solutions.
        d_th: Minimum distance between them.
        repeats: Simulations of each solution.
        numbers: Numbers of the solutions, best first.
        campaign: The campaign that simulates them.
    """

    of: str
    t_b: float
    d_th: float
    repeats: int
    numbers: tuple[int, ...]
    campaign: PreparedCampaign


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredRepeats:
    """Repeats with their results so far.

    Attributes:
        campaign: The campaign that simulates them.
        t_b: Maximum fitness of the solutions.
        d_th: Minimum distance between them.
        repeats: Simulations of each solution, at the end.
        numbers: Numbers of the solutions, best first.
        evaluated: Numbers of the candidates of that campaign that were evaluated so far.
        unsafe: Whether each of these was unsafe.
        failed: Numbers of those that have no verdict.
    """

    campaign: Campaign
    t_b: float
    d_th: float
    repeats: int
    numbers: tuple[int, ...]
    evaluated: tuple[int, ...]
    unsafe: tuple[bool, ...]
    failed: tuple[int, ...]

    @property
    def kind(self) -> FollowUpKind:
        """The question that it asks."""
        return _kind_of(self.repeats)

    @property
    def boundary(self) -> bool:
        """Whether the solutions are a boundary rather than named by number."""
        return (self.t_b, self.d_th) != (EVERY_T_B, EVERY_D_TH)

    def drives(self) -> list[tuple[int, bool | None]]:
        """Return the position, among the numbers, and the verdict of each finished simulation of repeats.

        The verdict says whether it was unsafe; None if it failed.
        """
        ended: dict[int, bool | None] = dict(zip(self.evaluated, self.unsafe, strict=True))
        ended |= dict.fromkeys(self.failed)
        params, count = self.campaign.body.algorithm.params, len(self.numbers)
        keep, size = params.get("keep"), params.get("generation_size", GENERATION_SIZE)
        if not keep:
            return [(number % count, unsafe) for number, unsafe in ended.items()]
        places = dict(enumerate(schedule(keep, ended, self.campaign.budget, size)))
        return [(places[number], unsafe) for number, unsafe in ended.items() if number in places]

    def tallies(self, z: float) -> Tallies:
        """Return how often each solution was unsafe, with intervals at `z` standard deviations."""
        judged = [(place, unsafe) for place, unsafe in self.drives() if unsafe is not None]
        places, verdicts = [place for place, _ in judged], [unsafe for _, unsafe in judged]
        return tallied(places, verdicts, len(self.numbers), z)


def _kind_of(repeats: int) -> FollowUpKind:
    if repeats == REDUCTION:
        return FollowUpKind.MINIMISE
    return FollowUpKind.COMPONENT if repeats == SINGLE else FollowUpKind.CONFIRM


def is_follow_up(plan: Plan, repeats: int, numbers: Sequence[int]) -> bool:
    """Return whether a campaign can be the follow-up that asks this question about these solutions.

    Args:
        plan: The plan of the campaign.
        repeats: The stored number of repeats, which says what the follow-up asks.
        numbers: The stored numbers of the solutions.
    """
    config = plan.config
    if _kind_of(repeats) is FollowUpKind.MINIMISE:
        return isinstance(config, MinimiseConfig) and 2 * len(config.safe) == len(numbers)
    if not isinstance(config, RepeatsConfig) or len(config.keep) not in (0, len(numbers)):
        return False
    return len(config.solutions) == len(numbers)


def followed_by(connection: Connection, campaign_id: str) -> tuple[str, FollowUpKind] | None:
    """Return the campaign that a follow-up asks about, and its question; None if it is not a follow-up."""
    row = connection.execute(
        select(RepeatsRow.of_id, RepeatsRow.repeats).where(RepeatsRow.campaign_id == campaign_id)
    ).one_or_none()
    return None if row is None else (row.of_id, _kind_of(row.repeats))


def plan_boundary_repeats(
    campaign: Campaign, plan: Plan, archive: Archive, *, repeats: int, t_b: float, d_th: float
) -> PlannedRepeats | None:
    """Plan repeats of a campaign's distinct boundary solutions, the best `MOST` of them; return None if it has none.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        repeats: Simulations of each solution.
        t_b: Maximum fitness.
        d_th: Minimum distance between two solutions.

    Raises:
        InvalidInput: The repeats cannot run, or there are too many boundary solutions to compare with each other.
    """
    try:
        chosen = find_boundary(archive, t_b, d_th)[:MOST]
    except BoundaryTooLarge as error:
        raise InvalidInput.at("/d_th", f"campaign {campaign.id}: {error}") from None
    if not len(chosen):
        return None
    # With the campaign's own seed, the first repeats would be the same episodes as the campaign's.
    seed = int(generator(campaign.body.seed, Stream.REPEATS, repeats).integers(2**53))
    return PlannedRepeats(
        of=campaign.id,
        t_b=t_b,
        d_th=d_th,
        repeats=repeats,
        numbers=tuple(archive.numbers[chosen].tolist()),
        campaign=_prepare(campaign, plan, archive, chosen, repeats, seed, "boundary again"),
    )


def plan_named_repeats(
    campaign: Campaign,
    plan: Plan,
    archive: Archive,
    *,
    repeats: int,
    numbers: Sequence[int],
    until_decided: bool = False,
) -> PlannedRepeats:
    """Plan repeats of solutions named by number.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        repeats: Simulations of each solution.
        numbers: Distinct numbers in any order, at most `MOST`.
        until_decided: Whether to simulate each only until its verdict is confirmed or refuted; `repeats` is then the
            largest number of simulations of each.

    Raises:
        InvalidInput: The repeats cannot run, or a number is not an evaluated solution of the campaign.
    """
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}
    unknown = [(index, number) for index, number in enumerate(numbers) if number not in places]
    if unknown:
        raise InvalidInput(
            FieldError(
                pointer=f"/numbers/{index}",
                message=f"campaign {campaign.id} has no evaluated solution {number}",
            )
            for index, number in unknown[:_MOST_ERRORS]
        )
    named = np.array([places[number] for number in numbers], np.intp)
    chosen = named[np.lexsort((archive.numbers[named], archive.fitness[named]))]
    ordered = tuple(archive.numbers[chosen].tolist())
    # With the seed of other repeats, some of these would be the same episodes.
    index = (repeats, *sorted(ordered), *([len(ordered), 1] if until_decided else []))
    seed = int(generator(campaign.body.seed, Stream.REPEATS, *index).integers(2**53))
    again = f"solution {ordered[0]} again" if len(ordered) == 1 else f"{len(ordered)} solutions again"
    return PlannedRepeats(
        of=campaign.id,
        t_b=EVERY_T_B,
        d_th=EVERY_D_TH,
        repeats=repeats,
        numbers=ordered,
        campaign=_prepare(campaign, plan, archive, chosen, repeats, seed, again, until_decided=until_decided),
    )


def _prepare(
    campaign: Campaign,
    plan: Plan,
    archive: Archive,
    chosen: NDArray[np.intp],
    repeats: int,
    seed: int,
    again: str,
    *,
    until_decided: bool = False,
) -> PreparedCampaign:
    """Prepare the campaign that repeats solutions, given as positions in the archive."""
    params = {"solutions": archive.vectors[chosen].tolist()}
    if until_decided:
        params["keep"] = archive.unsafe[chosen].tolist()
    body = follow_up_body(campaign, plan, again, Repeats.id, repeats * len(chosen), params)
    return prepare_campaign(body.model_copy(update={"seed": seed}))


def follow_up_body(
    campaign: Campaign, plan: Plan, what: str, algorithm: str, simulations: int, params: Mapping[str, Any]
) -> CampaignBody:
    """Return the body of a follow-up, with the problem and the seed of its campaign.

    Args:
        campaign: The campaign.
        plan: Its plan.
        what: What the follow-up simulates, in a few words; ends its name.
        algorithm: Id of its algorithm.
        simulations: Its budget.
        params: Settings of its algorithm beside the neighbourhood, which is that of the campaign.
    """
    body, near = campaign.body, plan.neighbourhood
    return CampaignBody(
        name=f"{body.name[: _NAME_LENGTH - len(what) - 2]}: {what}",
        problem=body.problem,
        algorithm=PluginChoice(
            id=algorithm, params={**params, "radius": near.radius, "p_th": near.p_th, "z": near.z}
        ),
        budget=Budget(simulations=simulations),
        seed=body.seed,
        priority=body.priority,
        ground_truth=body.ground_truth,
        execution=body.execution.model_copy(update={"keep_traces": 0}),
    )


def store_repeats(connection: Connection, planned: PlannedRepeats) -> tuple[Campaign, bool]:
    """Store repeats unless identical ones exist; return their campaign, and whether it is new."""
    candidates = connection.execute(
        select(RepeatsRow.numbers, CampaignRow.__table__)
        .join(CampaignRow, RepeatsRow.campaign_id == CampaignRow.id)
        .where(
            RepeatsRow.of_id == planned.of,
            RepeatsRow.t_b == planned.t_b,
            RepeatsRow.d_th == planned.d_th,
            RepeatsRow.repeats == planned.repeats,
            CampaignRow.status.not_in((CampaignStatus.CANCELLED, CampaignStatus.FAILED)),
        )
    )
    equal = campaigns_of(connection, [row for row in candidates if tuple(row.numbers) == planned.numbers])
    seed = (
        planned.campaign.body.seed
    )  # tells repeats of all solutions from those until a verdict is confirmed
    known = next((campaign for campaign in equal if campaign.body.seed == seed), None)
    if known is not None:
        return known, False
    campaign = store_campaign(connection, planned.campaign)
    connection.execute(
        insert(RepeatsRow).values(
            campaign_id=campaign.id,
            of_id=planned.of,
            t_b=planned.t_b,
            d_th=planned.d_th,
            repeats=planned.repeats,
            numbers=list(planned.numbers),
        )
    )
    note_change(connection, planned.of)
    return campaign, True


def read_repeats(connection: Connection, campaign_id: str) -> list[StoredRepeats]:
    """Return all repeats of a campaign's solutions with other seeds, oldest first."""
    found = read_follow_ups(connection, campaign_id)
    return [one for one in found if one.kind is FollowUpKind.CONFIRM]


def read_follow_ups(connection: Connection, campaign_id: str) -> list[StoredRepeats]:
    """Return all follow-ups of a campaign, oldest first."""
    query = (
        select(RepeatsRow.t_b, RepeatsRow.d_th, RepeatsRow.repeats, RepeatsRow.numbers, CampaignRow.__table__)
        .join(CampaignRow, CampaignRow.id == RepeatsRow.campaign_id)
        .where(RepeatsRow.of_id == campaign_id)
        .order_by(CampaignRow.created_at, CampaignRow.id)
    )
    found = []
    rows = connection.execute(query).all()
    for row, campaign in zip(rows, campaigns_of(connection, rows), strict=True):
        verdicts = _verdicts(connection, campaign.id)
        evaluated = {
            number: verdict for number, verdict in verdicts.items() if verdict != SolutionVerdict.FAILED
        }
        found.append(
            StoredRepeats(
                campaign=campaign,
                t_b=row.t_b,
                d_th=row.d_th,
                repeats=row.repeats,
                numbers=tuple(row.numbers),
                evaluated=tuple(evaluated),
                unsafe=tuple(verdict == SolutionVerdict.UNSAFE for verdict in evaluated.values()),
                failed=tuple(number for number in verdicts if number not in evaluated),
            )
        )
    return found


def read_pair_campaigns(connection: Connection, campaigns: Sequence[str]) -> list[Campaign]:
    """Return the campaigns that confirm pairs of the given campaigns, or attribute their hazard, oldest first.

    Those that were cancelled or have failed are left out: they may be asked for again.
    """
    query = (
        select(CampaignRow.__table__)
        .join(RepeatsRow, RepeatsRow.campaign_id == CampaignRow.id)
        .where(
            RepeatsRow.of_id.in_(list(campaigns)),
            RepeatsRow.t_b == EVERY_T_B,
            RepeatsRow.d_th == EVERY_D_TH,
            RepeatsRow.repeats != REDUCTION,
            CampaignRow.status.not_in((CampaignStatus.CANCELLED, CampaignStatus.FAILED)),
        )
        .order_by(CampaignRow.created_at, CampaignRow.id)
    )
    return campaigns_of(connection, connection.execute(query).all())


def _verdicts(connection: Connection, campaign_id: str) -> dict[int, str]:
    """Return whether each finished simulation of a campaign was safe or unsafe, or failed, by number."""
    ended = (SolutionVerdict.SAFE, SolutionVerdict.UNSAFE, SolutionVerdict.FAILED)
    query = select(SolutionRow.number, SolutionRow.verdict).where(
        SolutionRow.campaign_id == campaign_id, SolutionRow.verdict.in_(ended), is_told(campaign_id)
    )
    return {row.number: row.verdict for row in connection.execute(query)}
