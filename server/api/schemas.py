"""What the REST API answers with."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from brink.server.campaigns.body import CampaignBody
from brink.server.states import CampaignStatus, JobStatus, SolutionVerdict

MAX_NUMBER = 2**53
"""Largest number of a job or a solution that is looked up: JSON readers keep it exactly."""


class View(BaseModel):
    """Base of all answers. Models are built at their first use: the command line needs few of them."""

    model_config = ConfigDict(frozen=True, defer_build=True)


class CampaignView(View):
    """A campaign and where it stands."""

    id: str
    name: str
    status: CampaignStatus
    status_reason: str
    sequence: Annotated[
        int, Field(description="Grows with every change of the campaign but its jobs' states.")
    ]
    simulations: Annotated[
        int, Field(description="Candidates evaluated so far, measured and failed ones included.")
    ]
    budget: int
    unsafe: int
    failed: int
    measured: Annotated[int, Field(description="Of them, measured on a data set and not simulated.")]
    generation: int
    created_at: datetime
    finished_at: datetime | None
    body: CampaignBody


class CampaignList(View):
    """A page of campaigns, newest first."""

    campaigns: list[CampaignView]
    next: Annotated[str | None, Field(description="Pass as `cursor` to get the next page.")]


class GenerationView(View):
    """Where the archive stood after a generation."""

    number: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    best_fitness: Annotated[float | None, Field(description="Of what the algorithm minimises.")]
    median_fitness: float | None
    dbs: int
    strict_dbs: int
    step_s: float
    told_at: datetime


class Progress(View):
    """Counts, series since a cursor, rates."""

    id: str
    name: str
    status: CampaignStatus
    status_reason: str
    sequence: Annotated[
        int, Field(description="Grows with every change of the campaign but its jobs' states.")
    ]
    budget: int
    simulations: Annotated[int, Field(description="Done so far, this generation's included.")]
    evaluated: int
    unsafe: int
    failed: int
    measured: Annotated[int, Field(description="Measured on a data set and not simulated.")]
    quarantined: int
    queued: int
    leased: int
    generation: int
    rate_per_s: float | None
    remaining_s: float | None
    elapsed_s: float
    workers: Annotated[int, Field(description="Workers heard of lately.")]
    unrunnable: Annotated[
        dict[str, int], Field(description="Queued jobs by a capability that no live worker has.")
    ]
    looks_for_boundary: Annotated[
        bool, Field(description="Whether it looks for the hazard boundary, rather than different violations.")
    ]
    origins: Annotated[
        dict[str, int],
        Field(description="Where solutions come from, once the campaign has ended; empty if unknown."),
    ]
    asking: Annotated[
        str | None, Field(description="What is being asked of a language model, if anything is.")
    ]
    trouble: Annotated[str | None, Field(description="Why the database takes no writes now, if it does not.")]
    trouble_s: Annotated[float, Field(description="For how long.")]
    digest: Annotated[str | None, Field(description="SHA-256 of the archive, once the campaign has ended.")]
    t_b: float
    d_th: float
    generations: list[GenerationView]


class SolutionView(View):
    """A complete solution with its decoded parameters."""

    number: int
    generation: int
    verdict: SolutionVerdict
    robustness: float | None
    objectives: dict[str, float] | None
    failure: str | None
    origin: Annotated[
        str | None,
        Field(description="Where it comes from: random, heuristic, mutation, crossover, llm, llm_repair."),
    ]
    fitness: float | None
    neighbours: int | None
    unsafe_neighbours: int | None
    interval: Annotated[
        tuple[float, float] | None, Field(description="Wilson interval of the unsafe share around it.")
    ]
    seed: int
    attempts: int | None
    words: Annotated[str, Field(description="What it is, for people.")]
    parameters: Annotated[dict[str, dict[str, Any]], Field(description="By component, then by name.")]
    verdicts: Annotated[dict[str, Any] | None, Field(description="All requirements.")] = None
    features: dict[str, Any] | None = None
    provenance: dict[str, Any] | None = None
    spec: Annotated[dict[str, Any] | None, Field(description="The episode, to run it again.")] = None


class SolutionPage(View):
    """Solutions, ascending by number."""

    solutions: list[SolutionView]
    next: Annotated[int | None, Field(description="Pass as `after` to get the next page.")]


class DbsCell(View):
    """How many distinct boundary solutions there are for one pair of thresholds."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int


class Boundary(View):
    """The distinct boundary solutions."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int
    note: str
    grid: Annotated[list[DbsCell], Field(description="The paper's grid of thresholds.")]
    solutions: list[SolutionView]
    strict: Annotated[list[int], Field(description="Numbers of the strict distinct boundary solutions.")]


class TechniqueLevel(View):
    """A technique at one of its levels; a chain is a list of them, in order."""

    technique: str
    level: int
    levels: Annotated[int, Field(description="The highest level it has.")]


class ChainTally(View):
    """How often a chain was unsafe."""

    chain: list[TechniqueLevel]
    words: str
    unsafe: int
    trials: int


class CombinationView(ChainTally):
    """A chain of techniques, and what became of its parts and other orders in the same places."""

    parts: Annotated[
        list[ChainTally], Field(description="Where both were simulated; an empty chain is nothing at all.")
    ]
    orders: list[ChainTally]
    hazardous: Annotated[bool, Field(description="Unsafe in at least four places of five.")]
    minimal: Annotated[bool, Field(description="Hazardous, and no part is.")]
    only_together: Annotated[
        bool, Field(description="Hazardous, and every part is safe in four places of five.")
    ]
    order_matters: Annotated[
        bool, Field(description="Hazardous, and another order is safe in four places of five.")
    ]
    together: Annotated[list[int], Field(description="Its unsafe solutions where every part is safe.")]
    turned: Annotated[list[int], Field(description="Its unsafe solutions where another order is safe.")]


class StepTally(View):
    """A technique at a level: how often unsafe alone, and how often with others."""

    step: TechniqueLevel
    words: str
    alone_unsafe: int
    alone_trials: int
    joined_unsafe: int
    joined_trials: int


class Variant(View):
    """A solution in the same place as another, with a part of its techniques or another order."""

    number: int
    unsafe: bool
    chain: list[TechniqueLevel]
    words: str


class Combinations(View):
    """What a campaign on ordered techniques found."""

    steps: list[StepTally]
    combinations: Annotated[list[CombinationView], Field(description="The most telling first.")]


class LlmCall(View):
    """A call of a language model."""

    request: Annotated[int, Field(description="Which request for seeds.")]
    turn: Annotated[int, Field(description="0 for the question, 1 for the repair turn.")]
    outcome: str
    mode: Annotated[str, Field(description="How the form of the reply was asked for.")]
    prompt_hash: str
    calls: Annotated[int, Field(description="Requests that the endpoint worked on, or may have.")]
    prompt_tokens: int | None
    completion_tokens: int | None
    estimated: Annotated[bool, Field(description="Whether tokens are an estimate: the endpoint stated none.")]
    cost: Annotated[float | None, Field(description="Unknown without prices; never 0 for that.")]
    latency_s: float
    error: str | None
    reply: Annotated[
        str | None, Field(description="The raw body of the reply, but for the key, if asked for.")
    ]


class LlmCalls(View):
    """The calls of a campaign."""

    calls: Annotated[list[LlmCall], Field(description="In the order of asking.")]
    total_calls: int
    total_tokens: int
    estimated_tokens: int
    cost: Annotated[float | None, Field(description="Of all; None if any is unknown.")]


class DistanceBlock(View):
    """A block of the distance matrix."""

    numbers: list[int]
    distances: list[list[float]]


class JobViewModel(View):
    """A job as it stands."""

    id: int
    campaign: str
    number: int
    kind: str
    needs: str
    status: JobStatus
    attempt: int
    max_attempts: int
    worker: str | None
    last_error: str | None
    created_at: datetime
    finished_at: datetime | None


class JobList(View):
    """Jobs, ascending by id."""

    jobs: list[JobViewModel]
    next: int | None


class JobCounts(View):
    """How many jobs are not done: one entry a list for those that are alike."""

    status: Annotated[list[JobStatus], Field(description="Queued, leased or quarantined.")]
    campaign: list[str]
    kind: list[str]
    needs: Annotated[list[str], Field(description="What a worker must be able to run.")]
    jobs: list[int]
    campaigns: Annotated[dict[str, str], Field(description="Names of the campaigns by their ids.")]
    paused: Annotated[list[str], Field(description="Of them, those that are paused with jobs in the queue.")]
    ended: Annotated[
        list[str], Field(description="Of them, those that have ended: nobody waits for their jobs.")
    ]
    unrunnable: Annotated[
        dict[str, int],
        Field(
            description="Queued jobs, but for those of paused campaigns, by a need that no live worker meets."
        ),
    ]


class WorkerView(View):
    """A worker that was heard of."""

    id: str
    host: str
    pid: int
    version: str
    capabilities: list[str]
    first_seen_at: datetime
    last_seen_at: datetime
    seen_s_ago: float
    live: bool
    jobs_done: int
    jobs_failed: int
    jobs_held: int


class ProblemView(View):
    """A problem of the catalogue."""

    id: str
    summary: str
    params: Annotated[dict[str, Any], Field(description="JSON schema of its parameters.")]
    space: Annotated[dict[str, Any], Field(description="Its search space with default parameters.")]
    simulator: str | None
    finds: Annotated[
        list[str],
        Field(description="What a campaign on it tells besides a boundary: violations, combinations."),
    ]
    algorithm_defaults: Annotated[
        dict[str, Any], Field(description="Defaults of algorithms' parameters on it, in place of their own.")
    ]


class AlgorithmView(View):
    """An algorithm of the catalogue."""

    id: str
    summary: str
    params: Annotated[dict[str, Any], Field(description="JSON schema of its parameters.")]


class BeingMade(View):
    """A trace that is not there yet."""

    detail: str


class ProblemDetail(BaseModel):
    """An error, as RFC 9457 has it."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: Annotated[
        list[dict[str, str | None]],
        Field(description="For input errors: pointer, message and nearest valid name of each wrong field."),
    ] = []
