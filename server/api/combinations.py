"""Routes of hazardous combinations: chains of techniques, and the parts of one."""

from fastapi import APIRouter

from brink.server.api.context import Services
from brink.server.api.solutions import Number
from brink.server.findings.combinations.analysis import find_combinations, find_variants
from brink.server.findings.combinations.views import Combinations, Variant

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


@router.get("/combinations")
async def get_combinations(campaign_id: str, services: Services) -> Combinations:
    """Return the hazardous chains of techniques, and which of them need all their techniques or a certain order."""
    campaign = await services.campaigns.get(campaign_id)
    return await find_combinations(services, campaign, await services.archives.get(campaign))


@router.get("/solutions/{number}/variants")
async def get_variants(campaign_id: str, number: Number, services: Services) -> list[Variant]:
    """Return the parts and reorderings of a solution that were simulated with the same scenario, itself last."""
    return await find_variants(services, await services.campaigns.get(campaign_id), number)
