"""Commands that draw: plot, replay; and how other commands draw a campaign."""

import asyncio
import contextlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import Progress

from brink.api.client import Api, CoordinatorSaid
from brink.cli.options import AsJson, CampaignId, Database, Server, Threshold, console, print_json, with_api
from brink.search.archive import Archive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.errors import FieldError, InvalidInput, ServerError
from brink.sim.replay import render
from brink.sim.trace import Trace
from brink.worker.process import EpisodeProcess, episode_result
from brink.worker.wire import JobFailed


@dataclass(frozen=True, slots=True, kw_only=True)
class FetchedArchive:
    """A campaign's archive, fetched over the API."""

    id: str
    body: CampaignBody
    plan: Plan
    archive: Archive
    generations: tuple[int, ...]


async def fetch_archive(api: Api, campaign_id: str) -> FetchedArchive:
    """Return the archive of a campaign.

    Raises:
        CoordinatorSaid: There is no such campaign.
    """
    campaign = await api.get(f"/campaigns/{campaign_id}")
    body = CampaignBody.model_validate(campaign["body"])
    response = await api.request("GET", f"/campaigns/{campaign_id}/archive.npz")
    with np.load(io.BytesIO(response.content), allow_pickle=False) as npz:
        arrays = {name: npz[name] for name in npz.files}
    plan = make_plan(body)
    archive = Archive.restore(
        plan.problem.space,
        plan.neighbourhood,
        **{
            name: arrays[name]
            for name in ("numbers", "vectors", "unsafe", "robustness", "neighbours", "unsafe_neighbours")
        },
    )
    generations = arrays["generations"]
    ends = np.searchsorted(generations, np.unique(generations), side="right")
    return FetchedArchive(
        id=campaign["id"], body=body, plan=plan, archive=archive, generations=tuple(int(end) for end in ends)
    )


def draw_figures(
    fetched: FetchedArchive, folder: Path, *, t_b: float, d_th: float, formats: tuple[str, ...] = ("png",)
) -> list[Path]:
    """Write all figures of a campaign; return their files."""
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots import CampaignFigures, write_campaign_figures

    figures = CampaignFigures(
        archive=fetched.archive,
        space=fetched.plan.problem.space,
        title=fetched.body.name,
        generation_ends=fetched.generations,
        t_b=t_b,
        d_th=d_th,
    )
    return write_campaign_figures(figures, folder, formats=formats)


async def write_results(
    api: Api, campaign_id: str, folder: Path, *, t_b: float, d_th: float
) -> dict[str, Any]:
    """Write boundary (CSV and JSON) and archive of a campaign; return the boundary."""
    folder.mkdir(parents=True, exist_ok=True)
    params = {"t_b": t_b, "d_th": d_th}
    boundary: dict[str, Any] = await api.get(f"/campaigns/{campaign_id}/boundary", params)
    (folder / "boundary.json").write_text(json.dumps(boundary, indent=2) + "\n", encoding="utf-8")
    table = await api.request("GET", f"/campaigns/{campaign_id}/boundary", params={**params, "format": "csv"})
    (folder / "boundary.csv").write_bytes(table.content)
    archive = await api.request("GET", f"/campaigns/{campaign_id}/archive.npz")
    (folder / "archive.npz").write_bytes(archive.content)
    return boundary


ASK_AGAIN_S = 0.5
EPISODE_S = 120.0


class NoTrace(ServerError):
    """The trace of a solution cannot be had."""


async def fetch_trace(api: Api, campaign_id: str, number: int, patience_s: float) -> Trace:
    """Return the trace of a solution, which workers make if it was not kept.

    Raises:
        NoTrace: No worker made it in time.
        CoordinatorSaid: There is no such solution, or its trace cannot be made.
    """
    deadline = asyncio.get_running_loop().time() + patience_s
    path = f"/campaigns/{campaign_id}/solutions/{number}/trace"
    while True:
        response = await api.request("GET", path, params={"wait_s": min(20.0, patience_s)})
        if response.status_code == 200:
            return Trace.from_bytes(response.content)
        if asyncio.get_running_loop().time() >= deadline:
            raise NoTrace(
                f"no worker made the trace of solution {number} in {patience_s:g} s; is one running?"
            )
        await asyncio.sleep(ASK_AGAIN_S)


async def run_again(api: Api, campaign_id: str, number: int) -> Trace:
    """Return the trace of a solution by running its episode on this machine.

    Raises:
        NoTrace: The problem has no episodes, or this one failed here.
    """
    solution: dict[str, Any] = await api.get(f"/campaigns/{campaign_id}/solutions/{number}")
    if solution["spec"] is None:
        raise NoTrace(f"solution {number} was not simulated: there is nothing to replay")

    def run() -> Trace:
        with contextlib.closing(EpisodeProcess()) as process:
            process.start()
            outcome = process.run(solution["spec"], record=True, timeout_s=EPISODE_S)
        if isinstance(outcome, JobFailed):
            raise NoTrace(f"the episode of solution {number} failed here: {outcome.message}")
        trace = episode_result(outcome).trace
        if trace is None:
            raise NoTrace(f"the simulator of solution {number} records no trace")
        return Trace.from_bytes(trace)

    return await asyncio.to_thread(run)


async def write_replays(
    api: Api, campaign_id: str, numbers: list[int], folder: Path, *, stop: asyncio.Event, patience_s: float
) -> list[Path]:
    """Draw the replays of some solutions as PNG; those that cannot be had are left out."""
    files = []
    requirement = await requirement_of(api, campaign_id)
    for number in numbers:
        if stop.is_set():
            break
        try:
            trace = await fetch_trace(api, campaign_id, number, patience_s)
        except (NoTrace, CoordinatorSaid):
            continue
        path = folder / f"replay-{number}.png"
        await asyncio.to_thread(render, trace, path, requirement=requirement)
        files.append(path)
    return files


async def requirement_of(api: Api, campaign_id: str) -> str | None:
    """Return the requirement that gives a campaign's verdict; None if several do."""
    params = (await api.get(f"/campaigns/{campaign_id}"))["body"]["problem"]["params"]
    return str(params["requirement"]) if "requirement" in params else None


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
