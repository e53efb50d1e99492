"""Routes of pairs: two neighbouring solutions, one safe and one unsafe, and the change between them."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response

from brink.server.api.context import Services
from brink.server.api.responses import (
    MEDIA,
    NOT_MODIFIED,
    etag_of,
    file_response,
    json_response,
    matches,
    not_modified,
    set_created,
)
from brink.server.findings.follow_ups import FollowUpView, follow_up_view
from brink.server.findings.pairs.questions import FollowUpBody, PairsQuestion, follow_up_pairs
from brink.server.findings.pairs.views import DEFAULT_PAIRS, MOST_PAIRS, PairsView

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
    question = await PairsQuestion.of(services, campaign, eps, d_th)
    etag = etag_of(*question.state, limit, format)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    answer = await question.answer(services, limit, format)
    headers = {"ETag": etag}
    if isinstance(answer, bytes):
        return file_response(answer, f"pairs-{campaign.id}", format, headers)
    return await services.pages.run(lambda: json_response(answer, headers))


@router.post(
    "/follow-ups",
    status_code=201,
    responses={200: {"model": FollowUpView, "description": "This had already been requested."}},
)
async def ask_about_pairs(
    campaign_id: str, body: FollowUpBody, services: Services, response: Response
) -> FollowUpView:
    """Simulate sides of the distinct pairs again, as a new campaign, to find out more about them."""
    campaign = await services.campaigns.get(campaign_id)
    again, new = await follow_up_pairs(services, services.campaigns, campaign, body)
    set_created(response, f"campaigns/{again.id}", new=new)
    return follow_up_view(body.kind, again)
