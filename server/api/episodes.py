"""Routes of a solution's episode: its trace, replays, the scene that the dashboard draws, and the camera's film.

If a trace was not kept, a worker records it once a client has asked for that with POST; other requests, which are
safe, may wait for it. A request to record it fails, and nothing is enqueued, while no live worker can do so.
"""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Annotated, Any, Literal, TypeVar

from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import JSONResponse
from sqlalchemy import Connection

from brink.pictures import render_bytes
from brink.search.deadline import check_time
from brink.server.api.context import Context, Services, client_gone
from brink.server.api.episode_views import EpisodeView, episode_view
from brink.server.api.schemas import MAX_NUMBER, BeingMade, ProblemDetail
from brink.server.campaigns.outcomes import deciding_requirements
from brink.server.campaigns.simulators import other_simulator
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.traces import TraceStatus, trace_status
from brink.server.db.engine import read
from brink.server.errors import Conflict, NotFound, NotRecorded, NoWorker
from brink.server.queue.workers import can_run
from brink.server.states import JobStatus
from brink.sim.catalogue import worker_for
from brink.sim.errors import SimulatorError
from brink.sim.trace import Trace

router = APIRouter(prefix="/campaigns/{campaign_id}/solutions/{number}", tags=["solutions"])

MOST_PICTURES = 1_000_000
POLL_S = 0.25
NO_WORKER_RETRY_S = 5
REPLAY_MEDIA = {"png": "image/png", "gif": "image/gif", "mp4": "video/mp4"}
"""Media types of replays, by extension."""

NOT_YET: dict[int | str, dict[str, Any]] = {
    202: {
        "model": BeingMade,
        "description": "A worker is recording the trace; try again after `Retry-After`.",
    },
    404: {
        "model": ProblemDetail,
        "description": "There is no such solution or, if the title is `Not recorded`, no trace of it: "
        "`POST …/solutions/{number}/trace` has a worker record it.",
    },
    503: {
        "model": ProblemDetail,
        "description": "No live worker can record the trace; try again after `Retry-After`.",
    },
}
"""Responses of a route that needs a trace while there is none."""

UNREADABLE = (
    SimulatorError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    MemoryError,
)
"""Errors that drawing a malformed trace may raise, since workers may send anything."""

Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]
Index = Annotated[
    int, PathParameter(ge=0, lt=MOST_PICTURES, description="Index of a picture in the film, from 0.")
]
Wait = Annotated[float, Query(ge=0, le=60, description="How long to wait for a worker to record the trace.")]

T = TypeVar("T")


@router.get(
    "/trace", response_class=Response, responses={200: {"content": {"application/x-npz": {}}}, **NOT_YET}
)
async def get_trace(
    campaign_id: str, number: Number, request: Request, services: Services, wait_s: Wait = 20.0
) -> Response:
    """Return the trace of a solution's episode as npz, if it was kept or recorded on request."""
    campaign = await services.campaigns.get(campaign_id)
    document = await trace_of(services, campaign, number, request, wait_s)
    return being_made() if document is None else Response(document, media_type="application/x-npz")


@router.post(
    "/trace",
    response_class=Response,
    status_code=202,
    responses={204: {"description": "The trace is kept already."}, **NOT_YET},
)
async def record_trace(campaign_id: str, number: Number, request: Request, services: Services) -> Response:
    """Have a worker run a solution's episode again to record its trace. Repeating the request is harmless."""
    campaign = await services.campaigns.get(campaign_id)
    if not await record_missing(services, campaign, [number]):
        return Response(status_code=204)
    answer = being_made()
    answer.headers["Location"] = request.url.path
    return answer


@router.get(
    "/replay.{extension}",
    response_class=Response,
    responses={200: {"content": {media: {} for media in REPLAY_MEDIA.values()}}, **NOT_YET},
)
async def get_replay(
    campaign_id: str,
    number: Number,
    extension: Literal["png", "gif", "mp4"],
    request: Request,
    services: Services,
    wait_s: Wait = 20.0,
) -> Response:
    """Return an image or a video of a solution's episode, seen from above."""
    campaign = await services.campaigns.get(campaign_id)
    document = await trace_of(services, campaign, number, request, wait_s)
    if document is None:
        return being_made()

    def draw() -> bytes:
        judged = deciding_requirements(campaign.body)
        return render_bytes(
            Trace.from_bytes(document),
            f".{extension}",
            requirement=judged or None,
            on_progress=lambda *_: check_time(),
        )

    return Response(await _drawn(services.drawing, number, draw), media_type=REPLAY_MEDIA[extension])


@router.get("/episode", response_model=EpisodeView, responses=NOT_YET)
async def get_episode(
    campaign_id: str, number: Number, request: Request, services: Services, wait_s: Wait = 20.0
) -> Response:
    """Return a solution's episode ready to be drawn, if its trace was kept or recorded on request."""
    campaign = await services.campaigns.get(campaign_id)
    document = await trace_of(services, campaign, number, request, wait_s)
    if document is None:
        return being_made()

    def draw() -> str:
        judged = deciding_requirements(campaign.body)
        view = episode_view(Trace.from_bytes(document), judged)
        return view.model_dump_json()

    return Response(await _drawn(None, number, draw), media_type="application/json")


@router.get(
    "/pictures/{index}.jpg", response_class=Response, responses={200: {"content": {"image/jpeg": {}}}}
)
async def get_picture(campaign_id: str, number: Number, index: Index, services: Services) -> Response:
    """Return one picture from the film of a solution's episode, if its trace is kept and has a film."""
    campaign = await services.campaigns.get(campaign_id)
    picture = await services.films.picture(campaign, number, index)
    return Response(picture, media_type="image/jpeg")


async def _drawn(executor: Executor | None, number: int, draw: Callable[[], T]) -> T:
    """Draw a solution's trace in a thread.

    Args:
        executor: Where to draw; None for the event loop's default threads.
        number: The solution.
        draw: Draws the trace.

    Raises:
        Conflict: The trace cannot be drawn.
    """
    try:
        return await asyncio.get_running_loop().run_in_executor(executor, draw)
    except UNREADABLE as error:
        raise Conflict(
            f"solution {number}: its trace cannot be drawn: {type(error).__name__}: {error}"
        ) from None


async def trace_of(
    services: Context, campaign: Campaign, number: int, request: Request, wait_s: float
) -> bytes | None:
    """Return the trace of a solution, waiting for a worker to record it; None if that takes too long.

    Args:
        services: The services of this process.
        campaign: The solution's campaign.
        number: The solution.
        request: The client's request; waiting ends when the client disconnects.
        wait_s: How long to wait.

    Raises:
        NotFound: There is no such solution, or it was not simulated.
        NotRecorded: There is no trace, and nobody has asked for one.
        Conflict: Its simulator records no traces, or the trace cannot be recorded.
        NoWorker: No live worker can record it.
    """
    deadline = asyncio.get_running_loop().time() + wait_s
    async with client_gone(request) as gone:
        while True:
            found = await _trace_status(services, campaign, number, requested=False)
            if found.document is not None:
                return found.document
            late = asyncio.get_running_loop().time() >= deadline
            if late or gone.is_set() or services.queue.stopping:
                return None
            await asyncio.sleep(POLL_S)


async def record_missing(services: Context, campaign: Campaign, numbers: Sequence[int]) -> bool:
    """Have workers record the traces of solutions that have none; return whether any of them is missing.

    Raises:
        NotFound, Conflict, NoWorker: As `trace_of`; nothing was enqueued.
    """
    found = [(number, await _trace_status(services, campaign, number, requested=True)) for number in numbers]
    missing = [(number, one.job) for number, one in found if one.document is None]
    for number, job in missing:
        if job is None:
            await services.campaigns.request_trace(campaign.id, number)
    return bool(missing)


async def _trace_status(
    services: Context, campaign: Campaign, number: int, *, requested: bool
) -> TraceStatus:
    """Return the state of a trace that exists, is being recorded, or can be recorded if this request is to record it.

    Raises:
        NotFound, NotRecorded, Conflict, NoWorker: As `trace_of`.
    """

    def look_up(connection: Connection) -> tuple[TraceStatus, bool]:
        """Return the state of the trace, and whether no live worker can record it."""
        found = trace_status(connection, campaign.id, number)
        waits = found.document is None and found.needs is not None and found.job in (None, JobStatus.QUEUED)
        return found, waits and not can_run(connection, str(found.needs), services.settings.worker_seen_s)

    found, stuck = await read(services.engines, look_up)
    if found.document is not None:
        return found
    if found.needs is None:
        raise NotFound(f"campaign {campaign.id} has no simulated solution {number}")
    if found.job is None and not requested:
        raise NotRecorded(
            f"solution {number}: no trace is kept; "
            f"POST /campaigns/{campaign.id}/solutions/{number}/trace has a worker record it"
        )
    if stuck:
        other = await read(services.engines, lambda c: other_simulator(c, campaign))
        raise NoWorker(
            f"solution {number}: no live worker can run {found.needs} to make the trace; "
            f"{other or f'start {worker_for(found.needs)} and try again'}",
            retry_after_s=NO_WORKER_RETRY_S,
        )
    if found.job == JobStatus.DONE:
        raise Conflict(f"solution {number}: its simulator records no traces")
    if found.job in (JobStatus.QUARANTINED, JobStatus.CANCELLED):
        raise Conflict(f"solution {number}: the trace cannot be made: {found.last_error}")
    return found


def being_made() -> JSONResponse:
    """Return the 202 response for a client whose wait ended before the trace was available."""
    view = BeingMade(detail="a worker is making the trace; try again soon")
    return JSONResponse(view.model_dump(), status_code=202, headers={"Retry-After": "2"})
