"""Route of a solution's neighbours: what its fitness is made of."""

import asyncio
import math
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi import Path as PathParameter
from pydantic import Field

from brink.search.analysis.nearest import Nearest, nearest
from brink.server.api.context import Services
from brink.server.api.schemas import MAX_NUMBER, View
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.plan import looks_for_boundary
from brink.server.errors import NotFound

router = APIRouter(prefix="/campaigns/{campaign_id}/solutions/{number}", tags=["solutions"])

Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]
Most = Annotated[int, Query(ge=0, le=1000, description="How many of the nearest to return.")]


class Neighbour(View):
    """An evaluated solution near another one."""

    number: int
    distance: float
    within: Annotated[bool, Field(description="Whether it counts as a neighbour: within the radius.")]
    unsafe: bool
    robustness: float
    fitness: float


class Neighbours(View):
    """The neighbourhood of a solution, and the solutions nearest to it."""

    number: int
    radius: Annotated[float, Field(description="Largest distance of a neighbour.")]
    p_th: Annotated[float, Field(description="Share of unsafe solutions that the boundary is at.")]
    confidence: Annotated[float, Field(description="Of the interval, such as 0.95.")]
    looks_for_boundary: Annotated[
        bool, Field(description="Whether the search looks for that boundary; if not, it says little.")
    ]
    neighbours: Annotated[int, Field(description="Solutions within the radius, itself included.")]
    unsafe_neighbours: int
    interval: Annotated[
        tuple[float, float], Field(description="Wilson interval of the unsafe share within the radius.")
    ]
    fitness: Annotated[float, Field(description="How far that interval is from p_th; 0 on the boundary.")]
    evaluated: Annotated[int, Field(description="All evaluated solutions of the campaign.")]
    nearest: Annotated[list[Neighbour], Field(description="The nearest first, itself left out.")]


@router.get("/neighbours")
async def get_neighbours(campaign_id: str, number: Number, services: Services, most: Most = 12) -> Neighbours:
    """Return the evaluated solutions nearest to one of them."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    boundary = looks_for_boundary(campaign.body.algorithm.id)

    def look() -> Neighbours:
        place = found.places.get(number)
        if place is None:
            raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}")
        return _view(found, number, place, nearest(found.archive, place, most), boundary=boundary)

    return await asyncio.get_running_loop().run_in_executor(None, look)


def _view(found: ReadArchive, number: int, place: int, near: Nearest, *, boundary: bool) -> Neighbours:
    archive, settings = found.archive, found.plan.neighbourhood
    low, high = archive.interval[place].tolist()
    return Neighbours(
        number=number, radius=settings.radius, p_th=settings.p_th,
        confidence=math.erf(settings.z / math.sqrt(2)), looks_for_boundary=boundary,
        neighbours=int(archive.neighbours[place]), unsafe_neighbours=int(archive.unsafe_neighbours[place]),
        interval=(low, high), fitness=float(archive.fitness[place]), evaluated=len(archive),
        nearest=[
            Neighbour(
                number=int(archive.numbers[other]), distance=distance, within=distance <= settings.radius,
                unsafe=bool(archive.unsafe[other]), robustness=float(archive.robustness[other]),
                fitness=float(archive.fitness[other]),
            )
            for other, distance in zip(near.places.tolist(), near.distances.tolist(), strict=True)
        ],
    )  # fmt: skip
