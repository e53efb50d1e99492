"""Response schemas of the REST API that several routes or the command line share."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from brink.search.analysis.avoidable import Avoidable, AvoidedBy
from brink.server.campaigns.body import CampaignBody
from brink.server.experiments.body import ExperimentBody
from brink.server.states import CampaignStatus, JobStatus, OutcomeKind, SolutionVerdict

MAX_NUMBER = 2**53
"""Largest job or solution number that is looked up; every JSON parser reads it exactly."""
AVOIDABLE = (
    "Who would have avoided it: a careful driver (UN Regulation No. 157, Annex 3), only an ideal one who brakes at "
    "once, or neither (no); null if that was not measured."
)
AVOIDED_BY = (
    "How that driver avoids it: by `braking` before the time of the violation, for a road user or a red light, or by "
    "`driving on`, having passed earlier or kept its lane; null if no driver avoids it, or that was not recorded."
)


class View(BaseModel):
    """Base class of all response schemas. Validators are built on first use: the command line needs few of them."""

    model_config = ConfigDict(frozen=True, defer_build=True)


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
    tags: list[str] = []
    notes: str = ""
    looks_for_boundary: Annotated[
        bool,
        Field(
            description="Whether it searches for the hazard boundary; otherwise fitness is of no interest."
        ),
    ]
    body: CampaignBody
    thresholds: Thresholds


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
    dbs: int
    strict_dbs: int
    step_s: float
    told_at: datetime


class KnownView(View):
    """How much a campaign started from."""

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
    """What a deletion would delete: nothing if a campaign of the list has not ended."""

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
        int, Field(description="Verdicts that workers have reported and the search has not been told yet.")
    ] = 0
    reported_unsafe: Annotated[int, Field(description="Those of them that are unsafe.")] = 0
    reported_failed: Annotated[
        int, Field(description="Failed simulations that the search has not been told yet.")
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
        dict[str, str], Field(description="What kind of worker each of these capabilities needs, in words.")
    ] = {}
    looks_for_boundary: Annotated[
        bool,
        Field(
            description="Whether it searches for the hazard boundary rather than for different violations."
        ),
    ]
    looks_for_pairs: Annotated[
        bool,
        Field(description="Whether it searches for pairs across the boundary: the boundary is a side line."),
    ] = False
    looks_for_tolerances: Annotated[
        bool, Field(description="Whether it estimates how gross errors may be; see `GET …/tolerance`.")
    ] = False
    origins: Annotated[
        dict[str, int],
        Field(description="Number of solutions by origin, once the campaign has ended; empty if unknown."),
    ]
    known: Annotated[
        KnownView | None,
        Field(description="What the campaign started from, see `GET …/known`; null if from nothing."),
    ] = None
    asking: Annotated[str | None, Field(description="Current request to a language model, if any.")]
    trouble: Annotated[
        str | None, Field(description="Why the database currently rejects writes, if it does.")
    ]
    trouble_s: Annotated[float, Field(description="How long the database has rejected writes, in seconds.")]
    digest: Annotated[str | None, Field(description="SHA-256 of the archive, once the campaign has ended.")]
    finished_at: datetime | None = None
    tags: list[str] = []
    notes: str = ""
    t_b: float
    d_th: float
    generations: list[GenerationView]


class ViolatedView(View):
    """A requirement that an episode violated."""

    requirement: str
    time_s: Annotated[float | None, Field(description="Simulated time of the first violation, if recorded.")]
    words: Annotated[str, Field(description="What the ego did, such as `hit a pedestrian`.")]
    decides: Annotated[bool, Field(description="Whether the campaign's verdict depends on it.")]
    avoidable: Annotated[Avoidable | None, Field(description=AVOIDABLE)] = None
    avoided_by: Annotated[AvoidedBy | None, Field(description=AVOIDED_BY)] = None
    avoidable_words: Annotated[
        str,
        Field(
            description="The same in words, such as `avoidable by a careful driver`; empty if not measured."
        ),
    ] = ""


class ActivityView(View):
    """Which parameters had a part in the episode of a solution, and the values that they had there."""

    inactive: Annotated[
        list[str],
        Field(
            description="Parameters whose value cannot have influenced the episode, as component.parameter: for "
            "example, those of a trajectory that begins after the episode ended."
        ),
    ]
    effective: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values as the episode had them: a time window that its end cut off ends there."),
    ]
    idle: Annotated[list[str], Field(description="Components that had no part in the episode.")]


class SolutionView(View):
    """A complete solution with its decoded parameters."""

    number: int
    generation: int
    verdict: Annotated[
        SolutionVerdict,
        Field(description="Safe or unsafe by the campaign's requirements; see `outcome` for the others."),
    ]
    outcome: Annotated[
        str | None,
        Field(
            description="What its simulation showed about all recorded requirements, such as `front gap held; hit a "
            "pedestrian at 12.8 s`; null without a verdict."
        ),
    ] = None
    kind: Annotated[
        OutcomeKind | None,
        Field(
            description="Whether it violated no recorded requirement (held), only others than those that decide "
            "(other), or one that decides (violated); null without a verdict."
        ),
    ] = None
    requirements: Annotated[
        list[str], Field(description="Requirements that decide the verdict; empty if unknown.")
    ] = []
    violated: Annotated[
        list[ViolatedView], Field(description="Violated requirements: those that decide first, then by time.")
    ] = []
    robustness: float | None
    objectives: dict[str, float] | None
    failure: str | None
    origin: Annotated[
        str | None,
        Field(description="How it was generated: random, heuristic, mutation, crossover, llm, llm_repair."),
    ]
    fitness: float | None
    neighbours: int | None
    unsafe_neighbours: int | None
    interval: Annotated[
        tuple[float, float] | None,
        Field(description="Wilson interval of the unsafe share in its neighbourhood."),
    ]
    seed: int
    attempts: int | None
    losses: Annotated[int | None, Field(description="Attempts among them whose worker stopped responding.")]
    words: Annotated[str, Field(description="Description in words.")]
    parameters: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values by component, then by name, as they were chosen."),
    ]
    titles: Annotated[
        dict[str, str],
        Field(
            description="What people read in place of a parameter's name, with its unit, by component.parameter; the "
            "others are read by name. Only for a single solution."
        ),
    ] = {}
    activity: Annotated[
        ActivityView | None,
        Field(description="Which of them had a part in the episode; null if that was not recorded."),
    ] = None
    verdicts: Annotated[dict[str, Any] | None, Field(description="Verdicts of all requirements.")] = None
    features: dict[str, Any] | None = None
    provenance: dict[str, Any] | None = None
    spec: Annotated[
        dict[str, Any] | None, Field(description="Specification of the episode, for simulating it again.")
    ] = None


class SolutionPage(View):
    """A page of solutions, in ascending order of number."""

    solutions: list[SolutionView]
    next: Annotated[int | None, Field(description="Pass as `after` to get the next page.")]


class DbsCell(View):
    """DBS and strict DBS at one pair of thresholds."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int


class BudgetBoundary(View):
    """The boundary of a campaign without the simulations beyond its budget."""

    simulations: Annotated[int, Field(description="The budget.")]
    beyond: Annotated[
        int, Field(description="Evaluated solutions beyond it, which complete the last generation.")
    ]
    dbs: int
    strict_dbs: int


class KnownBoundary(View):
    """The boundary of a campaign's solutions together with the known results that it started from."""

    results: Annotated[int, Field(description="Known results, none of which the campaign simulated.")]
    dbs: int
    strict_dbs: int


class Boundary(View):
    """The distinct boundary solutions of a campaign."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int
    words: Annotated[
        str,
        Field(
            description="How many solutions are listed, such as `8 distinct boundary solutions`, or, if these are "
            "not all, `the best 1,000 of 34,512 distinct boundary solutions`."
        ),
    ] = ""
    note: str
    grid: Annotated[
        list[DbsCell],
        Field(description="DBS at all thresholds, without distances at which it takes too long."),
    ]
    solutions: Annotated[
        list[SolutionView], Field(description="Best first; of more than `limit`, the best ones.")
    ]
    strict: Annotated[
        list[int], Field(description="The `number` of each of these that the strict DBS counts.")
    ]
    within_budget: Annotated[
        BudgetBoundary | None,
        Field(description="What comparisons count; null if the campaign did not exceed its budget."),
    ] = None
    with_known: Annotated[
        KnownBoundary | None,
        Field(description="With the known results; null if the campaign did not start from any."),
    ] = None


def listed_words(listed: int, distinct: int, what: str = "distinct boundary solution") -> str:
    """Return how many solutions are listed, and of how many if these are not all.

    Args:
        listed: How many are listed, best first.
        distinct: How many there are.
        what: What one of them is called.
    """
    if listed < distinct:
        return f"the best {listed:,} of {distinct:,} {what}s"
    return f"{listed:,} {what}" if listed == 1 else f"{listed:,} {what}s"


class ViolationView(View):
    """A violation of a requirement by a solution."""

    number: Annotated[int, Field(description="Number of the solution.")]
    requirement: str
    time_s: float
    type: str
    name: Annotated[str | None, Field(description="Name that a person gave it.")]
    avoidable: Annotated[Avoidable | None, Field(description=AVOIDABLE)]
    avoided_by: Annotated[AvoidedBy | None, Field(description=AVOIDED_BY)] = None
    at_fault: Annotated[
        bool, Field(description="Whether the ego vehicle was at fault by a rule of thumb; see `avoidable`.")
    ]
    signature: Annotated[
        dict[str, str], Field(description="Features that the rules derive from its circumstances.")
    ]
    circumstances: Annotated[
        dict[str, Any], Field(description="Circumstances as the simulator reported them.")
    ]


class TypeView(View):
    """A type of violation."""

    type: str
    solutions: Annotated[int, Field(description="Number of solutions with a violation of this type.")]
    avoided: Annotated[
        str,
        Field(
            description="In how many of these solutions `avoider` would have avoided it, such as `15 of 20`; their "
            "number alone if nobody would have, or if that was not measured."
        ),
    ]
    instances: Annotated[int, Field(description="Distinct instances: clusters of similar circumstances.")]
    first: Annotated[
        int, Field(description="Number of the first solution, in which the type was discovered.")
    ]
    example: Annotated[
        int,
        Field(
            description="Number of the first solution with a violation that is `avoidable` as the type is, other "
            "than the examples of earlier types, if there is one."
        ),
    ]
    numbers: Annotated[list[int], Field(description="Numbers of its solutions, in ascending order.")]
    again: Annotated[
        str,
        Field(
            description="In how many further drives of its solutions, under other seeds of the campaign, the type "
            "was seen again, such as `3 of 4`; empty if the search simulated none of them again."
        ),
    ] = ""
    named: Annotated[int, Field(description="Number of its violations that a person named.")]
    avoidable: Annotated[
        Avoidable | None,
        Field(description="The best of what its violations are; null if that was measured for none of them."),
    ]
    avoider: Annotated[str, Field(description="The same in words, such as `careful driver`.")]
    avoided_by: Annotated[
        AvoidedBy | None,
        Field(
            description="How that driver avoids them: by `braking` if that avoids any of them; null if none does, or "
            "that was not recorded."
        ),
    ] = None
    avoidable_by: Annotated[
        dict[Avoidable, int],
        Field(
            description="Number of its violations by who would have avoided them, where that was measured."
        ),
    ]
    at_fault: Annotated[
        bool | None,
        Field(
            description="Whether the ego vehicle was at fault by a rule of thumb; null if its violations differ."
        ),
    ]


class Violations(View):
    """The violations of a campaign."""

    rules_version: int
    words: Annotated[str, Field(description="The finding in a sentence, about all violations.")]
    explanation: Annotated[str, Field(description="Who the reference drivers are, in sentences.")]
    types: Annotated[
        list[TypeView],
        Field(
            description="First those that a person named, then those that a careful driver would have avoided, those "
            "that take braking at once, and the rest; each by frequency. `first` tells the order of discovery."
        ),
    ]
    violations: Annotated[list[ViolationView], Field(description="In ascending order of number.")]


class TechniqueLevel(View):
    """A technique at one of its levels; a chain is a list of them, in order."""

    technique: str
    level: int
    levels: Annotated[int, Field(description="Highest level of the technique.")]


class ChainTally(View):
    """How often a chain of techniques was unsafe."""

    chain: list[TechniqueLevel]
    words: str
    unsafe: int
    trials: int


class CombinationView(ChainTally):
    """A chain of techniques with the tallies of its parts and reorderings in the same scenarios."""

    parts: Annotated[
        list[ChainTally],
        Field(
            description="Tallies over the scenarios with simulations of part and chain. The empty chain is a part."
        ),
    ]
    orders: list[ChainTally]
    hazardous: Annotated[
        bool, Field(description="Simulated in at least three scenarios, and unsafe in at least 80% of them.")
    ]
    minimal: Annotated[bool, Field(description="Hazardous, but no part of it is, in the same scenarios.")]
    only_together: Annotated[
        bool,
        Field(description="Hazardous, but every part of it is safe in at least 80% of the same scenarios."),
    ]
    order_matters: Annotated[
        bool, Field(description="Hazardous, but another order is safe in at least 80% of the same scenarios.")
    ]
    alpha: Annotated[
        float | None,
        Field(description="Objective `alpha` on the data set; null if it was not measured there."),
    ] = None
    added_harm: Annotated[
        float | None,
        Field(
            description="How much worse `alpha` is than that of the most harmful part alone, on the data set; harms "
            "that merely add up count. Null unless the chain and each of its techniques alone were measured there."
        ),
    ] = None
    interacts: Annotated[
        bool | None,
        Field(
            description="Whether the added harm reaches `margin`. Null if the added harm or the margin is unknown."
        ),
    ] = None
    together: Annotated[list[int], Field(description="Numbers of unsafe solutions whose parts are all safe.")]
    turned: Annotated[
        list[int], Field(description="Numbers of unsafe solutions that are safe in another order.")
    ]


class StepTally(View):
    """How often a technique at a level was unsafe alone, and how often together with others."""

    step: TechniqueLevel
    words: str
    alone_unsafe: int
    alone_trials: int
    joined_unsafe: int
    joined_trials: int


class Variant(View):
    """A solution with the same scenario as another, and with a subset or another order of its techniques."""

    number: int
    unsafe: bool
    chain: list[TechniqueLevel]
    words: str


class Combinations(View):
    """Results of a campaign on ordered perturbation techniques."""

    words: Annotated[str, Field(description="The finding in a sentence.")]
    margin: Annotated[
        float | None,
        Field(description="Added harm from which a chain interacts; null if the search has no such setting."),
    ] = None
    explanation: Annotated[
        str, Field(description="What added harm means, in sentences; empty if no chain has a known one.")
    ] = ""
    steps: list[StepTally]
    combinations: Annotated[list[CombinationView], Field(description="Most informative first.")]


class LlmCall(View):
    """A call to a language model: one prompt, with all HTTP requests that it took."""

    request: Annotated[int, Field(description="Number of the request for seeds.")]
    turn: Annotated[int, Field(description="0 for the first prompt, 1 for the repair prompt.")]
    outcome: Annotated[
        str,
        Field(
            description="sent, ok, truncated, invalid, declined, refused, unavailable, over_budget or circuit_open."
        ),
    ]
    mode: Annotated[str, Field(description="How structured output was requested.")]
    prompt_hash: str
    calls: Annotated[int, Field(description="HTTP requests sent, whatever became of them.")]
    prompt_tokens: int | None
    completion_tokens: int | None
    estimated: Annotated[
        bool, Field(description="Whether tokens are estimated because the endpoint reported none.")
    ]
    cost: Annotated[float | None, Field(description="Null if no prices are configured.")]
    latency_s: float
    error: Annotated[str | None, Field(description="What went wrong, in words; null if nothing did.")]
    reply: Annotated[
        str | None, Field(description="Raw body of the reply with the API key removed, if requested.")
    ]


class LlmCalls(View):
    """Language-model calls of a campaign."""

    calls: Annotated[list[LlmCall], Field(description="In the order in which they were made.")]
    total_calls: Annotated[int, Field(description="HTTP requests sent, whatever became of them.")]
    max_calls: Annotated[
        int | None, Field(description="How many may be sent; null without a language model.")
    ]
    total_tokens: int
    estimated_tokens: int
    cost: Annotated[float | None, Field(description="Total cost; null if the cost of any call is unknown.")]


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
        dict[str, str], Field(description="What kind of worker each of these capabilities needs, in words.")
    ] = {}


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
    measures_detector: Annotated[
        bool,
        Field(
            description="Whether its drives measure the errors of a detector, to hold it against tolerances."
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
