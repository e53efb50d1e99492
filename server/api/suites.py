"""Routes of suites: the verdicts on the drives of a campaign that simulates a suite."""

from fastapi import APIRouter

from brink.search.algorithms.suite import SuiteConfig
from brink.server.api.context import Services
from brink.server.campaigns.follow_ups.store import read_ended
from brink.server.errors import InvalidInput
from brink.server.suites.results import CaseResult, judged, sorted_cases

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["suites"])


@router.get("/suite")
async def get_suite(campaign_id: str, services: Services) -> list[CaseResult]:
    """Return the verdict on each drive of a suite so far, those that are not as expected first."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    if not isinstance(found.plan.config, SuiteConfig):
        message = (
            f"campaign {campaign.id} does not simulate a suite: its algorithm is {campaign.body.algorithm.id}"
        )
        raise InvalidInput.at("/path/campaign_id", message)
    ended = await services.pages.read(
        services.engines, lambda connection: read_ended(connection, campaign.id)
    )
    params, system = campaign.body.algorithm.params, campaign.body.problem.id
    return await services.pages.run(
        lambda: sorted_cases(judged(params, ended, system=system, campaign=campaign.id))
    )
