"""Route of the dashboard's first page: all campaigns at a glance, columnar."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from sqlalchemy import Connection

from brink.server.api.conditional import NOTHING_NEW, is_known, nothing_new, tag_of
from brink.server.api.context import Services
from brink.server.api.cursor import cursor_of, read_cursor
from brink.server.api.schemas import View
from brink.server.campaigns.plan import looks_for_boundary
from brink.server.campaigns.view_store import read_campaign_progress
from brink.server.dashboard.overview import Outline, list_outlines
from brink.server.db.engine import read
from brink.server.queue.job_store import count_unfinished
from brink.server.queue.workers import live_capabilities
from brink.server.states import CampaignStatus

router = APIRouter(tags=["campaigns"])


class Overview(View):
    """Campaigns, newest first, a list for each of what is told of them."""

    id: list[str]
    name: list[str]
    problem: list[str]
    algorithm: list[str]
    seed: list[int]
    status: list[CampaignStatus]
    status_reason: list[str]
    sequence: Annotated[list[int], Field(description="Grows with every change of the campaign.")]
    budget: list[int]
    simulations: Annotated[list[int], Field(description="Done so far, this generation's included.")]
    evaluated: list[int]
    unsafe: list[int]
    failed: list[int]
    quarantined: Annotated[
        list[int | None], Field(description="Jobs that were given up; None once it has ended.")
    ]
    generation: list[int]
    rate_per_s: list[float | None]
    remaining_s: list[float | None]
    dbs: Annotated[
        list[list[int]],
        Field(
            description="Distinct boundary solutions at the default thresholds, evenly over the generations."
        ),
    ]
    looks_for_boundary: Annotated[
        list[bool],
        Field(description="Whether it looks for the hazard boundary, rather than different violations."),
    ]
    created_at: list[datetime]
    finished_at: list[datetime | None]
    experiment: Annotated[list[str | None], Field(description="That it belongs to.")]
    repeats_of: Annotated[list[str | None], Field(description="Campaign whose boundary it repeats.")]
    workers: Annotated[int, Field(description="Workers heard of lately.")]
    trouble: Annotated[str | None, Field(description="Why the database takes no writes now, if it does not.")]
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")]


@router.get("/overview", responses=NOTHING_NEW)
async def get_overview(
    services: Services,
    request: Request,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
    status: Annotated[list[CampaignStatus] | None, Query()] = None,
    name: Annotated[str, Query(max_length=200, description="Part of a name, or beginning of an id.")] = "",
    experiment: Annotated[str | None, Query(max_length=16)] = None,
) -> Overview:
    """Return campaigns at a glance, newest first. Answers 304 to a known ETag."""
    before = read_cursor(cursor) if cursor else None
    trouble = services.queue.writer.trouble

    def look(connection: Connection) -> tuple[str, Overview | None]:
        outlines = list_outlines(
            connection,
            limit=limit,
            before=before,
            statuses=tuple(status or ()),
            named=name,
            experiment=experiment,
        )
        pulses = [_pulse(connection, one) for one in outlines]
        workers = sorted(live_capabilities(connection, services.settings.worker_seen_s))
        told = (pulses, workers, limit, trouble.reason if trouble else None)
        etag = tag_of(*told)
        if is_known(request, etag):
            return etag, None
        return etag, _overview(services, connection, outlines, limit, len(workers))

    etag, overview = await read(services.engines, look)
    if overview is None:
        return nothing_new(etag)  # type: ignore[no-any-return]
    response.headers["ETag"] = etag
    return overview


def _pulse(connection: Connection, one: Outline) -> tuple[object, ...]:
    if one.finished_at is not None:
        return (one.id, one.sequence)
    return (one.id, one.sequence, *sorted(count_unfinished(connection, one.id).items()))


def _overview(
    services: Services, connection: Connection, outlines: list[Outline], limit: int, workers: int
) -> Overview:
    standings = [
        read_campaign_progress(connection, one) if one.finished_at is None else None for one in outlines
    ]
    both = list(zip(outlines, standings, strict=True))
    sparks = services.figures.sparks.of(connection, outlines)
    trouble = services.queue.writer.trouble
    last = outlines[-1] if len(outlines) == limit else None
    columns = {
        name: [getattr(one, name) for one in outlines]
        for name in (
            "id", "name", "problem", "algorithm", "seed", "status", "status_reason", "sequence", "budget",
            "evaluated", "unsafe", "failed", "generation", "created_at", "finished_at", "experiment", "repeats_of",
        )
    }  # fmt: skip
    return Overview(
        **columns,
        simulations=[standing.done if standing else one.completed for one, standing in both],
        quarantined=[standing.quarantined if standing else None for _, standing in both],
        rate_per_s=[standing.rate_per_s if standing else None for _, standing in both],
        remaining_s=[standing.remaining_s if standing else None for _, standing in both],
        dbs=[list(sparks[one.id]) for one in outlines],
        looks_for_boundary=[looks_for_boundary(one.algorithm) for one in outlines],
        workers=workers,
        trouble=trouble.reason if trouble else None,
        next=cursor_of(last.created_at, last.id) if last else None,
    )
