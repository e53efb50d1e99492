"""`brink run`: a coordinator, workers and one campaign in one command, with a summary at the end."""

import asyncio
import contextlib
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from brink.api.client import Api, CoordinatorSaid
from brink.cli.compare import compared_archives
from brink.cli.draw import draw_figures, fetch_archive, write_replays, write_results
from brink.cli.findings.drawing import Drawing
from brink.cli.findings.finding import Findings, fetch_findings
from brink.cli.inspect import grid_table, solution_table
from brink.cli.local import RESULTS, Local, check_extra, local_service, stopping, watch_campaign
from brink.cli.options import (
    CampaignFile,
    Database,
    New,
    Port,
    Resume,
    Workers,
    brink,
    console,
    database_option,
    file_name,
    print_json,
    settings_with,
)
from brink.cli.repeats import finished_repeats, sentence, write_repeats
from brink.search.analysis.comparison import control_summaries
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody, read_campaign_file
from brink.server.campaigns.submission import check_submission
from brink.server.errors import Conflict
from brink.server.settings import Settings

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
    for line in summary["control"]:
        screen.print(line)
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


TRACES_S = 30.0
UNFINISHED = ("running", "paused")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlan:
    """What `brink run` was asked for."""

    body: CampaignBody
    file: Path
    workers: int
    out: Path
    resume: bool
    new: bool
    pictures: bool
    replays: int
    json: bool


def run(
    file: CampaignFile,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[Path, typer.Option(help="Folder for results and pictures.")] = RESULTS,
    pictures: Annotated[bool, typer.Option(help="Draw figures and replays at the end.")] = True,
    replays: Annotated[int, typer.Option(min=0, max=50, help="Replays of the best boundary solutions.")] = 3,
    port: Port = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Run one campaign: starts a coordinator and workers, shows progress, writes results and pictures.

    Ctrl-C stops cleanly; the same command with --resume goes on from there.

    Example: brink run examples/quickstart.yaml --workers 2
    """
    plan = RunPlan(
        body=read_campaign_file(file), file=file, workers=workers, out=out, resume=resume, new=new,
        pictures=pictures, replays=replays, json=as_json,
    )  # fmt: skip
    live, _ = check_submission(plan.body)
    check_extra(live.plan.problem)
    # The campaign is the user's own, and so is the coordinator: it may ask whom the file names.
    settings = settings_with(database=database, port=port, llm_endpoints="*")
    screen = Console(stderr=True, highlight=False) if as_json else console()
    out.mkdir(parents=True, exist_ok=True)  # what cannot be written is known before an hour of simulations
    with local_service(settings, out / "worker.log") as local:
        status = asyncio.run(_run(plan, settings, local, screen))
    raise typer.Exit(status)


async def _run(plan: RunPlan, settings: Settings, local: Local, screen: Console) -> int:
    """Return the exit status: 0 only if everything that was asked for is there."""
    stop = asyncio.Event()
    database = database_option(settings)
    async with local.api() as api:
        campaign_id = await _campaign(api, plan, screen)
        if local.token is None:  # else the page would ask for one that nobody was told
            screen.print(f"watch it in a browser: {local.url}/#/campaigns/{campaign_id}", soft_wrap=True)
        with stopping(stop):
            local.processes.start(plan.workers)
            progress = await watch_campaign(api, campaign_id, local.processes, stop, screen)
            if stop.is_set():
                await _set_aside(api, campaign_id, plan, progress, screen, database)
                return 1
            if progress["status"] != "finished":
                screen.print(f"campaign {campaign_id} is {progress['status']}: {progress['status_reason']}")
                screen.print(f"look closer with: {brink()} status {campaign_id}{database}", soft_wrap=True)
                return 1
            folder = plan.out / f"{file_name(plan.body.name)}-{campaign_id}"
            written = await _write_all(api, campaign_id, plan, folder, stop, screen)
            again = await finished_repeats(api, campaign_id, plan.body.repeats, local.processes, stop, screen)
            if again is not None:
                written.files.extend(write_repeats(again, folder, picture=plan.pictures))
    boundary = written.boundary
    summary = {
        "campaign": campaign_id,
        "digest": progress["digest"],
        "simulations": progress["simulations"],
        "evaluated": progress["evaluated"],
        "unsafe": progress["unsafe"],
        "failed": progress["failed"],
        "elapsed_s": progress["elapsed_s"],
        "t_b": DEFAULT_T_B,
        "d_th": DEFAULT_D_TH,
        "dbs": boundary["dbs"],
        "strict_dbs": boundary["strict_dbs"],
        "grid": boundary["grid"],
        "control": written.control,
        "looks_for_boundary": progress["looks_for_boundary"],
        "origins": progress["origins"],
        "findings": {findings.name: findings.sentence() for findings in written.findings},
        "repeats": again,
        "folder": str(folder),
        "files": [str(path) for path in written.files],
    }
    if plan.json:
        print_json(summary)
    else:
        if again is not None:
            screen.print(sentence(again), soft_wrap=True)
        print_summary(
            screen, plan.body, summary, boundary, written.findings, brink=brink(), database=database
        )
    if again is not None and again["status"] != "finished" and not stop.is_set():
        return 1
    if not stop.is_set():
        return 0
    screen.print("[yellow]interrupted: not all pictures are drawn[/yellow]")
    screen.print(f"draw them with: {brink()} run {plan.file} --resume{database}", soft_wrap=True)
    return 1


async def _campaign(api: Api, plan: RunPlan, screen: Console) -> str:
    """Return the campaign to watch: the latest one of this file that was not cancelled, or a new one."""
    states = [*UNFINISHED, "finished"] if plan.resume else UNFINISHED
    params = {"document_hash": plan.body.document_hash(), "status": list(states), "limit": 1}
    known = (await api.get("/campaigns", params))["campaigns"]
    if known and not plan.new:
        found = await api.get(f"/campaigns/{known[0]['id']}/progress")
        stands = f"{found['simulations']} of {found['budget']} simulations"
        if not plan.resume:
            raise Conflict(
                f"campaign {found['id']} of this file stands at {stands}: "
                f"go on with it by --resume, or start another by --new"
            )
        if found["status"] == "paused":
            await api.post(f"/campaigns/{found['id']}/resume")
        if found["status"] == "finished":
            screen.print(f"campaign {found['id']} of this file is finished; --new starts another")
        else:
            screen.print(f"campaign {found['id']}: going on at {stands}")
        return str(found["id"])
    campaign = await api.post("/campaigns", plan.body.model_dump(mode="json"))
    screen.print(
        f"campaign {campaign['id']}: {plan.body.algorithm.id} on {plan.body.problem.id}, "
        f"{plan.body.budget.simulations} simulations, seed {plan.body.seed}"
    )
    return str(campaign["id"])


async def _set_aside(
    api: Api, campaign_id: str, plan: RunPlan, progress: dict[str, Any], screen: Console, database: str
) -> None:
    """Pause a campaign that was stopped, so that it takes no workers until somebody goes on with it."""
    with contextlib.suppress(CoordinatorSaid):
        await api.post(f"/campaigns/{campaign_id}/pause")
    screen.print(f"stopped at {progress['simulations']} of {progress['budget']} simulations; nothing is lost")
    screen.print(f"go on with: {brink()} run {plan.file} --resume{database}", soft_wrap=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """What a run found, as it was written.

    Attributes:
        boundary: The distinct boundary solutions.
        files: Everything that was written.
        control: What the control says, in words.
        findings: What was found besides the boundary.
    """

    boundary: dict[str, Any]
    files: list[Path]
    control: list[str]
    findings: Sequence[Findings]


async def _write_all(
    api: Api, campaign_id: str, plan: RunPlan, folder: Path, stop: asyncio.Event, screen: Console
) -> Written:
    """Write results and pictures, and compare with the control; Ctrl-C leaves out what is not drawn yet."""
    boundary = await write_results(api, campaign_id, folder, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH)
    files = [folder / name for name in ("boundary.csv", "boundary.json", "archive.npz")]
    with screen.status("comparing with a control") as status:
        fetched = await fetch_archive(api, campaign_id)
        found = await fetch_findings(api, fetched)
        for findings in found:
            files += findings.write(folder)
        control = control_summaries(compared_archives([fetched], control=True), DEFAULT_T_B, DEFAULT_D_TH)
        written = Written(boundary=boundary, files=files, control=control, findings=found)
        if not plan.pictures or stop.is_set():
            return written
        began = time.monotonic()
        status.update("drawing the boundary")
        files += await asyncio.to_thread(draw_figures, fetched, folder, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH)
        drawing = Drawing(api=api, campaign=campaign_id, folder=folder, stop=stop, patience_s=TRACES_S)
        for findings in found:
            status.update(f"drawing {findings.name}")
            files += await findings.draw(drawing)
        numbers = [s["number"] for s in boundary["solutions"] if s["spec"] is not None]
        status.update("drawing replays")
        files += await write_replays(
            api, campaign_id, numbers[: plan.replays], folder, stop=stop, patience_s=TRACES_S
        )
    log.info("pictures took %.1f s", time.monotonic() - began)
    return written
