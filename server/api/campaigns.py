"""Routes of campaigns: submission, control, progress, the overview of all, and language-model calls."""

import asyncio
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Body, Query, Request, Response
from pydantic import AfterValidator, Field
from sqlalchemy import Connection

from brink.server.api.context import Context, Services
from brink.server.api.responses import (
    NOT_MODIFIED,
    THRESHOLDS,
    Cursor,
    DocumentHash,
    IdempotencyKey,
    etag_of,
    existing,
    matches,
    next_cursor,
    not_modified,
    read_cursor,
    set_created,
)
from brink.server.api.schemas import (
    MAX_NUMBER,
    CampaignList,
    CampaignView,
    Deletion,
    DoomedCampaign,
    GenerationView,
    KnownView,
    Progress,
)
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import (
    DEFAULT_D_TH,
    DEFAULT_T_B,
    MOST_TAGS,
    CampaignBody,
    CampaignChange,
    Tag,
    check_notes,
    parse_body,
)
from brink.server.campaigns.deletion import TreeMember
from brink.server.campaigns.known import count_known
from brink.server.campaigns.plan import finds_of, minimises_of
from brink.server.campaigns.reported import ReportedResults
from brink.server.campaigns.simulators import simulator_of
from brink.server.campaigns.store import CAMPAIGNS, Campaign, labelled
from brink.server.campaigns.view_store import read_campaign_progress
from brink.server.dashboard.found import Found, found_so_far
from brink.server.dashboard.overview import (
    Chosen,
    FollowUpListing,
    Outline,
    count_campaigns,
    list_outlines,
    with_follow_ups,
)
from brink.server.db.engine import read
from brink.server.db.writer import Trouble
from brink.server.documents import MAX_FILE_BYTES, parse_yaml
from brink.server.errors import InvalidInput, NotFound
from brink.server.queue.job_store import count_unfinished, queued_needs
from brink.server.queue.workers import live_capabilities
from brink.server.seeding import LlmCalls, spent_on
from brink.server.states import ENDED, CampaignStatus
from brink.server.views import View
from brink.sim.catalogue import worker_for

router = APIRouter(prefix="/campaigns", tags=["campaigns"])

MAX_FILE_VALUES = 10_000
"""Maximum number of values in a campaign file that is checked here: parsing YAML takes long."""

TagQuery = Annotated[
    list[Tag] | None,
    Query(max_length=MOST_TAGS, description="Only campaigns with this tag; with all of them, if repeated."),
]
SearchQuery = Annotated[
    str,
    Query(max_length=200, description="Only campaigns with all of these words in name, notes or tags."),
    AfterValidator(check_notes),
]
SearchOrIdQuery = Annotated[
    str,
    Query(
        max_length=200,
        description="Only campaigns with all of these words in name, notes or tags, or whose id begins with it.",
    ),
    AfterValidator(check_notes),
]
FollowUpsQuery = Annotated[
    FollowUpListing,
    Query(description="Whether follow-ups are listed like other campaigns, hidden, or nested below theirs."),
]
UnfoldQuery = Annotated[
    list[str] | None,
    Query(
        max_length=50,
        description="With hidden follow-ups: campaigns below which they are listed nevertheless.",
    ),
]


@router.post("", status_code=201, responses=existing(CampaignView, "campaign"))
async def submit_campaign(
    body: CampaignBody, services: Services, response: Response, idempotency_key: IdempotencyKey = None
) -> CampaignView:
    """Submit a campaign. Repeating the request with the same `Idempotency-Key` returns that campaign, with 200."""
    campaign, new = await services.campaigns.submit(body, idempotency_key)
    set_created(response, f"campaigns/{campaign.id}", new=new)
    return campaign_view(campaign)


@router.post("/check")
async def check_campaign(
    text: Annotated[
        str,
        Body(
            media_type="application/yaml",
            max_length=MAX_FILE_BYTES,
            description="A campaign file in YAML or JSON.",
        ),
    ],
    services: Services,
) -> CampaignBody:
    """Validate a campaign file without submitting it; return the parsed campaign, or the errors of a submission."""
    body = await asyncio.get_running_loop().run_in_executor(services.decoding, _parsed_file, text)
    await services.campaigns.check(body)
    return body


def _parsed_file(text: str) -> CampaignBody:
    return parse_body(parse_yaml(text, max_values=MAX_FILE_VALUES))


@router.get("")
async def list_campaigns(
    services: Services,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Cursor = None,
    status: Annotated[list[CampaignStatus] | None, Query()] = None,
    document_hash: DocumentHash = None,
    tag: TagQuery = None,
    search: SearchQuery = "",
) -> CampaignList:
    """List campaigns, newest first."""
    campaigns = await services.campaigns.list(
        limit=limit,
        before=read_cursor(cursor),
        statuses=tuple(status or ()),
        document_hash=document_hash,
        conditions=labelled(tag or (), search),
    )
    return CampaignList(
        campaigns=[campaign_view(campaign) for campaign in campaigns], next=next_cursor(campaigns, limit)
    )


@router.get("/{campaign_id}")
async def get_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Return a campaign by its id or a unique prefix of it."""
    campaign = await services.campaigns.get(campaign_id)
    simulator = await read(services.engines, lambda connection: simulator_of(connection, campaign.id))
    return campaign_view(campaign).model_copy(update={"simulator": simulator})


@router.patch("/{campaign_id}")
async def change_campaign(campaign_id: str, change: CampaignChange, services: Services) -> CampaignView:
    """Change the tags or notes of a campaign; everything that was simulated stays as it is."""
    return campaign_view(await services.campaigns.change(campaign_id, change))


@router.post("/{campaign_id}/pause")
async def pause_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Pause a campaign: workers get no more of its jobs; results of running jobs are still accepted."""
    return campaign_view(await services.campaigns.pause(campaign_id))


@router.post("/{campaign_id}/resume")
async def resume_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Resume a paused campaign, without the candidates that have failed so far."""
    return campaign_view(await services.campaigns.resume(campaign_id))


@router.post("/{campaign_id}/cancel")
async def cancel_campaign(campaign_id: str, services: Services) -> CampaignView:
    """Cancel a campaign; its results are kept."""
    return campaign_view(await services.campaigns.cancel(campaign_id))


@router.delete("/{campaign_id}", status_code=204)
async def delete_campaign(campaign_id: str, services: Services) -> None:
    """Delete a campaign with all of its data, and with its follow-ups; all of them must have ended."""
    await services.campaigns.delete(campaign_id)


@router.get("/{campaign_id}/deletion")
async def get_deletion(campaign_id: str, services: Services) -> Deletion:
    """Return the campaigns that deleting a campaign would delete: itself, its follow-ups, and theirs."""
    return deletion_view(await services.campaigns.doomed(campaign_id))


@router.get("/{campaign_id}/progress", responses=NOT_MODIFIED)
async def get_progress(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    since: Annotated[
        int, Query(ge=0, le=MAX_NUMBER, description="Number of the first generation to return.")
    ] = 0,
) -> Progress:
    """Return counts, rates and the generations from `since` on. Supports conditional requests with ETag."""
    etag = await _progress_etag(services, campaign_id, since)
    if etag is None:  # a prefix of an id, or an unknown id
        campaign_id = (await services.campaigns.get(campaign_id)).id
        etag = await _progress_etag(services, campaign_id, since)
    if etag is not None and matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    # The data is read after the tag, so it is at least as new: no change can be missed.
    progress = await _progress(services, campaign_id, since)
    response.headers["ETag"] = etag or ""
    return progress


async def _progress_etag(services: Context, campaign_id: str, since: int) -> str | None:
    """Return the ETag of a campaign's progress, or None if no campaign has exactly this id."""
    trouble = services.queue.writer.trouble

    def look(connection: Connection) -> tuple[object, ...] | None:
        version = view_store.read_version(connection, campaign_id)
        if version is None or version.ended:  # an ended campaign is unaffected by workers that come and go
            return version
        live = live_capabilities(connection, services.settings.worker_seen_s)
        return (*version, sorted((worker, sorted(able)) for worker, able in live.items()))

    version = await read(services.engines, look)
    if version is None:
        return None
    return etag_of(version, since, services.seeds.doing(campaign_id), trouble.reason if trouble else None)


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
            results=services.reported,
        )
        progress = await read(services.engines, look)
        if progress.status is campaign.status:
            return progress  # otherwise it ended between the two reads, and the digest would be missing


async def _final_archive(services: Context, campaign: Campaign) -> ReadArchive | None:
    """Return the archive of an ended campaign; None while it runs, or if its plug-ins are not installed here."""
    if campaign.status not in ENDED:
        return None
    try:
        return await services.archives.get(campaign)
    except InvalidInput:
        return None


def deletion_view(doomed: Sequence[TreeMember]) -> Deletion:
    """Return the response schema of a deletion preview."""
    return Deletion(
        campaigns=[
            DoomedCampaign(id=one.id, name=one.name, status=one.status, follow_up_of=one.follow_up_of)
            for one in doomed
        ]
    )


def campaign_view(campaign: Campaign) -> CampaignView:
    """Return the response schema of a campaign."""
    return CampaignView(
        id=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        status_reason=campaign.status_reason,
        sequence=campaign.sequence,
        simulations=campaign.completed,
        budget=campaign.budget,
        unsafe=campaign.unsafe,
        failed=campaign.failed,
        measured=campaign.measured,
        generation=campaign.generation,
        created_at=campaign.created_at,
        finished_at=campaign.finished_at,
        tags=campaign.body.tags,
        notes=campaign.body.notes,
        finds=list(finds_of(campaign.body.algorithm.id)),
        body=campaign.body,
        thresholds=THRESHOLDS,
    )


def read_progress(
    connection: Connection,
    campaign_id: str,
    since: int,
    worker_seen_s: float,
    archive: ReadArchive | None,
    asking: str | None,
    trouble: Trouble | None,
    results: ReportedResults,
) -> Progress:
    """Return counts and rates of a campaign, and its generations from `since` on.

    Args:
        connection: Read connection.
        campaign_id: Full id of the campaign.
        since: Number of the first generation to return.
        worker_seen_s: Time since its last contact after which a worker is no longer live, in seconds.
        archive: Archive of an ended campaign, if it could be read.
        asking: What a language model is being asked for this campaign, if anything.
        trouble: Why the database rejects writes, if it does.
        results: Reads the results that the search has not received yet.

    Raises:
        NotFound: The campaign does not exist.
    """
    campaign = CAMPAIGNS.find(connection, campaign_id)
    if campaign is None:
        raise NotFound(f"campaign {campaign_id}: no such campaign")
    reported = results.read(connection, campaign)
    live = live_capabilities(connection, worker_seen_s)
    standing = read_campaign_progress(connection, campaign, workers=len(live))
    capabilities = set().union(*live.values())
    waiting = queued_needs(connection, campaign.id) if standing.queued else {}
    unrunnable = {needs: count for needs, count in waiting.items() if needs not in capabilities}
    failed, failure = (
        view_store.read_failures(connection, campaign.id, campaign.generation)
        if standing.quarantined
        else (0, "")
    )
    return Progress(
        id=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        status_reason=campaign.status_reason,
        sequence=campaign.sequence,
        budget=campaign.budget,
        simulations=standing.done,
        evaluated=campaign.evaluated,
        unsafe=campaign.unsafe,
        failed=campaign.failed,
        measured=campaign.measured,
        reported=len(reported.results),
        reported_unsafe=reported.unsafe,
        reported_failed=failed,
        failure=failure,
        quarantined=standing.quarantined,
        queued=standing.queued,
        leased=standing.leased,
        generation=campaign.generation,
        rate_per_s=standing.rate_per_s,
        cached=standing.cached,
        remaining_s=standing.remaining_s,
        elapsed_s=standing.elapsed_s,
        workers=len(live),
        unrunnable=unrunnable,
        waits_for={needs: worker_for(needs) for needs in unrunnable},
        digest=archive.digest if archive is not None else None,
        finished_at=campaign.finished_at,
        finds=list(finds_of(campaign.body.algorithm.id)),
        minimises=minimises_of(campaign.body.algorithm.id),
        origins=view_store.count_origins(connection, campaign.id) if campaign.finished_at else {},
        known=_known_view(connection, campaign),
        asking=asking,
        tags=campaign.body.tags,
        notes=campaign.body.notes,
        trouble=trouble.reason if trouble else None,
        trouble_s=trouble.span_s if trouble else 0.0,
        t_b=DEFAULT_T_B,
        d_th=DEFAULT_D_TH,
        generations=[
            GenerationView.model_validate(item, from_attributes=True)
            for item in view_store.list_generations(connection, campaign.id, since)
        ],
    )


def _known_view(connection: Connection, campaign: Campaign) -> KnownView | None:
    start = campaign.body.start_from
    if start is None:
        return None
    counts = count_known(connection, campaign.id)
    return KnownView(
        campaign=start.campaign,
        results=counts.results,
        unsafe=counts.unsafe,
        points=counts.points,
        outside_odd=start.outside_odd or 0,
    )


overview_router = APIRouter(tags=["campaigns"])


class Overview(View):
    """Campaigns, newest first, as one list per column."""

    id: list[str]
    name: list[str]
    problem: list[str]
    algorithm: list[str]
    seed: list[int]
    status: list[CampaignStatus]
    status_reason: list[str]
    sequence: Annotated[list[int], Field(description="Increases with every change to the campaign.")]
    budget: list[int]
    simulations: Annotated[
        list[int], Field(description="Candidates finished so far, including those of the current generation.")
    ]
    evaluated: list[int]
    unsafe: list[int]
    failed: list[int]
    quarantined: Annotated[
        list[int | None], Field(description="Jobs in quarantine; null once the campaign has ended.")
    ]
    generation: list[int]
    rate_per_s: list[float | None]
    remaining_s: list[float | None]
    dbs: Annotated[
        list[list[int]],
        Field(
            description="Distinct boundary solutions at the default thresholds, at evenly spaced generations."
        ),
    ]
    finds: Annotated[
        list[list[str]],
        Field(description="Kinds of findings that its algorithm finds, its main purpose first."),
    ]
    found_kind: Annotated[list[str], Field(description="Kind of that finding; empty if there is none.")]
    found: Annotated[
        list[str | None],
        Field(
            description="Its finding, in a few words; empty while it runs, unless it searches for the "
            "boundary; null while it is being computed."
        ),
    ]
    created_at: list[datetime]
    finished_at: list[datetime | None]
    experiment: Annotated[list[str | None], Field(description="Experiment that the campaign belongs to.")]
    follow_up_of: Annotated[list[str | None], Field(description="Campaign that this one follows up.")]
    follow_ups: Annotated[list[int], Field(description="Number of follow-ups, listed or not.")]
    open_follow_ups: Annotated[list[int], Field(description="Number of follow-ups that have not ended.")]
    tags: list[list[str]]
    workers: Annotated[int, Field(description="Live workers.")]
    trouble: Annotated[
        str | None, Field(description="Why the database currently rejects writes, if it does.")
    ]
    total: Annotated[int, Field(description="Number of campaigns that match, on all pages.")] = 0
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")] = None


@overview_router.get("/overview", responses=NOT_MODIFIED)
async def get_overview(
    services: Services,
    request: Request,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Cursor = None,
    status: Annotated[list[CampaignStatus] | None, Query()] = None,
    name: Annotated[str, Query(max_length=200, description="Part of a name, or prefix of an id.")] = "",
    experiment: Annotated[str | None, Query(max_length=16)] = None,
    tag: TagQuery = None,
    search: SearchOrIdQuery = "",
    follow_ups: FollowUpsQuery = FollowUpListing.LISTED,
    unfold: UnfoldQuery = None,
) -> Overview:
    """Return a summary of campaigns, newest first. Supports conditional requests with ETag."""
    before = read_cursor(cursor)
    trouble = services.queue.writer.trouble
    chosen = Chosen(
        statuses=tuple(status or ()),
        named=name,
        experiment=experiment,
        tags=tag or (),
        search=search,
        follow_ups=follow_ups is FollowUpListing.LISTED,
    )

    def look(connection: Connection) -> tuple[str, Overview | None]:
        outlines = list_outlines(connection, limit=limit, before=before, chosen=chosen)
        following = next_cursor(outlines, limit)
        all_here = before is None and following is None
        total = len(outlines) if all_here else count_campaigns(connection, chosen)
        if follow_ups is not FollowUpListing.LISTED:
            shown = unfold or () if follow_ups is FollowUpListing.HIDDEN else None
            outlines = with_follow_ups(connection, outlines, shown)
        found = services.figures.found.of(outlines)
        states = [(*_outline_state(connection, one), found.get(one.id)) for one in outlines]
        workers = sorted(live_capabilities(connection, services.settings.worker_seen_s))
        etag = etag_of(states, workers, following, total, trouble.reason if trouble else None)
        if matches(request, etag):
            return etag, None
        overview = _overview(services, connection, outlines, found, len(workers))
        return etag, overview.model_copy(update={"next": following, "total": total})

    etag, overview = await read(services.engines, look)
    if overview is None:
        return not_modified(etag)  # type: ignore[no-any-return]
    response.headers["ETag"] = etag
    return overview


def _outline_state(connection: Connection, one: Outline) -> tuple[object, ...]:
    followed = (one.follow_ups.all, one.follow_ups.open)
    if one.finished_at is not None:
        return (one.id, one.sequence, *followed)
    return (one.id, one.sequence, *followed, *sorted(count_unfinished(connection, one.id).items()))


def _overview(
    services: Services,
    connection: Connection,
    outlines: list[Outline],
    known: Mapping[str, Found | None],
    workers: int,
) -> Overview:
    standings = [
        read_campaign_progress(connection, one, workers=workers) if one.finished_at is None else None
        for one in outlines
    ]
    both = list(zip(outlines, standings, strict=True))
    sparks = services.figures.sparks.of(connection, outlines)
    found = [
        known[one.id] if one.id in known else found_so_far(one.algorithm, sparks[one.id]) for one in outlines
    ]
    trouble = services.queue.writer.trouble
    columns = {
        name: [getattr(one, name) for one in outlines]
        for name in (
            "id",
            "name",
            "problem",
            "algorithm",
            "seed",
            "status",
            "status_reason",
            "sequence",
            "budget",
            "evaluated",
            "unsafe",
            "failed",
            "generation",
            "created_at",
            "finished_at",
            "experiment",
            "follow_up_of",
            "tags",
        )
    }
    return Overview(
        **columns,
        simulations=[standing.done if standing else one.completed for one, standing in both],
        quarantined=[standing.quarantined if standing else None for _, standing in both],
        rate_per_s=[standing.rate_per_s if standing else None for _, standing in both],
        remaining_s=[standing.remaining_s if standing else None for _, standing in both],
        dbs=[list(sparks[one.id]) for one in outlines],
        finds=[list(finds_of(one.algorithm)) for one in outlines],
        found_kind=["" if one is None else one.kind for one in found],
        found=[None if one is None else one.words for one in found],
        follow_ups=[one.follow_ups.all for one in outlines],
        open_follow_ups=[one.follow_ups.open for one in outlines],
        workers=workers,
        trouble=trouble.reason if trouble else None,
    )


llm_router = APIRouter(prefix="/campaigns/{campaign_id}/llm-calls", tags=["language models"])


@llm_router.get("")
async def get_llm_calls(
    campaign_id: str,
    services: Services,
    replies: Annotated[bool, Query(description="Whether to include the raw replies.")] = False,
) -> LlmCalls:
    """Return the language-model calls of a campaign and their cost."""
    campaign = await services.campaigns.get(campaign_id)
    calls = await read(services.engines, lambda connection: services.seeds.calls(connection, campaign.id))
    return LlmCalls(
        **spent_on(calls).model_dump(),
        calls=calls if replies else [call.model_copy(update={"reply": None}) for call in calls],
        max_calls=None if campaign.body.llm is None else campaign.body.llm.max_calls,
    )
