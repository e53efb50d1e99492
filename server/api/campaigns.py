"""Routes of campaigns: submit, list, look, control, progress."""

import hashlib
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response

from server.api.context import Context, Services
from server.api.cursor import cursor_of, read_cursor
from server.api.schemas import MAX_NUMBER, CampaignList, CampaignView, Progress
from server.api.views import campaign_view, read_progress
from server.campaigns.archives import ReadArchive
from server.campaigns.body import CampaignBody
from server.campaigns.service import read
from server.campaigns.store import ENDED
from server.campaigns.values import Campaign
from server.db.models import CampaignStatus
from server.errors import InvalidInput

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


@router.get("/{campaign_id}/progress", responses={304: {"description": "Nothing new since that ETag."}})
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
    progress = await _progress(services, campaign_id, since)
    known = progress.model_dump_json(exclude={"elapsed_s", "rate_per_s", "remaining_s", "trouble_s"})
    etag = f'"{hashlib.sha256(known.encode()).hexdigest()[:32]}"'
    response.headers["ETag"] = etag
    if request.headers.get("if-none-match") == etag:
        response.status_code = 304
    return progress


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
