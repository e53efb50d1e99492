"""Response schemas of the boundary."""

from typing import Annotated

from pydantic import Field

from brink.server.views import SolutionView, View


class DbsCell(View):
    """DBS and strict DBS at one pair of thresholds."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int


class BudgetBoundary(View):
    """The boundary of a campaign without the simulations beyond its budget."""

    simulations: Annotated[int, Field(description="The budget.")]
    beyond: Annotated[
        int, Field(description="Evaluated solutions beyond it, which complete the last generation.")
    ]
    dbs: int
    strict_dbs: int


class KnownBoundary(View):
    """The boundary among a campaign's solutions and its known results together."""

    results: Annotated[int, Field(description="Known results, none of which the campaign simulated.")]
    dbs: int
    strict_dbs: int


class Boundary(View):
    """The distinct boundary solutions of a campaign."""

    t_b: float
    d_th: float
    dbs: int
    strict_dbs: int
    words: Annotated[
        str,
        Field(
            description="How many solutions are listed, such as `8 distinct boundary solutions`, or, if these are "
            "not all, `the best 1,000 of 34,512 distinct boundary solutions`."
        ),
    ] = ""
    note: str
    grid: Annotated[
        list[DbsCell],
        Field(description="DBS at all thresholds, without distances at which it takes too long."),
    ]
    solutions: Annotated[
        list[SolutionView], Field(description="Best first; of more than `limit`, the best ones.")
    ]
    strict: Annotated[
        list[int], Field(description="The `number` of each of these that the strict DBS counts.")
    ]
    within_budget: Annotated[
        BudgetBoundary | None,
        Field(
            description="The figures that comparisons use; null if the campaign did not exceed its budget."
        ),
    ] = None
    with_known: Annotated[
        KnownBoundary | None,
        Field(description="With the known results; null if the campaign did not start from any."),
    ] = None
