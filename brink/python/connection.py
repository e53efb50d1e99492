"""Connections to campaigns: a coordinator, or a database on this machine."""

import os
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from anyio import CancelScope, to_thread

from brink.api.client import Api, connect, in_process
from brink.server.runtime.coordinator import WorkerProcesses, local_coordinator
from brink.server.settings import Settings
from brink.sim.adapters import function as simulator
from brink.sim.catalogue import PLUGINS_VARIABLE

RESULTS: Final = Path("brink-results")
"""Folder of the workers' log."""


class Connection(Protocol):
    """A connection to campaigns.

    Attributes:
        where: Its address, for people.
        has_workers: Whether workers elsewhere may simulate for it; otherwise this machine does.
    """

    @property
    def where(self) -> str: ...  # noqa: D102
    @property
    def has_workers(self) -> bool: ...  # noqa: D102

    def open(self) -> AbstractAsyncContextManager[Api]:
        """Return a client of its API, to be used in ``async with``."""
        ...


@dataclass(frozen=True, slots=True)
class Coordinator:
    """A coordinator, and the token that it requires."""

    url: str
    token: str | None = None

    @property
    def where(self) -> str:
        """Its address."""
        return self.url

    @property
    def has_workers(self) -> bool:
        """Whether other workers may simulate for it."""
        return True

    def open(self) -> AbstractAsyncContextManager[Api]:
        """Return a client of its API, to be used in ``async with``."""
        return connect(self.url, self.token)


@dataclass(frozen=True, slots=True)
class LocalDatabase:
    """A database on this machine, opened in this process."""

    settings: Settings

    @property
    def where(self) -> str:
        """Its address."""
        return self.settings.database

    @property
    def has_workers(self) -> bool:
        """Whether other workers may simulate for it."""
        return False

    def open(self) -> AbstractAsyncContextManager[Api]:
        """Return a client of its API, to be used in ``async with``."""
        return in_process(self.settings)


@contextmanager
def environment_with(function: Callable[..., Any] | None) -> Iterator[dict[str, str]]:
    """Yield environment variables with which local workers can call a function; none without a function.

    Raises:
        TypeError: The function cannot be pickled.
    """
    if function is None:
        yield {}
        return
    with tempfile.TemporaryDirectory(prefix="brink-") as folder:
        path, _ = simulator.write_function(function, Path(folder))
        plugins = filter(None, [os.environ.get(PLUGINS_VARIABLE), simulator.__name__])
        yield {PLUGINS_VARIABLE: ",".join(plugins), simulator.FILE_VARIABLE: str(path)}


@asynccontextmanager
async def with_workers(
    connection: Connection, workers: int, environment: Mapping[str, str] | None = None
) -> AsyncIterator[Api]:
    """Yield a client of a connection with workers: local workers, unless there are others.

    Args:
        connection: The place.
        workers: Number of worker processes on this machine.
        environment: Environment variables that they get besides those of this process.
    """
    if not isinstance(connection, LocalDatabase):
        async with connection.open() as api:
            yield api
        return
    async with local_workers(connection.settings, workers, environment) as (api, _):
        yield api


@asynccontextmanager
async def local_workers(
    settings: Settings, workers: int, environment: Mapping[str, str] | None = None
) -> AsyncIterator[tuple[Api, WorkerProcesses]]:
    """Yield a client of a coordinator in this process, and its worker processes.

    Args:
        settings: Settings of the coordinator; a port of 0 picks a free one.
        workers: Number of worker processes.
        environment: Environment variables that they get besides those of this process.
    """
    context = local_coordinator(settings.model_copy(update={"port": 0}), RESULTS / "worker.log")
    url, token, processes = await to_thread.run_sync(context.__enter__)
    try:
        processes.environment = environment or {}
        await to_thread.run_sync(processes.start, workers)
        async with connect(url, token) as api:
            yield api, processes
    finally:
        with CancelScope(shield=True):
            await to_thread.run_sync(context.__exit__, None, None, None)
