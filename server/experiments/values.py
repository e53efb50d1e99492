"""Experiments as plain values."""

from dataclasses import dataclass
from datetime import datetime

from brink.server.campaigns.values import Campaign
from brink.server.experiments.body import ExperimentBody
from brink.server.states import CampaignStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A campaign of an experiment.

    Attributes:
        place: Which of them.
        method: What its algorithm is called.
        problem: What its problem is called.
        campaign: As it stands.
    """

    place: int
    method: str
    problem: str
    campaign: Campaign


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """An experiment as it stands in the database.

    Attributes:
        body: What was asked for.
        document_hash: Of the body.
        members: Its campaigns, by place; one that was deleted is missing.
    """

    id: str
    body: ExperimentBody
    document_hash: str
    created_at: datetime
    members: tuple[Member, ...]

    @property
    def status(self) -> CampaignStatus:
        """Running while one of its campaigns is; else paused, failed, cancelled, or finished if all are."""
        states = {member.campaign.status for member in self.members}
        for status in (
            CampaignStatus.RUNNING,
            CampaignStatus.PAUSED,
            CampaignStatus.FAILED,
            CampaignStatus.CANCELLED,
        ):
            if status in states:
                return status
        return CampaignStatus.FINISHED

    @property
    def simulations(self) -> int:
        """Candidates evaluated so far by all of its campaigns."""
        return sum(member.campaign.told for member in self.members)

    @property
    def budget(self) -> int:
        """Simulations of all of its campaigns."""
        return self.body.campaigns * self.body.budget.simulations
