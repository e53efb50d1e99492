"""`brink thresholds`: where exactly drives turn from safe to unsafe, and further simulations of both ends."""

from pathlib import Path
from typing import Annotated, Any

import typer

from brink.api.client import Api
from brink.api.follow_ups import follow_up_requests
from brink.api.terminal import echo
from brink.cli.findings import show_kind
from brink.cli.follow_ups import THRESHOLDS_AGAIN, follow_up
from brink.cli.options import (
    AsJson,
    CampaignId,
    ConfirmPairs,
    Database,
    Server,
    WithGroundTruth,
    Workers,
    check_picture,
    console,
    print_json,
    with_api,
)
from brink.report.thresholds import draw_thresholds
from brink.server.campaigns.follow_ups.limits import MOST_PAIRS_FOLLOWED
from brink.server.findings.finding import Finding
from brink.server.findings.follow_ups import FollowUpView
from brink.server.findings.thresholds.views import ThresholdsView

SHOWN = 20


def thresholds(
    campaign: CampaignId,
    confirm: ConfirmPairs = None,
    component: WithGroundTruth = False,
    limit: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_PAIRS_FOLLOWED,
            show_default=False,
            help=f"Maximum number of thresholds to show, to draw and to simulate again (default: {SHOWN}; all with "
            "--json and --picture).",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw how likely a violation is along each number (.png, .svg or .pdf)."),
    ] = None,
    workers: Workers = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the thresholds of a campaign: the values at which drives turn from safe to unsafe.

    Each line says what changes, between which values, what is held, how the unsafe drive fails, and who is to blame.
    What --confirm and --component find out is stored and shown from then on. Without --server, the command runs a
    coordinator and workers until it is known; calling it again continues.

    Example: brink thresholds 3f2a

    Example: brink thresholds 3f2a --confirm 30 --component

    Example: brink thresholds 3f2a --picture thresholds.png
    """
    if picture is not None:
        check_picture(picture)
    requests = follow_up_requests({}, confirm, component=component, limit=limit or SHOWN)
    screen = console(stderr=as_json)
    complete = follow_up(
        "thresholds",
        campaign,
        requests,
        lambda api, request: _ask(api, campaign, request),
        screen,
        workers=workers,
        server=server,
        database=database,
        simulates=THRESHOLDS_AGAIN,
    )

    async def show(api: Api) -> None:
        path = f"/campaigns/{campaign}/findings/thresholds"
        rows = {} if limit is None else {"rows": limit}
        if picture is not None:
            draw_thresholds(await api.read(Finding, path, rows), picture)
            echo(picture)
        elif as_json:
            print_json(await api.get(path, rows))
        else:
            await show_kind(
                api,
                campaign,
                "thresholds",
                {"rows": limit or SHOWN},
                more=f"--limit up to {MOST_PAIRS_FOLLOWED:,}",
            )

    with_api(server, database, show)
    raise typer.Exit(int(not complete))


async def _ask(api: Api, campaign: str, request: dict[str, Any]) -> FollowUpView | None:
    """Start a follow-up, or return an identical one; None if the campaign has no threshold."""
    finding = await api.read(Finding, f"/campaigns/{campaign}/findings/thresholds", {"rows": 1})
    if finding.view is None or not ThresholdsView.model_validate(finding.view).kinds:
        return None  # the finding says why
    return await api.send(FollowUpView, f"/campaigns/{campaign}/thresholds/follow-ups", request)
