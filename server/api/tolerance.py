"""Routes of tolerances: how gross an error may be before too many drives violate a requirement because of it."""

import asyncio
from collections import Counter
from collections.abc import Collection, Mapping
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

from brink.server.api.context import Services
from brink.server.api.responses import NOT_MODIFIED, etag_of, matches, not_modified
from brink.server.campaigns.detector_check import MOST_DRIVES, Drive, read_drives
from brink.server.errors import InvalidInput
from brink.server.findings.tolerances.agreement import agreement_view
from brink.server.findings.tolerances.analysis import tolerance_csv, tolerance_view
from brink.server.findings.tolerances.detector import detector_view
from brink.server.findings.tolerances.views import AgreementView, DetectorView, ToleranceView
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_meter import MEASURED

router = APIRouter(prefix="/campaigns/{campaign_id}/tolerance", tags=["tolerance"])


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
    name = problem.measured_detector or other.body.name
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
