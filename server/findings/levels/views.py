"""Response schemas of rates by levels."""

from typing import Annotated

from pydantic import Field

from brink.server.findings.rate.views import IntervalView
from brink.server.views import View


class LevelView(View):
    """One level: samples whose robustness does not exceed the threshold of the level before."""

    threshold: Annotated[
        float, Field(description="Robustness of the next level; 0 at the last, that of unsafe samples.")
    ]
    share: Annotated[float, Field(description="Share of samples that belong to the next level.")]
    variation: Annotated[
        float | None, Field(description="Estimated coefficient of variation of the share; null if it is 0.")
    ]
    samples: int
    simulations: int
    accepted: Annotated[float, Field(description="Share of moves that were accepted.")]


class LevelsView(View):
    """A small rate as a product of shares."""

    ended: Annotated[
        str,
        Field(
            description="Why the search has ended: reached, not graded, or budget; or that it has not yet."
        ),
    ]
    rate: Annotated[
        IntervalView | None,
        Field(description="The rate with an approximate interval; null until unsafe samples are reached."),
    ]
    variation: Annotated[
        float | None, Field(description="Estimated coefficient of variation if levels are independent.")
    ]
    most_variation: Annotated[
        float | None,
        Field(
            description="The same if levels depend on each other as much as possible; the interval rests on it."
        ),
    ]
    bias: Annotated[
        float | None, Field(description="Largest bias that this allows for, as a share of the rate.")
    ]
    confidence: float
    simulations: int
    failed: Annotated[int, Field(description="Simulations without a verdict, which count as safe.")]
    distribution: Annotated[str, Field(description="The operational distribution in words.")]
    is_stated: Annotated[
        bool, Field(description="Whether a distribution was stated; if not, all values are equally likely.")
    ]
    levels: list[LevelView]
