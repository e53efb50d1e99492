"""What the campaigns of an experiment found, pairs or thresholds, as the API shows it."""

from collections.abc import Callable, Sequence
from typing import Annotated, Generic, Self, TypeVar

from pydantic import Field

from brink.search.analysis.count_comparison import (
    CountDuel,
    FoundRepeat,
    FoundStanding,
    ProblemMeasure,
    by_method,
    by_problem,
    count_duels,
)
from brink.search.analysis.pair_comparison import PairRepeat, PairStanding
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.threshold_comparison import ThresholdRepeat, ThresholdStanding
from brink.server.experiments.searched import LeftOut, SearchedCampaigns
from brink.server.experiments.store import Experiment
from brink.server.findings.pairs.views import ConfirmationRule
from brink.server.views import View

S = TypeVar("S", bound=FoundStanding)
R = TypeVar("R", bound=FoundRepeat)


class ExperimentFound(View, Generic[S, R]):
    """What an experiment's finished campaigns found of one kind."""

    id: str
    name: str
    d_th: Annotated[float, Field(description="Smallest distance between two distinct ones.")]
    campaigns: int
    counted: Annotated[int, Field(description="Finished campaigns included here.")]
    problems: list[ProblemMeasure]
    standings: list[S]
    duels: list[CountDuel]
    repeats: list[R]
    rule: Annotated[ConfirmationRule, Field(description="When one is confirmed.")] = ConfirmationRule()
    left_out: Annotated[
        tuple[LeftOut, ...],
        Field(description="Finished campaigns that found too many; no other number includes them."),
    ] = ()
    alpha: Annotated[
        float, Field(description="Corrected p value up to which a difference is significant.")
    ] = LEVEL

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        searched: SearchedCampaigns[R],
        standing: Callable[[Sequence[R]], S],
        *,
        alpha: float,
        **settings: float,
    ) -> Self:
        """Compare what campaigns found.

        Args:
            experiment: The experiment.
            searched: What its finished campaigns found.
            standing: Returns what the campaigns of a method on a problem found.
            alpha: Corrected p-value up to which a difference is significant, in (0, 1).
            settings: What counts.
        """
        problems = by_problem(searched.repeats)
        return cls(
            id=experiment.id,
            name=experiment.body.name,
            campaigns=experiment.body.campaigns,
            counted=len(searched.repeats),
            problems=[ProblemMeasure.of(ours) for ours in problems.values()],
            standings=[standing(ours) for each in problems.values() for ours in by_method(each).values()],
            duels=count_duels(searched.repeats, level=alpha),
            repeats=list(searched.repeats),
            left_out=tuple(searched.left_out),
            alpha=alpha,
            **settings,
        )


class ExperimentPairs(ExperimentFound[PairStanding, PairRepeat]):
    """The pairs of an experiment's finished campaigns."""

    eps: Annotated[float, Field(description="Largest distance between the sides of a pair.")]


class ExperimentThresholds(ExperimentFound[ThresholdStanding, ThresholdRepeat]):
    """The thresholds of an experiment's finished campaigns."""
