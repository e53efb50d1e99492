"""Response schemas of chains of techniques."""

from typing import Annotated

from pydantic import Field

from brink.server.views import View


class TechniqueLevel(View):
    """A technique at one of its levels; a chain is a list of them, in order."""

    technique: str
    level: int
    levels: Annotated[int, Field(description="Highest level of the technique.")]


class ChainTally(View):
    """How often a chain of techniques was unsafe."""

    chain: list[TechniqueLevel]
    words: str
    unsafe: int
    trials: int


class CombinationView(ChainTally):
    """A chain of techniques with the tallies of its parts and reorderings in the same scenarios."""

    parts: Annotated[
        list[ChainTally],
        Field(
            description="Tallies over the scenarios with simulations of part and chain. The empty chain is a part."
        ),
    ]
    orders: list[ChainTally]
    hazardous: Annotated[
        bool, Field(description="Simulated in at least three scenarios, and unsafe in at least 80% of them.")
    ]
    minimal: Annotated[bool, Field(description="Hazardous, but no part of it is, in the same scenarios.")]
    only_together: Annotated[
        bool,
        Field(description="Hazardous, but every part of it is safe in at least 80% of the same scenarios."),
    ]
    order_matters: Annotated[
        bool, Field(description="Hazardous, but another order is safe in at least 80% of the same scenarios.")
    ]
    alpha: Annotated[
        float | None,
        Field(description="Objective `alpha` on the data set; null if it was not measured there."),
    ] = None
    added_harm: Annotated[
        float | None,
        Field(
            description="How much worse `alpha` is than that of the most harmful part alone, on the data set; harms "
            "that merely add up count. Null unless the chain and each of its techniques alone were measured there."
        ),
    ] = None
    interacts: Annotated[
        bool | None,
        Field(
            description="Whether the added harm reaches `margin`. Null if the added harm or the margin is unknown."
        ),
    ] = None
    together: Annotated[list[int], Field(description="Numbers of unsafe solutions whose parts are all safe.")]
    turned: Annotated[
        list[int], Field(description="Numbers of unsafe solutions that are safe in another order.")
    ]


class StepTally(View):
    """How often a technique at a level was unsafe alone, and how often together with others."""

    step: TechniqueLevel
    words: str
    alone_unsafe: int
    alone_trials: int
    joined_unsafe: int
    joined_trials: int


class Variant(View):
    """A solution with the same scenario as another, and with a subset or another order of its techniques."""

    number: int
    unsafe: bool
    chain: list[TechniqueLevel]
    words: str


class Combinations(View):
    """Results of a campaign on ordered perturbation techniques."""

    words: Annotated[str, Field(description="The finding in a sentence.")]
    margin: Annotated[
        float | None,
        Field(description="Added harm from which a chain interacts; null if the search has no such setting."),
    ] = None
    explanation: Annotated[
        str, Field(description="What added harm means, in sentences; empty if no chain has a known one.")
    ] = ""
    steps: list[StepTally]
    combinations: Annotated[list[CombinationView], Field(description="Most informative first.")]
