"""Response schemas of follow-ups: campaigns that rerun solutions of another campaign."""

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from brink.server.states import CampaignStatus, FollowUpKind
from brink.server.views import View

if TYPE_CHECKING:
    from brink.server.campaigns.store import Campaign


class ShareView(View):
    """How often one side was unsafe when it was simulated again with other seeds."""

    evaluated: Annotated[int, Field(description="Simulations with a verdict.")]
    unsafe: int
    probability: Annotated[float | None, Field(description="Unsafe share; null without a verdict.")]
    low: Annotated[
        float,
        Field(
            description="Lower limit of its exact interval (Clopper-Pearson): of 90% for the sides of pairs."
        ),
    ]
    high: float
    failed: Annotated[
        int, Field(description="Simulations without a verdict: each may have had either one.")
    ] = 0


class FollowUpView(View):
    """A campaign that simulated sides of pairs again."""

    kind: FollowUpKind
    campaign: str
    status: CampaignStatus
    status_reason: str
    simulations: int
    budget: int


def follow_up_view(kind: FollowUpKind, campaign: "Campaign") -> FollowUpView:
    """Return the response schema of a follow-up, which a campaign simulates."""
    return FollowUpView(
        kind=kind,
        campaign=campaign.id,
        status=campaign.status,
        status_reason=campaign.status_reason,
        simulations=campaign.completed,
        budget=campaign.budget,
    )
