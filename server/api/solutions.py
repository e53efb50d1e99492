"""Routes of solutions: pages, neighbours, the boundary, distances, the archive."""

import io
import json
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, Response
from fastapi import Path as PathParameter
from pydantic import Field
from sqlalchemy import Row

from brink.search.parameters import Categorical
from brink.search.space import FloatArray, SearchSpace
from brink.server.api.context import Context, Services
from brink.server.api.responses import MEDIA, file_response, json_response
from brink.server.api.schemas import MAX_NUMBER, DistanceBlock, SolutionPage
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive, read_activity
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, MOST_KNOWN
from brink.server.campaigns.known import read_known
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import read
from brink.server.errors import InvalidInput, NotFound
from brink.server.findings.boundary.analysis import find_boundary
from brink.server.findings.boundary.table import boundary_file
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.neighbours import Neighbours, find_neighbours
from brink.server.findings.solutions import KnownSolutionView, known_view, solution_views
from brink.server.views import SolutionView, View

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])

MAX_DISTANCES = 1_000
MOST_LISTED = 1_000
"""Maximum number of boundary solutions in a response: each has all that its episode measured, about 10 kB."""
Threshold = Annotated[float, Query(ge=0, le=1)]
Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]


@router.get("/solutions", response_model=SolutionPage)
async def get_solutions(
    campaign_id: str,
    services: Services,
    after: Annotated[int, Query(ge=-1, le=MAX_NUMBER)] = -1,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    unsafe: bool | None = None,
    max_fitness: Annotated[float | None, Query(ge=0, le=1)] = None,
) -> Response:
    """List complete solutions in ascending order of number."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    archive = found.archive
    if max_fitness is None:
        rows = await services.pages.read(
            services.engines,
            lambda c: view_store.page_solutions(c, campaign.id, after=after, limit=limit, unsafe=unsafe),
        )
    else:
        wanted = (archive.fitness <= max_fitness) & (archive.numbers > after)
        if unsafe is not None:
            wanted &= archive.unsafe == unsafe
        numbers = [int(number) for number in np.sort(archive.numbers[wanted])[:limit]]
        rows = await services.pages.read(
            services.engines, lambda c: view_store.read_solutions(c, campaign.id, numbers)
        )
    return await services.pages.run(lambda: _page(rows, found, limit, rated=max_fitness is not None))


def _page(rows: Sequence[Row[*tuple[Any, ...]]], found: ReadArchive, limit: int, *, rated: bool) -> Response:
    views = solution_views(rows, found, rated=rated)
    return json_response(
        SolutionPage(solutions=views, next=views[-1].number if len(views) == limit else None)
    )


@router.get("/solutions/{number}")
async def get_solution(campaign_id: str, number: Number, services: Services) -> SolutionView:
    """Return one solution with all details: verdicts, features, provenance, episode."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    rows = await read(services.engines, lambda c: view_store.read_solutions(c, campaign.id, [number]))
    if not rows:
        raise NotFound(f"campaign {campaign.id} has no solution {number}")
    return await services.pages.run(lambda: solution_views(rows, found, full=True)[0])


@router.get(
    "/boundary",
    response_model=Boundary,
    responses={200: {"content": {media: {} for media in MEDIA.values()}}},
)
async def get_boundary(
    campaign_id: str,
    services: Services,
    t_b: Threshold = DEFAULT_T_B,
    d_th: Threshold = DEFAULT_D_TH,
    limit: Annotated[
        int, Query(ge=1, le=MOST_LISTED, description="Maximum number of solutions to return, best first.")
    ] = MOST_LISTED,
    format: Literal["json", "csv", "jsonl", "parquet"] = "json",  # noqa: A002  (the name of the query parameter)
) -> Response:
    """Return the distinct boundary solutions, DBS and strict DBS; table formats have one row for each solution.

    If there are more than `limit`, the best ones are listed, and `words` says so; `dbs` and `strict_dbs` count all.
    Thresholds at which too many solutions would have to be compared with each other are refused.
    """
    campaign = await services.campaigns.get(campaign_id)
    view = await find_boundary(services, campaign, t_b=t_b, d_th=d_th, limit=limit)
    if format == "json":
        return await services.pages.run(lambda: json_response(view))
    space = (await services.archives.get(campaign)).plan.problem.space
    content = await services.pages.run(lambda: boundary_file(view, campaign, space, format))
    return file_response(content, f"boundary-{campaign.id}", format)


@router.get("/distances", response_model=DistanceBlock)
async def get_distances(
    campaign_id: str,
    services: Services,
    numbers: Annotated[str, Query(description="Comma-separated numbers of solutions.")],
) -> Response:
    """Return the pairwise distances between evaluated solutions."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        wanted = [int(part) for part in numbers.split(",") if part.strip()]
    except ValueError:
        message = f"expected comma-separated solution numbers, got {numbers[:80]!r}"
        raise InvalidInput.at("/query/numbers", message) from None
    if not 1 <= len(wanted) <= MAX_DISTANCES:
        raise InvalidInput.at("/query/numbers", f"expected 1 to {MAX_DISTANCES} numbers, got {len(wanted)}")
    place = found.places
    unknown = [number for number in wanted if number not in place]
    if unknown:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {unknown[0]}")
    rows = [place[number] for number in wanted]
    distances = await services.archives.distances(campaign, found.archive, rows)
    return await services.pages.run(lambda: _distance_block(wanted, distances))


def _distance_block(numbers: list[int], distances: FloatArray) -> Response:
    # Row by row: in one go, a million numbers keep all other threads waiting for a tenth of a second.
    empty = DistanceBlock.model_construct(numbers=numbers, distances=[]).model_dump_json()
    rows = ",".join(json.dumps(row.tolist(), separators=(",", ":")) for row in distances)
    return Response(f"{empty.removesuffix(']}')}{rows}]}}", media_type="application/json")


@router.get("/archive.npz", response_class=Response)
async def get_archive(campaign_id: str, services: Services) -> Response:
    """Return all evaluated solutions as numpy arrays: numbers, vectors, verdicts, neighbour counts, fitness.

    `active` says which entries of `vectors` had a part in their episodes, and `effective` has the values that they
    had there. Where `recorded` is false, this was not recorded, and everything counts as active as stored.
    `seeds` and `digests` have the seed of each episode, and its digest (empty without an episode).
    `columns` names the columns of `vectors`. `choices` has one entry for each column: a JSON list of the choices of a
    categorical parameter, in the order of their indices; an empty string for any other parameter.
    """
    campaign = await services.campaigns.get(campaign_id)
    return await services.pages.run(lambda: _archive_file(services, campaign))


def _archive_file(services: Context, campaign: Campaign) -> Response:
    plan, stored, archive = services.archives.stored(campaign)
    with services.engines.reader.connect() as connection:
        activity = read_activity(connection, campaign.id, plan.problem, archive)
        episodes = view_store.read_episodes(connection, campaign.id)
    numbers = stored.numbers.tolist()
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        allow_pickle=False,
        seeds=np.array([episodes[number][0] for number in numbers], np.int64),
        digests=np.array([episodes[number][1] or "" for number in numbers], "U64"),
        columns=np.array(plan.problem.space.column_names()),
        choices=np.array(_choices(plan.problem.space)),
        numbers=stored.numbers,
        vectors=stored.vectors,
        unsafe=stored.unsafe,
        robustness=stored.robustness,
        generations=stored.generations,
        neighbours=archive.neighbours,
        unsafe_neighbours=archive.unsafe_neighbours,
        fitness=archive.fitness,
        recorded=activity.recorded,
        active=activity.active,
        effective=activity.effective,
    )
    return Response(buffer.getvalue(), media_type="application/x-npz")


def _choices(space: SearchSpace) -> list[str]:
    return [
        json.dumps(parameter.choices) if isinstance(parameter, Categorical) else ""
        for component in space.components
        for parameter in component.parameters
    ]


class KnownPage(View):
    """A page of the solutions that a campaign started from."""

    solutions: list[KnownSolutionView]
    next: Annotated[int | None, Field(description="Pass as `after` to get the next page.")]


@router.get("/known")
async def get_known(
    campaign_id: str,
    services: Services,
    after: Annotated[int, Query(ge=-1, le=MOST_KNOWN)] = -1,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> KnownPage:
    """List the solutions that a campaign started from; empty if there are none."""
    campaign = await services.campaigns.get(campaign_id)

    def look() -> list[KnownSolutionView]:
        problem = make_plan(campaign.body).problem
        with services.engines.reader.connect() as connection:
            records = read_known(connection, campaign.id, after=after, limit=limit)
        return [known_view(problem, place, one) for place, one in enumerate(records, after + 1)]

    views = await services.pages.run(look)
    return KnownPage(solutions=views, next=views[-1].place if len(views) == limit else None)


NeighbourLimit = Annotated[int, Query(ge=0, le=1000, description="Maximum number of neighbours to return.")]


@router.get("/solutions/{number}/neighbours")
async def get_neighbours(
    campaign_id: str, number: Number, services: Services, most: NeighbourLimit = 12
) -> Neighbours:
    """Return the neighbourhood of an evaluated solution and the solutions closest to it."""
    return await find_neighbours(services, await services.campaigns.get(campaign_id), number, most)
