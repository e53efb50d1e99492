"""Route of what one campaign reached beside its control, for the paper's thresholds."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse
from pydantic import Field

from brink.search.analysis.comparison import rows_of, said
from brink.search.analysis.scores import DRAWS, Scores
from brink.search.boundary import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.server.api.context import Services
from brink.server.api.experiment_schemas import ControlView
from brink.server.api.experiment_views import control_view
from brink.server.api.schemas import BeingMade, View
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.errors import Conflict
from brink.server.states import CampaignStatus

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["campaigns"])


class ScoresView(View):
    """What a campaign reached within its budget: a figure for each share of it, each t_b and each d_th."""

    id: str
    name: str
    status: CampaignStatus
    evaluated: Annotated[int, Field(description="Solutions within the budget that have a verdict.")]
    unsafe: int
    unsafe_share: float
    fractions: Annotated[list[float], Field(description="Shares of the budget.")]
    t_bs: list[float]
    d_ths: list[float]
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    control: Annotated[ControlView | None, Field(description="None where no component is a scenario.")]
    draws: Annotated[int, Field(description="Draws that the control's figures are means of.")]
    says: Annotated[
        list[list[str]],
        Field(
            description="What it and its control say together at the whole budget, a t_b, a d_th; else empty."
        ),
    ]


@router.get(
    "/scores",
    responses={202: {"model": BeingMade, "description": "Being computed; ask again after `Retry-After`."}},
)
async def get_scores(
    campaign_id: str,
    services: Services,
    wait_s: Annotated[float, Query(ge=0, le=60, description="How long to wait for scores.")] = 10.0,
) -> ScoresView:
    """Return the DBS and strict DBS that a campaign reached by its end and before, beside those of its control."""
    campaign = await services.campaigns.get(campaign_id)
    if campaign.status not in ENDED:
        raise Conflict(
            f"campaign {campaign.id} is {campaign.status}: what it reaches is known when it has ended"
        )
    scores = await services.scorebook.scores(campaign, wait_s)
    if scores is None:
        view = BeingMade(detail="the campaign is being scored; ask again soon")
        return JSONResponse(view.model_dump(), status_code=202, headers={"Retry-After": "2"})  # type: ignore[return-value]
    return _view(campaign, scores)


def _view(campaign: Campaign, scores: Scores) -> ScoresView:
    own, *control = rows_of(scores, campaign=campaign.id, label=campaign.body.name)
    return ScoresView(
        id=campaign.id, name=campaign.body.name, status=campaign.status, evaluated=scores.evaluated,
        unsafe=scores.unsafe, unsafe_share=own.unsafe_share, fractions=list(PAPER_FRACTIONS),
        t_bs=list(PAPER_T_BS), d_ths=list(PAPER_D_THS), dbs=scores.figures.dbs.tolist(),
        strict=scores.figures.strict.tolist(), control=control_view(scores.control), draws=DRAWS,
        says=[
            [said(own, blind, (i, j)) for j in range(len(PAPER_D_THS))]
            for blind in control
            for i in range(len(PAPER_T_BS))
        ],
    )  # fmt: skip
