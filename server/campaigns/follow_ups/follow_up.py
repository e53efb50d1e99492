"""A follow-up as it is planned and as it is stored."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from brink.server.campaigns.body import Budget, CampaignBody, PluginChoice
from brink.server.campaigns.plan import Plan, PreparedCampaign
from brink.server.campaigns.store import Campaign
from brink.server.states import FollowUpKind, Selection

_NAME_LENGTH = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowUp:
    """The question of a follow-up, and the solutions it is about. Equal follow-ups are simulated once.

    Attributes:
        of_id: Id of the campaign that it is about.
        kind: What it asks.
        selection: How its solutions were chosen.
        t_b: Maximum fitness of the solutions; None if they are not a boundary.
        d_th: Minimum distance between them; None if they are not a boundary.
        repeats: Most simulations of each solution with other seeds; None if it is simulated with its own seed.
        numbers: Numbers of the solutions. Best first, except for sides of pairs, whose order is that of their kind.
    """

    of_id: str
    kind: FollowUpKind
    selection: Selection
    t_b: float | None = None
    d_th: float | None = None
    repeats: int | None = None
    numbers: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedFollowUp:
    """A follow-up that is checked but not stored yet.

    Attributes:
        asks: What it asks.
        campaign: The campaign that simulates it.
    """

    asks: FollowUp
    campaign: PreparedCampaign


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredFollowUp(FollowUp):
    """A follow-up with its results so far.

    Attributes:
        campaign: The campaign that simulates it.
        evaluated: Numbers of the candidates of that campaign that were evaluated so far.
        unsafe: Whether each of these was unsafe.
        failed: Numbers of those that have no verdict.
    """

    campaign: Campaign
    evaluated: tuple[int, ...]
    unsafe: tuple[bool, ...]
    failed: tuple[int, ...]

    @property
    def verdicts(self) -> dict[int, bool | None]:
        """Whether each candidate that has ended was unsafe, by number; None if it failed."""
        return dict(zip(self.evaluated, self.unsafe, strict=True)) | dict.fromkeys(self.failed)


def follow_up_body(
    body: CampaignBody, plan: Plan, what: str, algorithm: str, simulations: int, params: Mapping[str, Any]
) -> CampaignBody:
    """Return the body of a follow-up, with the problem and the seed of its campaign.

    Args:
        body: The campaign.
        plan: Its plan.
        what: What the follow-up simulates, in a few words; ends its name.
        algorithm: Id of its algorithm.
        simulations: Its budget.
        params: Settings of its algorithm beside the neighbourhood, which is that of the campaign.
    """
    near = plan.neighbourhood
    return CampaignBody(
        name=f"{body.name[: _NAME_LENGTH - len(what) - 2]}: {what}",
        problem=body.problem,
        algorithm=PluginChoice(
            id=algorithm, params={**params, "radius": near.radius, "p_th": near.p_th, "z": near.z}
        ),
        budget=Budget(simulations=simulations),
        seed=body.seed,
        priority=body.priority,
        ground_truth=body.ground_truth,
        execution=body.execution.model_copy(update={"keep_traces": 0}),
    )
