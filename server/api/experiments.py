"""Routes of experiments: submit, list, control, progress, results."""

import asyncio
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import JSONResponse
from sqlalchemy import Connection

from brink.search.analysis.boundary import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.analysis.comparison import (
    LEVEL,
    Duel,
    Repeat,
    conclusion,
    duels,
    standings,
    with_low_controls,
)
from brink.search.analysis.scores import Control
from brink.server.api.conditional import NOTHING_NEW, tag
from brink.server.api.context import Services
from brink.server.api.cursor import cursor_of, read_cursor
from brink.server.api.experiment_schemas import (
    ControlView,
    DuelView,
    ExperimentList,
    ExperimentProgress,
    ExperimentSummary,
    ExperimentView,
    MemberView,
    RepeatView,
    Results,
    StandingView,
)
from brink.server.api.schemas import BeingMade
from brink.server.campaigns.store import ENDED
from brink.server.db.engine import read
from brink.server.db.writer import Trouble
from brink.server.experiments import store
from brink.server.experiments.body import ExperimentBody
from brink.server.experiments.store import Experiment
from brink.server.queue.job_store import count_unfinished
from brink.server.queue.workers import live_capabilities
from brink.server.states import CampaignStatus, JobStatus

router = APIRouter(prefix="/experiments", tags=["experiments"])


@router.post(
    "",
    status_code=201,
    responses={
        200: {
            "model": ExperimentView,
            "description": "The experiment of the first time, by its Idempotency-Key.",
        }
    },
)
async def submit_experiment(
    body: ExperimentBody,
    services: Services,
    response: Response,
    idempotency_key: Annotated[str | None, Header(max_length=200, pattern="^[ -~]+$")] = None,
) -> ExperimentView:
    """Submit an experiment: every algorithm on every problem with every seed; nothing, if one of them cannot run."""
    experiment, new = await services.experiments.submit(body, idempotency_key)
    response.headers["Location"] = f"/api/v1/experiments/{experiment.id}"
    if not new:
        response.status_code = 200
    return experiment_view(experiment)


@router.get("", responses=NOTHING_NEW)
async def list_experiments(
    services: Services,
    request: Request,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
    document_hash: Annotated[str | None, Query(max_length=64, pattern="^[0-9a-f]*$")] = None,
) -> ExperimentList:
    """List experiments, newest first. Answers 304 to a known ETag."""
    found = await services.experiments.list(
        limit=limit, before=read_cursor(cursor) if cursor else None, document_hash=document_hash
    )
    last = found[-1] if len(found) == limit else None
    view = ExperimentList(
        experiments=[summary_view(experiment) for experiment in found],
        next=cursor_of(last.created_at, last.id) if last else None,
    )
    tag(request, response, view)
    return view


@router.get("/{experiment_id}", responses=NOTHING_NEW)
async def get_experiment(
    experiment_id: str, services: Services, request: Request, response: Response
) -> ExperimentView:
    """Return an experiment by its id, or by the beginning of its id if that is unique.

    Answers 304 to a known ETag.
    """
    view = experiment_view(await services.experiments.get(experiment_id))
    tag(request, response, view)
    return view


@router.get("/{experiment_id}/progress", responses=NOTHING_NEW)
async def get_progress(
    experiment_id: str, services: Services, request: Request, response: Response
) -> ExperimentProgress:
    """Return counts and rates of all campaigns together. Answers 304 to a known ETag."""
    experiment = await services.experiments.get(experiment_id)
    seen_s, trouble = services.settings.worker_seen_s, services.queue.writer.trouble
    view = await read(services.engines, lambda c: read_progress(c, experiment, seen_s, trouble))
    tag(request, response, view, leave_out=("elapsed_s", "rate_per_s", "remaining_s", "trouble_s"))
    return view


@router.post("/{experiment_id}/pause")
async def pause_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """Hand out no more jobs of its campaigns; what is running is still taken in."""
    return summary_view(await services.experiments.pause(experiment_id))


@router.post("/{experiment_id}/resume")
async def resume_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """Go on with those of its campaigns that are paused."""
    return summary_view(await services.experiments.resume(experiment_id))


@router.post("/{experiment_id}/cancel")
async def cancel_experiment(experiment_id: str, services: Services) -> ExperimentSummary:
    """End those of its campaigns that have not ended; what they found stays."""
    return summary_view(await services.experiments.cancel(experiment_id))


@router.delete("/{experiment_id}", status_code=204)
async def delete_experiment(experiment_id: str, services: Services) -> None:
    """Delete an experiment that has ended, with all of its campaigns."""
    await services.experiments.delete(experiment_id)


@router.get(
    "/{experiment_id}/results",
    responses={202: {"model": BeingMade, "description": "Being computed; ask again after `Retry-After`."}},
)
async def get_results(
    experiment_id: str,
    services: Services,
    wait_s: Annotated[float, Query(ge=0, le=60, description="How long to wait for scores.")] = 10.0,
) -> Results:
    """Return tables and figures of the campaigns that have finished.

    Figures are DBS and strict DBS at shares of the budget, each scored with what was known then; tables are means
    with intervals, and Mann-Whitney U with Vargha-Delaney A12 between methods.
    """
    experiment = await services.experiments.get(experiment_id)
    repeats, missing = await services.scorebook.repeats(experiment, wait_s)
    if missing:
        view = BeingMade(detail=f"scored {len(repeats)} of {len(repeats) + missing} finished campaigns")
        return JSONResponse(view.model_dump(), status_code=202, headers={"Retry-After": "2"})  # type: ignore[return-value]
    return await asyncio.get_running_loop().run_in_executor(None, results_view, experiment, repeats)


RATE_S = 60.0
"""Time over which the rate is taken."""


def summary_view(experiment: Experiment) -> ExperimentSummary:
    """Return an experiment without its campaigns."""
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


def experiment_view(experiment: Experiment) -> ExperimentView:
    """Return an experiment with its campaigns."""
    return ExperimentView(
        **_summary(experiment),
        body=experiment.body,
        members=[
            MemberView(
                campaign=member.campaign.id, method=member.method, problem=member.problem,
                seed=member.campaign.body.seed, status=member.campaign.status,
                status_reason=member.campaign.status_reason, simulations=member.campaign.completed,
                unsafe=member.campaign.unsafe, failed=member.campaign.failed,
            )
            for member in experiment.members
        ],
    )  # fmt: skip


def read_progress(
    connection: Connection, experiment: Experiment, worker_seen_s: float, trouble: Trouble | None
) -> ExperimentProgress:
    """Return counts and rates of all campaigns of an experiment together."""
    ids = [member.campaign.id for member in experiment.members]
    running = [member.campaign.id for member in experiment.members if member.campaign.status not in ENDED]
    open_jobs = count_unfinished(connection, *ids)
    queued, leased = open_jobs.get(JobStatus.QUEUED, 0), open_jobs.get(JobStatus.LEASED, 0)
    in_generations = max(0, store.count_current_generations(connection, running) - queued - leased)
    ended = experiment.status in ENDED
    ends = [m.campaign.finished_at for m in experiment.members if m.campaign.finished_at is not None]
    now = max(ends) if ended and ends else datetime.now(UTC)
    elapsed_s = max(0.0, (now - experiment.created_at).total_seconds())
    span_s = elapsed_s if ended else min(RATE_S, elapsed_s)
    before = store.completed_by(connection, ids, now - timedelta(seconds=span_s))
    told = experiment.simulations
    done = told + in_generations
    if before:  # of what was in generations by then nothing is known
        rate = (told - before) / span_s if span_s > 0 and told > before else None
    else:
        rate = done / elapsed_s if elapsed_s > 0 and done else None
    remaining = sum(
        max(0, member.campaign.body.budget.simulations - member.campaign.completed)
        for member in experiment.members
        if member.campaign.status not in ENDED
    )
    remaining = max(0, remaining - in_generations)
    return ExperimentProgress(
        **{**_summary(experiment), "simulations": done},
        rate_per_s=rate,
        remaining_s=remaining / rate if rate and not ended else None,
        elapsed_s=elapsed_s,
        queued=queued,
        leased=leased,
        quarantined=open_jobs.get(JobStatus.QUARANTINED, 0),
        workers=len(live_capabilities(connection, worker_seen_s)),
        paused=[
            f"{member.campaign.id}: {member.campaign.status_reason or 'by hand'}"
            for member in experiment.members
            if member.campaign.status is CampaignStatus.PAUSED
        ],
        trouble=trouble.reason if trouble else None,
        trouble_s=trouble.span_s if trouble else 0.0,
    )


def results_view(experiment: Experiment, repeats: Sequence[Repeat]) -> Results:
    """Return the tables of an experiment."""
    stand = standings(repeats)
    means = {(one.line, one.measure, one.t_b, one.d_th): one.value.mean for one in stand}
    problems = {repeat.problem for repeat in repeats}
    low = {problem: with_low_controls(repeats, problem) for problem in problems}

    def says(one: Duel) -> str:
        first, second = (means[line, one.measure, one.t_b, one.d_th] for line in (one.first, one.second))
        return conclusion(one, first, second, low[one.first.problem])

    return Results(
        id=experiment.id, name=experiment.body.name, status=experiment.status,
        created_at=experiment.created_at, campaigns=experiment.body.campaigns, scored=len(repeats),
        fractions=list(PAPER_FRACTIONS), t_bs=list(PAPER_T_BS), d_ths=list(PAPER_D_THS),
        standings=[
            StandingView(
                problem=one.line.problem, method=one.line.method, control=one.line.control,
                measure=one.measure, t_b=one.t_b, d_th=one.d_th, mean=one.value.mean, low=one.value.low,
                high=one.value.high, repeats=one.value.repeats,
            )
            for one in stand
        ],
        duels=[
            DuelView(
                problem=one.first.problem, first=one.first.method, second=one.second.method,
                control=one.second.control, measure=one.measure, t_b=one.t_b, d_th=one.d_th,
                u=one.result.u, p=one.result.p_value, p_holm=one.adjusted, a12=one.result.a12,
                effect=one.size, differs=one.adjusted <= LEVEL, says=says(one),
            )
            for one in duels(repeats)
        ],
        repeats=[
            RepeatView(
                problem=one.problem, method=one.method, seed=one.seed, campaign=one.campaign,
                evaluated=one.scores.evaluated, unsafe=one.scores.unsafe,
                dbs=one.scores.figures.dbs.tolist(), strict=one.scores.figures.strict.tolist(),
                control=control_view(one.scores.control),
            )
            for one in repeats
        ],
    )  # fmt: skip


def control_view(control: Control | None) -> ControlView | None:
    """Return what the control of a campaign reached."""
    if control is None:
        return None
    return ControlView(
        unsafe_share=control.unsafe_share, behaviours_a_scenario=control.repeats, reads_low=control.reads_low,
        dbs=control.figures.dbs.tolist(), strict=control.figures.strict.tolist(),
        spread=control.spread.tolist(),
    )  # fmt: skip
