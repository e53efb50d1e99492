"""Routes of experiments: submit, list, control, progress, results."""

import asyncio
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from sqlalchemy import Connection

from brink.search.analysis.comparison import Duel, Repeat, conclusion, duels, standings, with_low_controls
from brink.search.analysis.paper import D_THS, LEVEL, PAPER_FRACTIONS, PAPER_T_BS, Measure
from brink.search.analysis.scores import Control
from brink.server.api.campaigns import deletion_view
from brink.server.api.context import Context, Services
from brink.server.api.experiment_findings import find_experiment_pairs, find_experiment_thresholds
from brink.server.api.responses import (
    COMPUTING,
    NOT_MODIFIED,
    THRESHOLDS,
    Alpha,
    Cursor,
    DocumentHash,
    IdempotencyKey,
    computing,
    existing,
    next_cursor,
    read_cursor,
    set_created,
    set_etag,
)
from brink.server.api.schemas import (
    ControlView,
    Deletion,
    ExperimentList,
    ExperimentProgress,
    ExperimentSummary,
    ExperimentView,
    MemberView,
    RepeatView,
)
from brink.server.campaigns.follow_ups.store import read_pair_campaigns
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import read
from brink.server.db.writer import Trouble
from brink.server.experiments import store
from brink.server.experiments.body import ExperimentBody
from brink.server.experiments.pairs import settings_of
from brink.server.experiments.store import Experiment
from brink.server.experiments.thresholds import distance_of
from brink.server.findings.experiments import ExperimentPairs, ExperimentThresholds
from brink.server.queue.job_store import count_unfinished
from brink.server.queue.workers import live_capabilities
from brink.server.states import ENDED, CampaignStatus, JobStatus
from brink.server.views import View

router = APIRouter(prefix="/experiments", tags=["experiments"])


class StandingView(View):
    """Mean and 95% interval of a method, or of its control, for one pair of thresholds."""

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
    """Comparison of a method with another, or with its own control, for one pair of thresholds."""

    problem: str
    first: str
    second: str
    control: Annotated[bool, Field(description="Whether the second is the control of the first.")]
    measure: Measure
    t_b: float
    d_th: float
    u: float
    p: Annotated[
        float | None, Field(description="p value; null if all values are equal, and nothing is tested.")
    ]
    p_holm: Annotated[
        float | None,
        Field(description="p value, corrected over all comparisons of this problem and measure."),
    ]
    found_nothing: Annotated[
        bool,
        Field(
            description="Whether one of them, or both, found nothing in any campaign: N/A in the paper's tables."
        ),
    ]
    a12: float
    effect: str
    differs: Annotated[bool, Field(description="Whether the corrected p value is at most alpha.")]
    says: Annotated[str, Field(description="Conclusion in words.")]


class Results(View):
    """Result tables of an experiment, from its finished campaigns."""

    id: str
    name: str
    status: CampaignStatus
    created_at: datetime
    campaigns: int
    scored: Annotated[int, Field(description="Finished campaigns included in the tables.")]
    fractions: Annotated[list[float], Field(description="Fractions of the budget.")]
    t_bs: list[float]
    d_ths: Annotated[
        list[float],
        Field(description="Values of d_th; methods are compared only at those of the paper's tables."),
    ]
    alpha: Annotated[
        float, Field(description="Corrected p value up to which a difference is significant.")
    ] = LEVEL
    pairs: Annotated[
        ExperimentPairs | None,
        Field(description="Pairs across the boundary; null if the experiment has no section `pairs`."),
    ] = None
    thresholds: Annotated[
        ExperimentThresholds | None,
        Field(description="Thresholds; null if the experiment has no section `thresholds`."),
    ] = None
    standings: list[StandingView]
    duels: list[DuelView]
    repeats: list[RepeatView]


@router.post("", status_code=201, responses=existing(ExperimentView, "experiment"))
async def submit_experiment(
    body: ExperimentBody, services: Services, response: Response, idempotency_key: IdempotencyKey = None
) -> ExperimentView:
    """Submit an experiment: every algorithm on every problem with every seed. If any cannot run, none does."""
    experiment, new = await services.experiments.submit(body, idempotency_key)
    set_created(response, f"experiments/{experiment.id}", new=new)
    return experiment_view(experiment)


@router.get("", responses=NOT_MODIFIED)
async def list_experiments(
    services: Services,
    request: Request,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    cursor: Cursor = None,
    document_hash: DocumentHash = None,
) -> ExperimentList:
    """List experiments, newest first. Supports conditional requests with ETag."""
    found = await services.experiments.list(
        limit=limit, before=read_cursor(cursor), document_hash=document_hash
    )
    view = ExperimentList(
        experiments=[summary_view(experiment) for experiment in found], next=next_cursor(found, limit)
    )
    set_etag(request, response, view)
    return view


@router.get("/{experiment_id}", responses=NOT_MODIFIED)
async def get_experiment(
    experiment_id: str, services: Services, request: Request, response: Response
) -> ExperimentView:
    """Return an experiment by its id or a unique prefix of it. Supports conditional requests with ETag."""
    view = experiment_view(await services.experiments.get(experiment_id))
    set_etag(request, response, view)
    return view


@router.get("/{experiment_id}/progress", responses=NOT_MODIFIED)
async def get_progress(
    experiment_id: str, services: Services, request: Request, response: Response
) -> ExperimentProgress:
    """Return counts and rates over all campaigns of an experiment. Supports conditional requests with ETag."""
    experiment = await services.experiments.get(experiment_id)
    seen_s, trouble = services.settings.worker_seen_s, services.queue.writer.trouble
    view = await read(services.engines, lambda c: read_progress(c, experiment, seen_s, trouble))
    set_etag(request, response, view, leave_out=("elapsed_s", "rate_per_s", "remaining_s", "trouble_s"))
    return view


@router.get("/{experiment_id}/follow-ups")
async def get_follow_ups(experiment_id: str, services: Services) -> ExperimentProgress:
    """Return counts and rates over the campaigns that follow up the pairs and thresholds of an experiment.

    These are the campaigns that simulate both sides of pairs or ends of thresholds again with other seeds or with
    ground truth, except cancelled and failed ones.
    """
    experiment = await services.experiments.get(experiment_id)
    seen_s, trouble = services.settings.worker_seen_s, services.queue.writer.trouble

    def look(connection: Connection) -> ExperimentProgress:
        campaigns = read_pair_campaigns(connection, [member.campaign.id for member in experiment.members])
        return progress_of(connection, campaigns, _follow_up_summary(experiment, campaigns), seen_s, trouble)

    return await read(services.engines, look)


@router.post("/{experiment_id}/pause")
async def pause_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """Pause an experiment: workers get no more of its jobs; results of running jobs are still accepted."""
    return summary_view(await services.experiments.pause(experiment_id))


@router.post("/{experiment_id}/resume")
async def resume_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """Resume the paused campaigns of an experiment."""
    return summary_view(await services.experiments.resume(experiment_id))


@router.post("/{experiment_id}/cancel")
async def cancel_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """Cancel the campaigns of an experiment that have not ended; their results are kept."""
    return summary_view(await services.experiments.cancel(experiment_id))


@router.delete("/{experiment_id}", status_code=204)
async def delete_experiment(experiment_id: str, services: Services) -> None:
    """Delete an experiment with its campaigns and their follow-ups; all of them must have ended."""
    await services.experiments.delete(experiment_id)


@router.get("/{experiment_id}/deletion")
async def get_deletion(experiment_id: str, services: Services) -> Deletion:
    """Return the campaigns that deleting an experiment would delete: its own, and all their follow-ups."""
    return deletion_view(await services.experiments.doomed(experiment_id))


@router.get("/{experiment_id}/results", responses=COMPUTING)
async def get_results(
    experiment_id: str,
    services: Services,
    wait_s: Annotated[
        float, Query(ge=0, le=60, description="How long to wait for the scores, in seconds.")
    ] = 10.0,
    alpha: Alpha = LEVEL,
) -> Results:
    """Return the result tables of the campaigns that have finished.

    These are DBS and strict DBS at fractions of the budget, each computed from the solutions evaluated by then; means
    with intervals; and Mann-Whitney U with Vargha-Delaney A12 between methods. With a section `pairs`, also the pairs
    across the boundary; with a section `thresholds`, also the thresholds.
    """
    experiment = await services.experiments.get(experiment_id)
    (repeats, missing), pairs, thresholds = await asyncio.gather(
        services.scorebook.repeats(experiment, wait_s),
        _pairs(experiment, services, wait_s, alpha),
        _thresholds(experiment, services, wait_s, alpha),
    )
    if missing:
        scored = f"scored {len(repeats)} of {len(repeats) + missing} finished campaigns"
        return computing(scored)  # type: ignore[no-any-return]
    if isinstance(pairs, str):
        return computing(pairs)  # type: ignore[no-any-return]
    if isinstance(thresholds, str):
        return computing(thresholds)  # type: ignore[no-any-return]
    return await services.analyses.run(
        lambda: results_view(experiment, repeats, pairs, thresholds, alpha=alpha)
    )


async def _pairs(
    experiment: Experiment, services: Context, wait_s: float, alpha: float
) -> ExperimentPairs | str | None:
    """Return an experiment's pairs, if it asks for any, or a description of what is still being computed."""
    if experiment.body.pairs is None:
        return None
    return await find_experiment_pairs(services, experiment, settings_of(experiment.body), wait_s, alpha)


async def _thresholds(
    experiment: Experiment, services: Context, wait_s: float, alpha: float
) -> ExperimentThresholds | str | None:
    """Return an experiment's thresholds, if it asks for any, or a description of what is still being computed."""
    if experiment.body.thresholds is None:
        return None
    d_th = distance_of(experiment.body)
    return await find_experiment_thresholds(services, experiment, d_th, wait_s, alpha)


RATE_S = 60.0
"""Time window of the rate."""


def summary_view(experiment: Experiment) -> ExperimentSummary:
    """Return the response schema of an experiment, without its campaigns."""
    return ExperimentSummary(**_summary(experiment))


def _summary(experiment: Experiment) -> dict[str, Any]:
    campaigns = [member.campaign for member in experiment.members]
    return {
        "id": experiment.id,
        "name": experiment.body.name,
        "status": experiment.status,
        "campaigns": experiment.body.campaigns,
        "deleted": experiment.body.campaigns - len(campaigns),
        "finished": sum(campaign.status is CampaignStatus.FINISHED for campaign in campaigns),
        "simulations": experiment.simulations,
        "budget": experiment.budget,
        "failed": sum(campaign.failed for campaign in campaigns),
        "created_at": experiment.created_at,
    }


def _follow_up_summary(experiment: Experiment, campaigns: Sequence[Campaign]) -> dict[str, Any]:
    statuses = {campaign.status for campaign in campaigns}
    open_ones = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)
    return {
        "id": experiment.id,
        "name": f"{experiment.body.name}: simulated again",
        "status": next((status for status in open_ones if status in statuses), CampaignStatus.FINISHED),
        "campaigns": len(campaigns),
        "deleted": 0,
        "finished": sum(campaign.status is CampaignStatus.FINISHED for campaign in campaigns),
        "simulations": sum(campaign.completed for campaign in campaigns),
        "budget": sum(
            campaign.completed if campaign.status is CampaignStatus.FINISHED else campaign.budget
            for campaign in campaigns
        ),
        "failed": sum(campaign.failed for campaign in campaigns),
        "created_at": min((one.created_at for one in campaigns), default=experiment.created_at),
    }


def experiment_view(experiment: Experiment) -> ExperimentView:
    """Return the response schema of an experiment, with its campaigns."""
    return ExperimentView(
        **_summary(experiment),
        body=experiment.body,
        thresholds=THRESHOLDS,
        members=[
            MemberView(
                campaign=member.campaign.id,
                method=member.method,
                problem=member.problem,
                seed=member.campaign.body.seed,
                status=member.campaign.status,
                status_reason=member.campaign.status_reason,
                simulations=member.campaign.completed,
                unsafe=member.campaign.unsafe,
                failed=member.campaign.failed,
            )
            for member in experiment.members
        ],
    )


def read_progress(
    connection: Connection, experiment: Experiment, worker_seen_s: float, trouble: Trouble | None
) -> ExperimentProgress:
    """Return counts and rates over all campaigns of an experiment.

    Args:
        connection: Read connection.
        experiment: The experiment.
        worker_seen_s: Time since its last contact after which a worker is no longer live, in seconds.
        trouble: Why the database rejects writes, if it does.
    """
    campaigns = [member.campaign for member in experiment.members]
    return progress_of(connection, campaigns, _summary(experiment), worker_seen_s, trouble)


def progress_of(
    connection: Connection,
    campaigns: Sequence[Campaign],
    summary: Mapping[str, Any],
    worker_seen_s: float,
    trouble: Trouble | None,
) -> ExperimentProgress:
    """Return counts and rates over campaigns.

    Args:
        connection: Read connection.
        campaigns: The campaigns.
        summary: The fields of `ExperimentSummary`.
        worker_seen_s: Time since its last contact after which a worker is no longer live, in seconds.
        trouble: Why the database rejects writes, if it does.
    """
    ids = [campaign.id for campaign in campaigns]
    running = [campaign for campaign in campaigns if campaign.status not in ENDED]
    open_jobs = count_unfinished(connection, *ids)
    queued, leased = open_jobs.get(JobStatus.QUEUED, 0), open_jobs.get(JobStatus.LEASED, 0)
    in_flight = max(0, store.count_in_flight(connection, [one.id for one in running]) - queued - leased)
    ended = summary["status"] in ENDED
    ends = [campaign.finished_at for campaign in campaigns if campaign.finished_at is not None]
    now = max(ends) if ended and ends else datetime.now(UTC)
    elapsed_s = max(0.0, (now - summary["created_at"]).total_seconds())
    whole = ended or elapsed_s <= RATE_S
    span_s = elapsed_s if whole else RATE_S
    since = None if whole else now - timedelta(seconds=RATE_S)
    before = 0 if since is None else store.completed_by(connection, campaigns, since)
    done = sum(campaign.completed for campaign in campaigns) + in_flight
    cached = store.cached_after(connection, campaigns, since or datetime.min.replace(tzinfo=UTC))
    simulated = done - before - cached
    rate = simulated / span_s if span_s > 0 and simulated > 0 else None
    workers = len(live_capabilities(connection, worker_seen_s))
    waiting = summary["status"] is not CampaignStatus.RUNNING or (queued > 0 and leased == 0 and workers == 0)
    remaining = sum(max(0, campaign.budget - campaign.completed) for campaign in running)
    remaining = max(0, remaining - in_flight)
    return ExperimentProgress(
        **{**summary, "simulations": done},
        rate_per_s=rate,
        cached=cached,
        remaining_s=remaining / rate if rate and not waiting else None,
        elapsed_s=elapsed_s,
        queued=queued,
        leased=leased,
        quarantined=open_jobs.get(JobStatus.QUARANTINED, 0),
        workers=workers,
        paused=[
            f"{campaign.id}: {campaign.status_reason or 'paused by a user'}"
            for campaign in campaigns
            if campaign.status is CampaignStatus.PAUSED
        ],
        trouble=trouble.reason if trouble else None,
        trouble_s=trouble.span_s if trouble else 0.0,
    )


def results_view(
    experiment: Experiment,
    repeats: Sequence[Repeat],
    pairs: ExperimentPairs | None = None,
    thresholds: ExperimentThresholds | None = None,
    *,
    alpha: float = LEVEL,
) -> Results:
    """Return the result tables of an experiment."""
    stand = standings(repeats)
    means = {(one.line, one.measure, one.t_b, one.d_th): one.value.mean for one in stand}
    problems = {repeat.problem for repeat in repeats}
    low = {problem: with_low_controls(repeats, problem) for problem in problems}

    def says(one: Duel) -> str:
        first, second = (means[line, one.measure, one.t_b, one.d_th] for line in (one.first, one.second))
        return conclusion(one, first, second, low[one.first.problem])

    return Results(
        id=experiment.id,
        name=experiment.body.name,
        status=experiment.status,
        created_at=experiment.created_at,
        campaigns=experiment.body.campaigns,
        scored=len(repeats),
        fractions=list(PAPER_FRACTIONS),
        t_bs=list(PAPER_T_BS),
        d_ths=list(D_THS),
        alpha=alpha,
        pairs=pairs,
        thresholds=thresholds,
        standings=[
            StandingView(
                problem=one.line.problem,
                method=one.line.method,
                control=one.line.control,
                measure=one.measure,
                t_b=one.t_b,
                d_th=one.d_th,
                mean=one.value.mean,
                low=one.value.low,
                high=one.value.high,
                repeats=one.value.repeats,
            )
            for one in stand
        ],
        duels=[
            DuelView(
                problem=one.first.problem,
                first=one.first.method,
                second=one.second.method,
                control=one.second.control,
                measure=one.measure,
                t_b=one.t_b,
                d_th=one.d_th,
                u=one.result.u,
                p=one.result.p_value,
                p_holm=one.adjusted,
                a12=one.result.a12,
                effect=one.size,
                found_nothing=one.found_nothing,
                differs=one.differs,
                says=says(one),
            )
            for one in duels(repeats, level=alpha)
        ],
        repeats=[
            RepeatView(
                problem=one.problem,
                method=one.method,
                seed=one.seed,
                campaign=one.campaign,
                evaluated=one.scores.evaluated,
                unsafe=one.scores.unsafe,
                dbs=one.scores.figures.dbs.tolist(),
                strict=one.scores.figures.strict.tolist(),
                control=control_view(one.scores.control),
            )
            for one in repeats
        ],
    )


def control_view(control: Control | None) -> ControlView | None:
    """Return the scores of a campaign's control."""
    if control is None:
        return None
    return ControlView(
        unsafe_share=control.unsafe_share,
        behaviours_a_scenario=control.repeats,
        reads_low=control.reads_low,
        dbs=control.figures.dbs.tolist(),
        strict=control.figures.strict.tolist(),
        spread=control.spread.tolist(),
    )
