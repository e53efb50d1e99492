"""A coordinator and workers on this machine for as long as a command runs."""

import asyncio
import contextlib
import secrets
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
from pydantic import SecretStr
from rich.console import Console

from brink.api.client import TIMEOUT, Api
from brink.cli.live import CampaignDisplay
from brink.search.errors import install_command
from brink.server.errors import FieldError, InvalidInput, Unavailable
from brink.server.problems.base import NeedsExtra, Problem
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import has_tokens, prepare_database, release_leases_of_dead_workers
from brink.server.settings import Settings

RESULTS = Path("brink-results")
"""Where commands that run something write what was found."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
LOOK_EVERY_S = 0.3
TROUBLE_S = 5.0
"""How long a database may take no writes before a run gives up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """What runs.

    Attributes:
        url: Where the coordinator listens.
        token: What it wants from everybody, if anything.
        processes: The workers, of which none is started yet.
    """

    url: str
    token: str | None
    processes: WorkerProcesses

    @contextlib.asynccontextmanager
    async def api(self) -> AsyncIterator[Api]:
        """Give its API."""
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        async with httpx.AsyncClient(base_url=self.url, timeout=TIMEOUT, headers=headers) as client:
            yield Api(client, self.url)


@contextlib.contextmanager
def local_service(settings: Settings, worker_log: Path) -> Iterator[Local]:
    """Give a coordinator that serves, and stop it and its workers in the end.

    Args:
        settings: Of the coordinator. Its database is made or upgraded.
        worker_log: Where workers write what they say.

    Raises:
        DatabaseError: The database cannot be used.
        CannotListen: The coordinator did not come up.
    """
    prepare_database(settings)
    if settings.token is None and has_tokens(settings, valid_only=False):
        # The database is that of a coordinator with tokens: this command and its workers have one of their own.
        settings = settings.model_copy(update={"token": SecretStr(secrets.token_hex(24))})
    release_leases_of_dead_workers(settings)
    coordinator = EmbeddedCoordinator(settings)
    coordinator.start()
    token = settings.token.get_secret_value() if settings.token else None
    processes = WorkerProcesses(url=coordinator.url, log_file=worker_log, token=token)
    try:
        yield Local(url=coordinator.url, token=token, processes=processes)
    finally:
        processes.stop()
        coordinator.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


async def watched(
    look: Callable[[], Awaitable[dict[str, Any]]], processes: WorkerProcesses, stop: asyncio.Event
) -> dict[str, Any]:
    """Look again and again how far something is, and keep its workers alive, until it ends or is stopped.

    Args:
        look: Returns its progress document, and shows it.
        processes: The workers.
        stop: Set when the user wants no more.

    Returns:
        The last progress.

    Raises:
        Unavailable: The database has taken no writes for a while.
    """
    while True:
        progress = await look()
        if progress["status"] != "running" or stop.is_set():
            return progress
        if progress["trouble_s"] > TROUBLE_S:
            raise Unavailable(
                f"{progress['trouble']}; what was acknowledged is stored, go on later with --resume"
            )
        processes.replace_dead()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), LOOK_EVERY_S)


async def watch_campaign(
    api: Api, campaign: str, processes: WorkerProcesses, stop: asyncio.Event, screen: Console
) -> dict[str, Any]:
    """Show how far a campaign is until it ends or is stopped; return its last progress."""
    with CampaignDisplay(screen) as display:

        async def look() -> dict[str, Any]:
            since = {"since": display.generations}
            progress: dict[str, Any] = await api.get(f"/campaigns/{campaign}/progress", since)
            display.show(progress)
            return progress

        return await watched(look, processes, stop)


@contextlib.contextmanager
def stopping(stop: asyncio.Event) -> Iterator[None]:
    """Set the event on Ctrl-C or SIGTERM instead of dying; afterwards, while all is being stopped, ignore both."""
    loop = asyncio.get_running_loop()
    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, stop.set)
    try:
        yield
    finally:
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)
            signal.signal(number, signal.SIG_IGN)


def check_extra(problem: Problem) -> None:
    """Refuse a problem that the workers of this machine cannot simulate.

    Raises:
        InvalidInput: An optional part of Brink is missing here.
    """
    if isinstance(problem, NeedsExtra) and any(find_spec(module) is None for module in problem.modules):
        message = (
            f"{problem.id} needs the {problem.extra} extra, which is not installed here: "
            f"{install_command(problem.extra)}"
        )
        raise InvalidInput([FieldError(pointer="/problem/id", message=message)])
