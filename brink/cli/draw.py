"""`brink plot` and `brink replay`, and the first result files of `brink run`."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from brink.api.client import Api
from brink.api.live import Steps
from brink.api.results import (
    TRACE_TIMEOUT_S,
    fetch_archive,
    fetch_requirements,
    fetch_trace,
    read_all_pairs,
    run_episode,
)
from brink.api.terminal import echo
from brink.cli.options import (
    RESULTS,
    AsJson,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Server,
    check_out,
    console,
    print_json,
    with_api,
    write_json,
)
from brink.pictures import render
from brink.report.figures import draw_figures
from brink.search.errors import TooManyPairs
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.findings.boundary.views import Boundary


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

    async def work(api: Api) -> list[Path]:
        fetched = await fetch_archive(api, campaign)
        folder = out or RESULTS / f"plots-{campaign}"
        folder.mkdir(parents=True, exist_ok=True)
        formats = ("png", "svg") if svg else ("png",)
        pairs = None
        if fetched.plan.is_for("pairs"):
            pairs = await read_all_pairs(api, fetched.id)
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
    check_out(out, ".png", ".gif", ".mp4")

    async def work(api: Api) -> None:
        requirement = await fetch_requirements(api, campaign)
        # On stderr: the output of this command is the name of the file.
        with Steps(console(stderr=True), f"simulating solution {number}") as steps:
            if server is None:
                trace = await run_episode(api, campaign, number)
            else:
                trace = await fetch_trace(api, campaign, number, TRACE_TIMEOUT_S)
            drawn = steps.of(f"drawing {out}")
            await asyncio.to_thread(render, trace, out, requirement=requirement, on_progress=drawn)

    with_api(server, database, work)
    echo(out)


async def write_results(
    api: Api, campaign: str, folder: Path, *, t_b: float, d_th: float, even_empty: bool = True
) -> tuple[Boundary, list[Path]]:
    """Write the boundary (CSV and JSON) and the archive of a campaign.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        folder: Folder to write to; created if missing.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.
        even_empty: Whether to write the boundary even if it is empty.

    Returns:
        The boundary, and the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, params = f"/campaigns/{campaign}/boundary", {"t_b": t_b, "d_th": d_th}
    document = await api.get(path, params)
    boundary, files = Boundary.model_validate(document), []
    if boundary.solutions or even_empty:
        files = [folder / "boundary.csv", folder / "boundary.json"]
        table = await api.request("GET", path, params={**params, "format": "csv"})
        files[0].write_bytes(table.content)
        write_json(files[1], document)
    archive = await api.request("GET", f"/campaigns/{campaign}/archive.npz")
    files.append(folder / "archive.npz")
    files[-1].write_bytes(archive.content)
    return boundary, files
