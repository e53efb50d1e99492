"""`brink experiment submit | list | status | report | pause | resume | cancel | delete`."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from brink.api.client import Api
from brink.cli.experiments.results import fetch_results, print_results, write_report
from brink.cli.experiments.running import ExperimentFile, run
from brink.cli.live import duration, rate_of
from brink.cli.local import RESULTS
from brink.cli.options import (
    AsJson,
    Database,
    Server,
    Sure,
    change,
    console,
    delete_after_asking,
    file_name,
    look_at,
    print_json,
    say,
    with_api,
)
from brink.server.errors import Conflict
from brink.server.experiments.body import ExperimentBody, read_experiment_file

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
