"""Commands that look at campaigns: status, results, plot, replay."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from brink.api.client import Api
from brink.cli.live import spark
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    brink,
    console,
    print_json,
    with_api,
)
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import FieldError, InvalidInput

ERRORS_SHOWN = 5
SHOWN = 5
"""Boundary solutions in a table, at most."""
LATEST = 10**9
"""A generation that no campaign reaches."""


def status(
    campaign: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="Campaign id; all without it.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Say where campaigns stand: one with its failures and workers, or all.

    Example: brink status 3f2a
    """

    async def one(api: Api, campaign_id: str) -> None:
        progress = await api.get(f"/campaigns/{campaign_id}/progress")
        jobs = await api.get("/jobs", {"campaign": progress["id"], "status": "quarantined", "limit": 1000})
        workers = await api.get("/workers")
        if as_json:
            print_json({**progress, "quarantined_jobs": jobs["jobs"], "live_workers": workers})
            return
        _print_status(progress, jobs["jobs"], [w for w in workers if w["live"]])

    async def everything(api: Api) -> None:
        listed = await api.get("/campaigns", {"limit": 200})
        if as_json:
            print_json(listed)
            return
        table = Table(box=None, pad_edge=False, header_style="dim")
        for name in ("id", "name", "status", "simulations", "unsafe", "failed", "submitted"):
            table.add_column(name)
        for item in listed["campaigns"]:
            if item["status"] in ("running", "paused"):  # with what is done of the generation under way
                item = {**item, **await api.get(f"/campaigns/{item['id']}/progress", {"since": LATEST})}
            table.add_row(
                item["id"], item["name"], item["status"], f"{item['simulations']} of {item['budget']}",
                str(item["unsafe"]), str(item["failed"]), item["created_at"][:16].replace("T", " "),
            )  # fmt: skip
        console().print(table if listed["campaigns"] else f"no campaign yet: {brink()} run FILE starts one")

    with_api(server, database, lambda api: one(api, campaign) if campaign else everything(api))


def _print_status(progress: dict[str, Any], quarantined: list[Any], workers: list[Any]) -> None:
    screen = console()
    series = progress["generations"]
    reason = f": {progress['status_reason']}" if progress["status_reason"] else ""
    screen.print(f"[bold]{progress['name']}[/bold] ({progress['id']}) is {progress['status']}{reason}")
    screen.print(
        f"{progress['simulations']} of {progress['budget']} simulations in {progress['elapsed_s']:.0f} s, "
        f"{progress['unsafe']} unsafe, {progress['failed']} failed, {progress['measured']} measured on data, "
        f"generation {progress['generation']}"
    )
    if series:
        last = series[-1]
        screen.print(
            f"boundary: {last['dbs']} distinct, {last['strict_dbs']} strict "
            f"(fitness at most {progress['t_b']:g}, {progress['d_th']:g} apart) {spark([g['dbs'] for g in series])}"
        )
    screen.print(
        f"jobs: {progress['queued']} queued, {progress['leased']} leased, {progress['quarantined']} in quarantine; "
        f"workers heard of lately: {len(workers)}"
    )
    for needs, count in progress["unrunnable"].items():
        screen.print(f"[yellow]{count} jobs need {needs}, which no live worker offers[/yellow]")
    for job in quarantined[:ERRORS_SHOWN]:
        error = (job["last_error"] or "").strip().splitlines()
        screen.print(
            f"  quarantined: job {job['id']}, solution {job['number']}, {job['attempt']} attempts: "
            f"{error[0] if error else ''}",
            markup=False,
        )
    if len(quarantined) > ERRORS_SHOWN:
        screen.print(
            f"  and {len(quarantined) - ERRORS_SHOWN} more: {brink()} status {progress['id']} --json"
        )
    if progress["digest"]:
        screen.print(f"archive sha256 {progress['digest']}")


def results(
    campaign: CampaignId,
    t_b: Annotated[float, typer.Option("--t-b", min=0.0, max=1.0, help="Largest fitness.")] = DEFAULT_T_B,
    d_th: Annotated[
        float, typer.Option("--d-th", min=0.0, max=1.0, help="Least distance apart.")
    ] = DEFAULT_D_TH,
    out: Annotated[Path | None, typer.Option(help="File to write: .csv, .jsonl, .parquet or .json.")] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the distinct boundary solutions of a campaign, or write them to a file.

    Example: brink results 3f2a --t-b 0.1 --d-th 0.2 --out boundary.csv
    """
    if out is not None and out.suffix not in (".csv", ".jsonl", ".parquet", ".json"):
        message = f"{out}: expected a file name that ends in .csv, .jsonl, .parquet or .json"
        raise InvalidInput([FieldError(pointer="--out", message=message)])

    async def work(api: Api) -> None:
        params: dict[str, Any] = {"t_b": t_b, "d_th": d_th}
        boundary = await api.get(f"/campaigns/{campaign}/boundary", params)
        if out is not None:
            form, path = out.suffix.removeprefix("."), f"/campaigns/{campaign}/boundary"
            if form == "json":
                content = f"{json.dumps(boundary, indent=2)}\n".encode()
            else:
                content = (await api.request("GET", path, params={**params, "format": form})).content
            out.write_bytes(content)
            typer.echo(f"{out}: {boundary['dbs']} distinct boundary solutions", err=as_json)
        if as_json:
            print_json(boundary)
        elif out is None:
            screen = console()
            screen.print(f"{boundary['dbs']} distinct boundary solutions, {boundary['strict_dbs']} strict")
            screen.print(solution_table(boundary, shown=50))
            screen.print(grid_table(boundary["grid"]))
            screen.print(f"[dim]{boundary['note']}[/dim]")

    with_api(server, database, work)


def grid_table(grid: list[dict[str, Any]]) -> Table:
    """Return DBS and strict DBS over the paper's grid of thresholds."""
    t_bs = sorted({cell["t_b"] for cell in grid})
    table = Table(title="DBS (strict DBS)", title_justify="left", title_style="dim", box=None, pad_edge=False)
    table.add_column("d_th", style="dim")
    for t_b in t_bs:
        table.add_column(f"t_b {t_b:g}", justify="right", header_style="dim")
    for d_th in sorted({cell["d_th"] for cell in grid}):
        cells = {cell["t_b"]: cell for cell in grid if cell["d_th"] == d_th}
        table.add_row(f"{d_th:g}", *(f"{cells[t]['dbs']} ({cells[t]['strict_dbs']})" for t in t_bs))
    return table


def solution_table(boundary: dict[str, Any], shown: int = SHOWN) -> Table:
    """Return the best boundary solutions as a table."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("number", "verdict", "robustness", "fitness", "unsafe near it", "what it is"):
        table.add_column(name, justify="left" if name in ("verdict", "what it is") else "right")
    for solution in boundary["solutions"][:shown]:
        table.add_row(
            str(solution["number"]),
            solution["verdict"],
            f"{solution['robustness']:.2f}",
            f"{solution['fitness']:.3f}",
            f"{solution['unsafe_neighbours']} of {solution['neighbours']}",
            solution["words"],
        )
    if len(boundary["solutions"]) > shown:
        table.add_row("…", "", "", "", "", f"and {len(boundary['solutions']) - shown} more in boundary.csv")
    return table
