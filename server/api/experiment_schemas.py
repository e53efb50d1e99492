"""What the routes of experiments answer with."""

from datetime import datetime
from typing import Annotated

from pydantic import Field

from brink.search.analysis.comparison import Measure
from brink.server.api.schemas import View
from brink.server.experiments.body import ExperimentBody
from brink.server.states import CampaignStatus


class MemberView(View):
    """A campaign of an experiment."""

    campaign: str
    method: str
    problem: str
    seed: int
    status: CampaignStatus
    status_reason: str
    simulations: int
    unsafe: int
    failed: int


class ExperimentSummary(View):
    """An experiment and where it stands."""

    id: str
    name: str
    status: Annotated[
        CampaignStatus,
        Field(
            description="Running while a campaign is; else paused, failed, cancelled, or finished if all are."
        ),
    ]
    campaigns: Annotated[int, Field(description="How many it consists of.")]
    deleted: Annotated[int, Field(description="Of them, deleted since.")]
    finished: int
    simulations: int
    budget: Annotated[int, Field(description="Simulations of all campaigns together.")]
    failed: Annotated[int, Field(description="Candidates that failed.")]
    created_at: datetime


class ExperimentView(ExperimentSummary):
    """An experiment with its campaigns."""

    body: ExperimentBody
    members: list[MemberView]


class ExperimentList(View):
    """A page of experiments, newest first."""

    experiments: list[ExperimentSummary]
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")]


class ExperimentProgress(ExperimentSummary):
    """Counts and rates of all campaigns together."""

    rate_per_s: Annotated[float | None, Field(description="Over the last minute.")]
    remaining_s: float | None
    elapsed_s: float
    queued: int
    leased: int
    quarantined: int
    workers: Annotated[int, Field(description="Workers heard of lately.")]
    paused: Annotated[list[str], Field(description="Campaigns that are paused, and why.")]
    trouble: Annotated[str | None, Field(description="Why the database takes no writes now, if it does not.")]
    trouble_s: Annotated[float, Field(description="For how long.")]


class StandingView(View):
    """Where a method, or its control, stands for one pair of thresholds: mean and 95% interval."""

    problem: str
    method: str
    control: bool
    measure: Measure
    t_b: float
    d_th: float
    mean: float
    low: float | None
    high: float | None
    repeats: int


class DuelView(View):
    """One method against another, or against its own control, for one pair of thresholds."""

    problem: str
    first: str
    second: str
    control: Annotated[bool, Field(description="Whether the second is the first one's control.")]
    measure: Measure
    t_b: float
    d_th: float
    u: float
    p: float
    p_holm: Annotated[float, Field(description="Corrected for all comparisons of this problem and measure.")]
    a12: float
    effect: str
    differs: Annotated[
        bool, Field(description="Whether the corrected p is small enough to call it a difference.")
    ]
    says: Annotated[str, Field(description="What can be concluded, in words.")]


class RepeatView(View):
    """What a finished campaign reached: a figure for each share of the budget, each t_b and each d_th."""

    problem: str
    method: str
    seed: int
    campaign: str
    evaluated: int
    unsafe: int
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    control: Annotated["ControlView | None", Field(description="None where no component is a scenario.")]


class ControlView(View):
    """What the control of a campaign reached, in means of its draws."""

    unsafe_share: float
    behaviours_a_scenario: float
    reads_low: bool
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    spread: Annotated[
        list[list[float]], Field(description="Standard deviation of strict DBS over the draws.")
    ]


class Results(View):
    """The tables of an experiment, from the campaigns that have finished."""

    id: str
    name: str
    status: CampaignStatus
    created_at: datetime
    campaigns: int
    scored: Annotated[int, Field(description="Finished campaigns that are in the tables.")]
    fractions: Annotated[list[float], Field(description="Shares of the budget.")]
    t_bs: list[float]
    d_ths: list[float]
    standings: list[StandingView]
    duels: list[DuelView]
    repeats: list[RepeatView]
