"""Routes of analyses: map, convergence curve, parameter dependence, scores, safety monitor."""

import base64
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from numpy.typing import NDArray
from pydantic import Field

from brink.search.analysis.choices import Model
from brink.search.analysis.comparison import control_summary, rows_of
from brink.search.analysis.dependence import Dependence, ParameterColumn, parameter_columns
from brink.search.analysis.ground import Ground
from brink.search.analysis.monitor import Answer, Monitor
from brink.search.analysis.paper import D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.analysis.scores import DRAWS, Scores
from brink.search.errors import SpaceError
from brink.search.space import Categorical
from brink.server.api.context import Services
from brink.server.api.experiments import control_view
from brink.server.api.responses import (
    COMPUTING,
    NOT_MODIFIED,
    computing,
    etag_of,
    json_response,
    matches,
    not_modified,
)
from brink.server.api.schemas import MAX_NUMBER, ControlView
from brink.server.api.solutions import Threshold
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ArchiveActivity, ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.outcomes import CampaignOutcomes, OutcomeGroup
from brink.server.campaigns.reported import Reported, read_asked
from brink.server.campaigns.store import Campaign
from brink.server.dashboard import figures
from brink.server.dashboard.solution_map import SolutionMap
from brink.server.db.engine import read
from brink.server.documents import Body
from brink.server.errors import Conflict, FieldError, InvalidInput, nearest
from brink.server.states import ENDED, CampaignStatus, OutcomeKind
from brink.server.views import View

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["figures"])

DIGITS = 4
"""Decimal places of coordinates and fitness on the map."""


class ColourBy(View):
    """The values of one parameter by which the map is coloured, one for each drawn solution."""

    parameter: Annotated[str, Field(description="Name as component.parameter.")]
    unit: str
    choices: Annotated[
        list[str] | None,
        Field(description="Choices of a categorical parameter; its values are indices into them."),
    ]
    low: float | None
    high: float | None
    values: Annotated[
        list[float | None], Field(description="Null where the parameter is inactive in that solution.")
    ]


class GroundView(View):
    """The ground of the map: a grid over a part of it, rows going up, as base64 with one byte for each cell."""

    left: float
    bottom: float
    right: float
    top: float
    columns: int
    rows: int
    p_th: Annotated[float, Field(description="Unsafe share in the middle of the scale.")]
    tint: Annotated[
        str,
        Field(
            description="Unsafe share of the neighbourhoods nearby: 0 safe, 128 on the boundary, 255 unsafe."
        ),
    ]
    clarity: Annotated[
        str,
        Field(description="How much is known there: 0 if nothing was simulated nearby, 255 if enough was."),
    ]


class ReportedView(View):
    """Reported results that the search has not received yet, as one list per column."""

    number: list[int]
    unsafe: Annotated[list[int], Field(description="1 or 0.")]
    outcome: Annotated[list[int], Field(description="Index of each outcome in `outcomes`.")]
    robustness: list[float]
    x: list[float]
    y: list[float]


class MapView(View):
    """Positions of solutions on the map, as one list per column, in order of evaluation."""

    version: Annotated[
        str,
        Field(
            description="Version of the layout, within which points do not move; pass it together with `after`."
        ),
    ]
    generation: Annotated[int, Field(description="Generations completed.")]
    evaluated: Annotated[int, Field(description="Evaluated solutions.")]
    drawn: Annotated[int, Field(description="Number of evaluated solutions on the map.")]
    explained: Annotated[float, Field(description="Share of the squared distances that the map preserves.")]
    across: Annotated[str | None, Field(description="Meaning of the horizontal axis, in words.")]
    up: Annotated[str | None, Field(description="Meaning of the vertical axis, in words.")]
    own_axes: Annotated[
        bool, Field(description="Whether the axes are the problem's two parameters, drawn with equal scales.")
    ]
    first: Annotated[int, Field(description="Solutions left out because the client already has them.")]
    number: list[int]
    told_in: Annotated[list[int], Field(description="Generation of each solution.")]
    unsafe: Annotated[list[int], Field(description="1 or 0.")]
    outcome: Annotated[list[int], Field(description="Index of each solution's outcome in `outcomes`.")]
    outcomes: Annotated[
        list[str],
        Field(description="The different outcomes in words, such as `front gap held; hit a pedestrian`."),
    ]
    outcome_kinds: Annotated[list[OutcomeKind], Field(description="The kind of each of these.")]
    kinds: Annotated[
        dict[OutcomeKind, str], Field(description="What the solutions of each kind have in common.")
    ]
    outcomes_in_words: Annotated[
        str, Field(description="How many drives held the requirements, and which others they violated.")
    ]
    robustness: list[float]
    x: list[float]
    y: list[float]
    fitness: Annotated[
        list[float],
        Field(description="Fitness of all drawn solutions, since it changes with every generation."),
    ]
    ground: Annotated[GroundView | None, Field(description="Null while no solution has been evaluated.")]
    reported: ReportedView
    by: ColourBy | None


@router.get("/map", response_model=MapView, responses=NOT_MODIFIED)
async def get_map(
    campaign_id: str,
    services: Services,
    request: Request,
    version: Annotated[str, Query(max_length=40, description="Version of the map that the client has.")] = "",
    after: Annotated[
        int, Query(ge=0, le=MAX_NUMBER, description="How many of its solutions the client has.")
    ] = 0,
    parameter: Annotated[
        str, Query(max_length=200, description="Parameter whose values to include, as component.parameter.")
    ] = "",
) -> Response:
    """Return the positions of a campaign's solutions on its map; large campaigns are thinned out."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    reported = await services.pages.read(services.engines, lambda c: services.reported.read(c, campaign))
    etag = _etag(campaign, found.generation, len(reported.results), version, after, parameter)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    column = None
    if parameter:
        activity = await services.archives.activity(campaign, found)
        column = await services.pages.run(lambda: _column(found, activity, parameter))
    asked = None
    if not len(found.archive):
        dimension = found.plan.problem.space.dimension
        asked = await read(services.engines, lambda c: read_asked(c, campaign, dimension))
    drawn = await services.figures.maps.get(campaign.id, found, ended=campaign.status in ENDED, asked=asked)
    outcomes = await services.outcomes.get(campaign.id, found)
    first = min(after, len(drawn.rows)) if version == drawn.version else 0

    series = await read(services.engines, lambda c: view_store.list_generations(c, campaign.id, 0))

    def respond() -> Response:
        ends = np.array([generation.evaluated for generation in series], np.int64)
        view = _map_view(found, drawn, outcomes, reported, ends, first, column)
        return json_response(view, {"ETag": etag})

    return await services.pages.run(respond)


def _etag(campaign: Campaign, *parts: object) -> str:
    return etag_of(campaign.id, campaign.sequence, campaign.status in ENDED, *parts)


def _column(found: ReadArchive, activity: ArchiveActivity, parameter: str) -> ParameterColumn:
    columns = parameter_columns(found.plan.problem.space, found.archive.vectors, activity.active)
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
    outcomes: CampaignOutcomes,
    reported: Reported,
    ends: NDArray[np.int64],
    first: int,
    column: ParameterColumn | None,
) -> MapView:
    archive, rows = found.archive, drawn.rows
    new, points = rows[first:], drawn.points[first:]
    groups = list(dict.fromkeys([*outcomes.groups, *(one.outcome for one in reported.results)]))
    return MapView.model_construct(
        version=drawn.version,
        generation=found.generation,
        evaluated=len(archive),
        drawn=len(rows),
        explained=drawn.explained,
        own_axes=drawn.own_axes,
        across=drawn.axes[0],
        up=drawn.axes[1],
        first=first,
        number=archive.numbers[new].tolist(),
        told_in=np.searchsorted(ends, new, side="right").tolist(),
        unsafe=archive.unsafe[new].astype(np.int64).tolist(),
        outcome=outcomes.which[new].tolist(),
        outcomes=[group.words for group in groups],
        outcome_kinds=[group.kind for group in groups],
        kinds={kind: outcomes.kind_words(kind) for kind in OutcomeKind},
        outcomes_in_words=outcomes.sentence(),
        robustness=_rounded(archive.robustness[new]),
        x=_rounded(points[:, 0]),
        y=_rounded(points[:, 1]),
        fitness=_rounded(archive.fitness[rows]),
        ground=None if drawn.ground is None else _ground(drawn.ground, found.plan.neighbourhood.p_th),
        reported=_reported(reported, drawn, groups),
        by=_colour_by(column, rows) if column is not None else None,
    )


def _ground(ground: Ground, p_th: float) -> GroundView:
    (left, bottom), (right, top) = ground.low.tolist(), ground.high.tolist()
    rows, columns = ground.tint.shape
    return GroundView.model_construct(
        left=left,
        bottom=bottom,
        right=right,
        top=top,
        rows=rows,
        columns=columns,
        p_th=p_th,
        tint=_bytes(ground.tint),
        clarity=_bytes(ground.clarity),
    )


def _bytes(shares: NDArray[np.float64]) -> str:
    return base64.b64encode(np.round(255 * shares).astype(np.uint8).tobytes()).decode()


def _reported(reported: Reported, drawn: SolutionMap, groups: Sequence[OutcomeGroup]) -> ReportedView:
    results, which = reported.results, {group: place for place, group in enumerate(groups)}
    points = drawn.projection.placed(reported.vectors) if results else np.empty((0, 2))
    return ReportedView.model_construct(
        number=[one.number for one in results],
        unsafe=[int(one.unsafe) for one in results],
        outcome=[which[one.outcome] for one in results],
        robustness=_rounded(np.array([one.robustness for one in results], np.float64)),
        x=_rounded(points[:, 0]),
        y=_rounded(points[:, 1]),
    )


def _rounded(values: NDArray[np.float64]) -> list[float]:
    rounded: list[float] = np.round(np.nan_to_num(values, posinf=1e9, neginf=-1e9), DIGITS).tolist()
    return rounded


def _colour_by(column: ParameterColumn, rows: NDArray[np.intp]) -> ColourBy:
    parameter, awake = column.parameter, column.active[rows].tolist()
    scale = None if isinstance(parameter, Categorical) else parameter
    return ColourBy.model_construct(
        parameter=column.name,
        unit=scale.unit if scale else "",
        choices=list(parameter.choices) if isinstance(parameter, Categorical) else None,
        low=float(scale.low) if scale else None,
        high=float(scale.high) if scale else None,
        values=[
            value if there else None
            for value, there in zip(_rounded(column.values[rows]), awake, strict=True)
        ],
    )


class CourseView(View):
    """Convergence curve, as one list per column; each point counts only solutions evaluated by then."""

    t_b: float
    d_th: float
    simulations: list[int]
    evaluated: list[int]
    dbs: list[int]
    strict_dbs: list[int]
    note: Annotated[str | None, Field(description="Why there is no curve, if there is none.")]


@router.get("/course", responses=NOT_MODIFIED)
async def get_course(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    t_b: Threshold = DEFAULT_T_B,
    d_th: Threshold = DEFAULT_D_TH,
) -> CourseView:
    """Return the convergence curve: distinct boundary solutions against simulations, at any thresholds."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    etag = _etag(campaign, found.generation, t_b, d_th)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    points = await services.figures.convergence.get(campaign.id, found, t_b, d_th)
    response.headers["ETag"] = etag
    return CourseView(
        t_b=t_b,
        d_th=d_th,
        simulations=[point.simulations for point in points],
        evaluated=[point.evaluated for point in points],
        dbs=[int(point.grid.dbs[0, 0]) for point in points],
        strict_dbs=[int(point.grid.strict[0, 0]) for point in points],
        note=_no_curve(len(found.archive)),
    )


def _no_curve(evaluated: int) -> str | None:
    if evaluated <= figures.MAX_SOLUTIONS:
        return None
    return (
        f"with more than {figures.MAX_SOLUTIONS:,} solutions, the curve is available only at the default thresholds, "
        f"t_b {DEFAULT_T_B:g} and d_th {DEFAULT_D_TH:g}"
    )


class DependenceView(View):
    """The unsafe share of solutions by value of one parameter."""

    component: str
    parameter: str
    title: Annotated[str, Field(description="Display name; empty for the name in words.")]
    unit: str
    places: Annotated[
        list[float],
        Field(description="Position of each group: index of a choice, a value, or the median of a bin."),
    ]
    labels: Annotated[list[str], Field(description="Names of the groups; empty on a numeric axis.")]
    low: float | None
    high: float | None
    log: Annotated[bool, Field(description="Whether the axis is logarithmic.")]
    counts: list[int]
    unsafe: list[int]
    strength: Annotated[
        float,
        Field(
            description="Cramér's V between group and verdict. It describes the archive; it is not a test."
        ),
    ]


class Dependences(View):
    """How the verdict depends on each parameter."""

    generation: int
    evaluated: int
    unsafe: int
    parameters: Annotated[list[DependenceView], Field(description="Strongest first.")]


@router.get("/dependence", responses=NOT_MODIFIED)
async def get_dependence(
    campaign_id: str, services: Services, request: Request, response: Response
) -> Dependences:
    """Return the unsafe share by value of each parameter. Not a risk estimate, as searches sample unevenly."""
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    etag = _etag(campaign, found.generation)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    activity = await services.archives.activity(campaign, found)
    known = await services.figures.dependences(campaign.id, found, activity)
    response.headers["ETag"] = etag
    return await services.pages.run(lambda: _dependences(found, known))


def _dependences(found: ReadArchive, known: Sequence[Dependence]) -> Dependences:
    return Dependences(
        generation=found.generation,
        evaluated=len(found.archive),
        unsafe=int(np.count_nonzero(found.archive.unsafe)),
        parameters=[_dependence(one) for one in known],
    )


def _dependence(one: Dependence) -> DependenceView:
    parameter = one.column.parameter
    scale = None if isinstance(parameter, Categorical) else parameter
    return DependenceView(
        component=one.column.component,
        parameter=parameter.name,
        title=parameter.title,
        unit=scale.unit if scale else "",
        places=one.places.tolist(),
        labels=list(one.labels),
        low=float(scale.low) if scale else None,
        high=float(scale.high) if scale else None,
        log=scale is not None and scale.log,
        counts=one.counts.tolist(),
        unsafe=one.unsafe.tolist(),
        strength=one.strength,
    )


class ScoresView(View):
    """DBS that a campaign reached, for each fraction of its budget, each t_b and each d_th."""

    id: str
    name: str
    status: CampaignStatus
    evaluated: Annotated[int, Field(description="Solutions evaluated within the budget.")]
    unsafe: int
    unsafe_share: float
    fractions: Annotated[list[float], Field(description="Fractions of the budget.")]
    t_bs: list[float]
    d_ths: list[float]
    dbs: list[list[list[float]]]
    strict: list[list[list[float]]]
    control: Annotated[
        ControlView | None, Field(description="Null if no component of the problem is a scenario.")
    ]
    draws: Annotated[int, Field(description="Number of draws that the control's values are averaged over.")]
    says: Annotated[
        list[list[str]],
        Field(
            description="Conclusion from the comparison with the control at the full budget, for each t_b and d_th; "
            "empty without a control."
        ),
    ]


@router.get("/scores", responses=COMPUTING)
async def get_scores(
    campaign_id: str,
    services: Services,
    wait_s: Annotated[
        float, Query(ge=0, le=60, description="How long to wait for the scores, in seconds.")
    ] = 10.0,
) -> ScoresView:
    """Return the DBS and strict DBS of an ended campaign, and of its control, at fractions of its budget."""
    campaign = await services.campaigns.get(campaign_id)
    if campaign.status not in ENDED:
        raise Conflict(f"campaign {campaign.id} is {campaign.status}: scores are available once it has ended")
    scores = await services.scorebook.scores(campaign, wait_s)
    if scores is None:
        return computing("the campaign is being scored; try again soon")  # type: ignore[no-any-return]
    return await services.pages.run(lambda: _scores_view(campaign, scores))


def _scores_view(campaign: Campaign, scores: Scores) -> ScoresView:
    own, *control = rows_of(scores, campaign=campaign.id, label=campaign.body.name)
    return ScoresView(
        id=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        evaluated=scores.evaluated,
        unsafe=scores.unsafe,
        unsafe_share=own.unsafe_share,
        fractions=list(PAPER_FRACTIONS),
        t_bs=list(PAPER_T_BS),
        d_ths=list(D_THS),
        dbs=scores.figures.dbs.tolist(),
        strict=scores.figures.strict.tolist(),
        control=control_view(scores.control),
        draws=DRAWS,
        says=[
            [control_summary(own, blind, (i, j)) for j in range(len(D_THS))]
            for blind in control
            for i in range(len(PAPER_T_BS))
        ],
    )


monitors_router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["monitors"])

MAX_SOLUTIONS = 1_000


class Questions(Body):
    """Solutions to score."""

    solutions: Annotated[
        list[dict[str, dict[str, Any]]],
        Field(
            min_length=1,
            max_length=MAX_SOLUTIONS,
            description="Parameters of each solution by component and name, as in the response for a solution.",
        ),
    ]
    threshold: Annotated[
        float | None,
        Field(
            gt=0, lt=1, description="Probability above which a solution is called unsafe; p_th by default."
        ),
    ] = None
    model: Annotated[
        Literal["trees", "neighbours"] | None,
        Field(description="Model to fit; by default trees if they can be fitted, otherwise neighbours."),
    ] = None


class RiskView(View):
    """Estimated probability that a solution is unsafe."""

    probability: float
    low: Annotated[float, Field(description="Lower limit of the interval.")]
    high: float
    neighbours: Annotated[
        float | None,
        Field(description="Effective number of nearby evaluations: their total weight; null for trees."),
    ]
    nearest: Annotated[float, Field(description="Distance to the nearest evaluated solution.")]
    unlike: Annotated[
        str, Field(description="How the solution differs from anything evaluated; empty if it does not.")
    ]
    answer: Annotated[
        Answer,
        Field(
            description="`unknown` if the interval contains the threshold, or if the solution is unlike "
            "anything evaluated."
        ),
    ]


class Scored(View):
    """Risk estimates of a campaign's safety monitor."""

    campaign: str
    learned_from: Annotated[int, Field(description="Number of solutions that the monitor was fitted to.")]
    threshold: float
    model: Annotated[Model, Field(description="The fitted model.")]
    risks: Annotated[
        list[RiskView], Field(description="One estimate for each solution, in the order of the request.")
    ]


@monitors_router.post("/monitor/score")
async def score_solutions(campaign_id: str, questions: Questions, services: Services) -> Scored:
    """Estimate the probability that solutions are unsafe; intervals are wide where few solutions were evaluated."""
    campaign = await services.campaigns.get(campaign_id)
    monitor = await services.monitors.get(
        campaign, None if questions.model is None else Model(questions.model)
    )
    threshold = questions.threshold if questions.threshold is not None else monitor.threshold
    return await services.analyses.run(lambda: _scored(campaign.id, monitor, questions.solutions, threshold))


def _scored(
    campaign: str, monitor: Monitor, solutions: Sequence[dict[str, dict[str, Any]]], threshold: float
) -> Scored:
    rows = []
    for place, values in enumerate(solutions):
        try:
            rows.append(monitor.encoded(values))
        except SpaceError as error:
            raise InvalidInput.at(f"/solutions/{place}", str(error)) from None
    risks = monitor.score(np.array(rows))
    return Scored(
        campaign=campaign,
        learned_from=len(monitor),
        threshold=threshold,
        model=monitor.model,
        risks=[RiskView(**asdict(risk)) for risk in risks.each(threshold)],
    )
