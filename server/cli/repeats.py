"""`brink repeats`: does the boundary of a campaign hold up when it is simulated with other seeds?"""

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from server.api.repeats import DEFAULT_REPEATS
from server.campaigns.plan import DEFAULT_D_TH, DEFAULT_T_B
from server.cli.api import Api, CoordinatorSaid
from server.cli.coordinator import WorkerProcesses
from server.cli.live import CampaignDisplay
from server.cli.local import RESULTS, local_service, stopping, watched
from server.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    Workers,
    brink,
    console,
    database_option,
    print_json,
    settings_with,
    with_api,
)

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
    asked = {"repeats": times, "t_b": t_b, "d_th": d_th}
    screen = Console(stderr=True, highlight=False) if as_json else console()
    if server:

        async def work(api: Api) -> dict[str, Any]:
            return await _asked_for(api, campaign, asked)

        view = with_api(server, database, work)
        if view["status"] not in ("finished", "cancelled", "failed"):
            screen.print(
                f"campaign {view['campaign']} repeats them: {view['simulations']:,} of {view['budget']:,} "
                "simulations; the same command shows what came of it"
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
    campaign: str, asked: dict[str, Any], workers: int, settings: Any, screen: Console
) -> dict[str, Any]:
    RESULTS.mkdir(parents=True, exist_ok=True)
    with local_service(settings, RESULTS / "worker.log") as local:

        async def work() -> dict[str, Any]:
            stop = asyncio.Event()
            async with local.api() as api:
                view = await _asked_for(api, campaign, asked)
                with stopping(stop):
                    if view["status"] != "finished":
                        local.processes.start(workers)
                        view = await watch_repeats(api, view, local.processes, stop, screen)
                    if stop.is_set() and view["status"] != "finished":
                        with contextlib.suppress(CoordinatorSaid):
                            await api.post(f"/campaigns/{view['campaign']}/pause")
                        screen.print(
                            f"stopped; nothing is lost. Go on with: {brink()} repeats {campaign} --repeats "
                            f"{asked['repeats']} --t-b {asked['t_b']:g} --d-th {asked['d_th']:g}"
                            f"{database_option(settings)}",
                            soft_wrap=True,
                        )
            return view

        return asyncio.run(work())


async def _asked_for(api: Api, campaign: str, asked: dict[str, Any]) -> dict[str, Any]:
    view: dict[str, Any] = await api.post(f"/campaigns/{campaign}/repeats", asked)
    if view["status"] == "paused":
        await api.post(f"/campaigns/{view['campaign']}/resume")
    return view


async def watch_repeats(
    api: Api, view: dict[str, Any], processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any]:
    """Show how far repeats are until they end or are stopped; return what came of them."""
    with CampaignDisplay(screen) as display:

        async def look() -> dict[str, Any]:
            since = {"since": display.generations}
            progress: dict[str, Any] = await api.get(f"/campaigns/{view['campaign']}/progress", since)
            display.show(progress)
            return progress

        await watched(look, processes, stop)
    found: list[dict[str, Any]] = await api.get(f"/campaigns/{view['of']}/repeats")
    return next(one for one in found if one["campaign"] == view["campaign"])


async def finished_repeats(
    api: Api, campaign: str, processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any] | None:
    """Wait for the repeats that a campaign asked for itself; return what came of them, None if there are none."""
    found: list[dict[str, Any]] = await api.get(f"/campaigns/{campaign}/repeats")
    if not found:
        return None
    view = found[0]
    if view["status"] == "paused":
        await api.post(f"/campaigns/{view['campaign']}/resume")
    if view["status"] == "finished":
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
    judged = sum(one["evaluated"] > 0 for one in view["solutions"])
    if not judged:
        return f"none of {len(view['solutions'])} boundary solutions is simulated again yet"
    share = view["unsafe"] / view["evaluated"]
    return (
        f"of {judged} distinct boundary solutions (fitness at most {view['t_b']:g}, {view['d_th']:g} apart), "
        f"simulated again {view['repeats']} times each, {view['holding']} ({view['holding'] / judged:.0%}) have an "
        f"interval that contains p_th = {view['p_th']:g}; {view['below']} lie below it, {view['above']} above; "
        f"all together {share:.1%} unsafe"
    )


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
    from server.plots.repeats import RepeatedPoint, figure_repeats

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
    figure_repeats(points, p_th=view["p_th"], repeats=view["repeats"], title=title).savefig(file)
