"""Repeats: solutions of a campaign simulated again with other seeds, in a campaign of their own.

So they need nothing that campaigns do not have: workers, progress, resuming, no result lost. Its algorithm is
`brink.search.algorithms.repeats`.

They are the distinct boundary at two thresholds, or solutions that somebody named. Named ones are stored with the
thresholds that leave nothing out, `EVERY_T_B` and `EVERY_D_TH`: with these it is their numbers alone that say which
solutions they are. Whether the same were asked for before is decided by numbers in either case.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, insert, select

from brink.search.algorithms.repeats import Repeats, Tallies, tallied
from brink.search.analysis.boundary import distinct_boundary
from brink.search.archive import Archive
from brink.search.streams import Stream, generator
from brink.server.campaigns import store
from brink.server.campaigns.body import Budget, CampaignBody, PluginChoice
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.submission import Prepared, prepared, store_prepared
from brink.server.campaigns.values import Campaign
from brink.server.db.locking import note_change
from brink.server.db.models import CampaignRow, RepeatsRow, SolutionRow
from brink.server.errors import Conflict, FieldError, InvalidInput
from brink.server.states import CampaignStatus, SolutionVerdict

MOST = 1_000
"""Solutions that are repeated, the best ones: they stand in the settings of a campaign."""
EVERY_T_B = 1.0
EVERY_D_TH = 0.0
"""Thresholds that every solution meets."""
_NAME_LENGTH = 200
_MOST_ERRORS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRepeats:
    """Repeats that can run, not stored yet.

    Attributes:
        of: The campaign whose solutions they repeat.
        t_b: Largest fitness of these.
        d_th: Least distance between these.
        repeats: Simulations of each.
        numbers: Which they are, best first.
        campaign: That simulates them.
    """

    of: str
    t_b: float
    d_th: float
    repeats: int
    numbers: tuple[int, ...]
    campaign: Prepared


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredRepeats:
    """Repeats as they stand.

    Attributes:
        campaign: That simulates them.
        t_b: Largest fitness of the solutions.
        d_th: Least distance between them.
        repeats: Simulations of each, in the end.
        numbers: Which they are, best first.
        evaluated: Numbers in the campaign of what was evaluated so far.
        unsafe: Their verdicts.
    """

    campaign: Campaign
    t_b: float
    d_th: float
    repeats: int
    numbers: tuple[int, ...]
    evaluated: tuple[int, ...]
    unsafe: tuple[bool, ...]

    @property
    def boundary(self) -> bool:
        """Whether they are a boundary; if not, they are solutions by their numbers."""
        return (self.t_b, self.d_th) != (EVERY_T_B, EVERY_D_TH)

    def tallies(self, z: float) -> Tallies:
        """Return how likely each solution is unsafe, by its own simulations."""
        return tallied(self.evaluated, self.unsafe, len(self.numbers), z)


def plan_repeats(
    campaign: Campaign, plan: Plan, archive: Archive, *, repeats: int, t_b: float, d_th: float
) -> PlannedRepeats | None:
    """Return repeats of a campaign's distinct boundary solutions; None if it has none.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: What it found.
        repeats: Simulations of each solution.
        t_b: Largest fitness.
        d_th: Least distance between two.

    Raises:
        InvalidInput: They cannot run.
    """
    chosen = distinct_boundary(archive, t_b, d_th)[:MOST]
    if not len(chosen):
        return None
    # A seed of their own: with the campaign's, the first of them would be its own episodes.
    seed = int(generator(campaign.body.seed, Stream.REPEATS, repeats).integers(2**53))
    return PlannedRepeats(
        of=campaign.id,
        t_b=t_b,
        d_th=d_th,
        repeats=repeats,
        numbers=tuple(archive.numbers[chosen].tolist()),
        campaign=_prepared(campaign, plan, archive, chosen, repeats, seed, "boundary again"),
    )


def plan_named(
    campaign: Campaign, plan: Plan, archive: Archive, *, repeats: int, numbers: Sequence[int]
) -> PlannedRepeats:
    """Return repeats of some solutions of a campaign.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: What it found.
        repeats: Simulations of each solution.
        numbers: Which solutions, in any order, each once; at most `MOST`.

    Raises:
        InvalidInput: They cannot run, or one of them is no evaluated solution of the campaign.
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
    # Other solutions, other seeds: with those of the boundary, some of these would be the same episodes again.
    seed = int(generator(campaign.body.seed, Stream.REPEATS, repeats, *sorted(ordered)).integers(2**53))
    again = f"solution {ordered[0]} again" if len(ordered) == 1 else f"{len(ordered)} solutions again"
    return PlannedRepeats(
        of=campaign.id,
        t_b=EVERY_T_B,
        d_th=EVERY_D_TH,
        repeats=repeats,
        numbers=ordered,
        campaign=_prepared(campaign, plan, archive, chosen, repeats, seed, again),
    )


def _prepared(
    campaign: Campaign,
    plan: Plan,
    archive: Archive,
    chosen: NDArray[np.intp],
    repeats: int,
    seed: int,
    again: str,
) -> Prepared:
    """Return the campaign that simulates solutions, given as positions in the archive, again."""
    body, near = campaign.body, plan.neighbourhood
    return prepared(
        CampaignBody(
            name=f"{body.name[: _NAME_LENGTH - len(again) - 2]}: {again}",
            problem=body.problem,
            algorithm=PluginChoice(
                id=Repeats.id,
                params={
                    "solutions": archive.vectors[chosen].tolist(),
                    "radius": near.radius,
                    "p_th": near.p_th,
                    "z": near.z,
                },
            ),
            budget=Budget(simulations=repeats * len(chosen)),
            seed=seed,
            priority=body.priority,
            execution=body.execution.model_copy(update={"keep_traces": 0}),
        ),
        llm_endpoints="",
    )


def store_repeats(connection: Connection, planned: PlannedRepeats) -> tuple[Campaign, bool]:
    """Store repeats, unless the same were asked for before; return their campaign, and whether it is new."""
    alike = connection.execute(
        select(RepeatsRow.numbers, CampaignRow.__table__)
        .join(CampaignRow, RepeatsRow.campaign_id == CampaignRow.id)
        .where(
            RepeatsRow.of_id == planned.of, RepeatsRow.t_b == planned.t_b, RepeatsRow.d_th == planned.d_th,
            RepeatsRow.repeats == planned.repeats,
            CampaignRow.status.not_in((CampaignStatus.CANCELLED, CampaignStatus.FAILED)),
        )
    )  # fmt: skip
    known = next((row for row in alike if tuple(row.numbers) == planned.numbers), None)
    if known is not None:
        return store.campaign_of(known), False
    campaign = store_prepared(connection, planned.campaign)
    connection.execute(
        insert(RepeatsRow).values(
            campaign_id=campaign.id, of_id=planned.of, t_b=planned.t_b, d_th=planned.d_th,
            repeats=planned.repeats, numbers=list(planned.numbers),
        )
    )  # fmt: skip
    note_change(connection, planned.of)
    return campaign, True


def read_repeats(connection: Connection, campaign_id: str) -> list[StoredRepeats]:
    """Return all repeats of a campaign's solutions, those that were asked for first first."""
    query = (
        select(RepeatsRow.t_b, RepeatsRow.d_th, RepeatsRow.repeats, RepeatsRow.numbers, CampaignRow.__table__)
        .join(CampaignRow, CampaignRow.id == RepeatsRow.campaign_id)
        .where(RepeatsRow.of_id == campaign_id)
        .order_by(CampaignRow.created_at, CampaignRow.id)
    )
    found = []
    for row in connection.execute(query):
        campaign = store.campaign_of(row)
        verdicts = _verdicts(connection, campaign.id)
        found.append(
            StoredRepeats(
                campaign=campaign, t_b=row.t_b, d_th=row.d_th, repeats=row.repeats,
                numbers=tuple(row.numbers), evaluated=tuple(number for number, _ in verdicts),
                unsafe=tuple(unsafe for _, unsafe in verdicts),
            )
        )  # fmt: skip
    return found


def check_no_open_repeats(connection: Connection, campaign_id: str) -> None:
    """Check that a campaign may be deleted with its repeats, and with theirs.

    Raises:
        Conflict: Some of them run, or wait.
    """
    query = select(CampaignRow.id, CampaignRow.status).join(
        RepeatsRow, RepeatsRow.campaign_id == CampaignRow.id
    )
    for row in connection.execute(query.where(RepeatsRow.of_id == campaign_id)).all():
        if row.status not in store.ENDED:
            raise Conflict(
                f"campaign {row.id} repeats the boundary of {campaign_id} and is {row.status}: cancel it first"
            )
        check_no_open_repeats(connection, row.id)


def _verdicts(connection: Connection, campaign_id: str) -> Sequence[tuple[int, bool]]:
    query = select(SolutionRow.number, SolutionRow.verdict).where(
        SolutionRow.campaign_id == campaign_id,
        SolutionRow.verdict.in_((SolutionVerdict.SAFE, SolutionVerdict.UNSAFE)),
    )
    return [(row.number, row.verdict == SolutionVerdict.UNSAFE) for row in connection.execute(query)]
