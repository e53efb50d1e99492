"""Routes of experiments: submit, list, look, control, progress, results."""

import asyncio
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import JSONResponse

from brink.server.api.conditional import NOTHING_NEW, tag
from brink.server.api.context import Services
from brink.server.api.cursor import cursor_of, read_cursor
from brink.server.api.experiment_schemas import (
    ExperimentList,
    ExperimentProgress,
    ExperimentSummary,
    ExperimentView,
    Results,
)
from brink.server.api.experiment_views import experiment_view, read_progress, results_view, summary_view
from brink.server.api.schemas import BeingMade
from brink.server.db.engine import read
from brink.server.experiments.body import ExperimentBody

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
