"""Routes of campaigns: submit, list, look, control, progress."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Body, Header, Query, Request, Response
from sqlalchemy import Connection

from brink.server.api.conditional import NOTHING_NEW, is_known, nothing_new, tag_of
from brink.server.api.context import Context, Services
from brink.server.api.cursor import cursor_of, read_cursor
from brink.server.api.schemas import (
    MAX_NUMBER,
    CampaignList,
    CampaignView,
    GenerationView,
    Progress,
)
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody, parse_body
from brink.server.campaigns.plan import looks_for_boundary
from brink.server.campaigns.store import CAMPAIGNS, ENDED, Campaign
from brink.server.campaigns.view_store import read_campaign_progress
from brink.server.db.engine import read
from brink.server.db.writer import Trouble
from brink.server.documents import MAX_FILE_BYTES, parse_yaml
from brink.server.errors import InvalidInput, NotFound
from brink.server.queue.job_store import queued_needs
from brink.server.queue.workers import live_capabilities
from brink.server.states import CampaignStatus

router = APIRouter(prefix="/campaigns", tags=["campaigns"])


@router.post(
    "",
    status_code=201,
    responses={
        200: {"model": CampaignView, "description": "The campaign of the first time, by its Idempotency-Key."}
    },
)
async def submit_campaign(
    body: CampaignBody,
    services: Services,
    response: Response,
    idempotency_key: Annotated[str | None, Header(max_length=200, pattern="^[ -~]+$")] = None,
) -> CampaignView:
    """Submit a campaign. The same `Idempotency-Key` again returns the campaign of the first time, with 200."""
    campaign, new = await services.campaigns.submit(body, idempotency_key)
    response.headers["Location"] = f"/api/v1/campaigns/{campaign.id}"
    if not new:
        response.status_code = 200
    return campaign_view(campaign)


@router.post("/check")
async def check_campaign(
    text: Annotated[
        str,
        Body(
            media_type="application/yaml",
            max_length=MAX_FILE_BYTES,
            description="A campaign file: YAML, of which JSON is a part.",
        ),
    ],
    services: Services,
) -> CampaignBody:
    """Return the campaign of a file if it could be submitted, with the same errors if it could not; store nothing."""
    body = parse_body(parse_yaml(text))
    await services.campaigns.check(body)
    return body


@router.get("")
async def list_campaigns(
    services: Services,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
    status: Annotated[list[CampaignStatus] | None, Query()] = None,
    document_hash: Annotated[str | None, Query(max_length=64, pattern="^[0-9a-f]*$")] = None,
) -> CampaignList:
    """List campaigns, newest first."""
    campaigns = await services.campaigns.list(
        limit=limit,
        before=read_cursor(cursor) if cursor else None,
        statuses=tuple(status or ()),
        document_hash=document_hash,
    )
    last = campaigns[-1] if len(campaigns) == limit else None
    return CampaignList(
        campaigns=[campaign_view(campaign) for campaign in campaigns],
        next=cursor_of(last.created_at, last.id) if last else None,
    )


@router.get("/{campaign_id}")
async def get_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Return a campaign by its id, or by the beginning of its id if that is unique."""
    return campaign_view(await services.campaigns.get(campaign_id))


@router.post("/{campaign_id}/pause")
async def pause_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Hand out no more of its jobs; what is running is still taken in."""
    return campaign_view(await services.campaigns.pause(campaign_id))


@router.post("/{campaign_id}/resume")
async def resume_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Go on with a paused campaign, without the candidates that failed so far."""
    return campaign_view(await services.campaigns.resume(campaign_id))


@router.post("/{campaign_id}/cancel")
async def cancel_campaign(campaign_id: str, services: Services) -> CampaignView:
    """End a campaign; what it found stays."""
    return campaign_view(await services.campaigns.cancel(campaign_id))


@router.delete("/{campaign_id}", status_code=204)
async def delete_campaign(campaign_id: str, services: Services) -> None:
    """Delete a campaign that has ended, with everything that belongs to it."""
    await services.campaigns.delete(campaign_id)


@router.get("/{campaign_id}/progress", responses=NOTHING_NEW)
async def get_progress(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    since: Annotated[
        int, Query(ge=0, le=MAX_NUMBER, description="Number of the first generation to return.")
    ] = 0,
) -> Progress:
    """Return counts and rates, and the series of generations from `since` on. Answers 304 to a known ETag."""
    etag = await _pulse(services, campaign_id, since)
    if etag is None:  # the beginning of an id, or none
        campaign_id = (await services.campaigns.get(campaign_id)).id
        etag = await _pulse(services, campaign_id, since)
    if etag is not None and is_known(request, etag):
        return nothing_new(etag)  # type: ignore[no-any-return]
    # What is read now is as new as the tag, or newer: no change can be missed.
    progress = await _progress(services, campaign_id, since)
    response.headers["ETag"] = etag or ""
    return progress


async def _pulse(services: Context, campaign_id: str, since: int) -> str | None:
    """Return the tag of a campaign's progress; None without a campaign of that whole id."""
    trouble = services.queue.writer.trouble

    def look(connection: Connection) -> tuple[object, ...] | None:
        pulse = view_store.read_version(connection, campaign_id)
        if pulse is None:
            return None
        live = live_capabilities(connection, services.settings.worker_seen_s)
        return (*pulse, sorted((worker, sorted(able)) for worker, able in live.items()))

    pulse = await read(services.engines, look)
    if pulse is None:
        return None
    return tag_of(pulse, since, services.seeds.doing(campaign_id), trouble.reason if trouble else None)


async def _progress(services: Context, campaign_id: str, since: int) -> Progress:
    while True:
        campaign = await services.campaigns.get(campaign_id)
        archive = await _final_archive(services, campaign)
        look = partial(
            read_progress,
            campaign_id=campaign.id,
            since=since,
            worker_seen_s=services.settings.worker_seen_s,
            archive=archive,
            asking=services.seeds.doing(campaign.id),
            trouble=services.queue.writer.trouble,
        )
        progress = await read(services.engines, look)
        if progress.status is campaign.status:
            return progress  # else it ended in between, and its digest must not be missing


async def _final_archive(services: Context, campaign: Campaign) -> ReadArchive | None:
    """Return the archive of a campaign that has ended; None if it runs, or its plug-ins are not installed here."""
    if campaign.status not in ENDED:
        return None
    try:
        return await services.archives.get(campaign)
    except InvalidInput:
        return None


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
