"""Routes of what the dashboard draws of an episode: its trace in columns, and the pictures of its film."""

import asyncio
from typing import Annotated

from fastapi import APIRouter, Request, Response
from fastapi import Path as PathParameter

from brink.server.api.context import Services
from brink.server.api.episode_schemas import EpisodeView
from brink.server.api.episode_views import episode_view
from brink.server.api.schemas import MAX_NUMBER
from brink.server.api.traces import NOT_YET, UNREADABLE, Wait, being_made, trace_of
from brink.server.errors import Conflict
from brink.sim.trace import Trace

router = APIRouter(prefix="/campaigns/{campaign_id}/solutions/{number}", tags=["solutions"])

MOST_PICTURES = 1_000_000
Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]
Index = Annotated[int, PathParameter(ge=0, lt=MOST_PICTURES, description="Of the film's pictures, from 0.")]


@router.get("/episode", response_model=EpisodeView, responses=NOT_YET)
async def get_episode(
    campaign_id: str, number: Number, request: Request, services: Services, wait_s: Wait = 20.0
) -> Response:
    """Return a solution's episode in columns; workers re-run the episode if its trace was not kept."""
    campaign = await services.campaigns.get(campaign_id)
    data = await trace_of(services, campaign, number, request, wait_s)
    if data is None:
        return being_made()
    requirement = campaign.body.problem.params.get("requirement")

    def draw() -> str:
        view = episode_view(Trace.from_bytes(data), str(requirement) if requirement else None)
        return view.model_dump_json()

    try:
        text = await asyncio.get_running_loop().run_in_executor(None, draw)
    except UNREADABLE as error:
        raise Conflict(
            f"solution {number}: its trace cannot be drawn: {type(error).__name__}: {error}"
        ) from None
    return Response(text, media_type="application/json")


@router.get(
    "/pictures/{index}.jpg", response_class=Response, responses={200: {"content": {"image/jpeg": {}}}}
)
async def get_picture(campaign_id: str, number: Number, index: Index, services: Services) -> Response:
    """Return a picture of what the camera saw in a solution's episode, if its trace is kept and has a film."""
    campaign = await services.campaigns.get(campaign_id)
    picture = await services.films.picture(campaign, number, index)
    return Response(picture, media_type="image/jpeg")
