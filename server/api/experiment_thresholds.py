"""Routes of the thresholds that the campaigns of an experiment found."""

from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import Field

from brink.search.analysis.count_comparison import problems_of
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.threshold_comparison import (
    ThresholdCounts,
    ThresholdMeasure,
    ThresholdRepeat,
    measure_of,
    measure_words,
    threshold_duels,
    threshold_standings,
)
from brink.server.api.context import Context, Services
from brink.server.api.experiment_counts import (
    CountDuelView,
    MeanView,
    ProportionView,
    duel_fields,
    mean_view,
    proportion_view,
)
from brink.server.api.responses import COMPUTING, Alpha, computing
from brink.server.experiments.store import Experiment
from brink.server.experiments.thresholds import distance_of
from brink.server.findings.pairs.views import ConfirmationRule
from brink.server.views import View

router = APIRouter(prefix="/experiments", tags=["experiments"])


class ThresholdStandingView(View):
    """The thresholds of a method on a problem."""

    problem: str
    method: str
    distinct: Annotated[MeanView, Field(description="Distinct thresholds of a campaign.")]
    kinds: Annotated[MeanView, Field(description="Kinds of the thresholds of a campaign.")]
    confirmed: Annotated[
        MeanView | None,
        Field(
            description="Confirmed distinct thresholds of a campaign; null unless all of all campaigns were judged."
        ),
    ]
    confirmed_kinds: Annotated[
        MeanView | None, Field(description="Kinds of the confirmed thresholds of a campaign; null likewise.")
    ]
    known: Annotated[int, Field(description="Campaigns whose thresholds were all judged, or that have none.")]
    found: Annotated[int, Field(description="Thresholds of all campaigns.")]
    paired: Annotated[int, Field(description="Those with a tight pair of ends, which can be confirmed.")]
    tried: Annotated[
        int, Field(description="Those whose ends were simulated with other seeds after the search.")
    ]
    held: Annotated[
        ProportionView | None,
        Field(
            description="Share of the judged thresholds with at most 20% unsafe drives at the safe end and at least "
            "80% at the other, as observed; null if none was judged."
        ),
    ]
    overall: Annotated[
        ProportionView | None,
        Field(
            description="Share of the judged thresholds that were confirmed, by `rule`; null if none was judged."
        ),
    ]
    component: Annotated[
        ProportionView | None,
        Field(
            description="Share of the unsafe ends that are safe with ground truth in place of the component; null "
            "if that was not tried."
        ),
    ]


class ThresholdDuelView(CountDuelView):
    """Comparison of a method with another by their thresholds."""

    measure: Annotated[
        ThresholdMeasure, Field(description="Whether confirmed or all distinct thresholds are compared.")
    ]


class ThresholdRepeatView(View):
    """The thresholds of a finished campaign, and the results of finished follow-ups on them."""

    problem: str
    method: str
    seed: int
    campaign: str
    computed: Annotated[
        bool, Field(description="Whether verdicts are computed, not simulated: there is nothing to confirm.")
    ]
    found: Annotated[int, Field(description="Thresholds.")]
    distinct: Annotated[
        int, Field(description="Distinct ones: of another kind than all sharper ones, or `d_th` away.")
    ]
    kinds: Annotated[int, Field(description="Kinds of the thresholds.")]
    paired: Annotated[int, Field(description="Thresholds with a tight pair of ends.")]
    tried: Annotated[int, Field(description="Those whose ends were simulated with other seeds.")]
    judged: Annotated[
        int, Field(description="Tried ones with enough drives to be confirmed, or that are refuted.")
    ]
    held: Annotated[int, Field(description="Judged ones that held at both ends, as observed.")]
    confirmed: Annotated[
        int | None, Field(description="Confirmed ones, by `rule`; null if some can be, but none was tried.")
    ]
    confirmed_distinct: Annotated[
        int | None, Field(description="Distinct ones among the confirmed; null likewise.")
    ]
    confirmed_kinds: Annotated[int | None, Field(description="Kinds of the confirmed ones; null likewise.")]
    refuted: Annotated[int, Field(description="Refuted ones.")]
    component: Annotated[int, Field(description="Unsafe ends that are safe with ground truth.")]
    scenario: Annotated[int, Field(description="Unsafe ends that are unsafe with ground truth, too.")]
    drives: Annotated[
        int, Field(description="Minimum number of drives with other seeds, over all ends that were tried.")
    ]


class ProblemThresholds(View):
    """The measure on which the methods are compared on one problem."""

    problem: str
    measure: ThresholdMeasure
    says: Annotated[str, Field(description="The measure of the comparison, and why.")]


class ExperimentThresholds(View):
    """The thresholds of an experiment's finished campaigns."""

    id: str
    name: str
    d_th: Annotated[float, Field(description="Smallest distance between two distinct ones of one kind.")]
    campaigns: int
    counted: Annotated[int, Field(description="Finished campaigns included here.")]
    problems: list[ProblemThresholds]
    standings: list[ThresholdStandingView]
    duels: list[ThresholdDuelView]
    repeats: list[ThresholdRepeatView]
    rule: ConfirmationRule = ConfirmationRule()
    alpha: Annotated[
        float, Field(description="Corrected p value up to which a difference is significant.")
    ] = LEVEL


@router.get("/{experiment_id}/thresholds", responses=COMPUTING)
async def get_experiment_thresholds(
    experiment_id: str,
    services: Services,
    d_th: Annotated[
        float | None,
        Query(ge=0, le=1, description="Smallest distance between thresholds; the experiment's by default."),
    ] = None,
    wait_s: Annotated[
        float, Query(ge=0, le=60, description="How long to wait for the thresholds, in seconds.")
    ] = 10.0,
    alpha: Alpha = LEVEL,
) -> ExperimentThresholds:
    """Return how many thresholds the finished campaigns found, of how many kinds, and how many are confirmed."""
    experiment = await services.experiments.get(experiment_id)
    found = await find_experiment_thresholds(
        services, experiment, distance_of(experiment.body, d_th), wait_s, alpha
    )
    if isinstance(found, str):
        return computing(found)  # type: ignore[no-any-return]
    return found


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
        done = len(searched.repeats)
        return f"estimated the thresholds of {done} of {done + searched.pending} finished campaigns"
    return await services.analyses.run(lambda: _view(experiment, d_th, list(searched.repeats), alpha))


def _view(
    experiment: Experiment, d_th: float, repeats: list[ThresholdRepeat], alpha: float
) -> ExperimentThresholds:
    return ExperimentThresholds(
        id=experiment.id,
        name=experiment.body.name,
        d_th=d_th,
        alpha=alpha,
        campaigns=experiment.body.campaigns,
        counted=len(repeats),
        problems=[
            ProblemThresholds(
                problem=problem, measure=measure_of(repeats, problem), says=measure_words(repeats, problem)
            )
            for problem in problems_of(repeats)
        ],
        standings=[
            ThresholdStandingView(
                problem=one.problem,
                method=one.method,
                distinct=mean_view(one.distinct),
                kinds=mean_view(one.kinds),
                confirmed=None if one.confirmed is None else mean_view(one.confirmed),
                confirmed_kinds=None if one.confirmed_kinds is None else mean_view(one.confirmed_kinds),
                known=one.known,
                found=one.found,
                paired=one.paired,
                tried=one.tried,
                held=proportion_view(one.held),
                overall=proportion_view(one.overall),
                component=proportion_view(one.component),
            )
            for one in threshold_standings(repeats)
        ],
        duels=[
            ThresholdDuelView(measure=one.measure, **duel_fields(one))
            for one in threshold_duels(repeats, level=alpha)
        ],
        repeats=[
            ThresholdRepeatView(
                problem=one.problem,
                method=one.method,
                seed=one.seed,
                campaign=one.campaign,
                computed=one.computed,
                **_counts(one.counts),
            )
            for one in repeats
        ],
    )


def _counts(counts: ThresholdCounts) -> dict[str, Any]:
    fields = {name: getattr(counts, name) for name in ThresholdCounts.__slots__}
    if counts.tried or not counts.paired:
        return fields
    return {**fields, "confirmed": None, "confirmed_distinct": None, "confirmed_kinds": None}
