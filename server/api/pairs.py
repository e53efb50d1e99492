"""Routes of pairs: two neighbouring solutions, one safe and one unsafe, and the change between them."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from sqlalchemy import Connection

from brink.server.api.context import Services
from brink.server.api.responses import (
    MEDIA,
    NOT_MODIFIED,
    etag_of,
    json_response,
    matches,
    not_modified,
    set_created,
)
from brink.server.campaigns.follow_ups.question import AskedPairs, question_of
from brink.server.campaigns.follow_ups.same_episodes import read_seeds
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.pairs import PairSettings
from brink.server.campaigns.store import ENDED
from brink.server.db.engine import read
from brink.server.errors import Conflict, InvalidInput
from brink.server.findings.follow_ups import FollowUpView, follow_up_view
from brink.server.findings.pairs.analysis import pairs_view
from brink.server.findings.pairs.table import pairs_file
from brink.server.findings.pairs.views import DEFAULT_PAIRS, MOST_PAIRS, FollowUpBody, PairsView

router = APIRouter(prefix="/campaigns/{campaign_id}/pairs", tags=["pairs"])


Eps = Annotated[
    float | None,
    Query(
        ge=0,
        le=1,
        description="Largest distance between the sides of a pair; by default that of the search for pairs, or 0.02.",
    ),
]
PairDistance = Annotated[
    float | None,
    Query(
        ge=0,
        le=1,
        description="Smallest distance between two distinct pairs; by default that of the search for pairs, or 0.2.",
    ),
]
Limit = Annotated[int, Query(ge=1, le=MOST_PAIRS, description="Maximum number of pairs to return.")]


@router.get(
    "",
    response_model=PairsView,
    responses={200: {"content": {media: {} for media in MEDIA.values()}}, **NOT_MODIFIED},
)
async def get_pairs(
    campaign_id: str,
    services: Services,
    request: Request,
    eps: Eps = None,
    d_th: PairDistance = None,
    limit: Limit = DEFAULT_PAIRS,
    format: Literal["json", "csv", "jsonl", "parquet"] = "json",  # noqa: A002  (the name of the query parameter)
) -> Response:
    """Return the distinct pairs of a campaign; table formats have one row for each pair."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    stored = await services.pages.read(services.engines, lambda c: read_follow_ups(c, campaign.id))
    settings = PairSettings.of(found.plan, eps, d_th)
    states = [(one.campaign.id, one.campaign.sequence) for one in stored]
    etag = etag_of(campaign.id, campaign.sequence, found.generation, settings, limit, format, states)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    pairs = await services.pairs.get(campaign, found, settings)

    def respond(connection: Connection) -> Response:
        view = pairs_view(connection, campaign, found, pairs, stored, limit)
        if format == "json":
            return json_response(view, {"ETag": etag})
        table = pairs_file(view, found.plan.problem.space, format)
        headers = {
            "Content-Disposition": f'attachment; filename="pairs-{campaign.id}.{format}"',
            "ETag": etag,
        }
        return Response(table, media_type=MEDIA[format], headers=headers)

    return await services.pages.read(services.engines, respond)


@router.post(
    "/follow-ups",
    status_code=201,
    responses={200: {"model": FollowUpView, "description": "This had already been requested."}},
)
async def follow_up_pairs(
    campaign_id: str, body: FollowUpBody, services: Services, response: Response
) -> FollowUpView:
    """Simulate sides of the distinct pairs again, as a new campaign, to find out more about them."""
    campaign = await services.campaigns.get(campaign_id)
    if campaign.status not in ENDED:
        raise Conflict(f"campaign {campaign.id} is {campaign.status}: wait until it has ended")
    found = await services.archives.get(campaign)
    try:
        pairs = await services.pairs.get(campaign, found, PairSettings.of(found.plan, body.eps, body.d_th))
    except InvalidInput as error:  # it points at the parameter of the other route
        [refused] = error.errors
        raise InvalidInput.at(refused.pointer.removeprefix("/query"), refused.message) from None
    chosen = pairs.found.pairs[: body.limit]
    if not chosen:
        raise Conflict(
            f"campaign {campaign.id} has no pair at eps {pairs.settings.eps:g}, d_th {pairs.settings.d_th:g}"
        )
    asked = AskedPairs(campaign=campaign, plan=found.plan, archive=found.archive, pairs=chosen)
    numbers = [pair.unsafe.number for pair in chosen]
    seeds = await read(services.engines, lambda c: read_seeds(c, campaign.id, numbers))
    again, new = await services.campaigns.follow_up(
        campaign, lambda: question_of(body.kind).plan(asked, seeds, body.repeats)
    )
    set_created(response, f"campaigns/{again.id}", new=new)
    return follow_up_view(body.kind, again)
