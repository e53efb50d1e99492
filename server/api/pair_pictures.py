"""Routes of top-down pictures of two drives at the decisive moment.

They are the drives of a pair, or the system's drive with a violation and that of a reference driver who avoids it.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Final, Literal

from fastapi import APIRouter, Request, Response

from brink.pictures import DrivePair, ReplayError, Side, render_pair_maps
from brink.pictures.reference import comparison_of
from brink.server.api.context import Context, Services
from brink.server.api.episodes import NOT_YET, UNREADABLE, Number, Wait, being_made, record_missing, trace_of
from brink.server.campaigns.outcomes import deciding_requirements
from brink.server.campaigns.store import Campaign
from brink.server.errors import Conflict, NotFound
from brink.sim.trace import Trace

router = APIRouter(prefix="/campaigns/{campaign_id}/pairs", tags=["pairs"])
compared_router = APIRouter(prefix="/campaigns/{campaign_id}/solutions/{number}", tags=["solutions"])

KEPT: Final = 64
"""Number of pairs of drives whose pictures are kept in memory."""


_RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    200: {"content": {"image/png": {}}},
    204: {
        "description": "There is no picture: a drive has no trace that can be drawn. `POST` to the same address has "
        "workers run drives again whose traces were not kept."
    },
    **NOT_YET,
}
_RECORDING: Final[dict[int | str, dict[str, Any]]] = {
    204: {"description": "There is nothing to wait for: the traces are kept, or none can be recorded."},
    **NOT_YET,
}


@router.get("/{safe}-{unsafe}/{side}.png", response_class=Response, responses=_RESPONSES)
async def get_pair_picture(
    campaign_id: str,
    safe: Number,
    unsafe: Number,
    side: Literal["safe", "unsafe"],
    request: Request,
    services: Services,
    wait_s: Wait = 20.0,
) -> Response:
    """Return one drive of a pair from above, with the outline of the other drive's car."""
    campaign = await services.campaigns.get(campaign_id)
    numbers = (safe, unsafe)

    def pair_of(traces: Sequence[Trace]) -> DrivePair:
        judged = deciding_requirements(campaign.body)
        sides = [Side(number=number, trace=trace) for number, trace in zip(numbers, traces, strict=True)]
        return DrivePair(safe=sides[0], unsafe=sides[1], change="", requirement=judged or None)

    documents = await _documents(services, campaign, numbers, request, wait_s)
    if isinstance(documents, Response):
        return documents
    return await _picture(services, (campaign.id, *numbers), documents, pair_of, second=side == "unsafe")


@router.post("/{safe}-{unsafe}/{side}.png", response_class=Response, status_code=202, responses=_RECORDING)
async def record_pair(
    campaign_id: str, safe: Number, unsafe: Number, side: Literal["safe", "unsafe"], services: Services
) -> Response:
    """Have workers rerun the drives of a pair whose traces were not kept. Repeating the request is harmless."""
    return await _record(services, campaign_id, (safe, unsafe))


@compared_router.get("/compared/{side}.png", response_class=Response, responses=_RESPONSES)
async def get_compared_picture(
    campaign_id: str,
    number: Number,
    side: Literal["system", "reference"],
    request: Request,
    services: Services,
    wait_s: Wait = 20.0,
) -> Response:
    """Return the system's drive from above, or that of a reference driver who avoids its violation."""
    campaign = await services.campaigns.get(campaign_id)

    def pair_of(traces: Sequence[Trace]) -> DrivePair:
        judged = deciding_requirements(campaign.body)
        (trace,) = traces
        compared = comparison_of(trace, judged or None)
        if compared is None:
            raise ReplayError("no reference driver avoids a violation of this drive")
        return compared.pair(trace)

    documents = await _documents(services, campaign, (number,), request, wait_s)
    if isinstance(documents, Response):
        return documents
    return await _picture(services, (campaign.id, number), documents, pair_of, second=side == "reference")


@compared_router.post("/compared/{side}.png", response_class=Response, status_code=202, responses=_RECORDING)
async def record_compared(
    campaign_id: str, number: Number, side: Literal["system", "reference"], services: Services
) -> Response:
    """Have a worker rerun a drive whose trace was not kept. Repeating the request is harmless."""
    return await _record(services, campaign_id, (number,))


async def _record(services: Context, campaign_id: str, numbers: Sequence[int]) -> Response:
    campaign = await services.campaigns.get(campaign_id)
    try:
        missing = await record_missing(services, campaign, numbers)
    except (NotFound, Conflict):
        missing = False
    return being_made() if missing else Response(status_code=204)


async def _documents(
    services: Context, campaign: Campaign, numbers: Sequence[int], request: Request, wait_s: float
) -> list[bytes] | Response:
    """Return the traces of drives, or the response if there are none yet or at all."""
    try:
        documents = [await trace_of(services, campaign, number, request, wait_s) for number in numbers]
    except (NotFound, Conflict):
        return Response(status_code=204)
    kept = [document for document in documents if document is not None]
    if len(kept) < len(numbers):
        return being_made()
    return kept


async def _picture(
    services: Context,
    key: Hashable,
    documents: Sequence[bytes],
    pair_of: Callable[[Sequence[Trace]], DrivePair],
    *,
    second: bool,
) -> Response:
    """Return one of the two pictures of a pair of drives, which are drawn once.

    Args:
        services: The services of this process.
        key: What the pictures are kept by.
        documents: The traces.
        pair_of: Makes the pair of the traces.
        second: Whether the second picture is wanted.
    """

    def draw() -> tuple[bytes, bytes]:
        return render_pair_maps(pair_of([Trace.from_bytes(document) for document in documents]))

    try:
        pictures = await services.pair_pictures.get(key, 0, draw)
    except UNREADABLE:
        return Response(status_code=204)
    return Response(pictures[second], media_type="image/png")
