"""`brink worker`: one worker, or many on a Ray cluster."""

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from brink.cli.options import LogFormatOption, LogLevelOption, settings_with
from brink.extras import install_command
from brink.server.settings import Settings
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.worker.log import configure_logging
from brink.worker.run import run_worker
from brink.worker.settings import WorkerSettings


def worker(
    server: Annotated[
        str, typer.Option("--server", envvar="BRINK_SERVER", help="URL of the coordinator.")
    ] = "http://127.0.0.1:8700",
    max_jobs: Annotated[
        int, typer.Option(min=2, max=128, help="Maximum number of jobs to hold at once.")
    ] = 8,
    memory_mib: Annotated[
        int, typer.Option(min=0, help="Memory limit of an episode in MiB; 0 for none.")
    ] = 2048,
    exit_when_idle_s: Annotated[
        float | None, typer.Option(min=0.0, help="Exit after this many seconds without a job.")
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            show_default=False,
            help="Run workers on a Ray cluster instead, one per free CPU: HOST:PORT, auto for the cluster running on "
            "this machine, local to start one here.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, show_default=False, help="With --ray: number of workers, placed on any free CPUs."
        ),
    ] = None,
    grace_s: Annotated[
        float, typer.Option(min=0.0, help="Grace period of the running episode after SIGTERM, in seconds.")
    ] = 8.0,
    alive_file: Annotated[
        Path | None,
        typer.Option(
            show_default=False,
            help="File to touch every few seconds while the worker makes progress, for liveness probes.",
        ),
    ] = None,
    commands: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            show_default=False,
            help="Folder with the definitions of the programs that campaigns may run here; none by default.",
        ),
    ] = None,
    log_format: LogFormatOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Run one worker, which leases simulations from a coordinator and reports the results. Start one per core.

    On SIGTERM or Ctrl-C the worker finishes the running episode and returns its other jobs.

    Example: brink worker --server http://coordinator:8700
    """
    if workers is not None and ray is None:
        raise typer.BadParameter(
            "only works with --ray; without it, start one worker per core", param_hint="--workers"
        )
    if alive_file is not None and ray is not None:
        raise typer.BadParameter(
            "does not work with --ray, which has many workers", param_hint="--alive-file"
        )
    os.environ[COMMANDS_VARIABLE] = "" if commands is None else str(commands.absolute())
    common = settings_with(log_format=log_format, log_level=log_level)
    settings = WorkerSettings(
        server=server,
        token=common.token.get_secret_value() if common.token else None,
        max_jobs=max_jobs,
        memory_mib=memory_mib,
        exit_when_idle_s=exit_when_idle_s,
        grace_s=grace_s,
        alive_file=alive_file,
        # Passed explicitly: the nodes of a cluster do not share the environment of this process.
        plugins=tuple(filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(","))),
    )
    if ray is not None:
        raise typer.Exit(_run_on_ray(ray, settings, workers, common))
    configure_logging(common.log_level, common.log_format, worker=settings.worker_id)
    raise typer.Exit(run_worker(settings))


def _run_on_ray(address: str, settings: WorkerSettings, workers: int | None, common: Settings) -> int:
    if find_spec("ray") is None:
        message = f"needs the ray extra, which is not installed: {install_command('ray')}"
        raise typer.BadParameter(message, param_hint="--ray")
    from brink.worker.ray_pool import PoolSettings, run_pool

    configure_logging(common.log_level, common.log_format)
    return run_pool(
        PoolSettings(
            address=address,
            worker=settings,
            workers=workers,
            level=common.log_level,
            log_format=common.log_format,
        )
    )
