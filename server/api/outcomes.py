"""Routes of outcomes: the results of a campaign's simulations for all recorded requirements."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from brink.server.api.context import Services
from brink.server.api.responses import json_response
from brink.server.api.schemas import OutcomeGroupView, OutcomesView
from brink.server.campaigns.outcomes import CampaignOutcomes
from brink.server.states import OutcomeKind

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


@router.get("/outcomes", response_model=OutcomesView)
async def get_outcomes(
    campaign_id: str,
    services: Services,
    solutions: Annotated[bool, Query(description="Whether to add the outcome of each solution.")] = False,
) -> Response:
    """Return how many solutions held or violated which requirements."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    outcomes = await services.outcomes.get(campaign.id, found)
    return await services.pages.run(lambda: json_response(_view(outcomes, solutions=solutions)))


def _view(outcomes: CampaignOutcomes, *, solutions: bool) -> OutcomesView:
    return OutcomesView(
        requirements=list(outcomes.requirements),
        evaluated=len(outcomes.numbers),
        recorded=outcomes.recorded,
        words=outcomes.sentence(),
        odd=outcomes.odd,
        kinds={kind: outcomes.kind_words(kind) for kind in OutcomeKind},
        counts={kind: outcomes.count(kind) for kind in OutcomeKind},
        groups=[
            OutcomeGroupView(words=group.words, kind=group.kind, solutions=count)
            for group, count in zip(outcomes.groups, outcomes.counts.tolist(), strict=True)
        ],
        number=outcomes.numbers.tolist() if solutions else None,
        group=outcomes.which.tolist() if solutions else None,
    )
