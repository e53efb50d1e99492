"""Campaigns and solutions as users see them."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row

from brink.search.archive import Archive
from brink.search.boundary import distinct_boundary
from brink.server.api.schemas import (
    Boundary,
    CampaignView,
    DbsCell,
    GenerationView,
    Progress,
    SolutionView,
)
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.plan import looks_for_boundary
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.campaigns.view_store import read_campaign_progress
from brink.server.db.writer import Trouble
from brink.server.errors import NotFound
from brink.server.problems.base import Problem, words_of
from brink.server.queue.job_store import queued_needs
from brink.server.queue.workers import live_capabilities


def campaign_view(campaign: Campaign) -> CampaignView:
    """Return a campaign."""
    return CampaignView(
        id=campaign.id, name=campaign.body.name, status=campaign.status,
        status_reason=campaign.status_reason, sequence=campaign.sequence, simulations=campaign.completed,
        budget=campaign.budget, unsafe=campaign.unsafe, failed=campaign.failed,
        measured=campaign.measured, generation=campaign.generation, created_at=campaign.created_at,
        finished_at=campaign.finished_at,
        body=campaign.body,
    )  # fmt: skip


def read_progress(
    connection: Connection,
    campaign_id: str,
    since: int,
    worker_seen_s: float,
    archive: ReadArchive | None,
    asking: str | None,
    trouble: Trouble | None,
) -> Progress:
    """Return counts and series of a campaign, from generation `since` on."""
    campaign = CAMPAIGNS.find(connection, campaign_id)
    if campaign is None:
        raise NotFound(f"campaign {campaign_id}: no such campaign")
    standing = read_campaign_progress(connection, campaign)
    live = live_capabilities(connection, worker_seen_s)
    capabilities = set().union(*live.values())
    waiting = queued_needs(connection, campaign.id) if standing.queued else {}
    return Progress(
        id=campaign.id, name=campaign.body.name, status=campaign.status,
        status_reason=campaign.status_reason, sequence=campaign.sequence, budget=campaign.budget,
        simulations=standing.done, evaluated=campaign.evaluated, unsafe=campaign.unsafe, failed=campaign.failed,
        measured=campaign.measured, quarantined=standing.quarantined, queued=standing.queued,
        leased=standing.leased, generation=campaign.generation, rate_per_s=standing.rate_per_s,
        remaining_s=standing.remaining_s, elapsed_s=standing.elapsed_s, workers=len(live),
        unrunnable={needs: n for needs, n in waiting.items() if needs not in capabilities},
        digest=archive.digest if archive is not None else None,
        looks_for_boundary=looks_for_boundary(campaign.body.algorithm.id),
        origins=view_store.count_origins(connection, campaign.id) if campaign.finished_at else {},
        asking=asking,
        trouble=trouble.reason if trouble else None,
        trouble_s=trouble.span_s if trouble else 0.0,
        t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH,
        generations=[
            GenerationView.model_validate(item, from_attributes=True)
            for item in view_store.list_generations(connection, campaign.id, since)
        ],
    )  # fmt: skip


def solution_views(
    rows: Iterable[Row[*tuple[Any, ...]]], read: ReadArchive, *, full: bool = False
) -> list[SolutionView]:
    """Return solutions with decoded parameters and their place in the archive.

    Args:
        rows: From the store.
        read: The campaign's archive.
        full: Whether to add all verdicts, features, provenance and the episode.
    """
    return [
        _solution(row, read.plan.problem, read.archive, read.places.get(row.number), full=full)
        for row in rows
    ]


def _solution(
    row: Row[*tuple[Any, ...]], problem: Problem, archive: Archive, index: int | None, *, full: bool
) -> SolutionView:
    result: Mapping[str, Any] = json.loads(row.result) if full and row.result else {}
    vectors = problem.space.split(np.frombuffer(row.vector, dtype="<f8"))
    return SolutionView(
        number=row.number, generation=row.generation, verdict=row.verdict, robustness=row.robustness,
        objectives=row.objectives, failure=row.failure, origin=row.origin,
        fitness=None if index is None else float(archive.fitness[index]),
        neighbours=None if index is None else int(archive.neighbours[index]),
        unsafe_neighbours=None if index is None else int(archive.unsafe_neighbours[index]),
        interval=None if index is None else (float(archive.interval[index, 0]), float(archive.interval[index, 1])),
        seed=row.seed, attempts=row.attempt,
        words=words_of(problem, vectors), parameters=problem.space.decode(vectors),
        verdicts=result.get("verdicts"), features=result.get("features"),
        provenance=result.get("provenance"),
        spec=json.loads(row.spec) if full and row.spec else None,
    )  # fmt: skip


def boundary_view(
    connection: Connection, campaign: Campaign, read: ReadArchive, t_b: float, d_th: float
) -> Boundary:
    """Return the distinct boundary solutions of a campaign, best first."""
    archive = read.archive
    chosen = distinct_boundary(archive, t_b, d_th)
    strict = distinct_boundary(archive, t_b, d_th, strict=True)
    grid = read.grid
    numbers = [int(number) for number in archive.numbers[chosen]]
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers)}
    return Boundary(
        t_b=t_b,
        d_th=d_th,
        dbs=len(chosen),
        strict_dbs=len(strict),
        note=_note(read, t_b),
        grid=[
            DbsCell(t_b=t, d_th=d, dbs=int(grid.dbs[row, column]), strict_dbs=int(grid.strict[row, column]))
            for row, t in enumerate(grid.t_bs)
            for column, d in enumerate(grid.d_ths)
        ],
        solutions=solution_views([rows[number] for number in numbers], read, full=True),
        strict=[int(number) for number in archive.numbers[strict]],
    )


def _note(read: ReadArchive, t_b: float) -> str:
    """Say what a figure of this threshold can and cannot mean."""
    p_th = read.plan.neighbourhood.p_th
    all_safe = p_th / max(p_th, 1 - p_th)
    if t_b >= all_safe:
        return (
            f"t_b {t_b:g} counts neighbourhoods without a single unsafe solution as boundary (their fitness falls "
            f"to {all_safe:.3f}); strict_dbs does not."
        )
    return "strict_dbs counts only solutions whose interval holds p_th and whose neighbourhood holds both verdicts."
