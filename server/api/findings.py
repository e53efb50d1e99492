"""Routes of findings: all kinds of a campaign's findings, or one of them as JSON or as a table."""

from typing import Annotated, Final, Literal

from fastapi import APIRouter, Query, Request, Response

from brink.server.api.context import Services
from brink.server.api.responses import MEDIA, file_response, json_response
from brink.server.errors import NotFound
from brink.server.findings.finding import Finding, Findings
from brink.server.findings.summary import ROWS, find_all, find_kind
from brink.server.findings.table import MOST_ROWS

router = APIRouter(prefix="/campaigns/{campaign_id}/findings", tags=["findings"])
_OWN: Final = frozenset({"table", "rows", "format"})
"""Parameters of the query that are not settings of a kind."""


@router.get("")
async def get_findings(
    campaign_id: str,
    services: Services,
    rows: Annotated[
        int, Query(ge=0, le=MOST_ROWS, description="Maximum number of rows of each table.")
    ] = ROWS,
) -> Findings:
    """Return a campaign's findings: a summary sentence, all kinds, and next steps."""
    return await find_all(services, await services.campaigns.get(campaign_id), rows=rows)


@router.get(
    "/{kind}", response_model=Finding, responses={200: {"content": {media: {} for media in MEDIA.values()}}}
)
async def get_finding(
    campaign_id: str,
    kind: str,
    services: Services,
    request: Request,
    table: Annotated[str | None, Query(description="Name of the table; by default the first.")] = None,
    rows: Annotated[
        int, Query(ge=1, le=MOST_ROWS, description="Maximum number of rows of each table.")
    ] = MOST_ROWS,
    format: Literal["json", "csv", "jsonl", "parquet"] = "json",  # noqa: A002  (the name of the query parameter)
) -> Response:
    """Return one kind of a campaign's findings: a sentence, its tables and next steps, or one table as a file.

    All other parameters of the query are settings of the kind, such as `eps` and `d_th` of pairs.
    """
    campaign = await services.campaigns.get(campaign_id)
    settings = {name: value for name, value in request.query_params.items() if name not in _OWN}
    finding = await find_kind(services, campaign, kind, rows=rows, settings=settings)
    if format == "json":
        return await services.pages.run(lambda: json_response(finding))
    chosen = finding.table(table)
    if chosen is None:
        names = ", ".join(one.name for one in finding.tables) or "none"
        raise NotFound(f"findings of kind {kind[:64]!r} have no such table; expected one of {names}")
    content = await services.pages.run(lambda: chosen.to_bytes(format))
    return file_response(content, f"{kind}-{campaign.id}", format)
