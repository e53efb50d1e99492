"""`brink experiment`: run, submit, watch and report comparisons of algorithms."""

import asyncio
import contextlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console, Group
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from brink.api.client import Api, CoordinatorSaid
from brink.cli.live import SERIES_WIDTH, LiveDisplay, duration, rate_of
from brink.cli.local import RESULTS, Local, check_extra, local_service, stopping, watched
from brink.cli.options import (
    AsJson,
    Database,
    New,
    Port,
    Resume,
    Server,
    Sure,
    Workers,
    brink,
    change,
    console,
    database_option,
    delete_after_asking,
    file_name,
    look_at,
    print_json,
    say,
    settings_with,
    with_api,
)
from brink.report.experiment import html_report, markdown_report, sentences
from brink.search.analysis.comparison import Measure, Repeat, duels, standings
from brink.search.analysis.scores import Control, Figures, Scores
from brink.server.api.experiment_schemas import ControlView, RepeatView, Results
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.submission import checked_plan
from brink.server.errors import Conflict, InvalidInput
from brink.server.experiments.body import ExperimentBody, read_experiment_file
from brink.server.runtime.coordinator import WorkerProcesses
from brink.server.settings import Settings


class ExperimentDisplay(LiveDisplay):
    """Shows progress documents of ``GET /experiments/{id}/progress`` and the campaigns of the experiment."""

    def show(self, progress: dict[str, Any], members: list[dict[str, Any]]) -> None:
        """Show where an experiment stands."""
        self._update(lambda: self._panel(progress, members), lambda: _line(progress))

    def _panel(self, progress: dict[str, Any], members: list[dict[str, Any]]) -> Group:
        head = Table.grid(padding=(0, 1))
        head.add_row(
            Text(progress["name"], style="bold"),
            ProgressBar(
                total=progress["budget"],
                completed=min(progress["simulations"], progress["budget"]),
                width=SERIES_WIDTH,
            ),
            f"{progress['simulations']:,} of {progress['budget']:,} simulations",
        )
        facts = Table.grid(padding=(0, 2))
        facts.add_row(
            Text("campaigns", style="dim"), f"{progress['finished']} of {progress['campaigns']} finished"
        )
        facts.add_row(
            Text("rate", style="dim"),
            f"{rate_of(progress['rate_per_s'])}   left {duration(progress['remaining_s'])}",
        )
        facts.add_row(
            Text("workers", style="dim"),
            f"{progress['workers'] or 'none yet'}   running {progress['leased']}   queued {progress['queued']}",
        )
        if progress["failed"] or progress["quarantined"]:
            facts.add_row(
                Text("failed", style="dim"),
                f"{progress['failed']}   in quarantine {progress['quarantined']}",
            )
        for reason in progress["paused"]:
            facts.add_row(Text("paused", style="dim"), Text(reason))
        if progress["trouble"]:
            facts.add_row(Text("trouble", style="dim"), Text(progress["trouble"]))
        return Group(head, facts, _methods(members))


def _methods(members: list[dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for name, justify in (
        ("method", "left"),
        ("finished", "right"),
        ("simulations", "right"),
        ("unsafe", "right"),
    ):
        table.add_column(name, justify=justify, header_style="dim")  # type: ignore[arg-type]
    problems = len({member["problem"] for member in members}) > 1
    of: Counter[str] = Counter()
    finished: Counter[str] = Counter()
    simulations: Counter[str] = Counter()
    unsafe: Counter[str] = Counter()
    for member in members:
        label = f"{member['method']}, {member['problem']}" if problems else member["method"]
        of[label] += 1
        finished[label] += member["status"] == "finished"
        simulations[label] += member["simulations"]
        unsafe[label] += member["unsafe"]
    for label, count in of.items():
        share = f"{unsafe[label] / simulations[label]:.0%}" if simulations[label] else "–"
        table.add_row(Text(label), f"{finished[label]} of {count}", f"{simulations[label]:,}", share)
    return table


def _line(progress: dict[str, Any]) -> str:
    return (
        f"{progress['simulations']}/{progress['budget']} simulations, {progress['finished']} of "
        f"{progress['campaigns']} campaigns finished, {rate_of(progress['rate_per_s'])}, "
        f"left {duration(progress['remaining_s'])}, workers {progress['workers']}"
    )


LOOK_EVERY_S = 1.0


async def fetch_results(api: Api, experiment: str, screen: Console) -> Results:
    """Return the results of an experiment, waiting until its finished campaigns are scored.

    Raises:
        CoordinatorSaid: There is no such experiment.
    """
    with screen.status("scoring") as status:
        while True:
            response = await api.request("GET", f"/experiments/{experiment}/results", params={"wait_s": 5})
            if response.status_code == 200:
                return Results.model_validate_json(response.content)
            status.update(str(response.json()["detail"]))
            await asyncio.sleep(LOOK_EVERY_S)


def repeats_of(results: Results) -> list[Repeat]:
    """Return what finished campaigns reached."""
    return [
        Repeat(
            problem=one.problem, method=one.method, seed=one.seed, campaign=one.campaign, scores=_scores(one)
        )
        for one in results.repeats
    ]


def _scores(one: RepeatView) -> Scores:
    return Scores(
        evaluated=one.evaluated, unsafe=one.unsafe, figures=_figures(one),
        control=None if one.control is None else Control(
            figures=_figures(one.control), unsafe_share=one.control.unsafe_share,
            spread=np.array(one.control.spread), repeats=one.control.behaviours_a_scenario,
        ),
    )  # fmt: skip


def _figures(view: RepeatView | ControlView) -> Figures:
    return Figures(dbs=np.array(view.dbs), strict=np.array(view.strict))


def print_results(screen: Console, results: Results) -> None:
    """Print what an experiment says at the usual thresholds."""
    repeats = repeats_of(results)
    if not repeats:
        screen.print("no campaign of it has finished yet")
        return
    found, compared = standings(repeats), duels(repeats)
    usual = [one for one in found if (one.t_b, one.d_th) == (DEFAULT_T_B, DEFAULT_D_TH)]
    shares = {
        (one.problem, one.method): np.mean([
            other.scores.unsafe / max(1, other.scores.evaluated)
            for other in repeats
            if (other.problem, other.method) == (one.problem, one.method)
        ])
        for one in repeats
    }  # fmt: skip
    for problem in dict.fromkeys(one.problem for one in repeats):
        table = Table(
            title=f"{problem}: {results.scored} campaigns, t_b {DEFAULT_T_B:g}, d_th {DEFAULT_D_TH:g}",
            title_justify="left", box=None, pad_edge=False,
        )  # fmt: skip
        for name in ("", "DBS", "95%", "strict DBS", "95%", "unsafe"):
            table.add_column(name, justify="right" if name else "left", header_style="dim")
        for line in dict.fromkeys(one.line for one in usual if one.line.problem == problem):
            cells = []
            for measure in Measure:
                value = next(o.value for o in usual if o.line == line and o.measure is measure)
                cells += [
                    f"{value.mean:.1f}",
                    "" if value.low is None else f"{value.low:.1f} to {value.high:.1f}",
                ]
            share = "" if line.control else f"{shares[line.problem, line.method]:.0%}"
            table.add_row(line.label, *cells, share, style="dim" if line.control else None)
        screen.print(table, "")
        for sentence in sentences(repeats, found, compared, problem):
            screen.print(sentence.replace("**", "").rstrip(), markup=False, highlight=False)
        screen.print()


def write_report(
    results: Results, progress: dict[str, Any], body: ExperimentBody, folder: Path
) -> list[Path]:
    """Write the report of an experiment: pictures, Markdown beside them, one HTML page with all of it inside.

    Args:
        results: With one campaign at least.
        progress: Of ``GET /experiments/{id}/progress``.
        body: What was asked for.
        folder: Where to; made if it is not there.

    Returns:
        The files, the page first.
    """
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots.experiment import EXPERIMENT_FIGURES
    from brink.plots.style import DPI

    repeats = repeats_of(results)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    problems = list(dict.fromkeys(one.problem for one in repeats))
    pictures: dict[tuple[str, Measure, str], str] = {}
    for place, problem in enumerate(problems):
        for measure in Measure:
            for kind, draw in EXPERIMENT_FIGURES.items():
                name = f"figures/{measure}-{kind}{f'-{place + 1}' if len(problems) > 1 else ''}.png"
                draw(repeats, problem, measure).savefig(folder / name, dpi=DPI, metadata={"Software": None})
                pictures[problem, measure, kind] = name
    text = markdown_report(
        body, repeats, pictures, experiment=results.id, created_at=results.created_at,
        elapsed_s=progress["elapsed_s"],
    )  # fmt: skip
    files = [folder / "report.html", folder / "report.md", folder / "results.json"]
    files[0].write_text(html_report(text, results.name, folder), encoding="utf-8")
    files[1].write_text(text, encoding="utf-8")
    files[2].write_text(results.model_dump_json(indent=1) + "\n", encoding="utf-8")
    return [*files, *(folder / name for name in pictures.values())]


ExperimentFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Experiment file (YAML or JSON).", show_default=False)
]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    body: ExperimentBody
    file: Path
    workers: int
    out: Path
    resume: bool
    new: bool
    json: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Ran:
    """An experiment that ended.

    Attributes:
        results: What was found.
        folder: Where its report is.
    """

    results: Results
    folder: Path


def run(
    file: ExperimentFile,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = RESULTS,
    port: Port = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
) -> None:
    """Run every algorithm on every problem with every seed, and write a report that compares them.

    Ctrl-C stops cleanly; the same command with --resume goes on from there.

    Example: brink experiment run examples/paper-rq1.yaml --workers 2
    """
    ran = run_experiment(
        read_experiment_file(file), file, workers=workers, database=database, resume=resume, new=new, out=out,
        port=port, as_json=as_json,
    )  # fmt: skip
    raise typer.Exit(int(ran is None))


def run_experiment(
    body: ExperimentBody,
    file: Path,
    *,
    workers: int,
    database: str | None,
    resume: bool,
    new: bool,
    out: Path,
    port: int = 0,
    as_json: bool = False,
) -> Ran | None:
    """Run an experiment on this machine and write its report.

    Args:
        body: The experiment.
        file: Where it is written, for hints how to go on.
        workers: Worker processes.
        database: URL; the default one if None.
        resume: Go on with the one that was started last.
        new: Start anew even if there is one.
        out: Folder for the report.
        port: Of the coordinator; 0 takes a free one.
        as_json: Print the results as JSON.

    Returns:
        What was found; None if it did not end.

    Raises:
        InvalidInput: It cannot run.
        Conflict: There is one that has not ended, and neither `resume` nor `new` was given.
    """
    plan = _Plan(body=body, file=file, workers=workers, out=out, resume=resume, new=new, json=as_json)
    for cell in body.cells()[: len(body.problems) * len(body.algorithms)]:
        try:
            check_extra(checked_plan(cell.body).problem)
        except InvalidInput as error:
            raise cell.in_experiment(error) from None
    # The experiment is the user's own, and so is the coordinator: it may ask whom the file names.
    settings = settings_with(database=database, port=port, llm_endpoints="*")
    screen = Console(stderr=True, highlight=False) if as_json else console()
    out.mkdir(parents=True, exist_ok=True)  # what cannot be written is known before an hour of simulations
    with local_service(settings, out / "worker.log") as local:
        return asyncio.run(_run(plan, settings, local, screen))


async def _run(plan: _Plan, settings: Settings, local: Local, screen: Console) -> Ran | None:
    stop = asyncio.Event()
    database = database_option(settings)
    async with local.api() as api:
        experiment = await _experiment(api, plan, screen)
        with stopping(stop):
            local.processes.start(plan.workers)
            progress = await _watch(api, experiment, local.processes, stop, screen)
            if stop.is_set():
                with contextlib.suppress(CoordinatorSaid):
                    await api.post(f"/experiments/{experiment}/pause")
                screen.print(
                    f"stopped at {progress['simulations']:,} of {progress['budget']:,} simulations; nothing is lost"
                )
                screen.print(
                    f"go on with: {brink()} experiment run {plan.file} --resume{database}", soft_wrap=True
                )
                return None
            if progress["status"] != "finished":
                screen.print(f"experiment {experiment} is {progress['status']}")
                for reason in progress["paused"]:
                    screen.print(f"  campaign {reason}", markup=False)
                screen.print(
                    f"look closer with: {brink()} experiment status {experiment}{database}", soft_wrap=True
                )
                return None
            results = await fetch_results(api, experiment, screen)
            folder = plan.out / f"{file_name(plan.body.name)}-{experiment}"
            with screen.status("drawing"):
                files = await asyncio.to_thread(write_report, results, progress, plan.body, folder)
    if plan.json:
        print_json({**results.model_dump(mode="json"), "files": [str(path) for path in files]})
    else:
        print_results(screen, results)
        screen.print(f"report: {folder / 'report.html'}", soft_wrap=True)
    return Ran(results=results, folder=folder)


async def _experiment(api: Api, plan: _Plan, screen: Console) -> str:
    """Return the experiment to watch: the latest one of this file that was not cancelled, or a new one."""
    params = {"document_hash": plan.body.document_hash(), "limit": 100}
    known = [
        one
        for one in (await api.get("/experiments", params))["experiments"]
        if one["status"] in ("running", "paused", "finished") and not one["deleted"]
    ]
    unfinished = [one for one in known if one["status"] != "finished"]
    if plan.resume and known and not plan.new:
        found = known[0]
        if found["status"] == "finished":
            screen.print(f"experiment {found['id']} of this file is finished; --new starts another")
        else:
            await api.post(f"/experiments/{found['id']}/resume")
            screen.print(
                f"experiment {found['id']}: going on at {found['simulations']:,} of {found['budget']:,} simulations"
            )
        return str(found["id"])
    if unfinished and not plan.new:
        found = unfinished[0]
        raise Conflict(
            f"experiment {found['id']} of this file stands at {found['simulations']:,} of {found['budget']:,} "
            "simulations: go on with it by --resume, or start another by --new"
        )
    experiment = await api.post("/experiments", plan.body.model_dump(mode="json"))
    body = plan.body
    screen.print(
        f"experiment {experiment['id']}: {len(body.algorithms)} algorithms x {len(body.problems)} problems x "
        f"{len(body.seeds)} seeds x {body.budget.simulations:,} simulations = {experiment['budget']:,}"
    )
    return str(experiment["id"])


async def _watch(
    api: Api, experiment: str, processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any]:
    with ExperimentDisplay(screen) as display:

        async def look() -> dict[str, Any]:
            progress: dict[str, Any] = await api.get(f"/experiments/{experiment}/progress")
            members = (await api.get(f"/experiments/{experiment}"))["members"] if screen.is_terminal else []
            display.show(progress, members)
            return progress

        return await watched(look, processes, stop)


ExperimentId = Annotated[
    str, typer.Argument(metavar="ID", help="Experiment id, or the beginning of one.", show_default=False)
]
experiment = typer.Typer(
    name="experiment",
    help="Compare algorithms over several problems and seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def submit(
    file: ExperimentFile, database: Database = None, server: Server = None, as_json: AsJson = False
) -> None:
    """Submit an experiment to a coordinator, whose workers run it.

    Example: brink experiment submit examples/paper-rq1.yaml --server http://coordinator:8700
    """
    body = read_experiment_file(file)

    async def work(api: Api) -> dict[str, Any]:
        found: dict[str, Any] = await api.post("/experiments", body.model_dump(mode="json"))
        return found

    found = with_api(server, database, work)
    if as_json:
        print_json(found)
    else:
        say(f"experiment {found['id']}: {found['campaigns']} campaigns, {found['budget']:,} simulations")


def list_(database: Database = None, server: Server = None, as_json: AsJson = False) -> None:
    """List experiments, newest first.

    Example: brink experiment list
    """

    async def work(api: Api) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = (await api.get("/experiments", {"limit": 100}))["experiments"]
        return found

    found = with_api(server, database, work)
    if as_json:
        print_json(found)
        return
    table = Table(box=None, pad_edge=False)
    for name in ("id", "name", "status", "campaigns", "simulations", "submitted"):
        table.add_column(
            name, header_style="dim", justify="right" if name in ("campaigns", "simulations") else "left"
        )
    for one in found:
        table.add_row(
            one["id"], one["name"], one["status"], f"{one['finished']} of {one['campaigns']}",
            f"{one['simulations']:,} of {one['budget']:,}", one["created_at"][:16].replace("T", " "),
        )  # fmt: skip
    console().print(table if found else "no experiments yet")


def status(
    name: ExperimentId, database: Database = None, server: Server = None, as_json: AsJson = False
) -> None:
    """Say where an experiment and its campaigns stand.

    Example: brink experiment status 3f2a
    """

    async def work(api: Api) -> tuple[dict[str, Any], dict[str, Any]]:
        return await api.get(f"/experiments/{name}/progress"), await api.get(f"/experiments/{name}")

    progress, found = with_api(server, database, work)
    if as_json:
        print_json({**progress, "members": found["members"]})
        return
    screen = console()
    screen.print(
        f"experiment {progress['id']} ({progress['name']}): {progress['status']}, "
        f"{progress['simulations']:,} of {progress['budget']:,} simulations, {rate_of(progress['rate_per_s'])}, "
        f"left {duration(progress['remaining_s'])}",
        soft_wrap=True, markup=False,
    )  # fmt: skip
    table = Table(box=None, pad_edge=False)
    for column in ("campaign", "method", "problem", "seed", "status", "simulations", "unsafe", "failed"):
        right = column in ("seed", "simulations", "unsafe", "failed")
        table.add_column(column, header_style="dim", justify="right" if right else "left")
    for one in found["members"]:
        table.add_row(
            one["campaign"], one["method"], one["problem"], str(one["seed"]),
            f"{one['status']} {one['status_reason']}".strip(), f"{one['simulations']:,}", f"{one['unsafe']:,}",
            f"{one['failed']:,}",
        )  # fmt: skip
    screen.print(table)
    if progress["deleted"]:
        screen.print(f"{progress['deleted']} of its campaigns were deleted since")


def report(
    name: ExperimentId,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = RESULTS,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Write tables and figures of an experiment as one HTML and one Markdown report, from what has finished.

    Example: brink experiment report 3f2a --out reports
    """
    screen = console()

    async def work(api: Api) -> tuple[Any, dict[str, Any], ExperimentBody]:
        found = await api.get(f"/experiments/{name}")
        results = await fetch_results(api, found["id"], screen)
        return (
            results,
            await api.get(f"/experiments/{name}/progress"),
            ExperimentBody.model_validate(found["body"]),
        )

    results, progress, body = with_api(server, database, work)
    if not results.repeats:
        raise Conflict(f"experiment {results.id}: no campaign of it has finished yet")
    files = write_report(results, progress, body, out / f"{file_name(body.name)}-{results.id}")
    if as_json:
        print_json([str(path) for path in files])
        return
    print_results(screen, results)
    screen.print(f"report: {files[0]}", soft_wrap=True)


def pause(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """Hand out no more jobs of an experiment; what is running is still taken in.

    Example: brink experiment pause 3f2a
    """
    _change(name, "pause", database, server)


def resume(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """Go on with those campaigns of an experiment that are paused.

    Example: brink experiment resume 3f2a
    """
    _change(name, "resume", database, server)


def cancel(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """End those campaigns of an experiment that have not ended; what they found stays.

    Example: brink experiment cancel 3f2a
    """
    _change(name, "cancel", database, server)


def delete(
    name: ExperimentId,
    sure: Sure = False,
    database: Database = None,
    server: Server = None,
) -> None:
    """Delete an experiment that has ended, with all of its campaigns.

    Example: brink experiment delete 3f2a --yes
    """
    found = look_at(f"/experiments/{name}", server, database)
    what = f"experiment {found['id']} ({found['name']}) with {found['simulations']:,} simulations"
    delete_after_asking(f"/experiments/{found['id']}", what, sure=sure, server=server, database=database)


def _change(name: str, verb: str, database: str | None, server: str | None) -> None:
    found = change(f"/experiments/{name}", verb, server, database)
    say(
        f"experiment {found['id']} is {found['status']}: {found['simulations']:,} of {found['budget']:,} simulations"
    )


for command in (run, submit, status, report, pause, resume, cancel, delete):
    experiment.command()(command)
experiment.command("list")(list_)
