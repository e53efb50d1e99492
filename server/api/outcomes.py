"""Routes of outcomes: the results of a campaign's simulations for all recorded requirements."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field

from brink.server.api.context import Services
from brink.server.api.responses import json_response
from brink.server.campaigns.outcomes import CampaignOutcomes
from brink.server.states import OutcomeKind
from brink.server.views import View

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


class OutcomeGroupView(View):
    """Solutions whose simulations had the same outcome."""

    words: Annotated[
        str, Field(description="Such as `front gap held; hit a pedestrian`, without the moment.")
    ]
    kind: OutcomeKind
    solutions: Annotated[int, Field(description="Number of solutions.")]


class OutcomesView(View):
    """The results of a campaign's simulations for its own and all other recorded requirements."""

    requirements: Annotated[
        list[str], Field(description="Requirements that decide the verdict; empty if unknown.")
    ]
    evaluated: Annotated[int, Field(description="Solutions with a verdict.")]
    recorded: Annotated[int, Field(description="Solutions whose result has the requirements.")]
    words: Annotated[
        str,
        Field(
            description="How many drives held the requirements, which others they violated, and in which ODD."
        ),
    ]
    odd: Annotated[
        str,
        Field(
            description="The sentences in `words` about the ODD; empty if the search was not limited to one."
        ),
    ] = ""
    kinds: Annotated[
        dict[OutcomeKind, str],
        Field(description="What the solutions of each kind have in common, such as `front gap held`."),
    ]
    counts: Annotated[dict[OutcomeKind, int], Field(description="Number of solutions of each kind.")]
    groups: Annotated[list[OutcomeGroupView], Field(description="In order of first appearance.")]
    number: Annotated[
        list[int] | None, Field(description="Number of each solution, if requested with `solutions`.")
    ]
    group: Annotated[list[int] | None, Field(description="Index of each of these solutions in `groups`.")]


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
