"""Routes of repeats: simulations of boundary solutions with other seeds, to check whether the boundary holds up."""

from collections import Counter
from typing import Annotated, Self

from fastapi import APIRouter, Response
from pydantic import Field, model_validator

from brink.server.api.context import Services
from brink.server.api.responses import set_created
from brink.server.api.schemas import MAX_NUMBER, View
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.repeats import MOST, StoredRepeats, read_repeats
from brink.server.db.engine import read
from brink.server.documents import Body
from brink.server.states import CampaignStatus

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["repeats"])

DEFAULT_REPEATS = 50


class RepeatsBody(Body):
    """Which solutions to simulate again, and how often."""

    repeats: Annotated[int, Field(ge=2, le=10_000, description="Number of simulations of each solution.")] = (
        DEFAULT_REPEATS
    )
    t_b: Annotated[float, Field(ge=0, le=1, description="Maximum fitness of a boundary solution.")] = (
        DEFAULT_T_B
    )
    d_th: Annotated[
        float, Field(ge=0, le=1, description="Minimum distance between two boundary solutions.")
    ] = DEFAULT_D_TH
    numbers: Annotated[
        list[Annotated[int, Field(ge=0, le=MAX_NUMBER)]] | None,
        Field(
            min_length=1,
            max_length=MOST,
            description="Evaluated solutions to repeat instead of the distinct boundary at t_b and d_th.",
        ),
    ] = None

    @model_validator(mode="after")
    def _check_boundary_or_numbers(self) -> Self:
        if self.numbers is None:
            return self
        if given := sorted({"t_b", "d_th"} & self.model_fields_set):
            raise ValueError(
                f"expected either numbers or {given[0]}, not both: t_b and d_th select the boundary"
            )
        twice = [number for number, times in Counter(self.numbers).items() if times > 1]
        if twice:
            raise ValueError(f"numbers: expected each once, got {twice[0]} more than once")
        return self


class RepeatedSolution(View):
    """Estimated probability that a repeated solution is unsafe."""

    number: int
    evaluated: Annotated[
        int, Field(description="Number of simulations with other seeds that returned a verdict.")
    ]
    unsafe: int
    probability: Annotated[float | None, Field(description="Unsafe share of these simulations.")]
    low: Annotated[float, Field(description="Lower limit of its Wilson interval.")]
    high: float
    holds: Annotated[bool | None, Field(description="Whether the interval contains p_th.")]
    around: Annotated[
        float | None, Field(description="Unsafe share of its neighbourhood in the archive, including itself.")
    ]
    around_low: Annotated[float | None, Field(description="Lower limit of the neighbourhood's interval.")]
    around_high: float | None


class RepeatsView(View):
    """Results of simulating solutions of a campaign again with other seeds."""

    campaign: Annotated[str, Field(description="Campaign that runs the repeats.")]
    of: Annotated[str, Field(description="Campaign whose solutions are repeated.")]
    name: Annotated[str, Field(description="Name of the repeated campaign.")]
    status: CampaignStatus
    status_reason: str
    repeats: int
    boundary: Annotated[
        bool,
        Field(
            description="Whether these are the distinct boundary at t_b and d_th. If not, they were named by number, "
            "and t_b is 1 and d_th 0, which excludes nothing."
        ),
    ]
    t_b: float
    d_th: float
    p_th: float
    simulations: int
    budget: int
    holding: Annotated[int, Field(description="Number of solutions whose interval contains p_th.")]
    below: Annotated[
        int, Field(description="Number of solutions whose interval lies below p_th: safer than reported.")
    ]
    above: Annotated[int, Field(description="Number of solutions whose interval lies above p_th.")]
    evaluated: Annotated[int, Field(description="Number of verdicts so far, over all solutions.")]
    unsafe: int
    solutions: Annotated[list[RepeatedSolution], Field(description="Best fitness first.")]


@router.post(
    "/repeats",
    status_code=201,
    responses={200: {"model": RepeatsView, "description": "These repeats had already been requested."}},
)
async def repeat_boundary(
    campaign_id: str, body: RepeatsBody, services: Services, response: Response
) -> RepeatsView:
    """Simulate the distinct boundary solutions, or given ones, again with other seeds, as a new campaign."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    repeats, new = await services.campaigns.repeat(
        campaign, found.plan, found.archive,
        repeats=body.repeats, t_b=body.t_b, d_th=body.d_th, numbers=body.numbers,
    )  # fmt: skip
    set_created(response, f"campaigns/{repeats.id}", new=new)
    views = await _views(services, campaign_id)
    return next(view for view in views if view.campaign == repeats.id)


@router.get("/repeats")
async def get_repeats(campaign_id: str, services: Services) -> list[RepeatsView]:
    """List the results of all repeats of a campaign's solutions, one entry for each request."""
    return await _views(services, campaign_id)


async def _views(services: Services, campaign_id: str) -> list[RepeatsView]:
    campaign = await services.campaigns.get(campaign_id)
    stored = await read(services.engines, lambda connection: read_repeats(connection, campaign.id))
    if not stored:
        return []
    found = await services.archives.get(campaign)
    return [_view(campaign.id, campaign.body.name, one, found) for one in stored]


def _view(of: str, name: str, stored: StoredRepeats, read_archive: ReadArchive) -> RepeatsView:
    near = read_archive.plan.neighbourhood
    tallies = stored.tallies(near.z)
    known, holds = tallies.evaluated > 0, tallies.contains(near.p_th)
    solutions = []
    for place, number in enumerate(stored.numbers):
        index = read_archive.places.get(number)
        around = None if index is None else _around(read_archive, index)
        solutions.append(
            RepeatedSolution(
                number=number,
                evaluated=int(tallies.evaluated[place]),
                unsafe=int(tallies.unsafe[place]),
                probability=float(tallies.probability[place]) if known[place] else None,
                low=float(tallies.low[place]),
                high=float(tallies.high[place]),
                holds=bool(holds[place]) if known[place] else None,
                around=around[0] if around else None,
                around_low=around[1] if around else None,
                around_high=around[2] if around else None,
            )
        )
    return RepeatsView(
        campaign=stored.campaign.id, of=of, name=name, status=stored.campaign.status,
        status_reason=stored.campaign.status_reason, repeats=stored.repeats, boundary=stored.boundary,
        t_b=stored.t_b, d_th=stored.d_th,
        p_th=near.p_th, simulations=stored.campaign.completed, budget=stored.campaign.body.budget.simulations,
        holding=int((holds & known).sum()), below=int((tallies.high < near.p_th).sum()),
        above=int((tallies.low > near.p_th).sum()), evaluated=int(tallies.evaluated.sum()),
        unsafe=int(tallies.unsafe.sum()), solutions=solutions,
    )  # fmt: skip


def _around(read_archive: ReadArchive, index: int) -> tuple[float, float, float]:
    archive = read_archive.archive
    low, high = archive.interval[index].tolist()
    return float(archive.unsafe_neighbours[index] / archive.neighbours[index]), low, high
