"""Commands that draw: plot, replay."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from brink.api.client import Api
from brink.cli.options import AsJson, CampaignId, Database, Server, Threshold, console, print_json, with_api
from brink.cli.pictures import draw_figures, fetch_archive
from brink.cli.replays import fetch_trace, requirement_of, run_again
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import FieldError, InvalidInput
from brink.sim.replay import render

PATIENCE_S = 120.0


def plot(
    campaign: CampaignId,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures.")] = None,
    t_b: Threshold = DEFAULT_T_B,
    d_th: Threshold = DEFAULT_D_TH,
    svg: Annotated[bool, typer.Option("--svg", help="Write SVG too.")] = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Draw a campaign: its boundary, its embedding, its course, its parameters.

    DBS over simulations for several thresholds, the archive embedded in two dimensions, fitness over generations,
    and how the verdict depends on each parameter.

    Example: brink plot 3f2a --out figures
    """

    async def work(api: Api) -> list[Path]:
        fetched = await fetch_archive(api, campaign)
        folder = out or Path("brink-results") / f"plots-{campaign}"
        folder.mkdir(parents=True, exist_ok=True)
        formats = ("png", "svg") if svg else ("png",)
        return await asyncio.to_thread(draw_figures, fetched, folder, t_b=t_b, d_th=d_th, formats=formats)

    files = with_api(server, database, work)
    if as_json:
        print_json([str(path) for path in files])
    else:
        for path in files:
            typer.echo(path)


def replay(
    campaign: CampaignId,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Number of the solution.")],
    out: Annotated[Path, typer.Option(help="File to write: .png, .gif or .mp4.")],
    database: Database = None,
    server: Server = None,
) -> None:
    """Draw one episode from above, with what the camera saw and what the detector was made to say.

    Without --server the episode is run again on this machine; with it, the coordinator's workers run it.

    Example: brink replay 3f2a 17 --out replay.mp4
    """
    if out.suffix not in (".png", ".gif", ".mp4"):
        message = f"{out}: expected a file name that ends in .png, .gif or .mp4"
        raise InvalidInput([FieldError(pointer="--out", message=message)])
    if not out.parent.is_dir():
        raise InvalidInput([FieldError(pointer="--out", message=f"{out.parent}: no such folder")])

    async def work(api: Api) -> None:
        requirement = await requirement_of(api, campaign)
        if server is None:
            trace = await run_again(api, campaign, number)
        else:
            trace = await fetch_trace(api, campaign, number, PATIENCE_S)
        with Progress(console=console(), transient=True) as progress:
            task = progress.add_task(f"drawing {out}", total=None)
            await asyncio.to_thread(
                render,
                trace,
                out,
                requirement=requirement,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )

    with_api(server, database, work)
    typer.echo(out)
