"""`brink run`: a coordinator, workers and one campaign in one command, with a summary at the end."""

import asyncio
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from brink.api.live import CampaignDisplay, Steps, failures_of
from brink.api.results import fetch_archive
from brink.api.runs import CampaignRun
from brink.cli.campaigns import grid_table, solution_table, within_budget
from brink.cli.findings import Findings, fetch_findings
from brink.cli.local import CommandSession, RunOptions, run_to_end
from brink.cli.options import (
    RESULTS,
    CampaignFile,
    Database,
    New,
    Odd,
    Port,
    Resume,
    Workers,
    about_file,
    console,
    database_option,
    print_json,
    program,
    read_odd,
)
from brink.cli.pair_findings import PairFindings, TooManyFindings, fetch_pair_findings
from brink.cli.repeats import repeat_finished, write_repeats
from brink.cli.results_folder import results_folder, write_report, write_results
from brink.report.comparison import compared_archives
from brink.report.figures import Drawing, draw_figures, write_replays
from brink.search.analysis.comparison import control_summaries
from brink.server.api.outcomes import OutcomesView
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody, read_campaign_file
from brink.server.campaigns.plan import check_submission
from brink.server.findings.boundary.analysis import boundary_words
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.boundary.views import Boundary
from brink.server.problems.catalogue import check_extra
from brink.server.states import CampaignStatus

PAPER_BUDGET = 1300
TRACE_TIMEOUT_S = 30.0

log = logging.getLogger(__name__)


def run(
    file: CampaignFile,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[Path, typer.Option(help="Folder for results and figures.")] = RESULTS,
    pictures: Annotated[
        bool,
        typer.Option(
            help="Draw figures and replays at the end. Campaigns started without them record no traces."
        ),
    ] = True,
    replays: Annotated[
        int, typer.Option(min=0, max=50, help="Number of boundary solutions to replay, best first.")
    ] = 3,
    port: Port = None,
    odd: Odd = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Run one campaign: start a coordinator and workers, show progress, write results and figures.

    Ctrl-C stops cleanly; the same command with --resume continues.

    Example: brink run examples/quickstart.yaml --workers 2
    """
    body = read_campaign_file(file).within_odd(read_odd(odd))
    options = RunOptions(
        file=file,
        workers=workers,
        out=out,
        resume=resume,
        new=new,
        json=as_json,
        database=database,
        port=port,
    )
    with about_file(file):
        checked, _ = check_submission(body)
        check_extra(checked.plan.problem)
    screen = console(stderr=as_json)
    complete = run_to_end(
        CampaignRun(body, pictures=pictures),
        options,
        screen,
        CampaignDisplay(screen),
        lambda session, progress: _finish(
            session, progress, body, options, pictures=pictures, replays=replays
        ),
    )
    raise typer.Exit(int(not complete))


async def _finish(
    session: CommandSession,
    progress: Progress,
    body: CampaignBody,
    options: RunOptions,
    *,
    pictures: bool,
    replays: int,
) -> bool:
    """Write and print the results of a finished campaign; return whether they are complete."""
    folder = results_folder(options.out, body.name, progress.id)
    report = await _write_all(session, progress, body, folder, pictures=pictures, replays=replays)
    repeated = await repeat_finished(session, progress.id, body.repeats)
    if repeated is not None:
        report.files.extend(write_repeats(repeated, folder, picture=pictures))
    if not session.stop.is_set():
        with Steps(session.screen, "writing the report") as steps:
            report.files.append(
                await write_report(session.api, progress.id, folder, report.files, show=steps.show)
            )
    summary = _summary(progress, report, repeated, folder)
    if options.json:
        print_json(summary)
    else:
        if repeated is not None:
            session.screen.print(repeated.words, soft_wrap=True)
        _print_summary(session, options.file, body, progress, report, summary)
    if session.stop.is_set():
        session.screen.print("interrupted: some figures are missing", style="yellow")
        session.hint("draw them with", options.resume_command)
        return False
    return repeated is None or repeated.status is CampaignStatus.FINISHED


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The results of a campaign.

    Attributes:
        boundary: The distinct boundary solutions.
        files: All files written so far.
        control: One sentence for each comparison with a control.
        pairs: The pairs across the boundary, or that there are too many.
        findings: Other findings.
        outcomes: What the simulations showed about all requirements.
    """

    boundary: Boundary
    files: list[Path]
    control: list[str]
    pairs: PairFindings | TooManyFindings
    findings: Sequence[Findings]
    outcomes: OutcomesView


async def _write_all(
    session: CommandSession,
    progress: Progress,
    body: CampaignBody,
    folder: Path,
    *,
    pictures: bool,
    replays: int,
) -> Report:
    """Write results, comparison and figures of a campaign; Ctrl-C skips the remaining figures."""
    api, campaign = session.api, progress.id
    boundary, results = await write_results(
        api, campaign, folder, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH, even_empty=progress.is_for("boundary")
    )
    files: list[Path] = []
    with Steps(session.screen, "looking for pairs") as steps:
        fetched = await fetch_archive(api, campaign)
        pairs = await fetch_pair_findings(api, fetched)
        if not progress.is_for("tolerances"):
            files += pairs.write(folder)
        files += results
        found = await fetch_findings(api, fetched)
        for findings in found:
            files += findings.write(folder)
        steps.show("comparing with a control")
        control = []
        if "boundary" in progress.finds:
            control = control_summaries(compared_archives([fetched], control=True), DEFAULT_T_B, DEFAULT_D_TH)
        report = Report(
            boundary=boundary,
            files=files,
            control=control,
            pairs=pairs,
            findings=found,
            outcomes=fetched.outcomes,
        )
        if not pictures or session.stop.is_set():
            return report
        began = time.monotonic()
        drawing = Drawing(
            api=api,
            campaign=campaign,
            folder=folder,
            stop=session.stop,
            timeout_s=TRACE_TIMEOUT_S,
            show=steps.show,
        )
        steps.show("drawing a pair")
        files += await pairs.draw(drawing)
        if not progress.is_for("tolerances"):
            files += await asyncio.to_thread(
                draw_figures,
                fetched,
                folder,
                t_b=DEFAULT_T_B,
                d_th=DEFAULT_D_TH,
                pairs=pairs.view if pairs.searched else None,
                only=("map",) if pairs.searched else None,
                on_progress=steps.of("drawing figures"),
            )
        for findings in found:
            steps.show(f"drawing {findings.name}")
            files += await findings.draw(drawing)
        numbers = [solution.number for solution in boundary.solutions if solution.spec is not None]
        if progress.is_for("tolerances"):
            numbers = [number for findings in found for number in findings.examples]
        steps.show("drawing replays")
        files += await write_replays(drawing, numbers[:replays])
    log.info("drawing figures took %.1f s", time.monotonic() - began)
    return report


def _summary(
    progress: Progress, report: Report, repeated: RepeatsView | None, folder: Path
) -> dict[str, Any]:
    """Return what ``brink run --json`` prints."""
    boundary = report.boundary.model_dump(mode="json", include={"dbs", "strict_dbs", "grid", "within_budget"})
    return {
        "campaign": progress.id,
        "digest": progress.digest,
        "simulations": progress.simulations,
        "evaluated": progress.evaluated,
        "unsafe": progress.unsafe,
        "failed": failures_of(progress),
        "outcomes": report.outcomes.model_dump(mode="json", exclude={"number", "group"}),
        "elapsed_s": progress.elapsed_s,
        "t_b": DEFAULT_T_B,
        "d_th": DEFAULT_D_TH,
        "dbs": boundary["dbs"],
        "strict_dbs": boundary["strict_dbs"],
        "grid": boundary["grid"],
        "within_budget": boundary["within_budget"],
        "control": report.control,
        "finds": progress.finds,
        "origins": progress.origins,
        "pairs": report.pairs.summary(),
        "findings": {findings.name: findings.sentence() for findings in report.findings},
        "repeats": None if repeated is None else repeated.model_dump(mode="json"),
        "folder": str(folder),
        "files": [str(path) for path in report.files],
    }


def _print_summary(
    session: CommandSession,
    file: Path,
    body: CampaignBody,
    progress: Progress,
    report: Report,
    summary: dict[str, Any],
) -> None:
    screen, database = session.screen, database_option(session.settings)
    boundary, folder = report.boundary, summary["folder"]
    share = progress.unsafe / progress.evaluated if progress.evaluated else 0.0
    extra = progress.simulations - body.budget.simulations
    beyond = f" ({extra} extra to complete the last generation)" if extra > 0 else ""
    screen.print()
    words = (
        f": {progress.simulations} simulations{beyond} in {progress.elapsed_s:.0f} s, {share:.0%} unsafe, "
        f"{failures_of(progress)} failed"
    )
    screen.print(Text.assemble((body.name, "bold"), words))
    if report.outcomes.words:
        screen.print(report.outcomes.words, soft_wrap=True)
    if progress.origins:
        origins = ", ".join(f"{count} {origin}" for origin, count in progress.origins.items())
        screen.print(f"origins of the solutions: {origins}")
    if body.llm is not None and not any(origin.startswith("llm") for origin in progress.origins):
        screen.print(
            f"{body.llm.model} provided none of the seeds; patterns were used instead. "
            f"See why with: {program()} llm log {progress.id}{database}",
            soft_wrap=True,
            style="yellow",
        )
    if report.pairs.searched:
        screen.print()
        report.pairs.show(screen)
        screen.print()
    for findings in report.findings:
        findings.show(screen)
        screen.print()
    if report.pairs.searched and boundary.dbs:
        screen.print(
            f"by the measure of the MLCSHE paper, which this search does not pursue: {_boundary_words(boundary)}",
            soft_wrap=True,
            style="dim",
        )
    elif _about_the_boundary(progress, report):
        screen.print(_boundary_words(boundary), soft_wrap=True, style="bold")
        if boundary.solutions:
            screen.print(solution_table(boundary))
        screen.print(grid_table(boundary.grid))
        screen.print(boundary.note, style="dim")
    if not report.pairs.searched and not progress.is_for("tolerances"):
        for line in report.control:
            screen.print(line, soft_wrap=True)
        report.pairs.show(screen)
    screen.print(f"archive sha256 {progress.digest}", soft_wrap=True)
    screen.print()
    screen.print(f"files in {folder}:", soft_wrap=True)
    for path in summary["files"]:
        screen.print(f"  {path.removeprefix(folder + '/')}", soft_wrap=True)
    _print_next(screen, body, progress, report, repeated=summary["repeats"] is not None, database=database)
    if isinstance(report.pairs, PairFindings) and report.pairs.searched:
        _print_other_requirements(screen, file, report.pairs)


def _boundary_words(boundary: Boundary) -> str:
    words = boundary_words(boundary.dbs, boundary.strict_dbs, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH)
    return words + within_budget(boundary)


def _print_next(
    screen: Console, body: CampaignBody, progress: Progress, report: Report, *, repeated: bool, database: str
) -> None:
    """Print commands to continue with."""
    campaign, boundary = progress.id, report.boundary
    searched = report.pairs.searched or progress.is_for("tolerances")
    about_boundary = _about_the_boundary(progress, report)
    replayed = [path.stem.removeprefix("replay-") for path in report.files if path.stem.startswith("replay-")]
    hints = report.pairs.hints(campaign, database) if report.pairs.searched else []
    hints += [hint for findings in report.findings for hint in findings.hints(campaign, database)]
    hints.append(
        (f"report {campaign} --out report.html{database}", "write a report to hand on, with more pictures")
    )
    if not searched:
        hints += report.pairs.hints(campaign, database)
    if replayed and not searched:
        best = f"replay {campaign} {replayed[0]} --out replay.mp4{database}"
        hints.append((best, "watch the best solution"))
    if about_boundary:
        hints.append((f"results {campaign} --t-b 0.15 --d-th 0.1{database}", "try other thresholds"))
    if replayed and not searched:
        if not repeated:
            what = "simulate the boundary again with other seeds"
            hints.append((f"repeats {campaign} --picture repeats.png{database}", what))
        hints.append((f"evidence {campaign} --out evidence{database}", "export tables, rules and replays"))
    if report.control and not searched:
        hints.append((f"compare {campaign}{database}", "see how much the component accounts for"))
    urban = (
        about_boundary and body.problem.id == "urban-injected@1" and body.budget.simulations < PAPER_BUDGET
    )
    if urban and Path("examples/paper-mlcshe.yaml").exists():
        hints.append(
            (f"run examples/paper-mlcshe.yaml{database}", "use the paper's budget of 1,300 simulations")
        )
    if hints:
        screen.print()
        screen.print("next:")
    width = max((len(command) for command, _ in hints), default=0)
    for command, what in hints:  # not in a table, which would break commands that are to be pasted
        screen.print(Text.assemble(f"  {program()} {command:{width}}  ", (what, "dim")), soft_wrap=True)
    if about_boundary and boundary.strict_dbs == 0 and not report.findings:
        screen.print(
            "  raise budget.simulations: a fitness of .10 takes at least 35 neighbours, .05 takes 165"
        )


def _print_other_requirements(screen: Console, file: Path, pairs: PairFindings) -> None:
    if pairs.decides_by_some_requirements():
        screen.print(
            f"  for violations of any requirement, set problem.params.requirement to any in {file} "
            "and run it again",
            soft_wrap=True,
        )


def _about_the_boundary(progress: Progress, report: Report) -> bool:
    """Return whether to show the boundary: whether the search was for it."""
    return progress.is_for("boundary")
