"""`brink repeats`: does the boundary of a campaign hold up when it is simulated with other seeds?"""

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from brink.api.client import Api, CoordinatorSaid
from brink.cli.local import RESULTS, check_extra, local_service, stopping, watch_campaign
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    Workers,
    brink,
    check_picture,
    console,
    database_option,
    print_json,
    settings_with,
    with_api,
)
from brink.server.api.repeats import DEFAULT_REPEATS
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody
from brink.server.campaigns.plan import make_plan
from brink.server.runtime.coordinator import WorkerProcesses
from brink.server.settings import Settings

SHOWN = 20


def repeats(
    campaign: CampaignId,
    times: Annotated[
        int, typer.Option("--repeats", min=2, max=10_000, help="Simulations of each boundary solution.")
    ] = DEFAULT_REPEATS,
    t_b: Annotated[float, typer.Option("--t-b", min=0.0, max=1.0, help="Largest fitness.")] = DEFAULT_T_B,
    d_th: Annotated[
        float, typer.Option("--d-th", min=0.0, max=1.0, help="Least distance apart.")
    ] = DEFAULT_D_TH,
    workers: Workers = 2,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG or SVG to draw every solution's interval into.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a campaign's boundary solutions again with other seeds: how likely is each of them unsafe?

    Without --server it starts a coordinator and workers for as long as it takes. The same command again goes on, or
    shows what came of it.

    Example: brink repeats 3f2a --repeats 50 --picture repeats.png
    """
    check_picture(picture)
    asked = {"repeats": times, "t_b": t_b, "d_th": d_th}
    screen = Console(stderr=True, highlight=False) if as_json else console()
    if server:
        view = with_api(server, database, lambda api: _asked_for(api, campaign, asked))
        if view["status"] in ("running", "paused"):
            screen.print(
                f"campaign {view['campaign']} repeats them; the same command shows how far it is",
                soft_wrap=True,
            )
    else:
        view = _run(campaign, asked, workers, settings_with(database=database, port=0), screen)
    if as_json:
        print_json(view)
    else:
        print_repeats(screen, view)
    if picture is not None and view["evaluated"]:
        draw_repeats(view, picture)
        screen.print(f"picture: {picture}", soft_wrap=True)
    raise typer.Exit(int(not server and view["status"] != "finished"))


def _run(
    campaign: str, asked: dict[str, Any], workers: int, settings: Settings, screen: Console
) -> dict[str, Any]:
    RESULTS.mkdir(parents=True, exist_ok=True)
    with local_service(settings, RESULTS / "worker.log") as local:

        async def work() -> dict[str, Any]:
            stop = asyncio.Event()
            async with local.api() as api:
                body = CampaignBody.model_validate((await api.get(f"/campaigns/{campaign}"))["body"])
                check_extra(make_plan(body).problem)
                view = await _asked_for(api, campaign, asked)
                with stopping(stop):
                    if view["status"] != "finished":
                        local.processes.start(workers)
                        view = await watch_repeats(api, view, local.processes, stop, screen)
                    if stop.is_set() and view["status"] != "finished":
                        hint = f"--repeats {asked['repeats']} --t-b {asked['t_b']:g} --d-th {asked['d_th']:g}"
                        screen.print(
                            f"stopped; nothing is lost. Go on with: {brink()} repeats {campaign} {hint}"
                            f"{database_option(settings)}",
                            soft_wrap=True,
                        )
            return view

        return asyncio.run(work())


async def _asked_for(api: Api, campaign: str, asked: dict[str, Any]) -> dict[str, Any]:
    """Return these repeats, asked for now unless they were before."""
    known = await _latest(api, campaign, asked)
    if known is not None:
        return known
    view: dict[str, Any] = await api.post(f"/campaigns/{campaign}/repeats", asked)
    return view


async def _latest(api: Api, campaign: str, asked: dict[str, Any]) -> dict[str, Any] | None:
    """Return the latest of these repeats of a boundary that were not given up."""
    found: list[dict[str, Any]] = await api.get(f"/campaigns/{campaign}/repeats")
    same = [
        one for one in found if one["boundary"] and all(one[name] == value for name, value in asked.items())
    ]
    return next((one for one in reversed(same) if one["status"] not in ("cancelled", "failed")), None)


async def watch_repeats(
    api: Api, view: dict[str, Any], processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any]:
    """Show how far repeats are until they end or are stopped, which pauses them; return what came of them.

    Those that were paused by hand, or by being stopped, go on; those that were paused for a reason do not.
    """
    path = f"/campaigns/{view['campaign']}"
    if view["status"] == "paused" and not view["status_reason"]:
        await api.post(f"{path}/resume")
    progress = await watch_campaign(api, view["campaign"], processes, stop, screen)
    if progress["status"] == "running":
        with contextlib.suppress(CoordinatorSaid):
            await api.post(f"{path}/pause")
    found: list[dict[str, Any]] = await api.get(f"/campaigns/{view['of']}/repeats")
    return next(one for one in found if one["campaign"] == view["campaign"])


async def finished_repeats(
    api: Api, campaign: str, times: int, processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any] | None:
    """Wait for the repeats that a campaign asked for itself; return what came of them.

    Args:
        api: Of the coordinator.
        campaign: The campaign, which has finished.
        times: How many repeats it asked for.
        processes: The workers.
        stop: Set when the user wants no more.
        screen: Where to say how far it is.

    Returns:
        None if it asked for none, or has no boundary.
    """
    asked = {"repeats": times, "t_b": DEFAULT_T_B, "d_th": DEFAULT_D_TH}
    view = await _latest(api, campaign, asked) if times else None
    if view is None or view["status"] == "finished" or stop.is_set():
        return view
    screen.print("simulating the boundary again with other seeds")
    return await watch_repeats(api, view, processes, stop, screen)


def print_repeats(screen: Console, view: dict[str, Any]) -> None:
    """Print how many boundary solutions hold up, and those with the largest probabilities."""
    screen.print(sentence(view), soft_wrap=True)
    judged = [one for one in view["solutions"] if one["evaluated"]]
    if not judged:
        return
    table = Table(box=None, pad_edge=False)
    for name in ("solution", "simulated", "unsafe", "probability", "interval", "around it", ""):
        table.add_column(name, justify="right" if name else "left", header_style="dim")
    for one in sorted(judged, key=lambda one: -one["probability"])[:SHOWN]:
        around = "–" if one["around"] is None else f"{one['around_low']:.2f} to {one['around_high']:.2f}"
        words = "" if one["holds"] else "above" if one["low"] > view["p_th"] else "below"
        table.add_row(
            str(one["number"]), str(one["evaluated"]), str(one["unsafe"]), f"{one['probability']:.2f}",
            f"{one['low']:.2f} to {one['high']:.2f}", around, words,
        )  # fmt: skip
    screen.print(table)
    if len(judged) > SHOWN:
        screen.print(f"and {len(judged) - SHOWN} less likely ones: --json has them all")


def sentence(view: dict[str, Any]) -> str:
    """Return how many boundary solutions hold up, in words."""
    solutions = len(view["solutions"])
    reason = f" ({view['status_reason']})" if view["status_reason"] else ""
    if not view["evaluated"]:
        return f"none of {solutions} boundary solutions is simulated again yet: {view['status']}{reason}"
    what = (
        f"{solutions} distinct boundary solutions (fitness at most {view['t_b']:g}, {view['d_th']:g} apart), "
        f"simulated again {_times(view)} times each"
    )
    share = f"all together {view['unsafe'] / view['evaluated']:.1%} unsafe"
    if view["status"] != "finished":
        return f"not yet {view['repeats']} times: {what}, {share}; {view['status']}{reason}"
    judged = sum(one["evaluated"] > 0 for one in view["solutions"])
    return (
        f"of {what}, {view['holding']} ({view['holding'] / judged:.0%}) have an interval that contains p_th = "
        f"{view['p_th']:g}; {view['below']} lie below it, {view['above']} above; {share}"
    )


def _times(view: dict[str, Any]) -> str:
    counts = sorted({one["evaluated"] for one in view["solutions"]})
    return f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"


def write_repeats(view: dict[str, Any], folder: Path, *, picture: bool) -> list[Path]:
    """Write what came of repeats into a folder, as JSON and as a picture."""
    files = [folder / "repeats.json"]
    files[0].write_text(json.dumps(view, indent=2) + "\n", encoding="utf-8")
    if picture and view["evaluated"]:
        files.append(folder / "repeats.png")
        draw_repeats(view, files[1])
    return files


def draw_repeats(view: dict[str, Any], file: Path) -> None:
    """Draw every solution's interval."""
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots.repeats import RepeatedPoint, figure_repeats

    points = [
        RepeatedPoint(
            number=one["number"], probability=one["probability"], low=one["low"], high=one["high"],
            around=None if one["around"] is None else (one["around"], one["around_low"], one["around_high"]),
        )
        for one in view["solutions"]
        if one["evaluated"]
    ]  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    title = f"Does the boundary hold up? {view['name']}"
    figure_repeats(points, p_th=view["p_th"], times=_times(view), title=title).savefig(file)
