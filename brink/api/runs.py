"""Runs of campaigns and experiments: how the earlier run of a file is found and continued, or a new one submitted.

A run that was simulated with different code of a plug-in is not an earlier run.
"""

from collections.abc import Sequence
from typing import Protocol

from brink.api.client import Api
from brink.api.follow_ups import OPEN
from brink.api.following import P
from brink.server.api.schemas import (
    CampaignList,
    CampaignView,
    ExperimentList,
    ExperimentProgress,
    ExperimentSummary,
    ExperimentView,
    Progress,
)
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.simulators import changed_sources
from brink.server.experiments.body import ExperimentBody
from brink.server.seeding import SeederSettings
from brink.server.states import CampaignStatus


class Workload(Protocol[P]):
    """A campaign or an experiment to run to its end.

    Attributes:
        noun: "campaign" or "experiment"; its plural is the REST resource.
        note: A sentence if there is a run with different code; empty if `latest` found none.
        models: The language models that it names.
    """

    noun: str
    note: str

    @property
    def models(self) -> Sequence[SeederSettings | None]: ...  # noqa: D102

    async def latest(self, api: Api, statuses: Sequence[CampaignStatus]) -> P | None:
        """Return the latest run that has one of these statuses."""

    async def resume(self, api: Api, found: P) -> None:
        """Resume an unfinished run."""

    async def submit(self, api: Api) -> tuple[str, str]:
        """Submit a new run; return its id and a summary of it in words."""

    def reasons(self, progress: P) -> Sequence[str]:
        """Return the reasons why the work ended unfinished."""


async def resume_or_submit(workload: Workload[P], api: Api, found: P | None) -> tuple[str, str]:
    """Continue the run that was found or, without one, submit a new one; return its id and a summary if it is new."""
    if found is None:
        return await workload.submit(api)
    if found.status is not CampaignStatus.FINISHED:
        await workload.resume(api, found)
    return found.id, ""


class CampaignRun:
    """A campaign to run to its end.

    Args:
        body: The campaign.
        pictures: Whether pictures are wanted; without them, workers record no traces when the search ends.
    """

    noun = "campaign"

    def __init__(self, body: CampaignBody, *, pictures: bool = True) -> None:
        untraced = body.model_copy(update={"execution": body.execution.model_copy(update={"keep_traces": 0})})
        self.body = body if pictures else untraced
        self.models = (body.llm,)
        self.note = ""
        self._hashes = {body.document_hash(), untraced.document_hash()}

    async def latest(self, api: Api, statuses: Sequence[CampaignStatus]) -> Progress | None:
        """Return the latest run of the campaign, with or without pictures, that has one of these statuses."""
        found: list[CampaignView] = []
        for document_hash in self._hashes:
            params = {"document_hash": document_hash, "status": list(statuses), "limit": 1}
            found += (await api.read(CampaignList, "/campaigns", params)).campaigns
        if not found:
            return None
        latest = max(found, key=lambda one: one.created_at)
        changed = changed_sources(latest.body.sources, make_plan(self.body).body.sources)
        if changed is not None:
            self.note = (
                f"campaign {latest.id} was simulated with different code of {changed}, so it stays unchanged"
            )
            return None
        return await api.read(Progress, f"/campaigns/{latest.id}/progress")

    async def resume(self, api: Api, found: Progress) -> None:
        """Resume the campaign if it is paused."""
        if found.status is CampaignStatus.PAUSED:
            await api.post(f"/campaigns/{found.id}/resume")

    async def submit(self, api: Api) -> tuple[str, str]:
        """Submit the campaign; return its id and a summary of it."""
        body = self.body
        campaign = await api.send(CampaignView, "/campaigns", body.model_dump(mode="json"))
        return campaign.id, (
            f"{body.algorithm.id} on {body.problem.id}, {body.budget.simulations} simulations, seed {body.seed}"
            f"{self.note and f'; {self.note}'}"
        )

    def reasons(self, progress: Progress) -> Sequence[str]:
        """Return why the campaign ended unfinished."""
        return [progress.status_reason] if progress.status_reason else []


class ExperimentRun:
    """An experiment to run to its end."""

    noun = "experiment"

    def __init__(self, body: ExperimentBody) -> None:
        self.body = body
        self.models = tuple(one.llm for one in body.algorithms)
        self.note = ""

    async def latest(self, api: Api, statuses: Sequence[CampaignStatus]) -> ExperimentProgress | None:
        """Return the latest experiment from this file with one of these statuses and no deleted campaign, if any.

        One that has finished counts as unfinished as long as its follow-ups have not.
        """
        params = {"document_hash": self.body.document_hash(), "limit": 100}
        async for page in api.pages(ExperimentList, "/experiments", params):
            for one in page.experiments:
                if not one.deleted and (one.status in statuses or await self._is_followed_up(api, one)):
                    changed = await self._changed(api, one.id)
                    if changed is None:
                        return await api.read(ExperimentProgress, f"/experiments/{one.id}/progress")
                    self.note = f"experiment {one.id} was simulated with different code of {changed}"
                    return None
        return None

    async def _is_followed_up(self, api: Api, one: ExperimentSummary) -> bool:
        """Return whether an experiment has finished, but not its follow-ups."""
        if not self.body.follow_ups() or one.status is not CampaignStatus.FINISHED:
            return False
        progress = await api.read(ExperimentProgress, f"/experiments/{one.id}/follow-ups")
        return progress.status in OPEN

    async def _changed(self, api: Api, experiment: str) -> str | None:
        """Describe the plug-ins whose code differs from an earlier run, or None if none does."""
        now = {(cell.problem, cell.method): make_plan(cell.body).body.sources for cell in self.body.cells()}
        if not any(now.values()):
            return None
        members = (await api.read(ExperimentView, f"/experiments/{experiment}")).members
        for key, campaign in {(one.problem, one.method): one.campaign for one in members}.items():
            before = (await api.read(CampaignView, f"/campaigns/{campaign}")).body.sources
            if (changed := changed_sources(before, now[key])) is not None:
                return changed
        return None

    async def resume(self, api: Api, found: ExperimentProgress) -> None:
        """Resume the paused campaigns of the experiment."""
        await api.post(f"/experiments/{found.id}/resume")

    async def submit(self, api: Api) -> tuple[str, str]:
        """Submit the experiment; return its id and a summary of it."""
        body = self.body
        experiment = await api.send(ExperimentView, "/experiments", body.document())
        return experiment.id, (
            f"{len(body.algorithms)} algorithms x {len(body.problems)} problems x {len(body.seeds)} seeds x "
            f"{body.budget.simulations:,} simulations = {experiment.budget:,}{self.note and f'; {self.note}'}"
        )

    def reasons(self, progress: ExperimentProgress) -> Sequence[str]:
        """Return which campaigns are paused, and why."""
        return [f"campaign {reason}" for reason in progress.paused]
