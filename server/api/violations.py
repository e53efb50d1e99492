"""Routes of violations: their types, and the names that people give them."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from brink.search.analysis.avoidable import Avoidable
from brink.server.api.context import Context, Services
from brink.server.api.responses import json_response
from brink.server.api.solutions import Number
from brink.server.findings.violations.analysis import find_violations, name_violation
from brink.server.findings.violations.views import Violations

router = APIRouter(prefix="/campaigns/{campaign_id}/violations", tags=["violations"])

Requirement = Annotated[str, Path(max_length=64)]


class NameBody(BaseModel):
    """A name for a violation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]


@router.get("", response_model=Violations)
async def get_violations(
    campaign_id: str,
    services: Services,
    types_only: Annotated[bool, Query(description="Return the types only.")] = False,
    avoidable: Annotated[
        Avoidable | None,
        Query(
            description="Return only violations that this driver would have avoided (`no` for neither), and the "
            "types with one, even if another driver would have avoided others of the type. Counts are those of these "
            "violations, but `avoided` says of how many solutions."
        ),
    ] = None,
) -> Response:
    """Return the violations of a campaign, grouped by type; those that a careful driver would have avoided first."""
    campaign = await services.campaigns.get(campaign_id)
    view = await find_violations(services, campaign, avoidable, types_only=types_only)
    return await services.pages.run(lambda: json_response(view))


@router.put("/{number}/{requirement}/name", status_code=204)
async def put_name(
    campaign_id: str, number: Number, requirement: Requirement, body: NameBody, services: Services
) -> Response:
    """Name a violation by hand; it then belongs to the type of that name."""
    await _name(services, campaign_id, number, requirement, body.name)
    return Response(status_code=204)


@router.delete("/{number}/{requirement}/name", status_code=204)
async def delete_name(
    campaign_id: str, number: Number, requirement: Requirement, services: Services
) -> Response:
    """Remove the name of a violation; it then has the type that the rules assign."""
    await _name(services, campaign_id, number, requirement, None)
    return Response(status_code=204)


async def _name(services: Context, campaign_id: str, number: int, requirement: str, name: str | None) -> None:
    campaign = await services.campaigns.get(campaign_id)
    await name_violation(services, services.campaigns.writer, campaign, number, requirement, name)
