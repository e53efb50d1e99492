"""`brink experiment run`: a coordinator, workers and all campaigns of an experiment in one command."""

import asyncio
import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from brink.api.client import Api, CoordinatorSaid
from brink.cli.experiments.display import ExperimentDisplay
from brink.cli.experiments.results import fetch_results, print_results, write_report
from brink.cli.local import RESULTS, Local, check_extra, local_service, stopping, watched
from brink.cli.options import (
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
from brink.server.api.experiment_schemas import Results
from brink.server.campaigns.plan import make_checked_plan
from brink.server.errors import Conflict, InvalidInput
from brink.server.experiments.body import ExperimentBody, read_experiment_file
from brink.server.runtime.coordinator import WorkerProcesses
from brink.server.settings import Settings

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
            check_extra(make_checked_plan(cell.body).problem)
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
