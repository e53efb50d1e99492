"""`brink serve`: the coordinator."""

import logging
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import Annotated

import typer

from brink.cli.options import Database, LogFormatOption, LogLevelOption, console, settings_with
from brink.sim.catalogue import import_plugin_modules
from brink.worker.log import LogFormat, configure_logging

log = logging.getLogger(__name__)


def serve(
    database: Database = None,
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen on; addresses other than loopback require BRINK_TOKEN."),
    ] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen on.")] = None,
    log_format: LogFormatOption = None,
    log_level: LogLevelOption = None,
    access_log: Annotated[
        bool | None, typer.Option("--access-log", help="Log every request.", show_default=False)
    ] = None,
) -> None:
    """Run a coordinator until it is stopped. It upgrades its database on startup.

    Example: brink serve --database postgresql://brink:secret@db/brink --port 8700
    """
    from brink.server.runtime.coordinator import (
        CoordinatorServer,
        allow_many_open_files,
        freeze_loaded_objects,
        listen,
        url_of,
    )
    from brink.server.runtime.database import prepare_database, shown_url

    settings = settings_with(
        database=database,
        host=host,
        port=port,
        log_format=log_format,
        log_level=log_level,
        access_log=access_log,
    )
    import_plugin_modules()  # here, because every request for a campaign would fail
    allow_many_open_files()
    with closing(listen(settings)) as listener:
        before, after = prepare_database(settings)
        configure_logging(settings.log_level, settings.log_format)
        announce = _announcer(settings.log_format)
        if before != after:
            announce(f"database upgraded from schema {before or 'none'} to {after}")
        url = url_of(listener)
        announce(
            f"coordinator at {url} on {shown_url(settings)}; dashboard at {url}/, API documentation at {url}/docs; "
            "stop it with Ctrl-C"
        )
        server = CoordinatorServer(settings)
        freeze_loaded_objects()
        server.run(sockets=[listener])


def _announcer(log_format: LogFormat) -> Callable[[str], None]:
    """Return a function that announces the start: on the console, or in the log if the log is JSON."""
    if log_format is LogFormat.JSON:
        return log.info
    return partial(console().print, soft_wrap=True)
