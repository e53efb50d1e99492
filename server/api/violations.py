"""Routes of violations: their types, and the names that people give them."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from brink.search.analysis.avoidable import EXPLANATION, Avoidable
from brink.search.analysis.violations import RULES_VERSION, FoundViolation
from brink.server.api.context import Context, Services
from brink.server.api.responses import json_response
from brink.server.api.solutions import Number
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.violations import read_violations, set_name
from brink.server.errors import NotFound
from brink.server.findings.violations.analysis import (
    seen_again,
    violation_types,
    violation_view,
    violations_words,
)
from brink.server.findings.violations.views import Violations
from brink.server.problems.base import ReportsViolations

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
    found = await _found(services, campaign)
    archive = (await services.archives.get(campaign)).archive

    def respond() -> Response:
        chosen = found if avoidable is None else [one for one in found if one.avoidable is avoidable]
        view = Violations(
            rules_version=RULES_VERSION,
            words=violations_words(found),
            explanation=EXPLANATION,
            types=seen_again(violation_types(chosen, found), archive),
            violations=[] if types_only else [violation_view(one) for one in chosen],
        )
        return json_response(view)

    return await services.pages.run(respond)


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
    found = await _found(services, campaign)
    known = [str(one.circumstances["requirement"]) for one in found if one.number == number]
    if requirement not in known:
        raise NotFound(
            f"campaign {campaign.id}: solution {number} has no violation of {requirement[:64]!r}; "
            f"it has {', '.join(known) or 'none'}"
        )
    await services.campaigns.writer.write(
        lambda connection: set_name(connection, campaign.id, number, requirement, name)
    )


async def _found(services: Context, campaign: Campaign) -> list[FoundViolation]:
    problem = (await services.archives.get(campaign)).plan.problem
    if not isinstance(problem, ReportsViolations):
        raise NotFound(
            f"campaign {campaign.id}: violations are sorted into types only where other traffic causes them, as for "
            f"npc-actions@1, not for {campaign.body.problem.id}; see what it found with: brink report {campaign.id}"
        )
    return await services.pages.read(services.engines, lambda c: read_violations(c, campaign.id, problem))
