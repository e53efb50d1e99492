"""Response schemas of rates."""

from typing import Annotated

from pydantic import Field

from brink.search.conclusions import Decision
from brink.server.views import View


class IntervalView(View):
    """A number with its interval."""

    value: float
    low: float
    high: float


class LookView(View):
    """The rate as it was after some simulations, with the interval that holds at every look."""

    simulations: int
    rate: float
    low: float
    high: float


class ClaimView(View):
    """A safety performance indicator: the rate and the threshold that it must not exceed."""

    at_most: Annotated[float, Field(description="The threshold.")]
    confidence: float
    decision: Decision
    after: Annotated[int, Field(description="Simulations that it took to decide, or all of them.")]
    high: Annotated[float, Field(description="Upper end of the one-sided interval.")]
    low: Annotated[float, Field(description="Lower end of the one-sided interval on the other side.")]
    more: Annotated[
        int | None,
        Field(
            description="About how many more simulations would show it if the rate is as estimated; null if it is "
            "decided, or the estimate exceeds the threshold."
        ),
    ]
    words: str


class StratumView(View):
    """A part of operation, such as driving at night."""

    words: str
    simulations: int
    unsafe: int
    share: Annotated[float, Field(description="Its share of operation.")]
    part: Annotated[float | None, Field(description="Its share of all that is unsafe; null if nothing is.")]
    rate: Annotated[
        IntervalView | None,
        Field(description="The rate in it; its interval is for a number of simulations fixed beforehand."),
    ]


class RateView(View):
    """How often solutions are unsafe in operation."""

    simulations: Annotated[int, Field(description="Draws from operation, failed ones included.")]
    unsafe: int
    failed: Annotated[
        int,
        Field(
            description="Draws without a verdict: safe for lower ends of intervals, unsafe for upper ones."
        ),
    ]
    confidence: Annotated[float, Field(description="Confidence of all intervals.")]
    rate: Annotated[
        IntervalView,
        Field(
            description="Its interval holds at every number of simulations at once, so one may stop at any."
        ),
    ]
    fixed: Annotated[
        IntervalView,
        Field(
            description="The same with the interval for a number of simulations that was fixed beforehand."
        ),
    ]
    fitted: Annotated[
        IntervalView | None,
        Field(
            description="The same with an interval that also covers how uncertain fitted errors are, for a number of "
            "simulations that was fixed beforehand; null if drives do not have several replicates of a fit."
        ),
    ]
    replicates: Annotated[int, Field(description="Replicates of a fit that were driven.")]
    effective: Annotated[
        float, Field(description="Number of simulations drawn as in operation with the same variance.")
    ]
    distribution: Annotated[str, Field(description="The operational distribution in words.")]
    is_stated: Annotated[
        bool, Field(description="Whether a distribution was stated; if not, all values are equally likely.")
    ]
    claim: ClaimView | None
    per_1000_km: Annotated[
        IntervalView | None,
        Field(description="Unsafe drives per 1,000 km; null if drives record no distance."),
    ]
    per_hour: Annotated[
        IntervalView | None,
        Field(description="Unsafe drives per hour of driving; null if drives record no time."),
    ]
    looks: list[LookView]
    strata: list[StratumView]
