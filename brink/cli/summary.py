"""What `brink run` says at the end: what was found, where it lies, what to try next."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from brink.cli.findings.finding import Findings
from brink.cli.tables import grid_table, solution_table
from brink.server.campaigns.body import CampaignBody

PAPER_BUDGET = 1300


def print_summary(
    screen: Console,
    body: CampaignBody,
    summary: dict[str, Any],
    boundary: dict[str, Any],
    findings: Sequence[Findings],
    *,
    brink: str,
    database: str,
) -> None:
    """Print the end of a campaign for people.

    Args:
        screen: Where to.
        body: The campaign.
        summary: What ``brink run --json`` prints.
        boundary: The distinct boundary solutions.
        findings: What was found besides the boundary.
        brink: How to call the command line, for hints.
        database: The option that names the database, for hints.
    """
    share = summary["unsafe"] / summary["evaluated"] if summary["evaluated"] else 0.0
    beyond = summary["simulations"] - body.budget.simulations
    extra = f" ({beyond} beyond the budget, to end a generation)" if beyond > 0 else ""
    screen.print()
    screen.print(
        f"[bold]{body.name}[/bold]: {summary['simulations']} simulations{extra} in {summary['elapsed_s']:.0f} s, "
        f"{share:.0%} unsafe, {summary['failed']} failed"
    )
    if summary["origins"]:
        said = ", ".join(f"{count} {origin}" for origin, count in summary["origins"].items())
        screen.print(f"solutions come from: {said}")
    if body.llm is not None and not any(origin.startswith("llm") for origin in summary["origins"]):
        screen.print(
            f"[yellow]{escape(body.llm.model)} gave none of the seeds; patterns took their place: "
            f"{brink} llm log {summary['campaign']}{database} says why[/yellow]",
            soft_wrap=True,
        )
    for one in findings:
        one.show(screen)
        screen.print()
    if _is_about_the_boundary(summary):
        screen.print(
            f"[bold]{summary['dbs']} distinct boundary solutions[/bold] (fitness at most {summary['t_b']:g}, at "
            f"least {summary['d_th']:g} apart), {summary['strict_dbs']} of them strict"
        )
        if boundary["solutions"]:
            screen.print(solution_table(boundary))
        screen.print(grid_table(boundary["grid"]))
        screen.print(f"[dim]{boundary['note']}[/dim]")
    for sentence in summary["control"]:
        screen.print(sentence)
    screen.print(f"archive sha256 {summary['digest']}")
    screen.print()
    screen.print(f"files in {summary['folder']}:")
    for path in summary["files"]:
        screen.print(f"  {path.removeprefix(summary['folder'] + '/')}")
    _print_next(screen, body, summary, boundary, findings, brink=brink, database=database)


def _print_next(
    screen: Console,
    body: CampaignBody,
    summary: dict[str, Any],
    boundary: dict[str, Any],
    findings: Sequence[Findings],
    *,
    brink: str,
    database: str,
) -> None:
    campaign = summary["campaign"]
    hints = [hint for one in findings for hint in one.hints(campaign, database)]
    hints.append((f"serve{database}", "look at it in a browser, with replays"))
    if any("replay-" in path for path in summary["files"]):
        best = boundary["solutions"][0]["number"]
        hints.append((f"replay {campaign} {best} --out replay.mp4{database}", "watch the best one"))
    if _is_about_the_boundary(summary):
        hints.append((f"results {campaign} --t-b 0.15 --d-th 0.1{database}", "other thresholds"))
    if any("replay-" in path for path in summary["files"]):
        if not summary["repeats"]:
            again = "its boundary again with other seeds: does it hold up?"
            hints.append((f"repeats {campaign} --picture repeats.png{database}", again))
        hints.append(
            (f"evidence {campaign} --out evidence{database}", "tables, rules and replays for others")
        )
    if summary["control"]:
        hints.append((f"compare {campaign}{database}", "what is owed to the component's behaviour, in full"))
    if body.problem.id == "urban-injected@1" and body.budget.simulations < PAPER_BUDGET:
        hints.append(("run examples/paper-mlcshe.yaml", "the paper's budget of 1,300 simulations"))
    table = Table.grid(padding=(0, 2))
    for command, what in hints:
        table.add_row(f"  {brink} {command}", f"[dim]{what}[/dim]")
    screen.print()
    screen.print("next:")
    screen.print(table)
    if boundary["strict_dbs"] == 0 and not findings:
        screen.print(
            "  raise budget.simulations: a fitness of .10 takes at least 35 neighbours, .05 takes 165"
        )


def _is_about_the_boundary(summary: dict[str, Any]) -> bool:
    """Whether the search looked for the boundary, or found some of it; others look for different violations."""
    return bool(summary["looks_for_boundary"]) or summary["dbs"] > 0
