"""Routes of tolerances: how gross an error may be before too many drives violate a requirement because of it."""

import asyncio
import itertools
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Final, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

from brink.search.analysis.confirmation import Share
from brink.search.curves import Curve, Screening, severities
from brink.search.odd import with_odd
from brink.search.streams import Stream, generator
from brink.server.api.context import Services
from brink.server.api.pair_views import ShareView
from brink.server.api.responses import NOT_MODIFIED, etag_of, matches, not_modified
from brink.server.api.schemas import View
from brink.server.campaigns.detector_check import (
    ALL_DRIVES,
    MOST_DRIVES,
    CellCheck,
    CheckResult,
    Drive,
    check_detector,
    read_drives,
)
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.campaigns.tolerance import CampaignTolerance
from brink.server.csv_text import csv_text
from brink.server.errors import InvalidInput
from brink.server.problems.base import (
    MeasuresDetector,
    NamesRequirements,
    RatesMeasuredErrors,
    ScalesSeverity,
    SeverityScale,
)
from brink.server.problems.changes import as_sentence
from brink.server.states import CampaignStatus
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_meter import MEASURED

router = APIRouter(prefix="/campaigns/{campaign_id}/tolerance", tags=["tolerance"])

_NEARLY_ALL = 0.95
"""Severity from which the end of the scale is not told apart."""
EXAMPLES = 5
"""Most violations listed for a cell."""
BASELINE_CONFIDENCE = 0.95
"""Confidence of the intervals of shares without any error."""


class Finding(StrEnum):
    """What is known of a cell."""

    LIMIT = "limit"
    """The limit is reached within the scale."""
    THROUGHOUT = "throughout"
    """The limit is not reached, however gross the error."""
    UNDECIDED = "undecided"
    """It may or may not be reached within the scale."""


class Amount(View):
    """A severity and the magnitude that it stands for; both are null beyond the scale."""

    severity: float | None
    magnitude: Annotated[float | None, Field(description="In the unit of the cell; null without one, too.")]


class ToleratedView(View):
    """The severity at which the share of caused violations reaches the limit, with its interval."""

    finding: Finding
    value: Amount
    low: Annotated[Amount, Field(description="Lower end; above it, the limit may be exceeded.")]
    high: Amount


class CurveView(View):
    """The share of drives with a violation that the error caused, by severity, as one list per column."""

    severity: list[float]
    magnitude: Annotated[list[float] | None, Field(description="In the unit of the cell.")]
    share: Annotated[list[float], Field(description="Median.")]
    low: list[float]
    high: list[float]
    drives: Annotated[list[int], Field(description="Simulated drives with the error.")]
    caused: Annotated[list[int], Field(description="Those with a violation that the error caused.")]


class FallView(View):
    """A stretch of severity over which more error is safer."""

    from_severity: float
    to_severity: float
    from_share: float
    to_share: float
    words: str


class ExampleView(View):
    """A drive with a violation that the error caused."""

    number: int
    severity: float
    magnitude: float | None


class CellView(View):
    """One cell: a combination of choices under a condition."""

    place: Annotated[int, Field(description="Its place in the list, from 1.")]
    choices: dict[str, str]
    condition: str
    error: Annotated[
        str, Field(description="The error as an activity of the component, without its magnitude.")
    ]
    words: Annotated[str, Field(description="The error as an activity of the component, with its magnitude.")]
    sentence: Annotated[str, Field(description="The requirement that follows, with its basis.")]
    basis: Annotated[
        str, Field(description="How many drives it rests on, in words; empty if there are none.")
    ]
    unit: Annotated[str, Field(description="Unit of magnitudes; empty for none.")]
    decimals: Annotated[int, Field(description="Decimal places of magnitudes that matter.")]
    meaning: str
    drives: Annotated[int, Field(description="Drives with the error; of screened cells, vulnerable ones.")]
    caused: Annotated[int, Field(description="Those with a violation that the error caused.")]
    screened: Annotated[
        int, Field(description="Drives that were screened with the grossest error; 0 for none.")
    ]
    vulnerable: Annotated[int, Field(description="Those with a violation that the grossest error caused.")]
    tolerated: ToleratedView
    curve: CurveView
    fall: FallView | None
    examples: Annotated[list[ExampleView], Field(description="Mildest errors that caused a violation first.")]


class BaselineView(View):
    """How often drives violate a requirement without any error."""

    condition: str
    choices: Annotated[
        list[dict[str, str]],
        Field(description="Cells that it belongs to, by those of their choices that matter."),
    ]
    share: ShareView


class ToleranceView(View):
    """The tolerances of a campaign."""

    campaign: str
    name: str
    status: CampaignStatus
    complete: Annotated[bool, Field(description="Whether the campaign has ended.")]
    requirements: list[str]
    limit: float
    confidence: float
    note: str
    caveat: Annotated[str, Field(description="What the tolerances do not say.")]
    simulations: Annotated[
        int, Field(description="Simulations with a verdict, those without an error included.")
    ]
    open: Annotated[
        int, Field(description="Violations of which it is not known whether the error caused them.")
    ]
    mean_width: Annotated[float, Field(description="Mean width of the intervals, as a share of the scale.")]
    conditions: list[str]
    baseline: list[BaselineView]
    audited: Annotated[
        int,
        Field(description="Drives simulated with a milder error although they hold with the grossest one."),
    ]
    leaks: Annotated[int, Field(description="Those that violated all the same.")]
    cells: list[CellView]


@router.get("", responses={200: {"content": {"text/csv": {}}}, **NOT_MODIFIED})
async def get_tolerance(
    campaign_id: str,
    services: Services,
    request: Request,
    response: Response,
    format: Literal["json", "csv"] = "json",  # noqa: A002  (the name of the query parameter)
) -> ToleranceView:
    """Return how gross the errors of a component may be, by type, target and condition; CSV has one row per cell."""
    campaign = await services.campaigns.get(campaign_id)
    archive = await services.archives.get(campaign)
    etag = etag_of(campaign.id, campaign.sequence, archive.generation, format)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    found = await services.tolerances.get(campaign, archive)
    view = await services.pages.run(lambda: tolerance_view(campaign, archive.plan, found))
    if format == "json":
        response.headers["ETag"] = etag
        return view
    return Response(  # type: ignore[return-value]
        tolerance_csv(view), media_type="text/csv; charset=utf-8", headers={"ETag": etag}
    )


_TARGETS = tuple(target.value for target in Target)
_TYPES = tuple(kind.value for kind in MEASURED)


class DriveBody(BaseModel):
    """The errors of a detector in one drive."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[str, Field(max_length=200)]
    condition: Annotated[
        str | None, Field(description="One of the campaign's conditions; null if it is unknown.")
    ] = None
    measures: Annotated[
        dict[str, dict[str, FiniteFloat]],
        Field(
            description="Magnitude of each type of error, by target; shares as fractions of 1. What the drive cannot "
            "tell is missing."
        ),
    ]
    at_least: Annotated[
        dict[str, list[str]],
        Field(
            description="Types whose magnitude is a lower bound, by target, such as a miss at the end of a "
            "recording. A lower bound of no error tells nothing."
        ),
    ] = {}

    @field_validator("measures")
    @classmethod
    def _known(cls, measures: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
        _check_errors(measures)
        for target, errors in measures.items():
            for kind, magnitude in errors.items():
                if magnitude < 0.0:
                    raise ValueError(f"{target}.{kind}: expected a magnitude >= 0, got {magnitude:g}")
        return measures

    @field_validator("at_least")
    @classmethod
    def _known_bounds(cls, at_least: dict[str, list[str]]) -> dict[str, list[str]]:
        _check_errors(at_least)
        return at_least


def _check_errors(errors: Mapping[str, Collection[str]]) -> None:
    """Refuse unknown targets and types of error."""
    for target, kinds in errors.items():
        if target not in _TARGETS:
            raise ValueError(f"expected targets of {', '.join(_TARGETS)}; got {target!r}")
        for kind in kinds:
            if kind not in _TYPES:
                raise ValueError(f"{target}: expected types of {', '.join(_TYPES)}; got {kind!r}")


class DetectorBody(BaseModel):
    """The errors of a detector in its drives."""

    model_config = ConfigDict(extra="forbid")

    detector: Annotated[str, Field(max_length=200, description="What to call it.")]
    drives: Annotated[list[DriveBody], Field(min_length=1, max_length=MOST_DRIVES)]

    @field_validator("drives")
    @classmethod
    def _distinct(cls, drives: list[DriveBody]) -> list[DriveBody]:
        name, count = Counter(drive.name for drive in drives).most_common(1)[0]
        if count > 1:
            raise ValueError(f"expected each drive once, got {name!r} {count} times")
        return drives


class DetectorCell(View):
    """A detector's errors of one cell."""

    choices: dict[str, str]
    error: str
    condition: str
    result: CheckResult
    drives: Annotated[
        int,
        Field(description="Drives of the detector under the condition that tell how gross this error is."),
    ]
    needed: Annotated[
        int | None,
        Field(
            description="Drives with such errors that would decide, or without errors if there are none yet; null if "
            "more drives would not, or if it is decided."
        ),
    ]
    at_least: Annotated[
        int,
        Field(description="Drives whose error was cut off by the recording, so that it is a lower bound."),
    ]
    typical: Annotated[float | None, Field(description="Median magnitude, in the unit of the cell.")]
    grossest: Annotated[float | None, Field(description="Magnitude that 5% of the drives exceed.")]
    unit: str
    beyond: Annotated[int, Field(description="Drives with a grosser error than is tolerated.")]
    share: Annotated[float | None, Field(description="Share of drives that such errors make violate.")]
    low: float | None
    high: float | None
    worst: Annotated[list[str], Field(description="Drives with the grossest errors, grossest first.")]
    sentence: Annotated[str, Field(description="The result with its basis.")]


class DetectorConditionView(View):
    """The detector's drives under one condition."""

    condition: str
    drives: int
    violations: Annotated[
        int | None, Field(description="Those that violated a requirement; null if unknown.")
    ]


class DetectorView(View):
    """Whether a detector meets the requirement of a campaign."""

    campaign: str
    detector: str
    limit: float
    confidence: float
    note: str
    meaning: Annotated[str, Field(description="What met means, and of what.")]
    no_data: Annotated[str, Field(description="What no drive tells anything about; empty for nothing.")]
    next: Annotated[list[str], Field(description="What to record next to decide more, in sentences.")]
    conditions: list[DetectorConditionView]
    cells: Annotated[
        list[DetectorCell], Field(description="Those that are not met first, those without data last.")
    ]


@router.get("/detector")
async def get_detector(
    campaign_id: str,
    services: Services,
    episodes: Annotated[
        str, Query(description="A campaign with a camera and a detector in the loop, such as urban-camera@1.")
    ],
) -> DetectorView:
    """Return whether the detector of another campaign meets the requirement of this one."""
    campaign, other = await services.campaigns.get(campaign_id), await services.campaigns.get(episodes)
    archive = await services.archives.get(campaign)
    found = await services.tolerances.get(campaign, archive)
    there = await services.archives.get(other)
    drives = await services.pages.read(services.engines, lambda c: read_drives(c, other, there, found.layout))
    problem = there.plan.problem
    name = problem.measured_detector if isinstance(problem, MeasuresDetector) else other.body.name
    return await services.analyses.run(lambda: detector_view(campaign, archive.plan, found, name, drives))


@router.post("/detector")
async def post_detector(campaign_id: str, services: Services, body: DetectorBody) -> DetectorView:
    """Return whether a detector meets the requirement of a campaign, given its errors in drives of its own."""
    campaign = await services.campaigns.get(campaign_id)
    archive = await services.archives.get(campaign)
    found = await services.tolerances.get(campaign, archive)
    drives = [
        Drive(name=one.name, condition=one.condition, measures=one.measures, at_least=one.at_least)
        for one in body.drives
    ]
    return await services.analyses.run(
        lambda: detector_view(campaign, archive.plan, found, body.detector, drives)
    )


def detector_view(
    campaign: Campaign, plan: Plan, found: CampaignTolerance, name: str, drives: Sequence[Drive]
) -> DetectorView:
    """Return whether a detector meets a requirement.

    Args:
        campaign: The campaign with the tolerances.
        plan: Its plan.
        found: The tolerances.
        name: Name of the detector.
        drives: Its errors.

    Raises:
        InvalidInput: The errors do not fit the campaign.
    """
    order = list(_SHOWN)
    checks = sorted(
        check_detector(found, plan.problem, drives, campaign.body.seed),
        key=lambda check: order.index(check.result),
    )
    requirements = list(plan.problem.requirements) if isinstance(plan.problem, NamesRequirements) else []
    limit, confidence = found.config.limit, found.config.confidence
    cells = [
        _detector_cell(check, _Words(plan.problem, check.choices, requirements, limit)) for check in checks
    ]
    conditions = []
    for condition in dict.fromkeys((*found.layout.conditions, *(check.condition for check in checks))):
        here = [drive for drive in drives if condition in (drive.condition, ALL_DRIVES)]
        known = [drive.unsafe for drive in here if drive.unsafe is not None]
        conditions.append(
            DetectorConditionView(
                condition=condition, drives=len(here), violations=sum(known) if known else None
            )
        )
    return DetectorView(
        campaign=campaign.id,
        detector=name,
        limit=limit,
        confidence=confidence,
        note=_verdict(name, len(drives), [check.result for check in checks]),
        meaning="Each cell is a type of error that concerns one target, under one condition. Met: errors of the "
        f"sizes that this detector has make at most {limit:.0%} of drives {_violated(requirements)}, even at the "
        f"upper end of an interval of {confidence:.0%}. Not met: they make more, even at its lower end."
        + _not_judged(plan.problem, [check.choices for check in checks], drives),
        no_data=_no_data(cells),
        next=_next(cells, sum(drive.condition is None for drive in drives)),
        conditions=conditions,
        cells=cells,
    )


def _not_judged(problem: object, cells: Sequence[Mapping[str, str]], drives: Sequence[Drive]) -> str:
    """Return in a sentence the gross errors of the detector for which the campaign has no cell; empty for none."""
    names = {name.rpartition(".")[2]: name for name in cells[0]} if cells else {}
    if not (isinstance(problem, RatesMeasuredErrors) and isinstance(problem, ScalesSeverity)) or set(
        names
    ) != {"type", "target"}:
        return ""
    targets = dict.fromkeys(cell[names["target"]] for cell in cells)
    worst = []
    for kind, target in itertools.product(_TYPES, targets):
        choices = {names["type"]: kind, names["target"]: target}
        rated = [problem.measured_severity(choices, drive.measures, drive.at_least) for drive in drives]
        severity = max((one.severity for one in rated if one is not None), default=0.0)
        scale = problem.severity_scale(choices)
        if choices not in cells and severity >= _GROSS and scale is not None:
            worst.append((severity, problem.error_words(choices, scale.words(severity))))
    worst.sort(reverse=True)
    if not worst:
        return ""
    return f" Not judged, for want of a cell: {'; '.join(words for _, words in worst[:_MOST_NOT_JUDGED])}."


_GROSS: Final = 0.25
"""Severity from which an error is worth naming although no cell judges it."""
_MOST_NOT_JUDGED: Final = 5


_SHOWN: Final = (CheckResult.NOT_MET, CheckResult.TOO_LITTLE, CheckResult.MET, CheckResult.NO_DATA)
"""The order in which results matter."""


def _verdict(name: str, drives: int, results: Sequence[CheckResult]) -> str:
    """Return in how many cells a requirement is met, not met, or neither, in one sentence."""
    not_met, met, no_data = (
        results.count(result) for result in (CheckResult.NOT_MET, CheckResult.MET, CheckResult.NO_DATA)
    )
    unknown = len(results) - not_met - met
    if not_met:
        words = "does not meet the requirement"
    elif unknown:
        words = "is not shown to meet the requirement"
    else:
        words = "meets the requirement"
    without = f" ({no_data} without any data)" if no_data else ""
    return (
        f"{name} {words}: not met in {not_met} of {len(results)} cells, unknown in {unknown}{without}, met in {met}; "
        f"from {drives:,} {'drive' if drives == 1 else 'drives'}"
    )


def _detector_cell(check: CellCheck, words: "_Words") -> DetectorCell:
    drives, share = len(check.severity), check.share
    middle, most = (
        np.quantile(check.severity, [0.5, 0.95], method="inverted_cdf").tolist() if drives else (None, None)
    )
    scale = words.scale
    return DetectorCell(
        choices=dict(check.choices),
        error=words.error,
        condition=check.condition,
        result=check.result,
        drives=drives,
        needed=check.needed,
        at_least=check.bounds,
        typical=_in_unit(scale, middle),
        grossest=_in_unit(scale, most),
        unit=scale.unit if scale else "",
        beyond=check.beyond,
        share=share.value if share else None,
        low=share.low if share else None,
        high=share.high if share else None,
        worst=list(check.worst),
        sentence=words.checked(check, middle),
    )


def _no_data(cells: Sequence[DetectorCell]) -> str:
    """Return what no drive tells anything about, in a sentence for each group of conditions."""
    conditions: dict[str, list[str]] = {}
    for condition in dict.fromkeys(cell.condition for cell in cells):
        here = [cell for cell in cells if cell.condition == condition]
        without = [cell.error for cell in here if cell.result is CheckResult.NO_DATA]
        if without:
            errors = "everything" if len(without) == len(here) else ", ".join(without)
            conditions.setdefault(errors, []).append(condition)
    parts = [f"{as_sentence('; '.join(names))}: {errors}." for errors, names in conditions.items()]
    return f"Without data. {' '.join(parts)}" if parts else ""


def _next(cells: Sequence[DetectorCell], without_condition: int) -> list[str]:
    """Return what to record next: where more drives would decide, where there are none yet, and the rest.

    Args:
        cells: The cells.
        without_condition: How many drives have no condition.
    """
    begun: dict[tuple[str, str], list[int]] = {}
    empty: dict[str, list[DetectorCell]] = {}
    has_conditions = any(cell.condition != ALL_DRIVES for cell in cells)
    for cell in cells:
        target = next((value for name, value in cell.choices.items() if name.endswith(".target")), "")
        if cell.needed is not None and cell.drives:
            begun.setdefault((cell.condition, target), []).append(cell.needed - cell.drives)
        elif cell.needed is not None and (cell.condition != ALL_DRIVES or not has_conditions):
            empty.setdefault(target, []).append(cell)
    words = [
        f"{as_sentence(condition)}: about {most:,} more {'drive' if most == 1 else 'drives'} with "
        f"{_in_sight(target)} would decide {_cells(len(more))} if they are like those so far"
        for (condition, target), more in begun.items()
        if (most := max(more)) > 0
    ]
    if without_condition and has_conditions:
        words.append(
            f"{without_condition:,} {'drive has' if without_condition == 1 else 'drives have'} no condition, and "
            "count under all drives alone: say what it was like"
        )
    for target, without in empty.items():
        conditions = list(dict.fromkeys(cell.condition for cell in without))
        words.append(
            f"{as_sentence('; '.join(conditions))}: {max(cell.needed or 0 for cell in without):,} drives or more"
            f"{' each' if len(conditions) > 1 else ''} with {_in_sight(target)}, before "
            f"{_cells(len(without))} can be met; none so far tells anything about them"
        )
    open_ended = sum(cell.result is CheckResult.TOO_LITTLE and cell.needed is None for cell in cells)
    if open_ended:
        words.append(
            f"More drives would not decide {_cells(open_ended)}: the requirement is too uncertain, or the detector "
            "too close to it; a campaign with a larger budget may decide"
        )
    return words


def _cells(number: int) -> str:
    return "1 cell" if number == 1 else f"{number} cells"


def _in_sight(target: str) -> str:
    return f"{_IN_SIGHT.get(target, 'such a road user')} in sight"


_IN_SIGHT: Final[Mapping[str, str]] = {
    Target.LEAD: "a vehicle ahead",
    Target.ONCOMING: "an oncoming vehicle",
    Target.CROSSING: "a crossing vehicle",
    Target.PEDESTRIAN: "a pedestrian near the lane",
    Target.EVERYBODY: "somebody",
}


def _in_unit(scale: SeverityScale | None, severity: float | None) -> float | None:
    if severity is None:
        return None
    return severity if scale is None else scale.at(severity)


class AgreementCell(View):
    """What fresh drives say of one cell."""

    place: Annotated[int, Field(description="Its place in the list of cells, from 1.")]
    choices: dict[str, str]
    error: str
    condition: str
    drives: Annotated[int, Field(description="Fresh drives with the error.")]
    caused: Annotated[int, Field(description="Fresh drives with a violation that the error caused.")]
    low: Annotated[int, Field(description="Lower end of the interval in which that number was predicted.")]
    high: int
    agrees: bool


class AgreementView(View):
    """Whether the drives of another campaign are as the tolerances of a campaign predict."""

    campaign: str
    fresh: str
    confidence: float
    drives: int
    agreeing: Annotated[int, Field(description="Cells whose number lies in its interval.")]
    note: str
    cells: list[AgreementCell]


@router.get("/agreement")
async def get_agreement(
    campaign_id: str,
    services: Services,
    fresh: Annotated[
        str, Query(description="Another campaign that searches for tolerances in the same cells.")
    ],
    confidence: Annotated[
        float, Query(gt=0, lt=1, description="Probability that an interval covers the number.")
    ] = 0.95,
) -> AgreementView:
    """Return whether the drives of another campaign, simulated afresh, are as these tolerances predict."""
    campaign, other = await services.campaigns.get(campaign_id), await services.campaigns.get(fresh)
    if campaign.id == other.id:
        raise InvalidInput.at("/query/fresh", f"expected another campaign than {campaign.id} itself")
    if campaign.body.seed == other.body.seed:
        raise InvalidInput.at(
            "/query/fresh",
            f"expected a campaign with another seed than {campaign.body.seed}: its drives are the same",
        )
    if campaign.body.problem != other.body.problem:
        raise InvalidInput.at(
            "/query/fresh", "expected a campaign on the same problem with the same parameters"
        )
    known, found = [
        await services.tolerances.get(one, await services.archives.get(one)) for one in (campaign, other)
    ]
    if found.layout.groups or found.config.fixed != known.config.fixed:
        raise InvalidInput.at(
            "/query/fresh",
            "expected a campaign that does not screen its drives, such as one with design: random, and with the same "
            "fixed parameters",
        )
    plan = (await services.archives.get(campaign)).plan
    return await asyncio.to_thread(agreement_view, campaign, plan, other, known, found, confidence)


def agreement_view(
    campaign: Campaign,
    plan: Plan,
    other: Campaign,
    known: CampaignTolerance,
    found: CampaignTolerance,
    confidence: float,
) -> AgreementView:
    """Return whether fresh drives are as tolerances predict.

    Args:
        campaign: The campaign with the tolerances.
        plan: Its plan.
        other: The campaign with the fresh drives.
        known: The tolerances.
        found: What the fresh drives say.
        confidence: Probability that an interval covers the number of caused violations.

    Raises:
        InvalidInput: The campaigns have no cell in common.
    """
    places = {(cell.condition, cell.choices): place for place, cell in enumerate(found.layout.cells)}
    cells = []
    for place, (cell, curve) in enumerate(zip(known.layout.cells, known.curves, strict=True)):
        there = places.get((cell.condition, cell.choices))
        if there is None or known.layout.names != found.layout.names:
            continue
        fresh = found.curves[there]
        levels = np.repeat(np.arange(1, len(fresh.drives) + 1), fresh.drives)
        low, high = curve.predicted(
            levels, generator(campaign.body.seed, Stream.TOLERANCE, 3, place), confidence
        )
        caused = int(fresh.caused.sum())
        choices = dict(zip(known.layout.names, cell.choices, strict=True))
        cells.append(
            AgreementCell(
                place=place + 1,
                choices=choices,
                error=error_words(plan.problem, choices),
                condition=cell.condition,
                drives=len(levels),
                caused=caused,
                low=low,
                high=high,
                agrees=low <= caused <= high,
            )
        )
    if not cells:
        raise InvalidInput.at("/query/fresh", f"campaign {other.id} has no cell in common with {campaign.id}")
    agreeing, drives = sum(cell.agrees for cell in cells), sum(cell.drives for cell in cells)
    return AgreementView(
        campaign=campaign.id,
        fresh=other.id,
        confidence=confidence,
        drives=drives,
        agreeing=agreeing,
        note=f"{drives} fresh drives: in {agreeing} of {len(cells)} cells, as many violate because of the error as "
        f"predicted, within intervals of {confidence:.0%}",
        cells=cells,
    )


def tolerance_view(campaign: Campaign, plan: Plan, found: CampaignTolerance) -> ToleranceView:
    """Return the tolerances of a campaign for people and programs.

    Args:
        campaign: The campaign.
        plan: Its plan.
        found: Its tolerances.
    """
    problem = plan.problem
    requirements = list(problem.requirements) if isinstance(problem, NamesRequirements) else []
    layout, config = found.layout, found.config
    examples: dict[int, list[tuple[int, int]]] = {}
    for at, level, number in found.tally.caused:
        examples.setdefault(at, []).append((level, number))
    cells = []
    for place, (cell, curve) in enumerate(zip(layout.cells, found.curves, strict=True)):
        choices = dict(zip(layout.names, cell.choices, strict=True))
        words = _Words(problem, choices, requirements, config.limit)
        screening = None if cell.group is None else found.tally.screenings[cell.group]
        basis = _basis(curve, screening)
        cells.append(
            CellView(
                place=place + 1,
                choices=choices,
                condition=cell.condition,
                error=error_words(problem, choices),
                words=words.activity(curve),
                sentence=words.sentence(cell.condition, curve, basis),
                basis=basis,
                unit=words.scale.unit if words.scale else "",
                decimals=words.scale.decimals if words.scale else 2,
                meaning=words.scale.meaning if words.scale else "severity of the error",
                drives=int(curve.drives.sum()),
                caused=int(curve.caused.sum()),
                screened=0 if screening is None else screening.screened,
                vulnerable=0 if screening is None else screening.vulnerable,
                tolerated=words.tolerated(curve, basis),
                curve=words.curve(curve),
                fall=words.fall(curve),
                examples=[
                    ExampleView(
                        number=number,
                        severity=level / len(curve.drives),
                        magnitude=words.magnitude(level / len(curve.drives)),
                    )
                    for level, number in examples.get(place, ())[:EXAMPLES]
                ],
            )
        )
    drives = sum(cell.drives for cell in cells)
    return ToleranceView(
        campaign=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        complete=campaign.status in ENDED,
        requirements=requirements,
        limit=config.limit,
        confidence=config.confidence,
        simulations=campaign.evaluated,
        open=len(found.tally.open_numbers),
        note=_note(cells, drives, config.limit, config.confidence),
        caveat=with_odd(_caveat(cells, config.limit), plan.problem.space),
        conditions=list(layout.conditions),
        baseline=_baselines(found),
        cells=cells,
        mean_width=sum(curve.tolerated.width for curve in found.curves) / len(found.curves),
        audited=sum(one.audited for one in found.tally.screenings),
        leaks=sum(one.leaked for one in found.tally.screenings),
    )


def _note(cells: list[CellView], drives: int, limit: float, confidence: float) -> str:
    findings = [cell.tolerated.finding for cell in cells]
    reached, never = findings.count(Finding.LIMIT), findings.count(Finding.THROUGHOUT)
    if not any(cell.basis for cell in cells):
        return f"no drive with an error has been simulated yet; {len(cells)} cells are to be measured"
    return (
        f"{len(cells)} cells, {drives} drives with an error: in {reached} the error makes {limit:.0%} of drives "
        f"violate at some magnitude, in {never} at none; {len(cells) - reached - never} undecided; intervals of "
        f"{confidence:.0%}"
    )


def _caveat(cells: list[CellView], limit: float) -> str:
    about = "All of this is about one error at a time, in these scenarios, with this driving system."
    without = [cell for cell in cells if cell.basis and cell.tolerated.finding is Finding.THROUGHOUT]
    if not without:
        return about
    more = ""
    if shares := [cell.vulnerable / cell.screened for cell in without if cell.screened]:
        low, high = f"{min(shares):.0%}", f"{max(shares):.0%}"
        more = (
            f" The grossest error concerning the same road users makes "
            f"{low if low == high else f'{low} to {high}'} of drives violate."
        )
    return (
        f"{about} An error for which no limit was found is not harmless: it may make up to {limit:.0%} of drives "
        f"violate, and more in other scenarios or together with other errors.{more}"
    )


def _basis(curve: Curve, screening: Screening | None) -> str:
    """Return how many drives the tolerance of a cell rests on; empty if there are none."""
    drives, caused = int(curve.drives.sum()), int(curve.caused.sum())
    if screening is None:
        return f"such errors did so in {caused} of {drives} drives" if drives else ""
    if not screening.screened:
        return ""
    vulnerable = f"{screening.vulnerable} of {screening.screened} drives are vulnerable"
    return (
        f"such errors did so in {caused} of {drives} vulnerable drives; {vulnerable}"
        if drives
        else vulnerable
    )


def _baselines(found: CampaignTolerance) -> list[BaselineView]:
    layout = found.layout
    views = []
    for population, (violating, drives) in enumerate(found.tally.baseline):
        members = [cell for cell in layout.cells if cell.population == population]
        others = [
            cell
            for cell in layout.cells
            if cell.condition == members[0].condition and cell.population != population
        ]
        kept = [
            place
            for place, _ in enumerate(layout.names)
            if others and {c.choices[place] for c in members}.isdisjoint(c.choices[place] for c in others)
        ]
        choices = {tuple((layout.names[place], cell.choices[place]) for place in kept) for cell in members}
        views.append(
            BaselineView(
                condition=members[0].condition,
                choices=[dict(one) for one in sorted(choices)],
                share=ShareView.model_validate(
                    Share.of(violating, drives, confidence=BASELINE_CONFIDENCE), from_attributes=True
                ),
            )
        )
    return views


def error_words(problem: Any, choices: Mapping[str, str]) -> str:
    """Return the error of a cell without its magnitude, such as ``not reporting the lead for …``."""
    if isinstance(problem, ScalesSeverity) and problem.severity_scale(choices) is not None:
        return problem.error_words(choices, "…")
    return ", ".join(choice.replace("_", " ") for choice in choices.values()) or "the error"


class _Words:
    """Puts what is known of a cell into words and units."""

    def __init__(
        self, problem: Any, choices: Mapping[str, str], requirements: list[str], limit: float
    ) -> None:
        self._problem = problem if isinstance(problem, ScalesSeverity) else None
        self._choices = choices
        self._requirements = requirements
        self._limit = limit
        self.scale: SeverityScale | None = (
            self._problem.severity_scale(choices) if self._problem is not None else None
        )

    def magnitude(self, severity: float) -> float | None:
        return None if self.scale is None else self.scale.at(severity)

    def tolerated(self, curve: Curve, basis: str) -> ToleratedView:
        value, low, high = (self._amount(one) for one in _ends(curve))
        return ToleratedView(finding=_finding(curve, basis), value=value, low=low, high=high)

    def _amount(self, severity: float) -> Amount:
        if math.isinf(severity):
            return Amount(severity=None, magnitude=None)
        return Amount(severity=severity, magnitude=self.magnitude(severity))

    def curve(self, curve: Curve) -> CurveView:
        grid = severities().tolist()
        return CurveView(
            severity=grid,
            magnitude=None if self.scale is None else [self.scale.at(one) for one in grid],
            share=curve.median.tolist(),
            low=curve.low.tolist(),
            high=curve.high.tolist(),
            drives=[0, *curve.drives.tolist()],
            caused=[0, *curve.caused.tolist()],
        )

    def activity(self, curve: Curve) -> str:
        """Return the error with the magnitude at which the limit is reached, or with the largest one."""
        value, low, high = _ends(curve)
        if math.isinf(value):
            return self._activity(self._number(1.0, unit=True))
        if low == high:
            return self._activity(self._number(value, unit=True))
        return self._activity(f"{self._number(value, unit=True)} [{self._range(low, high)}]")

    def _activity(self, magnitude: str) -> str:
        if self._problem is None or self.scale is None:
            choices = ", ".join(self._choices.values())
            return f"{choices} at severity {magnitude}".lstrip()
        return self._problem.error_words(self._choices, magnitude)

    def _range(self, low: float, high: float) -> str:
        ends = sorted((low, high), key=lambda one: self.magnitude(min(one, 1.0)) or min(one, 1.0))
        texts = ["beyond" if math.isinf(one) else self._number(one) for one in ends]
        return ", ".join(texts)

    def _number(self, severity: float, *, unit: bool = False) -> str:
        if self.scale is None:
            return f"{severity:.2f}"
        return self.scale.words(severity) if unit else self.scale.number(severity)

    def sentence(self, condition: str, curve: Curve, basis: str) -> str:
        """Return the requirement that follows from a cell, with its interval.

        Args:
            condition: Its condition.
            curve: Its curve.
            basis: How many drives it rests on; empty if there are none.
        """
        share = f"{self._limit:.0%}"
        violated = _violated(self._requirements)
        activity = self.activity(curve)
        match _finding(curve, basis):
            case Finding.LIMIT:
                words = f"{activity} makes {share} of drives {violated}"
            case Finding.THROUGHOUT:
                words = f"{activity} makes fewer than {share} of drives {violated}"
            case Finding.UNDECIDED if not basis:
                words = f"{self._activity('any magnitude')}: nothing is known yet"
            case Finding.UNDECIDED if math.isinf(curve.tolerated.value):
                words = f"{activity} probably makes fewer than {share} of drives {violated}"
                if curve.tolerated.low < _NEARLY_ALL:
                    low = self._number(curve.tolerated.low, unit=True)
                    words += f", but {self._activity(low)} may already make that many"
            case Finding.UNDECIDED:
                words = f"{activity} probably makes {share} of drives {violated}, or no magnitude does"
        return f"{as_sentence(condition)}: {words}{f' ({basis})' if basis else ''}."

    @property
    def error(self) -> str:
        """The error without its magnitude."""
        return error_words(self._problem, self._choices)

    def checked(self, check: CellCheck, middle: float | None) -> str:
        """Return whether a detector meets the requirement of a cell, with the basis of that.

        Args:
            check: The detector's errors.
            middle: Median of their severities; None without any.
        """
        start = f"{as_sentence(check.condition)}: {self.error}: {check.result.value}"
        if check.share is None or middle is None:
            return f"{start}: no drive tells anything about it."
        drives, at_least = len(check.severity), " at least" if check.bounds else ""
        share = check.share
        words = (
            f"in {drives:,} {'drive' if drives == 1 else 'drives'} the worst such error has a median of{at_least} "
            f"{self._number(middle, unit=True)}; {share.value:.1%} [{100 * share.low:.1f}, {100 * share.high:.1f}] "
            f"of drives with such errors {_violated(self._requirements)}, {self._limit:.0%} are allowed"
        )
        return f"{start}: {words}."

    def fall(self, curve: Curve) -> FallView | None:
        fall = curve.fall
        if fall is None:
            return None
        words = (
            f"more error is safer from {self._number(fall.from_severity, unit=True)} on: {fall.from_share:.0%} of "
            f"drives violate because of it there, {fall.to_share:.0%} at {self._number(fall.to_severity, unit=True)}"
        )
        return FallView(
            from_severity=fall.from_severity,
            to_severity=fall.to_severity,
            from_share=fall.from_share,
            to_share=fall.to_share,
            words=words,
        )


def _ends(curve: Curve) -> tuple[float, float, float]:
    return curve.tolerated.value, curve.tolerated.low, curve.tolerated.high


def _finding(curve: Curve, basis: str) -> Finding:
    """Return what is known of a cell: nothing before the first drive, whatever the prior says."""
    if not basis:
        return Finding.UNDECIDED
    if math.isinf(curve.tolerated.low):
        return Finding.THROUGHOUT
    return Finding.UNDECIDED if math.isinf(curve.tolerated.high) else Finding.LIMIT


_VIOLATIONS = {
    "front-gap": "violate the front gap",
    "no-collision": "collide",
    "lane-keeping": "leave the lane",
    "red-light": "run a red light",
    "speed-limit": "exceed the speed limit",
    "progress": "get stuck",
}


def _violated(requirements: list[str]) -> str:
    """Return requirements as what violates them, such as ``violate the front gap or collide``."""
    if not requirements:
        return "violate the requirement"
    names = [name.partition("@")[0] for name in requirements]
    return " or ".join(_VIOLATIONS.get(name, f"violate {name}") for name in names)


def tolerance_csv(view: ToleranceView) -> str:
    """Return the tolerances as CSV, one row for each cell."""
    names = list(view.cells[0].choices) if view.cells else []
    ends = ("value", "low", "high")
    rows: list[list[object]] = [
        [
            *(name.rpartition(".")[2] for name in names),
            "error",
            "condition",
            "finding",
            "unit",
            *(f"tolerated_{end}" for end in ends),
            *(f"severity_{end}" for end in ends),
            "limit",
            "confidence",
            "screened",
            "vulnerable",
            "drives",
            "caused",
            "sentence",
        ]
    ]
    for cell in view.cells:
        amounts = [getattr(cell.tolerated, end) for end in ends]
        rows.append(
            [
                *(cell.choices[name] for name in names),
                cell.error,
                cell.condition,
                cell.tolerated.finding.value,
                cell.unit,
                *(_digits(one.magnitude) for one in amounts),
                *(_digits(one.severity) for one in amounts),
                view.limit,
                view.confidence,
                cell.screened,
                cell.vulnerable,
                cell.drives,
                cell.caused,
                cell.sentence,
            ]
        )
    return csv_text(rows)


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
