"""Response schemas of what the campaigns of an experiment found, of any kind: means, shares, comparisons."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any, TypeVar

from pydantic import Field

from brink.search.analysis.count_comparison import CountDuel, Proportion
from brink.search.analysis.statistics import MeanInterval
from brink.server.experiments.searched import LeftOut
from brink.server.views import View

M = TypeVar("M", bound=StrEnum)


class MeanView(View):
    """A mean over the campaigns of a method, with its 95% interval."""

    mean: float
    low: Annotated[float | None, Field(description="Null with a single campaign.")]
    high: float | None
    repeats: int


class ProportionView(View):
    """A share of counts pooled over the campaigns of a method, with its 95% Wilson interval."""

    count: int
    of: int
    share: float
    low: float
    high: float


class CountDuelView(View):
    """Comparison of a method with another by what they found."""

    problem: str
    first: str
    second: str
    first_mean: float
    second_mean: float
    u: float
    p: Annotated[
        float | None, Field(description="p value; null if all values are equal, and nothing is tested.")
    ]
    p_holm: Annotated[
        float | None, Field(description="p value, corrected over all comparisons of this problem.")
    ]
    a12: float
    effect: str
    differs: Annotated[bool, Field(description="Whether the corrected p value is at most alpha.")]
    says: Annotated[str, Field(description="Conclusion in words.")]


class LeftOutView(View):
    """A finished campaign that is not counted, because it found too much to compare."""

    problem: str
    method: str
    seed: int
    campaign: str
    reason: Annotated[str, Field(description="Which limit is exceeded, and which setting helps.")]


def mean_view(value: MeanInterval) -> MeanView:
    """Return the response schema of a mean."""
    return MeanView(mean=value.mean, low=value.low, high=value.high, repeats=value.repeats)


def proportion_view(value: Proportion | None) -> ProportionView | None:
    """Return the response schema of a share; None without one."""
    if value is None:
        return None
    return ProportionView(count=value.count, of=value.of, share=value.share, low=value.low, high=value.high)


def duel_fields(one: CountDuel[M]) -> dict[str, Any]:
    """Return the fields of `CountDuelView` of a comparison."""
    return {
        "problem": one.problem,
        "first": one.first,
        "second": one.second,
        "first_mean": one.first_mean,
        "second_mean": one.second_mean,
        "u": one.result.u,
        "p": one.result.p_value,
        "p_holm": one.adjusted,
        "a12": one.result.a12,
        "effect": one.size,
        "differs": one.differs,
        "says": one.says,
    }


def left_out_views(left_out: Sequence[LeftOut]) -> tuple[LeftOutView, ...]:
    """Return the response schemas of campaigns that are left out."""
    return tuple(
        LeftOutView(
            problem=one.member.problem,
            method=one.member.method,
            seed=one.member.campaign.body.seed,
            campaign=one.member.campaign.id,
            reason=one.reason,
        )
        for one in left_out
    )
