"""Connections to campaigns: a coordinator, or a database on this machine."""

import os
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from anyio import CancelScope, to_thread

from brink.api.client import Api, connect, in_process
from brink.api.following import Session
from brink.server.runtime.coordinator import local_coordinator
from brink.server.settings import Settings
from brink.sim.adapters import function as simulator
from brink.sim.catalogue import PLUGINS_VARIABLE

RESULTS: Final = Path("brink-results")
"""Folder of the workers' log."""


@dataclass(frozen=True, slots=True)
class Connection:
    """A connection to campaigns: a coordinator, or a database on this machine, opened in this process.

    Attributes:
        where: Its address, for people.
        token: The token that a coordinator requires.
        settings: Settings that name the database; None for a coordinator elsewhere.
    """

    where: str
    token: str | None = None
    settings: Settings | None = None

    @classmethod
    def local(cls, settings: Settings) -> Self:
        """Return the connection to a database on this machine."""
        return cls(settings.database, settings=settings)

    @property
    def has_workers(self) -> bool:
        """Whether other workers may simulate for it; otherwise this machine does."""
        return self.settings is None

    def open(self) -> AbstractAsyncContextManager[Api]:
        """Return a client of its API, to be used in ``async with``."""
        return connect(self.where, self.token) if self.settings is None else in_process(self.settings)


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
) -> AsyncIterator[Session]:
    """Yield a session with workers: local workers, unless there are others.

    Args:
        connection: Where the campaigns are.
        workers: Number of worker processes on this machine.
        environment: Environment variables that they get besides those of this process.
    """
    if connection.settings is None:
        async with connection.open() as api:
            yield Session(api=api, processes=None)
        return
    settings = connection.settings.model_copy(update={"port": 0})
    context = local_coordinator(settings, RESULTS / "worker.log")
    processes = await to_thread.run_sync(context.__enter__)
    try:
        processes.environment = environment or {}
        await to_thread.run_sync(processes.start, workers)
        async with connect(processes.url, processes.token) as api:
            yield Session(api=api, processes=processes)
    finally:
        with CancelScope(shield=True):
            await to_thread.run_sync(context.__exit__, None, None, None)
