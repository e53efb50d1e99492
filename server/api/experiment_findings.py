"""Routes of the pairs and thresholds that the campaigns of an experiment found."""

from typing import Annotated

from fastapi import APIRouter, Query

from brink.search.analysis.pair_comparison import PairStanding
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.threshold_comparison import ThresholdStanding
from brink.server.api.context import Context, Services
from brink.server.api.responses import COMPUTING, Alpha, computing
from brink.server.campaigns.pairs import PairSettings
from brink.server.experiments.pairs import settings_of
from brink.server.experiments.store import Experiment
from brink.server.experiments.thresholds import distance_of
from brink.server.findings.experiments import ExperimentPairs, ExperimentThresholds

router = APIRouter(prefix="/experiments", tags=["experiments"])

Distance = Annotated[
    float | None,
    Query(ge=0, le=1, description="Smallest distance between distinct ones; the experiment's by default."),
]
Wait = Annotated[float, Query(ge=0, le=60, description="How long to wait for the answer, in seconds.")]


@router.get("/{experiment_id}/pairs", responses=COMPUTING)
async def get_experiment_pairs(
    experiment_id: str,
    services: Services,
    eps: Annotated[
        float | None,
        Query(ge=0, le=1, description="Largest distance between the sides; the experiment's by default."),
    ] = None,
    d_th: Distance = None,
    wait_s: Wait = 10.0,
    alpha: Alpha = LEVEL,
) -> ExperimentPairs:
    """Return how many pairs across the boundary the finished campaigns found, and how many hold.

    All campaigns are searched for pairs with the same `eps` and `d_th`, so that methods can be compared.
    """
    experiment = await services.experiments.get(experiment_id)
    settings = settings_of(experiment.body, eps, d_th)
    found = await find_experiment_pairs(services, experiment, settings, wait_s, alpha)
    return computing(found) if isinstance(found, str) else found


@router.get("/{experiment_id}/thresholds", responses=COMPUTING)
async def get_experiment_thresholds(
    experiment_id: str, services: Services, d_th: Distance = None, wait_s: Wait = 10.0, alpha: Alpha = LEVEL
) -> ExperimentThresholds:
    """Return how many thresholds the finished campaigns found, of how many kinds, and how many are confirmed."""
    experiment = await services.experiments.get(experiment_id)
    settings = distance_of(experiment.body, d_th)
    found = await find_experiment_thresholds(services, experiment, settings, wait_s, alpha)
    return computing(found) if isinstance(found, str) else found


async def find_experiment_pairs(
    services: Context, experiment: Experiment, settings: PairSettings, wait_s: float, alpha: float
) -> ExperimentPairs | str:
    """Return the pairs of an experiment's finished campaigns, or a description of what is still being computed.

    Args:
        services: The services of this process.
        experiment: The experiment.
        settings: Which solutions are a pair, and which pairs are distinct.
        wait_s: How long to wait for campaigns that are being searched for pairs.
        alpha: Corrected p-value up to which a difference is significant, in (0, 1).
    """
    searched = await services.experiment_pairs.repeats(experiment, settings, wait_s)
    if searched.pending:
        return f"searched {searched.done} finished campaigns for pairs"
    return await services.analyses.run(
        lambda: ExperimentPairs.of(
            experiment, searched, PairStanding.of, alpha=alpha, eps=settings.eps, d_th=settings.d_th
        )
    )


async def find_experiment_thresholds(
    services: Context, experiment: Experiment, d_th: float, wait_s: float, alpha: float
) -> ExperimentThresholds | str:
    """Return the thresholds of an experiment's finished campaigns, or a description of what is still being computed.

    Args:
        services: The services of this process.
        experiment: The experiment.
        d_th: Smallest distance between two distinct thresholds of one kind.
        wait_s: How long to wait for campaigns whose thresholds are being estimated.
        alpha: Corrected p-value up to which a difference is significant, in (0, 1).
    """
    searched = await services.experiment_thresholds.repeats(experiment, d_th, wait_s)
    if searched.pending:
        return f"estimated the thresholds of {searched.done} finished campaigns"
    return await services.analyses.run(
        lambda: ExperimentThresholds.of(experiment, searched, ThresholdStanding.of, alpha=alpha, d_th=d_th)
    )
