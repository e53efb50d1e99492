"""Routes of repeats: simulations of boundary solutions with other seeds, to check whether the boundary holds up."""

from collections import Counter
from typing import Annotated, Self

from fastapi import APIRouter, Response
from pydantic import Field, model_validator

from brink.server.api.context import Services
from brink.server.api.responses import set_created
from brink.server.api.schemas import MAX_NUMBER
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.follow_ups.limits import DEFAULT_REPEATS, MOST
from brink.server.documents import Body
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.boundary.repeats import find_repeats

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["repeats"])


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


@router.post(
    "/repeats",
    status_code=201,
    responses={200: {"model": RepeatsView, "description": "These repeats had already been requested."}},
)
async def repeat_boundary(
    campaign_id: str, body: RepeatsBody, services: Services, response: Response
) -> RepeatsView:
    """Simulate the distinct boundary solutions, or given ones, again with other seeds, as a new campaign.

    Of a boundary with more than 1,000 solutions, the best 1,000 are simulated, and `words` says so.
    """
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    repeats, new = await services.campaigns.repeat(
        campaign,
        found.plan,
        found.archive,
        repeats=body.repeats,
        t_b=body.t_b,
        d_th=body.d_th,
        numbers=body.numbers,
    )
    set_created(response, f"campaigns/{repeats.id}", new=new)
    views = await find_repeats(services, campaign)
    return next(view for view in views if view.campaign == repeats.id)


@router.get("/repeats")
async def get_repeats(campaign_id: str, services: Services) -> list[RepeatsView]:
    """List the results of all repeats of a campaign's solutions, one entry for each request."""
    return await find_repeats(services, await services.campaigns.get(campaign_id))
