"""`brink experiment`: run, submit, follow and report comparisons of algorithms."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from brink.api.client import Api
from brink.api.live import rate_parts
from brink.cli.options import (
    RESULTS,
    Alpha,
    AsJson,
    Confirmed,
    ConfirmPairs,
    Database,
    New,
    Port,
    Resume,
    Server,
    WithGroundTruth,
    Workers,
    about_file,
    check_ids,
    console,
    delete_confirmed,
    file_name,
    plain_table,
    print_json,
    print_line,
    with_api,
)
from brink.search.analysis.paper import LEVEL
from brink.server.api.schemas import ExperimentList, ExperimentProgress, ExperimentSummary, ExperimentView
from brink.server.errors import Conflict
from brink.server.experiments.body import read_experiment_file

if TYPE_CHECKING:
    from brink.server.api.experiments import Results

ExperimentFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Experiment file (YAML or JSON).", show_default=False)
]
ExperimentId = Annotated[
    str,
    typer.Argument(
        metavar="ID", help="Experiment id or a unique prefix of it.", show_default=False, callback=check_ids
    ),
]
experiment = typer.Typer(
    name="experiment",
    help="Compare algorithms over several problems and seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@experiment.command()
def run(
    file: ExperimentFile,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = RESULTS,
    port: Port = None,
    alpha: Alpha = LEVEL,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Number of seeds, instead of those of the file.")
    ] = None,
    simulations: Annotated[
        int | None, typer.Option(min=1, help="Simulations of each campaign, instead of those of the file.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
) -> None:
    """Run every algorithm on every problem with every seed, and write a report that compares them.

    Ctrl-C stops cleanly; the same command with --resume continues.

    Example: brink experiment run examples/paper-rq1.yaml --workers 2

    Example: brink experiment run examples/heredity.yaml --seeds 2 --simulations 300
    """
    # Imported here, and below: the other commands need neither a coordinator nor the search.
    from brink.cli.experiment_run import run_experiment
    from brink.cli.local import RunOptions

    options = RunOptions(
        file=file,
        workers=workers,
        out=out,
        resume=resume,
        new=new,
        json=as_json,
        database=database,
        port=port,
        group="experiment ",
        sizes=tuple(
            f"{option} {number}"
            for option, number in (("--seeds", seeds), ("--simulations", simulations))
            if number is not None
        ),
    )
    with about_file(file):
        body = read_experiment_file(file).sized(seeds, simulations)
        found = run_experiment(body, options, alpha=alpha)
    raise typer.Exit(int(found is None))


@experiment.command()
def submit(
    file: ExperimentFile, database: Database = None, server: Server = None, as_json: AsJson = False
) -> None:
    """Submit an experiment to a coordinator, whose workers run it.

    Example: brink experiment submit examples/paper-rq1.yaml --server http://coordinator:8700
    """
    body = read_experiment_file(file).document()
    with about_file(file):
        document = with_api(server, database, lambda api: api.post("/experiments", body))
    if as_json:
        print_json(document)
        return
    found = ExperimentView.model_validate(document)
    print_line(f"experiment {found.id}: {found.campaigns} campaigns, {found.budget:,} simulations")


@experiment.command()
def status(
    name: ExperimentId, database: Database = None, server: Server = None, as_json: AsJson = False
) -> None:
    """Show the progress of an experiment and of its campaigns.

    Example: brink experiment status 3f2a
    """

    async def work(api: Api) -> tuple[Any, Any]:
        return await api.get(f"/experiments/{name}/progress"), await api.get(f"/experiments/{name}")

    progress, found = with_api(server, database, work)
    if as_json:
        print_json({**progress, "members": found["members"]})
    else:
        _print_status(ExperimentProgress.model_validate(progress), ExperimentView.model_validate(found))


def _print_status(progress: ExperimentProgress, found: ExperimentView) -> None:
    print_line(
        f"experiment {progress.id} ({progress.name}): {progress.status}, "
        + ", ".join([f"{progress.simulations:,} of {progress.budget:,} simulations", *rate_parts(progress)])
    )
    numbers = ("simulations", "unsafe", "failed")
    rows = [
        (
            one.campaign,
            one.method,
            one.problem,
            str(one.seed),
            f"{one.status} {one.status_reason}".strip(),
            f"{one.simulations:,}",
            f"{one.unsafe:,}",
            f"{one.failed:,}",
        )
        for one in found.members
    ]
    columns = ("campaign", "method", "problem", "seed", "status", *numbers)
    console().print(plain_table(*columns, right=("seed", *numbers), rows=rows))
    if progress.deleted:
        console().print(f"{progress.deleted} of its campaigns have been deleted")


@experiment.command()
def report(
    name: ExperimentId,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = RESULTS,
    alpha: Alpha = LEVEL,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Write a report of the finished campaigns of an experiment, as HTML and as Markdown.

    Example: brink experiment report 3f2a --out reports
    """
    from brink.cli.experiment_run import fetch_results, print_results, write_report

    screen = console()

    async def work(api: Api) -> "tuple[Results, ExperimentProgress, ExperimentView]":
        found = await api.read(ExperimentView, f"/experiments/{name}")
        results = await fetch_results(api, found.id, screen, alpha=alpha)
        return results, await api.read(ExperimentProgress, f"/experiments/{name}/progress"), found

    results, progress, found = with_api(server, database, work)
    if not results.repeats:
        raise Conflict(f"experiment {results.id}: no campaign has finished yet")
    folder = out / f"{file_name(found.body.name)}-{results.id}"
    files = write_report(results, progress.elapsed_s, found.body, folder)
    if as_json:
        print_json([str(path) for path in files])
        return
    print_results(screen, results)
    screen.print(f"report: {files[0]}", soft_wrap=True)


@experiment.command()
def pairs(
    name: ExperimentId,
    confirm: ConfirmPairs = None,
    component: WithGroundTruth = False,
    eps: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            show_default=False,
            help="Largest distance between the sides of a pair (default: the experiment's, else 0.02).",
        ),
    ] = None,
    d_th: Annotated[
        float | None,
        typer.Option(
            "--d-th",
            min=0.0,
            max=1.0,
            show_default=False,
            help="Smallest distance between two distinct pairs (default: the experiment's, else 0.2).",
        ),
    ] = None,
    alpha: Alpha = LEVEL,
    workers: Workers = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare algorithms by the pairs that they found: two neighbouring drives, one safe, one unsafe.

    All campaigns are searched for pairs with the same --eps and --d-th. What --confirm and --component find out is
    stored and shown from then on. Without --server, the command runs a coordinator and workers until it is known;
    calling it again continues.

    Example: brink experiment pairs 3f2a

    Example: brink experiment pairs 3f2a --confirm 30 --component
    """
    from brink.cli.experiment_findings import PAIRS, show_found

    settings = {key: value for key, value in (("eps", eps), ("d_th", d_th)) if value is not None}
    show_found(
        PAIRS,
        name,
        settings,
        alpha=alpha,
        confirm=confirm or 0,
        component=component,
        workers=workers,
        server=server,
        database=database,
        as_json=as_json,
    )


@experiment.command()
def thresholds(
    name: ExperimentId,
    confirm: ConfirmPairs = None,
    component: WithGroundTruth = False,
    d_th: Annotated[
        float | None,
        typer.Option(
            "--d-th",
            min=0.0,
            max=1.0,
            show_default=False,
            help="Smallest distance between two distinct thresholds of one kind (default: the experiment's, else "
            "0.2).",
        ),
    ] = None,
    alpha: Alpha = LEVEL,
    workers: Workers = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare algorithms by the thresholds that they found: where along one number drives turn unsafe.

    What --confirm and --component find out is stored and shown from then on. Without --server, the command runs a
    coordinator and workers until it is known; calling it again continues.

    Example: brink experiment thresholds 3f2a

    Example: brink experiment thresholds 3f2a --confirm 30 --component
    """
    from brink.cli.experiment_findings import THRESHOLDS, show_found

    settings = {} if d_th is None else {"d_th": d_th}
    show_found(
        THRESHOLDS,
        name,
        settings,
        alpha=alpha,
        confirm=confirm or 0,
        component=component,
        workers=workers,
        server=server,
        database=database,
        as_json=as_json,
    )


@experiment.command()
def pause(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """Pause an experiment. Its queued jobs wait; running ones still report their results.

    Example: brink experiment pause 3f2a
    """
    _control(name, "pause", database, server)


@experiment.command()
def resume(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """Resume the paused campaigns of an experiment.

    Example: brink experiment resume 3f2a
    """
    _control(name, "resume", database, server)


@experiment.command()
def cancel(name: ExperimentId, database: Database = None, server: Server = None) -> None:
    """Cancel the unfinished campaigns of an experiment. Their results are kept.

    Example: brink experiment cancel 3f2a
    """
    _control(name, "cancel", database, server)


def _control(name: str, verb: str, database: str | None, server: str | None) -> None:
    found = with_api(server, database, lambda api: api.send(ExperimentSummary, f"/experiments/{name}/{verb}"))
    print_line(
        f"experiment {found.id} is {found.status}: {found.simulations:,} of {found.budget:,} simulations"
    )


@experiment.command()
def delete(
    name: ExperimentId, confirmed: Confirmed = False, database: Database = None, server: Server = None
) -> None:
    """Delete an experiment that has ended, with all its campaigns.

    Example: brink experiment delete 3f2a --yes
    """
    found = with_api(server, database, lambda api: api.read(ExperimentView, f"/experiments/{name}"))
    what = f"experiment {found.id} ({found.name}) with {found.simulations:,} simulations"
    delete_confirmed(f"/experiments/{found.id}", what, confirmed=confirmed, server=server, database=database)


@experiment.command("list")
def list_(database: Database = None, server: Server = None, as_json: AsJson = False) -> None:
    """List experiments, newest first.

    Example: brink experiment list
    """

    async def work(api: Api) -> list[ExperimentSummary]:
        pages = api.pages(ExperimentList, "/experiments", {"limit": 100})
        return [one async for page in pages for one in page.experiments]

    found = with_api(server, database, work)
    if as_json:
        print_json([one.model_dump(mode="json") for one in found])
        return
    numbers = ("campaigns", "simulations")
    rows = [
        (
            one.id,
            one.name,
            one.status,
            f"{one.finished} of {one.campaigns}",
            f"{one.simulations:,} of {one.budget:,}",
            f"{one.created_at:%Y-%m-%d %H:%M}",
        )
        for one in found
    ]
    table = plain_table("id", "name", "status", *numbers, "submitted", right=numbers, rows=rows)
    console().print(table if found else "no experiments yet")
