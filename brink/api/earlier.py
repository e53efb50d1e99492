"""Finds the earlier run of a campaign, whose results are still those of the campaign."""

from collections.abc import Iterable, Sequence

from brink.api.client import Api
from brink.server.api.schemas import CampaignList, CampaignView
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.simulators import changed_sources
from brink.server.states import CampaignStatus


async def earlier_run(
    api: Api, body: CampaignBody, hashes: Iterable[str], statuses: Sequence[CampaignStatus]
) -> tuple[CampaignView | None, str]:
    """Return the latest run of a campaign.

    Args:
        api: Where it may have been submitted.
        body: The campaign, whose plug-ins are installed here.
        hashes: Hashes of the bodies that count as this campaign.
        statuses: Statuses that count.

    Returns:
        The run; None if there is none, or if it was simulated with other code of a plug-in. And a sentence that says
        so, empty if there is nothing to say.
    """
    found: list[CampaignView] = []
    for document_hash in hashes:
        params = {"document_hash": document_hash, "status": list(statuses), "limit": 1}
        found += (await api.read(CampaignList, "/campaigns", params)).campaigns
    if not found:
        return None, ""
    latest = max(found, key=lambda one: one.created_at)
    changed = changed_sources(latest.body.sources, make_plan(body).body.sources)
    if changed is None:
        return latest, ""
    return None, f"campaign {latest.id} was simulated with other code of {changed}, so it is left as it is"
