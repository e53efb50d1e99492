"""Route of the pictures of a pair: its two drives from above at the moment that matters."""

from typing import Annotated, Final, Literal

from fastapi import APIRouter, Query, Request, Response
from sqlalchemy import Connection

from brink.server.api.context import Context, Services
from brink.server.api.episodes import NOT_YET, UNREADABLE, Number, Wait, trace_of
from brink.server.api.responses import computing
from brink.server.campaigns.outcomes import deciding_requirements
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.campaigns.traces import trace_status
from brink.server.db.engine import read
from brink.server.errors import Conflict, NotFound
from brink.server.queue.workers import can_run
from brink.sim.replay import DrivePair, Side, render_pair_maps
from brink.sim.trace import Trace

router = APIRouter(prefix="/campaigns/{campaign_id}/pairs", tags=["pairs"])

KEPT: Final = 64
"""Number of pairs whose pictures are kept in memory."""


@router.get(
    "/{safe}-{unsafe}/{side}.png",
    response_class=Response,
    responses={
        200: {"content": {"image/png": {}}},
        204: {"description": "There is no picture: no trace that can be drawn is kept or can be recorded."},
        **NOT_YET,
    },
)
async def get_pair_picture(
    campaign_id: str,
    safe: Number,
    unsafe: Number,
    side: Literal["safe", "unsafe"],
    request: Request,
    services: Services,
    wait_s: Wait = 20.0,
    record: Annotated[
        bool, Query(description="Whether workers may run drives again whose traces were not kept.")
    ] = True,
) -> Response:
    """Return one drive of a pair from above, with the outline of the other drive's car."""
    campaign = await services.campaigns.get(campaign_id)
    numbers = (safe, unsafe)
    if not await _can_draw(services, campaign, numbers, record=record):
        return Response(status_code=204)
    try:
        documents = [await trace_of(services, campaign, number, request, wait_s) for number in numbers]
    except (NotFound, Conflict):
        return Response(status_code=204)
    kept = [document for document in documents if document is not None]
    if len(kept) < len(numbers):
        return computing("a worker is running the drives again; try again soon")  # type: ignore[no-any-return]
    judged = deciding_requirements(campaign.body)

    def draw() -> tuple[bytes, bytes]:
        safe_side, unsafe_side = (
            Side(number=number, trace=Trace.from_bytes(document))
            for number, document in zip(numbers, kept, strict=True)
        )
        return render_pair_maps(
            DrivePair(safe=safe_side, unsafe=unsafe_side, change="", requirement=judged or None)
        )

    try:
        pictures = await services.pair_pictures.get((campaign.id, *numbers), 0, draw)
    except UNREADABLE:
        return Response(status_code=204)
    return Response(pictures[side == "unsafe"], media_type="image/png")


async def _can_draw(services: Context, campaign: Campaign, numbers: tuple[int, int], *, record: bool) -> bool:
    """Return whether both traces are kept or may be recorded; request those that are missing, all at once."""

    def missing(connection: Connection) -> list[tuple[int, str | None, bool]]:
        """Return the numbers without a trace, what recording each needs, and whether a live worker has that."""
        found = [(number, trace_status(connection, campaign.id, number)) for number in numbers]
        return [
            (
                number,
                one.needs,
                one.needs is not None and can_run(connection, one.needs, services.settings.worker_seen_s),
            )
            for number, one in found
            if one.document is None
        ]

    absent = await read(services.engines, missing)
    if absent and not (record and campaign.status in ENDED and all(needs for _, needs, _ in absent)):
        return False
    if all(possible for *_, possible in absent):  # otherwise `trace_of` says what is missing
        for number, *_ in absent:
            await services.campaigns.request_trace(campaign.id, number)
    return True
