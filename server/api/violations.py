"""Routes of violations: which types a campaign found, and what people call them."""

import asyncio
from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from fastapi import Path as PathParameter
from pydantic import BaseModel, ConfigDict, Field

from brink.search.analysis.violations import RULES_VERSION, FoundViolation, ViolationType, by_type
from brink.server.api.context import Context, Services
from brink.server.api.schemas import MAX_NUMBER, View
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import read
from brink.server.errors import NotFound
from brink.server.problems.base import TellsViolations
from brink.server.violations import read_violations, set_name

router = APIRouter(prefix="/campaigns/{campaign_id}/violations", tags=["violations"])

Number = Annotated[int, PathParameter(ge=0, le=MAX_NUMBER)]
Requirement = Annotated[str, PathParameter(max_length=64)]


class ViolationView(View):
    """One violation of one solution."""

    number: Annotated[int, Field(description="The solution.")]
    requirement: str
    time_s: float
    type: str
    name: Annotated[str | None, Field(description="What a person says it is.")]
    signature: Annotated[dict[str, str], Field(description="What the rules make of its circumstances.")]
    circumstances: Annotated[dict[str, Any], Field(description="As the simulator told them.")]


class TypeView(View):
    """A type of violation."""

    type: str
    solutions: Annotated[int, Field(description="How many solutions violated something in this way.")]
    instances: Annotated[int, Field(description="Distinct ones: clusters of circumstances, and singles.")]
    first: Annotated[int, Field(description="Number of the first solution.")]
    numbers: Annotated[list[int], Field(description="Its solutions, ascending.")]
    named: Annotated[int, Field(description="How many of them a person named.")]
    at_fault: Annotated[
        bool | None, Field(description="Whether the ego was; None if named violations differ.")
    ]


class Violations(View):
    """The violations of a campaign."""

    rules_version: int
    types: Annotated[list[TypeView], Field(description="In the order of finding.")]
    violations: Annotated[list[ViolationView], Field(description="Ascending by number.")]


class NameBody(BaseModel):
    """What a person calls a violation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]


@router.get("")
async def get_violations(
    campaign_id: str,
    services: Services,
    types_only: Annotated[bool, Query(description="Leave out the violations themselves.")] = False,
) -> Violations:
    """Return all violations of a campaign, and their types."""
    campaign = await services.campaigns.get(campaign_id)
    found = await _found(services, campaign)
    types = await asyncio.get_running_loop().run_in_executor(None, _types, found)
    violations = [] if types_only else [_view(one) for one in found]
    return Violations(rules_version=RULES_VERSION, types=types, violations=violations)


@router.put("/{number}/{requirement}/name", status_code=204)
async def put_name(
    campaign_id: str, number: Number, requirement: Requirement, body: NameBody, services: Services
) -> Response:
    """Say what a violation is; it then belongs to the type of that name."""
    await _name(services, campaign_id, number, requirement, body.name)
    return Response(status_code=204)


@router.delete("/{number}/{requirement}/name", status_code=204)
async def delete_name(
    campaign_id: str, number: Number, requirement: Requirement, services: Services
) -> Response:
    """Give a violation back the type that the rules give it."""
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
    writer = services.campaigns.writer
    unit = writer.submit(lambda connection: set_name(connection, campaign.id, number, requirement, name))
    await asyncio.wrap_future(unit)


async def _found(services: Context, campaign: Campaign) -> Sequence[FoundViolation]:
    problem = (await services.archives.get(campaign)).plan.problem
    if not isinstance(problem, TellsViolations):
        raise NotFound(f"campaign {campaign.id}: {campaign.body.problem.id} tells no violations")
    return await read(
        services.engines,
        lambda connection: read_violations(connection, campaign.id, problem),
    )


def _types(found: Sequence[FoundViolation]) -> list[TypeView]:
    return [_type(kind) for kind in by_type(found)]


def _type(kind: ViolationType) -> TypeView:
    numbers = sorted({violation.number for violation in kind.violations})
    faults = {violation.signature.at_fault for violation in kind.violations}
    return TypeView(
        type=kind.words, solutions=len(numbers), instances=kind.instances, first=numbers[0], numbers=numbers,
        named=sum(violation.name is not None for violation in kind.violations),
        at_fault=faults == {"at fault"} if len(faults) == 1 else None,
    )  # fmt: skip


def _view(one: FoundViolation) -> ViolationView:
    return ViolationView(
        number=one.number, requirement=str(one.circumstances["requirement"]),
        time_s=float(one.circumstances["time_s"]), type=one.type, name=one.name,
        signature=one.signature.to_json(), circumstances=dict(one.circumstances),
    )  # fmt: skip
