"""What `brink run` says at the end: what was found, where it lies, what to try next."""

import os
from typing import Any

from rich.console import Console
from rich.table import Table

from server.campaigns.body import CampaignBody
from sim.catalogue import PLUGINS_VARIABLE

SHOWN = 5


def print_summary(
    screen: Console, body: CampaignBody, summary: dict[str, Any], boundary: dict[str, Any], database: str
) -> None:
    """Print the end of a campaign for people."""
    campaign = summary["campaign"]
    share = summary["unsafe"] / summary["evaluated"] if summary["evaluated"] else 0.0
    screen.print()
    screen.print(
        f"[bold]{body.name}[/bold]: {summary['simulations']} simulations in {summary['elapsed_s']:.0f} s, "
        f"{share:.0%} unsafe, {summary['failed']} failed"
    )
    screen.print(
        f"[bold]{summary['dbs']} distinct boundary solutions[/bold] (fitness at most {summary['t_b']:g}, at least "
        f"{summary['d_th']:g} apart), {summary['strict_dbs']} of them strict"
    )
    if boundary["solutions"]:
        screen.print(solution_table(boundary))
    screen.print(grid_table(boundary["grid"]))
    screen.print(f"[dim]{boundary['note']}[/dim]")
    screen.print(f"archive sha256 {summary['digest']}")
    screen.print()
    screen.print(f"files in {summary['folder']}:")
    for path in summary["files"]:
        screen.print(f"  {path.removeprefix(summary['folder'] + '/')}")
    drawn = any("replay-" in path for path in summary["files"])
    _print_next(screen, body, campaign, boundary, database, replays=drawn)


def _print_next(
    screen: Console,
    body: CampaignBody,
    campaign: str,
    boundary: dict[str, Any],
    database: str,
    *,
    replays: bool,
) -> None:
    option = f" {database}" if database else ""
    plugins = filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(","))
    brink = "brink" + "".join(f" --plugin {name}" for name in plugins)
    screen.print()
    screen.print("next:")
    if replays:
        best = boundary["solutions"][0]["number"]
        screen.print(f"  {brink} replay {campaign} {best} --out replay.mp4{option}   watch the best one")
    screen.print(f"  {brink} results {campaign} --t-b 0.15 --d-th 0.1{option}   other thresholds")
    if boundary["strict_dbs"] == 0:
        screen.print(
            "  raise budget.simulations: a fitness of .10 takes at least 35 neighbours, .05 takes 165"
        )
    screen.print(
        f"  {brink} compare {campaign}{option}   how much of it is owed to the component's behaviour"
    )
    if body.problem.id == "urban-injected@1":
        screen.print("  brink run examples/paper-mlcshe.yaml   the paper's budget of 1,300 simulations")


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
            describe(solution["parameters"]),
        )
    if len(boundary["solutions"]) > shown:
        table.add_row("…", "", "", "", "", f"and {len(boundary['solutions']) - shown} more in boundary.csv")
    return table


def describe(parameters: dict[str, dict[str, Any]]) -> str:
    """Return a solution in a few words: its categories."""
    words = []
    for values in parameters.values():
        for name, value in values.items():
            if isinstance(value, str):
                words.append(f"{name.split('.')[-1]}={value}" if value.isdigit() else value)
            elif not any(isinstance(v, str) for v in values.values()):
                words.append(f"{name}={value:.3g}")
    return ", ".join(words)


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
