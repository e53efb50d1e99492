"""Commands that keep things running: serve, worker."""

import logging
import os
from collections.abc import Callable
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from typing import Annotated

import typer

from brink.cli.options import (
    Database,
    LogFormatOption,
    LogLevelOption,
    console,
    settings_with,
)
from brink.search.errors import install_command
from brink.server.runtime.coordinator import CoordinatorServer, allow_many_open_files, listen, url_of
from brink.server.runtime.database import prepare_database, shown_url
from brink.server.settings import Settings
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.log import LogFormat, configure_logging
from brink.worker.run import run_worker
from brink.worker.settings import WorkerSettings

log = logging.getLogger(__name__)


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
