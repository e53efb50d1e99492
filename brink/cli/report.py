"""`brink report`: one HTML file about a campaign, for people who have never seen Brink."""

from pathlib import Path
from typing import Annotated

import typer

from brink.api.client import Api
from brink.api.live import Steps
from brink.cli.options import CampaignId, Database, Server, check_ids, check_out, console, with_api
from brink.report.campaign import campaign_report, write_page
from brink.report.kind_pictures import MOST_PAIRS


def report(
    campaign: CampaignId,
    out: Annotated[Path, typer.Option(help="File to write: .html.")] = Path("report.html"),
    pairs: Annotated[
        int,
        typer.Option(
            min=0,
            max=20,
            help="Maximum number of pairs to show in full, with pictures; others are in a table.",
        ),
    ] = MOST_PAIRS,
    episodes: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            callback=check_ids,
            help="Also check the detector of this campaign, such as one on urban-camera@1, against tolerances.",
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
) -> None:
    """Write a report of a campaign to hand on: one HTML file with all pictures, to be read in any browser or printed.

    It says what was found, shows the best pairs or whatever the campaign looked for, and says how far to trust it
    and how to compute it again. Without --server, this machine runs the episodes of the pictures again; with it, the
    coordinator's workers do. The report of a campaign that has not ended says so.

    Example: brink report 3f2a --out report.html
    """
    check_out(out, ".html", ".htm")
    screen = console()

    async def work(api: Api) -> str:
        with Steps(screen, "reading the campaign") as steps:
            return await campaign_report(
                api,
                campaign,
                most_pairs=pairs,
                episodes=episodes,
                workers=server is not None,
                show=steps.show,
            )

    size = write_page(out, with_api(server, database, work))
    screen.print(f"{out}: {size / 1e6:.1f} MB", soft_wrap=True)
