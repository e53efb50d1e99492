"""Routes of the pairs across the boundary that the campaigns of an experiment found."""

from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import Field

from brink.search.analysis.count_comparison import problems_of
from brink.search.analysis.pair_comparison import (
    PairCounts,
    PairMeasure,
    PairRepeat,
    measure_of,
    measure_words,
    pair_duels,
    pair_standings,
)
from brink.search.analysis.paper import LEVEL
from brink.server.api.context import Context, Services
from brink.server.api.experiment_counts import (
    CountDuelView,
    LeftOutView,
    MeanView,
    ProportionView,
    duel_fields,
    left_out_views,
    mean_view,
    proportion_view,
)
from brink.server.api.responses import COMPUTING, Alpha, computing
from brink.server.campaigns.pairs import PairSettings
from brink.server.experiments.pairs import settings_of
from brink.server.experiments.searched import SearchedCampaigns
from brink.server.experiments.store import Experiment
from brink.server.findings.pairs.views import ConfirmationRule
from brink.server.views import View

router = APIRouter(prefix="/experiments", tags=["experiments"])


class PairStandingView(View):
    """The pairs of a method on a problem."""

    problem: str
    method: str
    distinct: Annotated[MeanView, Field(description="Distinct pairs of a campaign.")]
    confirmed: Annotated[
        MeanView | None,
        Field(
            description="Confirmed distinct pairs of a campaign; null unless all pairs of all campaigns were judged."
        ),
    ]
    known: Annotated[int, Field(description="Campaigns whose pairs were all judged, or that have none.")]
    pairs: Annotated[int, Field(description="Distinct pairs of all campaigns.")]
    checked: Annotated[int, Field(description="Checked ones among them.")]
    tried: Annotated[int, Field(description="Pairs simulated again with other seeds after the search.")]
    precision: Annotated[
        ProportionView | None,
        Field(description="Share of the checked pairs that were confirmed; null if none was tried."),
    ]
    overall: Annotated[
        ProportionView | None,
        Field(description="Share of all pairs, checked or not, that were confirmed; null if none was tried."),
    ]
    component: Annotated[
        ProportionView | None,
        Field(
            description="Share of the unsafe sides that are safe with ground truth in place of the component; null "
            "if that was not tried."
        ),
    ]


class PairDuelView(CountDuelView):
    """Comparison of a method with another by their pairs."""

    measure: Annotated[
        PairMeasure, Field(description="Whether confirmed or all distinct pairs are compared.")
    ]


class PairRepeatView(View):
    """The pairs of a finished campaign, and the results of finished follow-ups on them."""

    problem: str
    method: str
    seed: int
    campaign: str
    computed: Annotated[
        bool, Field(description="Whether verdicts are computed, not simulated: there is nothing to confirm.")
    ]
    distinct: Annotated[int, Field(description="Distinct pairs.")]
    checked: Annotated[int, Field(description="Distinct pairs whose sides the search simulated again.")]
    tried: Annotated[
        int, Field(description="Distinct pairs that were simulated again with other seeds after the search.")
    ]
    judged: Annotated[
        int, Field(description="Tried ones with enough drives to be confirmed, or that are refuted.")
    ]
    confirmed: Annotated[
        int | None,
        Field(description="Confirmed pairs, by `rule`; null if there are pairs, but none was tried."),
    ]
    refuted: Annotated[int, Field(description="Refuted pairs.")]
    checked_judged: Annotated[int, Field(description="Checked ones among the judged.")]
    checked_confirmed: Annotated[int, Field(description="Checked ones among the confirmed.")]
    component: Annotated[int, Field(description="Unsafe sides that are safe with ground truth.")]
    scenario: Annotated[int, Field(description="Unsafe sides that are unsafe with ground truth, too.")]
    drives: Annotated[
        int, Field(description="Minimum number of drives with other seeds, over all sides of tried pairs.")
    ]


class ProblemPairs(View):
    """The measure on which the methods are compared on one problem."""

    problem: str
    measure: PairMeasure
    says: Annotated[str, Field(description="The measure of the comparison, and why.")]


class ExperimentPairs(View):
    """The pairs of an experiment's finished campaigns."""

    id: str
    name: str
    eps: Annotated[float, Field(description="Largest distance between the sides of a pair.")]
    d_th: Annotated[float, Field(description="Smallest distance between two distinct pairs.")]
    campaigns: int
    counted: Annotated[int, Field(description="Finished campaigns included here.")]
    problems: list[ProblemPairs]
    standings: list[PairStandingView]
    duels: list[PairDuelView]
    repeats: list[PairRepeatView]
    rule: ConfirmationRule = ConfirmationRule()
    left_out: Annotated[
        tuple[LeftOutView, ...],
        Field(description="Finished campaigns that have too many pairs; no other number includes them."),
    ] = ()
    alpha: Annotated[
        float, Field(description="Corrected p value up to which a difference is significant.")
    ] = LEVEL


@router.get("/{experiment_id}/pairs", responses=COMPUTING)
async def get_experiment_pairs(
    experiment_id: str,
    services: Services,
    eps: Annotated[
        float | None,
        Query(ge=0, le=1, description="Largest distance between the sides; the experiment's by default."),
    ] = None,
    d_th: Annotated[
        float | None,
        Query(ge=0, le=1, description="Smallest distance between pairs; the experiment's by default."),
    ] = None,
    wait_s: Annotated[
        float, Query(ge=0, le=60, description="How long to wait for the pairs, in seconds.")
    ] = 10.0,
    alpha: Alpha = LEVEL,
) -> ExperimentPairs:
    """Return how many pairs across the boundary the finished campaigns found, and how many hold.

    All campaigns are searched for pairs with the same `eps` and `d_th`, so that methods can be compared.
    """
    experiment = await services.experiments.get(experiment_id)
    settings = settings_of(experiment.body, eps, d_th)
    found = await find_experiment_pairs(services, experiment, settings, wait_s, alpha)
    if isinstance(found, str):
        return computing(found)  # type: ignore[no-any-return]
    return found


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
        done = len(searched.repeats) + len(searched.left_out)
        return f"searched {done} of {done + searched.pending} finished campaigns for pairs"
    return await services.analyses.run(lambda: _view(experiment, settings, searched, alpha))


def _view(
    experiment: Experiment, settings: PairSettings, searched: SearchedCampaigns[PairRepeat], alpha: float
) -> ExperimentPairs:
    repeats = searched.repeats
    return ExperimentPairs(
        id=experiment.id,
        name=experiment.body.name,
        eps=settings.eps,
        d_th=settings.d_th,
        alpha=alpha,
        campaigns=experiment.body.campaigns,
        counted=len(repeats),
        problems=[
            ProblemPairs(
                problem=problem, measure=measure_of(repeats, problem), says=measure_words(repeats, problem)
            )
            for problem in problems_of(repeats)
        ],
        standings=[
            PairStandingView(
                problem=one.problem,
                method=one.method,
                distinct=mean_view(one.distinct),
                confirmed=None if one.confirmed is None else mean_view(one.confirmed),
                known=one.known,
                pairs=one.pairs,
                checked=one.checked,
                tried=one.tried,
                precision=proportion_view(one.precision),
                overall=proportion_view(one.overall),
                component=proportion_view(one.component),
            )
            for one in pair_standings(repeats)
        ],
        duels=[
            PairDuelView(measure=one.measure, **duel_fields(one)) for one in pair_duels(repeats, level=alpha)
        ],
        repeats=[
            PairRepeatView(
                problem=one.problem,
                method=one.method,
                seed=one.seed,
                campaign=one.campaign,
                computed=one.computed,
                **_counts(one.counts),
            )
            for one in repeats
        ],
        left_out=left_out_views(searched.left_out),
    )


def _counts(counts: PairCounts) -> dict[str, Any]:
    fields = {name: getattr(counts, name) for name in PairCounts.__slots__}
    return fields if counts.tried or not counts.distinct else {**fields, "confirmed": None}
