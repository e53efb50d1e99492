"""Routes of hazardous combinations: chains of techniques, and the parts of one."""

from fastapi import APIRouter

from brink.search.algorithms.simood import SimoodConfig
from brink.search.errors import UnsupportedSpace
from brink.server.api.context import Services
from brink.server.api.solutions import Number
from brink.server.campaigns import view_store
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import read
from brink.server.errors import NotFound
from brink.server.findings.combinations.analysis import alphas_of, combinations_view, variants_view
from brink.server.findings.combinations.views import Combinations, Variant

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["solutions"])


@router.get("/combinations")
async def get_combinations(campaign_id: str, services: Services) -> Combinations:
    """Return the hazardous chains of techniques, and which of them need all their techniques or a certain order."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    measured = await read(services.engines, lambda c: view_store.read_measured(c, campaign.id))
    config = found.plan.config if isinstance(found.plan.config, SimoodConfig) else None

    def build_view() -> Combinations:
        space = found.plan.problem.space
        return combinations_view(space, found.archive, alphas_of(space, measured), config)

    try:
        return await services.analyses.run(build_view)
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None


@router.get("/solutions/{number}/variants")
async def get_variants(campaign_id: str, number: Number, services: Services) -> list[Variant]:
    """Return the parts and reorderings of a solution that were simulated with the same scenario, itself last."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    try:
        return await services.analyses.run(
            lambda: variants_view(found.plan.problem.space, found.archive, number)
        )
    except UnsupportedSpace:
        raise _no_techniques(campaign) from None
    except KeyError:
        raise NotFound(f"campaign {campaign.id} has no evaluated solution {number}") from None


def _no_techniques(campaign: Campaign) -> NotFound:
    return NotFound(f"campaign {campaign.id}: problem {campaign.body.problem.id} has no ordered techniques")
