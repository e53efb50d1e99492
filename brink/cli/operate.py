"""Commands that keep things running: serve, worker, submit, db."""

import asyncio
import logging
import os
from collections.abc import Callable
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from brink.api.client import Api
from brink.cli.live import CampaignDisplay
from brink.cli.options import (
    AsJson,
    CampaignFile,
    Database,
    LogFormatOption,
    LogLevelOption,
    brink,
    console,
    print_json,
    settings_with,
    with_api,
)
from brink.search.errors import install_command
from brink.server.campaigns.body import read_campaign_file
from brink.server.db.engine import open_engines
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.runtime.coordinator import CoordinatorServer, listen, prepare_database, shown_url, url_of
from brink.server.runtime.open_files import allow_many_open_files
from brink.server.settings import Settings
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.log import LogFormat, configure_logging
from brink.worker.run import run_worker
from brink.worker.settings import WorkerSettings

WATCH_S = 0.5

log = logging.getLogger(__name__)

db = typer.Typer(help="The database: upgrade it, or say which schema it has.", no_args_is_help=True)


def serve(
    database: Database = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; others than loopback need BRINK_TOKEN.")
    ] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen on.")] = None,
    log_format: LogFormatOption = None,
    log_level: LogLevelOption = None,
    access_log: Annotated[
        bool | None, typer.Option("--access-log", help="Log every request.", show_default=False)
    ] = None,
) -> None:
    """Run a coordinator until it is stopped. It upgrades its database itself.

    Example: brink serve --database postgresql://brink:secret@db/brink --port 8700
    """
    settings = settings_with(
        database=database,
        host=host,
        port=port,
        log_format=log_format,
        log_level=log_level,
        access_log=access_log,
    )
    allow_many_open_files()
    with closing(listen(settings)) as listener:
        before, after = prepare_database(settings)
        configure_logging(settings.log_level, settings.log_format)
        say = _announcer(settings.log_format)
        if before != after:
            say(f"database upgraded from schema {before or 'none'} to {after}")
        url = url_of(listener)
        say(
            f"coordinator at {url} on {shown_url(settings)}; dashboard at {url}/, API described at {url}/docs; "
            "Ctrl-C stops it"
        )
        CoordinatorServer(settings).run(sockets=[listener])


def _announcer(log_format: LogFormat) -> Callable[[str], None]:
    """Return what tells people how the start went; where a program reads the log, as a line of it."""
    if log_format is LogFormat.JSON:
        return log.info
    return partial(console().print, soft_wrap=True)


def worker(
    server: Annotated[
        str, typer.Option("--server", envvar="BRINK_SERVER", help="URL of the coordinator.")
    ] = "http://127.0.0.1:8700",
    max_jobs: Annotated[int, typer.Option(min=2, max=128, help="Most jobs to hold at once.")] = 8,
    memory_mib: Annotated[
        int, typer.Option(min=0, help="Memory that an episode may take, in MiB; 0 sets no limit.")
    ] = 2048,
    exit_when_idle_s: Annotated[
        float | None, typer.Option(min=0.0, help="Leave after this time without a job.")
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            show_default=False,
            help="Run workers on a Ray cluster instead, one a free CPU: HOST:PORT, auto for the cluster of this "
            "machine, local for a Ray of our own.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, show_default=False, help="With --ray: so many workers, wherever there is room."),
    ] = None,
    grace_s: Annotated[
        float, typer.Option(min=0.0, help="How long the running episode may go on after SIGTERM.")
    ] = 8.0,
    log_format: LogFormatOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Run one worker: leases simulations from a coordinator, runs them, reports. Start one a core.

    SIGTERM or Ctrl-C lets the running episode end and gives the rest back.

    Example: brink worker --server http://coordinator:8700
    """
    if workers is not None and ray is None:
        raise typer.BadParameter(
            "goes with --ray; without it start one worker a core", param_hint="--workers"
        )
    common = settings_with(log_format=log_format, log_level=log_level)
    settings = WorkerSettings(
        server=server,
        token=common.token.get_secret_value() if common.token else None,
        max_jobs=max_jobs,
        memory_mib=memory_mib,
        exit_when_idle_s=exit_when_idle_s,
        grace_s=grace_s,
        # Named here, too: the nodes of a cluster do not have the environment of this process.
        plugins=tuple(filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(","))),
    )
    if ray is not None:
        raise typer.Exit(_run_on_ray(ray, settings, workers, common))
    configure_logging(common.log_level, common.log_format, worker=settings.worker_id)
    raise typer.Exit(run_worker(settings))


def _run_on_ray(address: str, settings: WorkerSettings, workers: int | None, common: Settings) -> int:
    if find_spec("ray") is None:
        message = f"needs the ray extra, which is not installed here: {install_command('ray')}"
        raise typer.BadParameter(message, param_hint="--ray")
    from brink.worker.ray_pool import PoolSettings, run_pool

    configure_logging(common.log_level, common.log_format)
    return run_pool(
        PoolSettings(
            address=address, worker=settings, workers=workers, level=common.log_level,
            log_format=common.log_format,
        )
    )  # fmt: skip


def submit(
    file: CampaignFile,
    server: Annotated[
        str, typer.Option("--server", envvar="BRINK_SERVER", help="URL of the coordinator.")
    ] = "http://127.0.0.1:8700",
    watch: Annotated[bool, typer.Option("--watch", help="Show progress until the campaign ends.")] = False,
    key: Annotated[
        str | None, typer.Option(help="Idempotency key: the same key again submits nothing new.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Submit a campaign to a coordinator.

    Example: brink submit examples/paper-mlcshe.yaml --server http://coordinator:8700 --watch
    """
    body = read_campaign_file(file)

    async def work(api: Api) -> bool:
        headers = {"Idempotency-Key": key} if key else {}
        response = await api.request("POST", "/campaigns", json=body.model_dump(mode="json"), headers=headers)
        campaign = response.json()
        if as_json and not watch:
            print_json(campaign)
        elif not as_json:
            known = "" if response.status_code == 201 else " (submitted before with this key)"
            console().print(f"campaign {campaign['id']}{known}")
            if not watch:
                hint = f"see how it goes with: {brink()} status {campaign['id']} --server {server}"
                console().print(hint, soft_wrap=True)
        return await follow(api, campaign["id"], as_json=as_json) if watch else True

    if not with_api(server, None, work):
        raise typer.Exit(1)


async def follow(api: Api, campaign_id: str, *, as_json: bool, quiet: bool = False) -> bool:
    """Show progress until a campaign ends; return whether it finished."""
    screen = console()
    with CampaignDisplay(screen) as display:
        while True:
            progress = await api.get(f"/campaigns/{campaign_id}/progress", {"since": display.generations})
            if not (as_json or quiet):
                display.show(progress)
            if progress["status"] != "running":
                break
            await asyncio.sleep(WATCH_S)
    if as_json:
        print_json(progress)
    elif not quiet:
        screen.print(
            f"campaign {campaign_id} is {progress['status']}: {progress['simulations']} simulations, "
            f"{progress['unsafe']} unsafe {progress['status_reason']}"
        )
        screen.print(f"archive sha256 {progress['digest']}")
    return bool(progress["status"] == "finished")


@db.command("upgrade")
def db_upgrade(database: Database = None) -> None:
    """Bring a database to this version's schema; makes a new one if there is none.

    Example: brink db upgrade --database sqlite:///brink.db
    """
    settings = settings_with(database=database)
    before, after = prepare_database(settings)
    where = shown_url(settings)
    if before == after:
        typer.echo(f"{where}: schema {after} already")
    else:
        typer.echo(f"{where}: upgraded from schema {before or 'none'} to {after}")


@db.command("status")
def db_status(database: Database = None) -> None:
    """Say which schema a database has, and which this version needs.

    Example: brink db status
    """
    settings = settings_with(database=database)
    path: Path | None = settings.sqlite_file
    revision = None
    if path is None or path.exists():
        engines = open_engines(settings.database)
        try:
            revision = current_revision(engines)
        finally:
            engines.dispose()
    typer.echo(f"schema {revision or 'none'}; this version needs {head_revision()}")
    if revision != head_revision():
        raise typer.Exit(1)
