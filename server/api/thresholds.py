"""Routes of thresholds: further simulations of their ends."""

from fastapi import APIRouter, Response

from brink.server.api.context import Services
from brink.server.api.responses import set_created
from brink.server.findings.follow_ups import FollowUpView, follow_up_view
from brink.server.findings.thresholds.questions import ThresholdFollowUpBody, follow_up_thresholds
from brink.server.states import FollowUpKind

router = APIRouter(prefix="/campaigns/{campaign_id}/thresholds", tags=["thresholds"])


@router.post(
    "/follow-ups",
    status_code=201,
    responses={200: {"model": FollowUpView, "description": "This had already been requested."}},
)
async def ask_about_thresholds(
    campaign_id: str, body: ThresholdFollowUpBody, services: Services, response: Response
) -> FollowUpView:
    """Simulate ends of the thresholds again, as a new campaign, to find out more about them."""
    campaign = await services.campaigns.get(campaign_id)
    again, new = await follow_up_thresholds(services, services.campaigns, campaign, body)
    set_created(response, f"campaigns/{again.id}", new=new)
    return follow_up_view(FollowUpKind(body.kind), again)
