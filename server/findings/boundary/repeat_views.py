"""Response schemas of repeats."""

from typing import Annotated

from pydantic import Field

from brink.search.conclusions import Conclusion
from brink.server.states import CampaignStatus, Selection
from brink.server.views import View


class RepeatedSolution(View):
    """Estimated probability that a repeated solution is unsafe."""

    number: int
    evaluated: Annotated[
        int, Field(description="Number of simulations with other seeds that returned a verdict.")
    ]
    unsafe: int
    probability: Annotated[float | None, Field(description="Unsafe share of these simulations.")]
    low: Annotated[float, Field(description="Lower limit of its exact interval (Clopper-Pearson).")]
    high: float
    holds: Annotated[
        bool | None,
        Field(description="Whether the interval contains p_th; with few simulations, every interval does."),
    ]
    conclusion: Annotated[
        Conclusion | None,
        Field(
            description="What its simulations show: below or above p_th, near it (both verdicts, and an interval "
            "with a fitness of at most t_b), or inconclusive; null without a verdict."
        ),
    ]
    around: Annotated[
        float | None, Field(description="Unsafe share of its neighbourhood in the archive, including itself.")
    ]
    around_low: Annotated[float | None, Field(description="Lower limit of the neighbourhood's interval.")]
    around_high: float | None


class RepeatsView(View):
    """Results of simulating solutions of a campaign again with other seeds."""

    campaign: Annotated[str, Field(description="Campaign that runs the repeats.")]
    of: Annotated[str, Field(description="Campaign whose solutions are repeated.")]
    name: Annotated[str, Field(description="Name of the repeated campaign.")]
    status: CampaignStatus
    status_reason: str
    repeats: int
    selection: Annotated[
        Selection,
        Field(
            description="Whether the solutions are the distinct boundary at t_b and d_th, were named by number, or "
            "are sides of pairs."
        ),
    ]
    t_b: Annotated[float | None, Field(description="Null if the solutions are not a boundary.")]
    d_th: float | None
    p_th: float
    distinct: Annotated[
        int | None,
        Field(
            description="Number of distinct boundary solutions at t_b and d_th, of which the best 1,000 at most are "
            "repeated; null if they are not a boundary."
        ),
    ] = None
    simulations: int
    budget: int
    holding: Annotated[int, Field(description="Number of solutions whose interval contains p_th.")]
    below: Annotated[
        int, Field(description="Number of solutions whose interval lies below p_th: safer than reported.")
    ]
    above: Annotated[int, Field(description="Number of solutions whose interval lies above p_th.")]
    near: Annotated[int, Field(description="Number of solutions that are near p_th themselves.")]
    inconclusive: Annotated[
        int,
        Field(description="Number of solutions whose simulations are too few, or too one-sided, to decide."),
    ]
    evaluated: Annotated[int, Field(description="Number of verdicts so far, over all solutions.")]
    unsafe: int
    pooled: Annotated[
        tuple[float, float] | None,
        Field(description="Wilson interval of the unsafe share over all solutions; null without a verdict."),
    ]
    words: Annotated[str, Field(description="What the repeats show, in sentences.")]
    solutions: Annotated[list[RepeatedSolution], Field(description="Best fitness first.")]
