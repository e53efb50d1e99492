"""Finds the earlier run of a campaign or an experiment, unless it was simulated with other code."""

from collections.abc import Iterable, Sequence

from brink.api.client import Api
from brink.server.api.schemas import CampaignList, CampaignView, ExperimentView
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.simulators import changed_sources
from brink.server.experiments.body import ExperimentBody
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


async def changed_in_experiment(api: Api, body: ExperimentBody, experiment: str) -> str | None:
    """Describe the plug-ins whose code differs from an earlier run of an experiment, or None if none does.

    Args:
        api: Where it was submitted.
        body: The experiment, whose plug-ins are installed here.
        experiment: Id of the earlier run.
    """
    now = {(cell.problem, cell.method): make_plan(cell.body).body.sources for cell in body.cells()}
    if not any(now.values()):
        return None
    members = (await api.read(ExperimentView, f"/experiments/{experiment}")).members
    for key, campaign in {(one.problem, one.method): one.campaign for one in members}.items():
        before = (await api.read(CampaignView, f"/campaigns/{campaign}")).body.sources
        if (changed := changed_sources(before, now[key])) is not None:
            return changed
    return None
