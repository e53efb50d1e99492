"""`brink plot`, `brink replay` and `brink report`: pictures and pages about a campaign."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from brink.api.client import Api
from brink.api.live import Steps
from brink.api.terminal import echo
from brink.cli.options import (
    RESULTS,
    AsJson,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Server,
    check_ids,
    check_out,
    console,
    print_json,
    with_api,
)
from brink.report.limits import MOST_PAIRS
from brink.search.errors import TooManyPairs
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B


def plot(
    campaign: CampaignId,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures.")] = None,
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    svg: Annotated[bool, typer.Option("--svg", help="Write SVG too.")] = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Draw the figures of a campaign.

    They show the archive embedded in two dimensions, how the verdict depends on each parameter and, if the campaign
    searched for boundary solutions, DBS against simulations for several thresholds, and fitness over generations.

    Example: brink plot 3f2a --out figures
    """
    from brink.api.results import fetch_archive
    from brink.report.figures import draw_figures, marked_pairs

    async def work(api: Api) -> list[Path]:
        fetched = await fetch_archive(api, campaign)
        folder = out or RESULTS / f"plots-{campaign}"
        folder.mkdir(parents=True, exist_ok=True)
        formats = ("png", "svg") if svg else ("png",)
        pairs = await marked_pairs(api, fetched)
        if isinstance(pairs, TooManyPairs):
            console(stderr=True).print(f"no pair is marked: {pairs}", soft_wrap=True, style="yellow")
        with Steps(console(stderr=True), "drawing figures") as steps:
            return await asyncio.to_thread(
                draw_figures,
                fetched,
                folder,
                t_b=t_b,
                d_th=d_th,
                pairs=pairs,
                formats=formats,
                on_progress=steps.of("drawing figures"),
            )

    files = with_api(server, database, work)
    if as_json:
        print_json([str(path) for path in files])
    else:
        for path in files:
            echo(path)


def replay(
    campaign: CampaignId,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Number of the solution.")],
    out: Annotated[Path, typer.Option(help="File to write: .png, .gif or .mp4.")],
    database: Database = None,
    server: Server = None,
) -> None:
    """Draw one episode: the top view, the camera image, and the detections given to the driving system.

    If a reference driver would have avoided a violation of scripted traffic, that drive is shown beside it.

    Without --server, this machine runs the episode again; with it, the coordinator's workers do.

    Example: brink replay 3f2a 17 --out replay.mp4
    """
    from brink.api.results import fetch_requirements, trace_of
    from brink.pictures import render

    check_out(out, ".png", ".gif", ".mp4")

    async def work(api: Api) -> None:
        requirement = await fetch_requirements(api, campaign)
        # On stderr: the output of this command is the name of the file.
        with Steps(console(stderr=True), f"simulating solution {number}") as steps:
            trace = await trace_of(api, campaign, number, workers=server is not None)
            drawn = steps.of(f"drawing {out}")
            await asyncio.to_thread(render, trace, out, requirement=requirement, on_progress=drawn)

    with_api(server, database, work)
    echo(out)


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
    from brink.report.campaign import campaign_report, write_page

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
