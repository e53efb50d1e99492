"""Routes of tolerances: how severe an error may be before too many drives violate a requirement because of it."""

from collections import Counter
from collections.abc import Collection, Mapping
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

from brink.server.api.context import Services
from brink.server.api.responses import NOT_MODIFIED, etag_of, file_response, matches, not_modified
from brink.server.campaigns.detector_check import MOST_DRIVES, Drive
from brink.server.findings.tolerances.agreement import find_agreement
from brink.server.findings.tolerances.analysis import find_tolerance
from brink.server.findings.tolerances.detector import check_campaign, check_drives
from brink.server.findings.tolerances.kind import cells_table
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
    """Return how severe the errors of a component may be, by type, target and condition; CSV has one row per cell."""
    campaign = await services.campaigns.get(campaign_id)
    archive = await services.archives.get(campaign)
    etag = etag_of(campaign.id, campaign.sequence, archive.generation, format)
    if matches(request, etag):
        return not_modified(etag)  # type: ignore[no-any-return]
    view = await find_tolerance(services, campaign, archive)
    if format == "json":
        response.headers["ETag"] = etag
        return view
    content = await services.pages.run(lambda: cells_table(view).to_bytes(format))
    return file_response(content, f"tolerances-{campaign.id}", format, {"ETag": etag})  # type: ignore[return-value]


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
            description="Magnitude of each type of error, by target; shares as fractions of 1. Errors that the "
            "drive does not show are missing."
        ),
    ]
    at_least: Annotated[
        dict[str, list[str]],
        Field(
            description="Types whose magnitude is a lower bound, by target, such as a miss at the end of a "
            "recording. A lower bound of no error is uninformative."
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

    detector: Annotated[str, Field(max_length=200, description="Its name.")]
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
    return await check_campaign(services, campaign, other)


@router.post("/detector")
async def post_detector(campaign_id: str, services: Services, body: DetectorBody) -> DetectorView:
    """Return whether a detector meets the requirement of a campaign, given its errors in drives of its own."""
    drives = [
        Drive(name=one.name, condition=one.condition, measures=one.measures, at_least=one.at_least)
        for one in body.drives
    ]
    return await check_drives(services, await services.campaigns.get(campaign_id), body.detector, drives)


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
    """Return whether the fresh drives of another campaign agree with the predictions of these tolerances."""
    campaign, other = await services.campaigns.get(campaign_id), await services.campaigns.get(fresh)
    return await find_agreement(services, campaign, other, confidence)
