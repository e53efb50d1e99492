"""`brink run`: a coordinator, workers and one campaign in one command, with a summary at the end."""

import asyncio
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from brink.api.live import CampaignDisplay, Steps, failures_of
from brink.cli.examples import example_named
from brink.cli.findings import print_findings, print_steps
from brink.cli.follow_ups import ask_by_default
from brink.cli.local import CommandSession, RunOptions, run_to_end
from brink.cli.options import (
    RESULTS,
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
from brink.cli.repeats import repeat_finished, write_repeats
from brink.search.sequential import exact_interval
from brink.server.api.schemas import OutcomesView, Progress
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, Budget, CampaignBody, read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.finding import Findings
from brink.server.findings.words import percent
from brink.server.states import CampaignStatus

if TYPE_CHECKING:
    from brink.cli.kind_files import KindFiles
    from brink.server.campaigns.plan import Plan

TRACE_TIMEOUT_S = 30.0

log = logging.getLogger(__name__)


def run(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="Campaign file (YAML or JSON).", show_default=False)
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", show_default=False, help="Run an example in place of a file: brink examples."
        ),
    ] = None,
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
    simulations: Annotated[
        int | None,
        typer.Option(min=1, max=10_000_000, show_default=False, help="Another budget than the file's."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Run one campaign: start a coordinator and workers, show progress, write results and figures.

    Ctrl-C stops cleanly; the same command with --resume continues.

    Example: brink run examples/quickstart.yaml --workers 2

    Example: brink run --example quickstart
    """
    from brink.api.runs import CampaignRun

    named = ""
    if example is not None:
        if file is not None:
            raise InvalidInput.at("--example", "cannot be combined with a file")
        chosen = example_named(example, "--example")
        if chosen.is_experiment:
            raise InvalidInput.at(
                "--example",
                f"{chosen.name} is an experiment: copy it with {program()} examples {chosen.name} --to DIR, then use "
                f"{program()} experiment run",
            )
        file, named = chosen.file, f"--example {chosen.name}"
    if file is None:
        raise typer.BadParameter("expected a campaign file, or --example NAME", param_hint="FILE")
    options = RunOptions(
        file=file,
        named=named,
        workers=workers,
        out=out,
        resume=resume,
        new=new,
        json=as_json,
        database=database,
        port=port,
    )
    body, _ = checked_body(options, odd, simulations)
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


def checked_body(
    options: RunOptions, odd: Sequence[str] | None = None, simulations: int | None = None
) -> "tuple[CampaignBody, Plan]":
    """Return the campaign of a file, and its plan, once it is known that this machine can run it.

    Args:
        options: The command's options.
        odd: What ``--odd`` gives; None for the ODD of the campaign file.
        simulations: The budget; None for that of the campaign file.

    Raises:
        CoordinatorError: The file is wrong, or an extra is not installed.
    """
    from brink.server.campaigns.plan import check_submission
    from brink.server.problems.catalogue import check_extra

    body = read_campaign_file(options.file).within_odd(read_odd(odd))
    if simulations is not None:
        body = body.model_copy(update={"budget": Budget(simulations=simulations)})
    with about_file(options.file):
        checked, _ = check_submission(body)
        check_extra(checked.plan.problem)
    checked.plan.problem.install()
    return body, checked.plan


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
    from brink.cli.results_folder import results_folder, write_report

    folder = results_folder(options.out, body.name, progress.id)
    await ask_by_default(session, progress.id)
    report = await _write_all(session, progress, folder, pictures=pictures, replays=replays)
    repeated = await repeat_finished(session, progress.id, body.repeats)
    if repeated is not None:
        report.files.extend(write_repeats(repeated, folder, picture=pictures))
    if not session.stop.is_set():
        with Steps(session.screen, "writing the report") as steps:
            report.files.append(
                await write_report(session.api, progress.id, folder, report.files, show=steps.show)
            )
    if options.json:
        print_json(_summary(progress, report, repeated, folder))
    else:
        if repeated is not None:
            session.screen.print(repeated.words, soft_wrap=True)
        _print_summary(session, body, progress, report, folder)
    if session.stop.is_set():
        session.screen.print("interrupted: some figures are missing", style="yellow")
        session.hint("draw them with", options.resume_command)
        return False
    return repeated is None or repeated.status is CampaignStatus.FINISHED


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The results of a campaign.

    Attributes:
        findings: What it found.
        kinds: The files of each kind of findings.
        files: All files written so far.
        outcomes: What the simulations showed about all requirements.
    """

    findings: Findings
    kinds: "Mapping[str, KindFiles]"
    files: list[Path]
    outcomes: OutcomesView


async def _write_all(
    session: CommandSession, progress: Progress, folder: Path, *, pictures: bool, replays: int
) -> Report:
    """Write results, comparison and figures of a campaign; Ctrl-C skips the remaining figures."""
    from brink.api.results import fetch_archive
    from brink.cli.kind_files import read_files
    from brink.report.figures import Drawing, draw_figures, write_replays

    api, campaign = session.api, progress.id
    folder.mkdir(parents=True, exist_ok=True)
    with Steps(session.screen, "collecting the findings") as steps:
        fetched = await fetch_archive(api, campaign)
        found = await api.read(Findings, f"/campaigns/{campaign}/findings")
        kinds = await read_files(api, fetched, found)
        files = [file for one in kinds.values() for file in await one.write(api, folder)]
        files.append(folder / "archive.npz")
        archive = await api.request("GET", f"/campaigns/{campaign}/archive.npz")
        files[-1].write_bytes(archive.content)
        report = Report(findings=found, kinds=kinds, files=files, outcomes=fetched.outcomes)
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
        marked = next((one.marked for one in kinds.values() if one.marked is not None), None)
        if not found.exclusive:
            files += await asyncio.to_thread(
                draw_figures,
                fetched,
                folder,
                t_b=DEFAULT_T_B,
                d_th=DEFAULT_D_TH,
                pairs=marked,
                only=None if marked is None else ("map",),
                on_progress=steps.of("drawing figures"),
            )
        for kind, one in kinds.items():
            steps.show(f"drawing {kind}")
            files += await one.draw(drawing)
        steps.show("drawing replays")
        numbers = [number for one in kinds.values() for number in one.numbers]
        files += await write_replays(drawing, numbers[:replays])
    log.info("drawing figures took %.1f s", time.monotonic() - began)
    return report


def _summary(
    progress: Progress, report: Report, repeated: RepeatsView | None, folder: Path
) -> dict[str, Any]:
    """Return what ``brink run --json`` prints."""
    summary = {
        "campaign": progress.id,
        "digest": progress.digest,
        "simulations": progress.simulations,
        "evaluated": progress.evaluated,
        "unsafe": progress.unsafe,
        "failed": failures_of(progress),
        "outcomes": report.outcomes.model_dump(mode="json", exclude={"number", "group"}),
        "elapsed_s": progress.elapsed_s,
        "finds": progress.finds,
        "origins": progress.origins,
        "findings": {one.kind: one.sentence for one in report.findings.findings},
        "repeats": None if repeated is None else repeated.model_dump(mode="json"),
        "folder": str(folder),
        "files": [str(path) for path in report.files],
    }
    for one in report.kinds.values():
        summary |= one.summary()
    return summary


def _print_summary(
    session: CommandSession, body: CampaignBody, progress: Progress, report: Report, folder: Path
) -> None:
    from brink.server.problems.catalogue import is_baseline

    screen, place = session.screen, database_option(session.settings)
    share = f"{progress.unsafe / progress.evaluated:.0%}" if progress.evaluated else "0%"
    if is_baseline(body.algorithm.id) and body.start_from is None:
        low, high = exact_interval(progress.unsafe, progress.evaluated, 0.95)
        share = f"{share} [{percent(low, outward=-1)}, {percent(high, outward=1)}]"
    extra = progress.simulations - body.budget.simulations
    beyond = f" ({extra} extra to complete the last generation)" if extra > 0 else ""
    screen.print()
    words = (
        f": {progress.simulations} simulations{beyond} in {progress.elapsed_s:.0f} s, {share} unsafe, "
        f"{failures_of(progress)} failed"
    )
    screen.print(Text.assemble((body.name, "bold"), words))
    if progress.origins:
        origins = ", ".join(f"{count} {origin}" for origin, count in progress.origins.items())
        screen.print(f"origins of the solutions: {origins}")
    if body.llm is not None and not any(origin.startswith("llm") for origin in progress.origins):
        screen.print(
            f"{body.llm.model} provided none of the seeds; patterns were used instead. "
            f"See why with: {program()} llm log {progress.id}{place}",
            soft_wrap=True,
            style="yellow",
        )
    print_findings(screen, report.findings, place)
    screen.print()
    for one in report.kinds.values():
        for line in one.notes:
            screen.print(line, soft_wrap=True)
        if one.warning:
            screen.print(one.warning, soft_wrap=True, style="yellow")
    screen.print(f"archive sha256 {progress.digest}", soft_wrap=True)
    screen.print()
    screen.print(f"files in {folder}:", soft_wrap=True)
    for path in report.files:
        screen.print(f"  {path.relative_to(folder)}", soft_wrap=True)
    print_steps(screen, report.findings.steps, place)
