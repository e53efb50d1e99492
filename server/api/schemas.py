"""Response schemas of the REST API that several routes or the command line share."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, Field

from brink.server.campaigns.body import CampaignBody
from brink.server.experiments.body import ExperimentBody
from brink.server.states import CampaignStatus, JobStatus, OutcomeKind
from brink.server.views import SolutionView, View

MAX_NUMBER = 2**53
"""Largest job or solution number that is looked up; every JSON parser reads it exactly."""


class Thresholds(View):
    """Thresholds at which boundary solutions are counted."""

    t_b: Annotated[float, Field(description="Default maximum fitness of a boundary solution.")]
    d_th: Annotated[float, Field(description="Default minimum distance between boundary solutions.")]
    t_bs: Annotated[list[float], Field(description="Values of t_b in score tables.")]
    d_ths: Annotated[list[float], Field(description="Values of d_th in score tables.")]


class CampaignView(View):
    """A campaign and its status."""

    id: str
    name: str
    status: CampaignStatus
    status_reason: str
    sequence: Annotated[
        int, Field(description="Increases with every change to the campaign except changes of job states.")
    ]
    simulations: Annotated[
        int, Field(description="Candidates finished so far, including measured and failed ones.")
    ]
    budget: int
    unsafe: int
    failed: int
    measured: Annotated[int, Field(description="Candidates measured on a data set instead of simulated.")]
    generation: int
    created_at: datetime
    finished_at: datetime | None
    tags: list[str] = Field(default_factory=list)
    notes: str = ""
    finds: Annotated[
        list[str], Field(description="Kinds of findings that its algorithm finds, its main purpose first.")
    ] = Field(default_factory=list)
    body: CampaignBody
    thresholds: Thresholds
    simulator: Annotated[
        str | None,
        Field(
            description="Simulator with its version that the campaign began with; null where nothing was simulated, "
            "and in lists."
        ),
    ] = None


class CampaignList(View):
    """A page of campaigns, newest first."""

    campaigns: list[CampaignView]
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")]


class GenerationView(View):
    """State of the archive after a generation."""

    number: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    best_fitness: Annotated[
        float | None, Field(description="Best value of the quantity that the algorithm minimises.")
    ]
    median_fitness: float | None
    dbs: Annotated[
        int | None,
        Field(
            description="Distinct boundary solutions at the default thresholds. Of a search that is not for the "
            "boundary, they are counted after the last generation only; null before."
        ),
    ]
    strict_dbs: int | None
    step_s: float
    told_at: datetime


class KnownView(View):
    """How much prior knowledge a campaign started with."""

    campaign: Annotated[
        str | None, Field(description="The campaign that it started from; null for given solutions.")
    ]
    results: Annotated[int, Field(description="Known results, which the campaign did not simulate.")]
    unsafe: Annotated[int, Field(description="Unsafe ones among them.")]
    points: Annotated[
        int, Field(description="Known solutions without a result, which the campaign simulates first.")
    ]
    outside_odd: Annotated[
        int, Field(description="Solutions of that campaign that were left out, as they are outside the ODD.")
    ] = 0


class DoomedCampaign(View):
    """A campaign that would be deleted."""

    id: str
    name: str
    status: CampaignStatus
    follow_up_of: Annotated[
        str | None, Field(description="The campaign of this list that it is a follow-up of; null if of none.")
    ]


class Deletion(View):
    """The campaigns that a deletion would delete; empty if a campaign of the list has not ended."""

    campaigns: list[DoomedCampaign]


class Progress(View):
    """Counts, rates, and the generations since a cursor."""

    id: str
    name: str
    status: CampaignStatus
    status_reason: str
    sequence: Annotated[
        int, Field(description="Increases with every change to the campaign except changes of job states.")
    ]
    budget: int
    simulations: Annotated[
        int, Field(description="Candidates finished so far, including those of the current generation.")
    ]
    evaluated: int
    unsafe: int
    failed: int
    measured: Annotated[int, Field(description="Candidates measured on a data set instead of simulated.")]
    reported: Annotated[
        int, Field(description="Verdicts that workers have reported and the search has not received yet.")
    ] = 0
    reported_unsafe: Annotated[int, Field(description="Of these, unsafe ones.")] = 0
    reported_failed: Annotated[
        int, Field(description="Failed simulations that the search has not received yet.")
    ] = 0
    failure: Annotated[str, Field(description="The first error of a simulation that failed, if any.")] = ""
    quarantined: int
    queued: int
    leased: int
    generation: int
    rate_per_s: Annotated[
        float | None,
        Field(description="Simulations over the last generations while it runs, then over all of them."),
    ]
    cached: Annotated[
        int,
        Field(
            description="Candidates in the same time whose results came from the cache, not from a worker."
        ),
    ] = 0
    remaining_s: Annotated[float | None, Field(description="Null while it is paused or waits for a worker.")]
    elapsed_s: float
    workers: Annotated[int, Field(description="Live workers.")]
    unrunnable: Annotated[
        dict[str, int],
        Field(description="Number of queued jobs that no live worker can run, by required capability."),
    ]
    waits_for: Annotated[
        dict[str, str],
        Field(
            default_factory=dict,
            description="What kind of worker each of these capabilities needs, in words.",
        ),
    ]
    finds: Annotated[
        list[str], Field(description="Kinds of findings that its algorithm finds, its main purpose first.")
    ] = Field(default_factory=list)
    minimises: Annotated[
        str,
        Field(
            description="Name of a generation's `best_fitness`: `fitness` or `criticality`; empty if the algorithm "
            "minimises nothing that shows its progress."
        ),
    ] = ""
    origins: Annotated[
        dict[str, int],
        Field(description="Number of solutions by origin, once the campaign has ended; empty if unknown."),
    ]
    known: Annotated[
        KnownView | None,
        Field(
            description="Known results and points of the campaign, see `GET …/known`; null if it has none."
        ),
    ] = None
    asking: Annotated[str | None, Field(description="Current request to a language model, if any.")]
    trouble: Annotated[
        str | None, Field(description="Why the database currently rejects writes, if it does.")
    ]
    trouble_s: Annotated[float, Field(description="How long the database has rejected writes, in seconds.")]
    digest: Annotated[str | None, Field(description="SHA-256 of the archive, once the campaign has ended.")]
    finished_at: datetime | None = None
    tags: list[str] = Field(default_factory=list)
    notes: str = ""
    t_b: float
    d_th: float
    generations: list[GenerationView]

    def is_for(self, kind: str) -> bool:
        """Return whether the search is for a kind of finding: the first that its algorithm finds."""
        return self.finds[:1] == [kind]


class SolutionPage(View):
    """A page of solutions, in ascending order of number."""

    solutions: list[SolutionView]
    next: Annotated[int | None, Field(description="Pass as `after` to get the next page.")]


class DistanceBlock(View):
    """A block of the distance matrix."""

    numbers: list[int]
    distances: list[list[float]]


class JobViewModel(View):
    """A job and its state."""

    id: int
    campaign: str
    number: int
    kind: str
    needs: str
    status: JobStatus
    attempt: Annotated[int, Field(description="Leases so far, except those that were given back.")]
    counted_attempts: Annotated[int, Field(description="Attempts that count towards `max_attempts`.")]
    max_attempts: int
    losses: Annotated[
        int, Field(description="Attempts whose worker stopped responding, which count towards `max_losses`.")
    ]
    max_losses: int
    worker: str | None
    last_error: str | None
    created_at: datetime
    finished_at: datetime | None


class JobList(View):
    """A page of jobs, in ascending order of id."""

    jobs: list[JobViewModel]
    next: int | None


class JobCounts(View):
    """Counts of unfinished jobs by state, campaign, kind and required capability, as one list per column."""

    status: Annotated[list[JobStatus], Field(description="Queued, leased or quarantined.")]
    campaign: list[str]
    kind: list[str]
    needs: Annotated[list[str], Field(description="Capability that a worker must have.")]
    jobs: list[int]
    campaigns: Annotated[dict[str, str], Field(description="Campaign names by id.")]
    paused: Annotated[list[str], Field(description="Ids of paused campaigns with queued jobs.")]
    ended: Annotated[
        list[str],
        Field(description="Ids of ended campaigns; of their jobs, only those of kind `trace` still matter."),
    ]
    unrunnable: Annotated[
        dict[str, int],
        Field(
            description="Number of queued jobs in unpaused campaigns that no live worker can run, by capability."
        ),
    ]
    waits_for: Annotated[
        dict[str, str],
        Field(
            default_factory=dict,
            description="What kind of worker each of these capabilities needs, in words.",
        ),
    ]


class WorkerView(View):
    """A worker that has contacted the coordinator."""

    id: str
    host: str
    pid: int
    version: str
    capabilities: list[str]
    first_seen_at: datetime
    last_seen_at: datetime
    seen_s_ago: float
    live: bool
    draining: Annotated[bool, Field(description="Whether it is to finish the jobs that it holds, and exit.")]
    jobs_done: int
    jobs_failed: int
    jobs_held: int


class MeasureView(View):
    """A measure of what a solution does."""

    name: str
    low: Annotated[float, Field(description="Usual smallest value.")]
    high: Annotated[float, Field(description="Usual largest value.")]
    unit: str


class ProblemView(View):
    """A problem in the catalogue."""

    id: str
    summary: str
    params: Annotated[dict[str, Any], Field(description="JSON schema of its parameters.")]
    space: Annotated[dict[str, Any], Field(description="Search space with default parameters.")]
    simulator: str | None
    finds: Annotated[
        list[str], Field(description="What a campaign finds besides a boundary: violations, combinations.")
    ]
    measures: Annotated[
        list[MeasureView], Field(description="Measures of what a solution does, for qd@1 among others.")
    ]
    measures_detector: Annotated[
        bool,
        Field(
            description="Whether its drives measure the errors of a detector, to check it against tolerances."
        ),
    ]
    algorithm_defaults: Annotated[
        dict[str, Any],
        Field(
            description="Defaults of algorithm parameters that replace the algorithm's own on this problem."
        ),
    ]
    first_algorithm: Annotated[str, Field(description="Id of the algorithm to begin with.")]
    python_only: Annotated[
        bool, Field(description="Whether its campaigns can be started from Python only, with brink.search().")
    ]


class AlgorithmView(View):
    """An algorithm in the catalogue."""

    id: str
    summary: str
    params: Annotated[dict[str, Any], Field(description="JSON schema of its parameters.")]
    finds: Annotated[list[str], Field(description="Kinds of findings that it finds, its main purpose first.")]
    internal: Annotated[bool, Field(description="Whether only Brink itself starts campaigns with it.")]


class BeingMade(View):
    """A result that is not available yet."""

    detail: str


class ProblemDetail(BaseModel):
    """An error as defined by RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: Annotated[
        list[dict[str, str | None]],
        Field(
            description="For invalid input: pointer, message and closest valid name for each invalid field."
        ),
    ] = []


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
    """An experiment and its status."""

    id: str
    name: str
    status: Annotated[
        CampaignStatus,
        Field(
            description="The first of running, paused, failed, cancelled that any campaign is in; otherwise finished."
        ),
    ]
    campaigns: Annotated[int, Field(description="Number of campaigns.")]
    deleted: Annotated[int, Field(description="Number of its campaigns that have since been deleted.")]
    finished: int
    simulations: int
    budget: Annotated[int, Field(description="Budget of simulations, summed over all campaigns.")]
    failed: Annotated[int, Field(description="Failed candidates of all campaigns.")]
    created_at: datetime


class ExperimentView(ExperimentSummary):
    """An experiment with its campaigns."""

    body: ExperimentBody
    thresholds: Thresholds
    members: list[MemberView]


class ExperimentList(View):
    """A page of experiments, newest first."""

    experiments: list[ExperimentSummary]
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")]


class ExperimentProgress(ExperimentSummary):
    """Counts and rates over all campaigns of an experiment."""

    rate_per_s: Annotated[float | None, Field(description="Simulations, averaged over the last minute.")]
    cached: Annotated[
        int,
        Field(
            description="Candidates in the same time whose results came from the cache, not from a worker."
        ),
    ] = 0
    remaining_s: Annotated[float | None, Field(description="Null while it is paused or waits for a worker.")]
    elapsed_s: float
    queued: int
    leased: int
    quarantined: int
    workers: Annotated[int, Field(description="Live workers.")]
    paused: Annotated[list[str], Field(description="Ids of paused campaigns, each with the reason.")]
    trouble: Annotated[
        str | None, Field(description="Why the database currently rejects writes, if it does.")
    ]
    trouble_s: Annotated[float, Field(description="How long the database has rejected writes, in seconds.")]


class RepeatView(View):
    """Scores of a finished campaign: a value for each fraction of the budget, each t_b and each d_th."""

    problem: str
    method: str
    seed: int
    campaign: str
    evaluated: int
    unsafe: int
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    control: Annotated[
        "ControlView | None", Field(description="Null if no component of the problem is a scenario.")
    ]


class ControlView(View):
    """Scores of a campaign's control, averaged over its draws."""

    unsafe_share: float
    behaviours_a_scenario: float
    reads_low: bool
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    spread: Annotated[
        list[list[float]], Field(description="Standard deviation of strict DBS over the draws.")
    ]


class OutcomeGroupView(View):
    """Solutions whose simulations had the same outcome."""

    words: Annotated[
        str, Field(description="Such as `front gap held; hit a pedestrian`, without the moment.")
    ]
    kind: OutcomeKind
    solutions: Annotated[int, Field(description="Number of solutions.")]


class OutcomesView(View):
    """The results of a campaign's simulations for its own and all other recorded requirements."""

    requirements: Annotated[
        list[str], Field(description="Requirements that decide the verdict; empty if unknown.")
    ]
    evaluated: Annotated[int, Field(description="Solutions with a verdict.")]
    recorded: Annotated[int, Field(description="Solutions whose result has the requirements.")]
    words: Annotated[
        str,
        Field(
            description="How many drives held the requirements, which others they violated, and in which ODD."
        ),
    ]
    odd: Annotated[
        str,
        Field(
            description="The sentences in `words` about the ODD; empty if the search was not limited to one."
        ),
    ] = ""
    kinds: Annotated[
        dict[OutcomeKind, str],
        Field(description="What the solutions of each kind have in common, such as `front gap held`."),
    ]
    counts: Annotated[dict[OutcomeKind, int], Field(description="Number of solutions of each kind.")]
    groups: Annotated[list[OutcomeGroupView], Field(description="In order of first appearance.")]
    number: Annotated[
        list[int] | None, Field(description="Number of each solution, if requested with `solutions`.")
    ]
    group: Annotated[list[int] | None, Field(description="Index of each of these solutions in `groups`.")]
