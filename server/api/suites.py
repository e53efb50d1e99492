"""Routes of suites: submitting a run, and the verdicts of the campaigns that simulate one, alone and by versions."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, status
from pydantic import AfterValidator, Field
from sqlalchemy import Connection

from brink.search.algorithms.suite import SuiteConfig
from brink.search.analysis.suite import SuiteVerdict
from brink.server.api.context import Services
from brink.server.campaigns.body import LONGEST_NAME, Notes
from brink.server.campaigns.follow_ups.store import read_ended
from brink.server.campaigns.store import Campaign
from brink.server.documents import Body, check_printable
from brink.server.errors import FieldError, InvalidInput
from brink.server.states import CampaignStatus
from brink.server.suites.campaigns import ALGORITHM, prepare_runs
from brink.server.suites.file import SuiteFile
from brink.server.suites.matrix import Matrix, mark_of, matrix_of, state_of
from brink.server.suites.results import CaseResult, SuiteResults, judged, sorted_cases, version_label
from brink.server.suites.store import read_versions
from brink.server.views import View
from brink.worker.wire import JsonValues

router = APIRouter(prefix="/campaigns/{campaign_id}/suite", tags=["suites"])
runs_router = APIRouter(prefix="/suites", tags=["suites"])


class SuiteRunBody(Body):
    """A run of a suite."""

    name: Annotated[
        str,
        Field(min_length=1, max_length=LONGEST_NAME, description="Name of the suite."),
        AfterValidator(check_printable),
    ]
    suite: Annotated[SuiteFile, Field(description="The content of a suite file.")]
    changes: Annotated[
        JsonValues, Field(max_length=1_000, description="New values of parameters of its problems, by name.")
    ] = Field(default_factory=dict)
    label: Annotated[Notes, Field(description="What is tested; by default what is changed.")] = ""


class RefusedView(View):
    """A drive that cannot be simulated."""

    name: str
    reason: str


class SuiteRunView(View):
    """The simulation of the drives of one system of a suite."""

    system: str
    campaign: Annotated[str | None, Field(description="Null if none of its drives can be simulated.")]
    unaffected: Annotated[list[str], Field(description="Changes that its problem has no parameter for.")]
    refused: list[RefusedView]


@runs_router.post("/runs", status_code=status.HTTP_201_CREATED)
async def submit_suite_run(body: SuiteRunBody, services: Services) -> list[SuiteRunView]:
    """Submit a run of a suite: a campaign for each of its systems. What was simulated before costs nothing."""
    if wrong := body.suite.errors():
        raise InvalidInput(FieldError(pointer=f"/suite{one.pointer}", message=one.message) for one in wrong)
    choices = [(system.problem, ALGORITHM.id) for system in body.suite.systems.values()]
    runs = await services.campaigns.checks.run(
        choices,
        partial(prepare_runs, body.suite, body.changes, name=body.name, here=False, option="/changes"),
    )
    submitted = []
    for run in runs:
        campaign = None
        if run.body is not None:
            campaign, _ = await services.campaigns.submit(run.labelled(body.label))
        submitted.append(
            SuiteRunView(
                system=run.system,
                campaign=campaign and campaign.id,
                unaffected=list(run.unaffected),
                refused=[RefusedView(name=case.name, reason=reason) for case, reason in run.refused],
            )
        )
    return submitted


@router.get("")
async def get_suite(campaign_id: str, services: Services) -> list[CaseResult]:
    """Return the verdict on each drive of a suite so far, those that are not as expected first."""
    campaign = await _suite_campaign(campaign_id, services)
    ended = await services.pages.read(
        services.engines, lambda connection: read_ended(connection, campaign.id)
    )
    return await services.pages.run(lambda: sorted_cases(_judged(campaign, ended)))


class VersionView(View):
    """A version that a campaign simulated."""

    label: Annotated[str, Field(description="What was tested.")]
    campaign: str
    status: CampaignStatus
    at: Annotated[str, Field(description="When it was submitted, in UTC.")]


class CellView(View):
    """What became of a drive in a version."""

    mark: str
    state: Annotated[str, Field(description="safe, unsafe or other: the colour of the mark.")]
    words: Annotated[str, Field(description="The verdict, and how often it was unsafe.")]
    simulated: str
    fails: Annotated[bool, Field(description="Whether it was simulated and is not as expected.")]
    solution: int | None


class RowView(View):
    """A drive in all versions; null for those whose campaign does not have it."""

    name: str
    turned_unsafe: Annotated[
        bool,
        Field(description="Whether it is unsafe in the newest clear version and was safe in an earlier one."),
    ]
    cells: list[CellView | None]


class VersionsView(View):
    """The drives of one system of a suite by versions."""

    words: str
    versions: Annotated[list[VersionView], Field(description="The newest first.")]
    rows: Annotated[list[RowView], Field(description="What turned unsafe is on top.")]


@router.get("/versions")
async def get_suite_versions(campaign_id: str, services: Services) -> VersionsView:
    """Return the drives of a suite by versions: all campaigns that simulated the same system of it, newest first."""
    campaign = await _suite_campaign(campaign_id, services)

    def look(connection: Connection) -> list[tuple[Campaign, dict[int, bool | None]]]:
        return [(one, dict(read_ended(connection, one.id))) for one in read_versions(connection, campaign)]

    found = await services.pages.read(services.engines, look)
    return await services.pages.run(partial(_versions, found))


def _versions(found: list[tuple[Campaign, dict[int, bool | None]]]) -> VersionsView:
    results = [
        SuiteResults(
            suite=one.body.name,
            label=version_label(one.body.notes, one.id),
            at=one.created_at.isoformat(),
            cases=_judged(one, ended),
        )
        for one, ended in found
    ]
    matrix: Matrix = matrix_of(results)
    return VersionsView(
        words=matrix.words,
        versions=[
            VersionView(label=result.label, campaign=one.id, status=one.status, at=result.at)
            for (one, _), result in zip(found, results, strict=True)
        ],
        rows=[
            RowView(name=row.name, turned_unsafe=row.turned_unsafe, cells=[_cell(cell) for cell in row.cells])
            for row in matrix.rows
        ],
    )


def _cell(case: CaseResult | None) -> CellView | None:
    if case is None:
        return None
    return CellView(
        mark=mark_of(case),
        state=state_of(case),
        words=case.shown,
        simulated=case.simulated,
        fails=not (case.passed or case.verdict is SuiteVerdict.OPEN),
        solution=case.solution,
    )


async def _suite_campaign(campaign_id: str, services: Services) -> Campaign:
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    if not isinstance(found.plan.config, SuiteConfig):
        message = (
            f"campaign {campaign.id} does not simulate a suite: its algorithm is {campaign.body.algorithm.id}"
        )
        raise InvalidInput.at("/path/campaign_id", message)
    return campaign


def _judged(campaign: Campaign, ended: dict[int, bool | None]) -> list[CaseResult]:
    params, system = campaign.body.algorithm.params, campaign.body.problem.id
    return judged(params, ended, system=system, campaign=campaign.id)
