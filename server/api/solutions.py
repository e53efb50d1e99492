"""Routes of what a campaign found: solutions, boundary, distances, the archive, traces and replays."""

import asyncio
import io
import json
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as PathParameter
from starlette.responses import Response as PlainResponse

from brink.search.errors import UnsupportedSpace
from brink.search.parameters import Categorical
from brink.search.space import SearchSpace
from brink.server.api.boundary_table import boundary_rows, table_bytes
from brink.server.api.combination_views import combinations_view, variants_view
from brink.server.api.context import Services
from brink.server.api.schemas import (
    MAX_NUMBER,
    Boundary,
    Combinations,
    DistanceBlock,
    SolutionPage,
    SolutionView,
    Variant,
)
from brink.server.api.traces import NOT_YET, UNREADABLE, Wait, being_made, trace_of
from brink.server.api.views import boundary_view, solution_views
from brink.server.campaigns import view_store
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.db.engine import read
from brink.server.errors import Conflict, FieldError, InvalidInput, NotFound
from brink.sim.replay import render_bytes
from brink.sim.trace import Trace

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])

MAX_DISTANCES = 1_000
MEDIA = {"csv": "text/csv", "jsonl": "application/jsonl", "parquet": "application/vnd.apache.parquet"}
"""Media types of tables."""

Threshold = Annotated[float, Query(ge=0, le=1)]
Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]


@router.get("/solutions")
async def get_solutions(
    campaign_id: str,
    services: Services,
    after: Annotated[int, Query(ge=-1, le=MAX_NUMBER)] = -1,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    unsafe: bool | None = None,
    max_fitness: Annotated[float | None, Query(ge=0, le=1)] = None,
) -> SolutionPage:
    """Return complete solutions, ascending by number."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    archive = found.archive
    if max_fitness is None:
        rows = await read(
            services.engines,
            lambda c: view_store.page_solutions(c, campaign.id, after=after, limit=limit, unsafe=unsafe),
        )
    else:
        wanted = (archive.fitness <= max_fitness) & (archive.numbers > after)
        if unsafe is not None:
            wanted &= archive.unsafe == unsafe
        numbers = [int(number) for number in np.sort(archive.numbers[wanted])[:limit]]
        rows = await read(services.engines, lambda c: view_store.read_solutions(c, campaign.id, numbers))
    views = solution_views(rows, found)
    return SolutionPage(solutions=views, next=views[-1].number if len(views) == limit else None)


@router.get("/solutions/{number}")
async def get_solution(campaign_id: str, number: Number, services: Services) -> SolutionView:
    """Return one solution with all that is known of it."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    rows = await read(services.engines, lambda c: view_store.read_solutions(c, campaign.id, [number]))
    if not rows:
        raise NotFound(f"campaign {campaign.id} has no solution {number}")
    return solution_views(rows, found, full=True)[0]


@router.get(
    "/boundary",
    responses={200: {"content": {media: {} for media in MEDIA.values()}}},
)
async def get_boundary(
    campaign_id: str,
    services: Services,
    t_b: Threshold = DEFAULT_T_B,
    d_th: Threshold = DEFAULT_D_TH,
    format: Literal["json", "csv", "jsonl", "parquet"] = "json",  # noqa: A002  (the name of the query parameter)
) -> Boundary:
    """Return the distinct boundary solutions, DBS and strict DBS; as a table, one row a solution."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    view = await read(services.engines, lambda c: boundary_view(c, campaign, found, t_b, d_th))
    if format == "json":
        return view
    rows = boundary_rows(view, campaign.id, campaign.body)
    table = await asyncio.get_running_loop().run_in_executor(None, table_bytes, rows, format)
    headers = {"Content-Disposition": f'attachment; filename="boundary-{campaign.id}.{format}"'}
    return PlainResponse(table, media_type=MEDIA[format], headers=headers)  # type: ignore[return-value]


@router.get("/combinations")
async def get_combinations(campaign_id: str, services: Services) -> Combinations:
    """Return which chains of techniques are hazardous, and which only together or in one order."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return combinations_view(found.plan.problem.space, found.archive)
    except UnsupportedSpace:
        raise NotFound(
            f"campaign {campaign.id}: {campaign.body.problem.id} has no ordered techniques"
        ) from None


@router.get("/solutions/{number}/variants")
async def get_variants(campaign_id: str, number: Number, services: Services) -> list[Variant]:
    """Return a solution's parts and other orders that were simulated in its place, itself last."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return variants_view(found.plan.problem.space, found.archive, number)
    except UnsupportedSpace:
        raise NotFound(
            f"campaign {campaign.id}: {campaign.body.problem.id} has no ordered techniques"
        ) from None
    except KeyError:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}") from None


@router.get("/distances", response_model=DistanceBlock)
async def get_distances(
    campaign_id: str, services: Services, numbers: Annotated[str, Query(description="Comma-separated.")]
) -> Response:
    """Return the distances between some evaluated solutions."""
    campaign = await services.campaigns.get(campaign_id)
    archive = (await services.archives.get(campaign)).archive
    try:
        wanted = [int(part) for part in numbers.split(",") if part.strip()]
    except ValueError:
        message = f"expected comma-separated solution numbers, got {numbers[:80]!r}"
        raise InvalidInput([FieldError(pointer="/query/numbers", message=message)]) from None
    if not 1 <= len(wanted) <= MAX_DISTANCES:
        message = f"expected 1 to {MAX_DISTANCES} numbers, got {len(wanted)}"
        raise InvalidInput([FieldError(pointer="/query/numbers", message=message)])
    place = {int(number): index for index, number in enumerate(archive.numbers)}
    unknown = [number for number in wanted if number not in place]
    if unknown:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {unknown[0]}")
    rows = [place[number] for number in wanted]
    distances = await services.archives.distances(campaign, archive, rows)
    block = DistanceBlock.model_construct(numbers=wanted, distances=distances.tolist())
    text = await asyncio.get_running_loop().run_in_executor(None, block.model_dump_json)
    return Response(text, media_type="application/json")


@router.get("/archive.npz", response_class=Response)
async def get_archive(campaign_id: str, services: Services) -> Response:
    """Return all evaluated solutions as numpy arrays: numbers, vectors, verdicts, counts, fitness.

    `columns` names the columns of `vectors`; `choices` has, for each that is categorical, its choices as a JSON list
    in the order of their indices, and an empty text for the others.
    """
    campaign = await services.campaigns.get(campaign_id)
    plan, stored, archive = await asyncio.get_running_loop().run_in_executor(
        None, services.archives.stored, campaign
    )
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        allow_pickle=False,
        columns=np.array(plan.problem.space.column_names()),
        choices=np.array(_choices(plan.problem.space)),
        numbers=stored.numbers,
        vectors=stored.vectors,
        unsafe=stored.unsafe,
        robustness=stored.robustness,
        generations=stored.generations,
        neighbours=stored.neighbours,
        unsafe_neighbours=stored.unsafe_neighbours,
        fitness=archive.fitness,
    )
    return Response(buffer.getvalue(), media_type="application/x-npz")


def _choices(space: SearchSpace) -> list[str]:
    return [
        json.dumps(parameter.choices) if isinstance(parameter, Categorical) else ""
        for component in space.components
        for parameter in component.parameters
    ]


@router.get(
    "/solutions/{number}/trace",
    response_class=Response,
    responses={200: {"content": {"application/x-npz": {}}}, **NOT_YET},
)
async def get_trace(
    campaign_id: str, number: Number, request: Request, services: Services, wait_s: Wait = 20.0
) -> Response:
    """Return the trace of a solution's episode as npz; workers re-run the episode if it was not kept."""
    campaign = await services.campaigns.get(campaign_id)
    data = await trace_of(services, campaign, number, request, wait_s)
    return being_made() if data is None else Response(data, media_type="application/x-npz")


@router.get(
    "/solutions/{number}/replay.{extension}",
    response_class=Response,
    responses={200: {"content": {"image/png": {}, "image/gif": {}, "video/mp4": {}}}, **NOT_YET},
)
async def get_replay(
    campaign_id: str,
    number: Number,
    extension: Literal["png", "gif", "mp4"],
    request: Request,
    services: Services,
    wait_s: Wait = 20.0,
) -> Response:
    """Return a picture or an animation of a solution's episode, seen from above."""
    campaign = await services.campaigns.get(campaign_id)
    data = await trace_of(services, campaign, number, request, wait_s)
    if data is None:
        return being_made()
    requirement = campaign.body.problem.params.get("requirement")

    def draw() -> bytes:
        return render_bytes(Trace.from_bytes(data), f".{extension}", requirement=requirement)

    try:
        picture = await asyncio.get_running_loop().run_in_executor(services.drawing, draw)
    except UNREADABLE as error:
        raise Conflict(
            f"solution {number}: its trace cannot be drawn: {type(error).__name__}: {error}"
        ) from None
    media = {"png": "image/png", "gif": "image/gif", "mp4": "video/mp4"}[extension]
    return Response(picture, media_type=media)
