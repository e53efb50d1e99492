"""Routes of what can be said of a campaign: map, convergence, dependence on parameters, scores beside a control."""

import asyncio
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import JSONResponse
from numpy.typing import NDArray
from pydantic import Field

from brink.search.analysis.boundary import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.analysis.comparison import control_summary, rows_of
from brink.search.analysis.dependence import Dependence, ParameterColumn, parameter_columns
from brink.search.analysis.scores import DRAWS, Scores
from brink.search.space import Categorical
from brink.server.api.conditional import NOTHING_NEW, is_known, nothing_new, tag_of
from brink.server.api.context import Services
from brink.server.api.experiment_schemas import ControlView
from brink.server.api.experiments import control_view
from brink.server.api.schemas import MAX_NUMBER, BeingMade, View
from brink.server.api.solutions import Threshold
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.dashboard import course as courses
from brink.server.dashboard.solution_map import SolutionMap
from brink.server.db.engine import read
from brink.server.errors import Conflict, FieldError, InvalidInput, nearest
from brink.server.states import CampaignStatus

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["figures"])

DIGITS = 4
"""After the point, of places and fitness: a map is not read more exactly."""


class ColourBy(View):
    """The values of a parameter, one a solution."""

    parameter: Annotated[str, Field(description="component.parameter.")]
    unit: str
    choices: Annotated[
        list[str] | None, Field(description="Of a categorical one; its values are their indices.")
    ]
    low: float | None
    high: float | None
    values: Annotated[list[float | None], Field(description="None where it means nothing in that solution.")]


class MapView(View):
    """Where solutions lie, columnar, in the order in which they came."""

    version: Annotated[
        str, Field(description="Points of one version stay where they are; pass it with `after`.")
    ]
    generation: Annotated[int, Field(description="Generations told.")]
    evaluated: Annotated[int, Field(description="Solutions that have a verdict.")]
    drawn: Annotated[int, Field(description="Of them, on the map.")]
    explained: Annotated[float, Field(description="Share of the squared distances that the map shows.")]
    across: Annotated[str | None, Field(description="What lies behind the axis across, in words.")]
    up: str | None
    first: Annotated[int, Field(description="How many solutions before those that follow were told before.")]
    number: list[int]
    told_in: Annotated[list[int], Field(description="Generation of each.")]
    unsafe: Annotated[list[int], Field(description="1 or 0.")]
    robustness: list[float]
    x: list[float]
    y: list[float]
    fitness: Annotated[
        list[float], Field(description="Of all that are drawn: it changes with every generation.")
    ]
    by: ColourBy | None


@router.get("/map", response_model=MapView, responses=NOTHING_NEW)
async def get_map(
    campaign_id: str,
    services: Services,
    request: Request,
    version: Annotated[str, Query(max_length=40, description="Of the map that is known.")] = "",
    after: Annotated[int, Query(ge=0, le=MAX_NUMBER, description="How many of its solutions are known.")] = 0,
    parameter: Annotated[
        str, Query(max_length=200, description="Add the values of component.parameter.")
    ] = "",
) -> Response:
    """Return where the solutions of a campaign lie on its map; thinned, if there are more than can be drawn."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    etag = _tag(campaign, found.generation, version, after, parameter)
    if is_known(request, etag):
        return nothing_new(etag)  # type: ignore[no-any-return]
    column = None
    if parameter:
        column = await asyncio.get_running_loop().run_in_executor(None, _column, found, parameter)
    drawn = await services.figures.maps.get(campaign.id, found, ended=campaign.status in ENDED)
    first = min(after, len(drawn.rows)) if version == drawn.version else 0

    series = await read(services.engines, lambda c: view_store.list_generations(c, campaign.id, 0))
    ends = np.array([generation.evaluated for generation in series], np.int64)

    def write() -> str:
        return _map_view(found, drawn, ends, first, column).model_dump_json()

    text = await asyncio.get_running_loop().run_in_executor(None, write)
    return Response(text, media_type="application/json", headers={"ETag": etag})


def _tag(campaign: Campaign, *told: object) -> str:
    return tag_of(campaign.id, campaign.sequence, campaign.status in ENDED, *told)


def _column(found: ReadArchive, parameter: str) -> ParameterColumn:
    columns = parameter_columns(found.plan.problem.space, found.archive.vectors)
    for column in columns:
        if column.name == parameter:
            return column
    names = [column.name for column in columns]
    message = f"expected a parameter of {found.plan.problem.id}, such as {names[0]}; got {parameter[:80]!r}"
    raise InvalidInput(
        [FieldError(pointer="/query/parameter", message=message, nearest=nearest(parameter, names))]
    )


def _map_view(
    found: ReadArchive,
    drawn: SolutionMap,
    ends: NDArray[np.int64],
    first: int,
    column: ParameterColumn | None,
) -> MapView:
    archive, rows = found.archive, drawn.rows
    new, points = rows[first:], drawn.points[first:]
    return MapView.model_construct(
        version=drawn.version, generation=found.generation, evaluated=len(archive), drawn=len(rows),
        explained=drawn.projection.explained, across=drawn.axes[0], up=drawn.axes[1], first=first,
        number=archive.numbers[new].tolist(), told_in=np.searchsorted(ends, new, side="right").tolist(),
        unsafe=archive.unsafe[new].astype(np.int64).tolist(), robustness=_rounded(archive.robustness[new]),
        x=_rounded(points[:, 0]), y=_rounded(points[:, 1]), fitness=_rounded(archive.fitness[rows]),
        by=_colour_by(column, rows) if column is not None else None,
    )  # fmt: skip


def _rounded(values: NDArray[np.float64]) -> list[float]:
    rounded: list[float] = np.round(np.nan_to_num(values, posinf=1e9, neginf=-1e9), DIGITS).tolist()
    return rounded


def _colour_by(column: ParameterColumn, rows: NDArray[np.intp]) -> ColourBy:
    parameter, awake = column.parameter, column.active[rows].tolist()
    scale = None if isinstance(parameter, Categorical) else parameter
    return ColourBy.model_construct(
        parameter=column.name, unit=scale.unit if scale else "",
        choices=list(parameter.choices) if isinstance(parameter, Categorical) else None,
        low=float(scale.low) if scale else None, high=float(scale.high) if scale else None,
        values=[
            value if there else None
            for value, there in zip(_rounded(column.values[rows]), awake, strict=True)
        ],
    )  # fmt: skip


class CourseView(View):
    """Distinct boundary solutions over simulations, columnar, each point scored with only what was known then."""

    t_b: float
    d_th: float
    simulations: list[int]
    evaluated: list[int]
    dbs: list[int]
    strict_dbs: list[int]
    note: Annotated[str | None, Field(description="Why there is no course, if there is none.")]


@router.get("/course", responses=NOTHING_NEW)
async def get_course(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    t_b: Threshold = DEFAULT_T_B,
    d_th: Threshold = DEFAULT_D_TH,
) -> CourseView:
    """Return how the number of distinct boundary solutions grew with the simulations spent, at any thresholds."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    etag = _tag(campaign, found.generation, t_b, d_th)
    if is_known(request, etag):
        return nothing_new(etag)  # type: ignore[no-any-return]
    points = await services.figures.courses.get(campaign.id, found, t_b, d_th)
    response.headers["ETag"] = etag
    return CourseView(
        t_b=t_b, d_th=d_th,
        simulations=[point.simulations for point in points],
        evaluated=[point.evaluated for point in points],
        dbs=[int(point.grid.dbs[0, 0]) for point in points],
        strict_dbs=[int(point.grid.strict[0, 0]) for point in points],
        note=_no_course(len(found.archive)),
    )  # fmt: skip


def _no_course(evaluated: int) -> str | None:
    if evaluated <= courses.MOST:
        return None
    return (
        f"with more than {courses.MOST:,} solutions the course is known at the default thresholds only, "
        f"t_b {DEFAULT_T_B:g} and d_th {DEFAULT_D_TH:g}"
    )


class DependenceView(View):
    """The unsafe share over the values of one parameter."""

    component: str
    parameter: str
    unit: str
    places: Annotated[
        list[float], Field(description="Index of the choice, the value, or the median of the bin.")
    ]
    labels: Annotated[list[str], Field(description="Names of the groups; empty if the axis is a scale.")]
    low: float | None
    high: float | None
    counts: list[int]
    unsafe: list[int]
    strength: Annotated[float, Field(description="Cramér's V between group and verdict.")]
    p_value: float
    detectable: Annotated[
        bool, Field(description="Whether it stands out among all parameters by more than chance.")
    ]


class Dependences(View):
    """How the verdict depends on each parameter."""

    generation: int
    evaluated: int
    unsafe: int
    parameters: Annotated[list[DependenceView], Field(description="Strongest first.")]


@router.get("/dependence", responses=NOTHING_NEW)
async def get_dependence(
    campaign_id: str, services: Services, request: Request, response: Response
) -> Dependences:
    """Return the unsafe share over each parameter: where unsafe solutions were found, which is no random sample."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    etag = _tag(campaign, found.generation)
    if is_known(request, etag):
        return nothing_new(etag)  # type: ignore[no-any-return]
    known = await services.figures.dependences(campaign.id, found)
    response.headers["ETag"] = etag
    return Dependences(
        generation=found.generation, evaluated=len(found.archive), unsafe=int(np.count_nonzero(found.archive.unsafe)),
        parameters=[_dependence(one, len(known)) for one in known],
    )  # fmt: skip


def _dependence(one: Dependence, parameters: int) -> DependenceView:
    parameter = one.column.parameter
    scale = None if isinstance(parameter, Categorical) else parameter
    return DependenceView(
        component=one.column.component, parameter=parameter.name, unit=scale.unit if scale else "",
        places=one.places.tolist(), labels=list(one.labels),
        low=float(scale.low) if scale else None, high=float(scale.high) if scale else None,
        counts=one.counts.tolist(), unsafe=one.unsafe.tolist(), strength=one.strength, p_value=one.p_value,
        detectable=one.detectable(parameters),
    )  # fmt: skip


class ScoresView(View):
    """What a campaign reached within its budget: a figure for each share of it, each t_b and each d_th."""

    id: str
    name: str
    status: CampaignStatus
    evaluated: Annotated[int, Field(description="Solutions within the budget that have a verdict.")]
    unsafe: int
    unsafe_share: float
    fractions: Annotated[list[float], Field(description="Shares of the budget.")]
    t_bs: list[float]
    d_ths: list[float]
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    control: Annotated[ControlView | None, Field(description="None where no component is a scenario.")]
    draws: Annotated[int, Field(description="Draws that the control's figures are means of.")]
    says: Annotated[
        list[list[str]],
        Field(
            description="What it and its control say together at the whole budget, a t_b, a d_th; else empty."
        ),
    ]


@router.get(
    "/scores",
    responses={202: {"model": BeingMade, "description": "Being computed; ask again after `Retry-After`."}},
)
async def get_scores(
    campaign_id: str,
    services: Services,
    wait_s: Annotated[float, Query(ge=0, le=60, description="How long to wait for scores.")] = 10.0,
) -> ScoresView:
    """Return the DBS and strict DBS that a campaign reached by its end and before, beside those of its control."""
    campaign = await services.campaigns.get(campaign_id)
    if campaign.status not in ENDED:
        raise Conflict(
            f"campaign {campaign.id} is {campaign.status}: what it reaches is known when it has ended"
        )
    scores = await services.scorebook.scores(campaign, wait_s)
    if scores is None:
        view = BeingMade(detail="the campaign is being scored; ask again soon")
        return JSONResponse(view.model_dump(), status_code=202, headers={"Retry-After": "2"})  # type: ignore[return-value]
    return _scores_view(campaign, scores)


def _scores_view(campaign: Campaign, scores: Scores) -> ScoresView:
    own, *control = rows_of(scores, campaign=campaign.id, label=campaign.body.name)
    return ScoresView(
        id=campaign.id, name=campaign.body.name, status=campaign.status, evaluated=scores.evaluated,
        unsafe=scores.unsafe, unsafe_share=own.unsafe_share, fractions=list(PAPER_FRACTIONS),
        t_bs=list(PAPER_T_BS), d_ths=list(PAPER_D_THS), dbs=scores.figures.dbs.tolist(),
        strict=scores.figures.strict.tolist(), control=control_view(scores.control), draws=DRAWS,
        says=[
            [control_summary(own, blind, (i, j)) for j in range(len(PAPER_D_THS))]
            for blind in control
            for i in range(len(PAPER_T_BS))
        ],
    )  # fmt: skip
