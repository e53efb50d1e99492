"""Following work until it ends: one loop for commands that watch, for runs on this machine and for Python.

Progress is fetched and shown by a `Display`. A `Session` also keeps the workers of this machine alive, and pauses the
work if it is stopped: what is paused takes no workers until it is resumed.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from brink.api.client import Api, CoordinatorError, Unreachable
from brink.server.api.schemas import ExperimentProgress, Progress
from brink.server.errors import Unavailable
from brink.server.states import CampaignStatus

if TYPE_CHECKING:
    from brink.server.runtime.coordinator import WorkerProcesses

P = TypeVar("P", Progress, ExperimentProgress)
POLL_S: Final = 0.4
MAX_LOST_S: Final = 60.0
"""How long a coordinator may be unreachable, such as while it is restarted, before following ends."""
MAX_TROUBLE_S: Final = 5.0
"""How long the database may reject writes before a run on this machine gives up."""


class Display(Protocol[P]):
    """Fetches and shows the progress of one kind of work."""

    async def fetch(self, api: Api, work: str) -> P:
        """Return the progress of the work with this id."""

    def show(self, progress: P) -> None:
        """Show the progress."""


class Silent:
    """Fetches the progress of a campaign and shows nothing.

    Attributes:
        generations: Number of generations shown so far, which is the cursor of the next request.
    """

    generations = 0

    async def fetch(self, api: Api, campaign: str) -> Progress:
        """Return the progress of a campaign, with the generations that were not shown yet."""
        return await api.read(Progress, f"/campaigns/{campaign}/progress", {"since": self.generations})

    def show(self, progress: Progress) -> None:
        """Show nothing."""


def go_on(progress: object) -> None:
    """Let the work go on."""


async def follow(
    api: Api,
    work: str,
    display: Display[P],
    *,
    stop: asyncio.Event | None = None,
    check: Callable[[P], None] = go_on,
) -> P:
    """Show the progress of work until it ends, is paused or is stopped; return the last progress.

    Once the coordinator has answered, it may be away for as long as a restart takes.

    Args:
        api: Coordinator of the work.
        work: Id of the work.
        display: Fetches and shows the progress.
        stop: Ends this early.
        check: Called with each progress of work that still runs; an exception ends this.

    Raises:
        CoordinatorError: A request failed, or nobody has answered for `MAX_LOST_S`.
    """
    stop = stop or asyncio.Event()
    progress, answered_at = await display.fetch(api, work), time.monotonic()
    while True:
        display.show(progress)
        if progress.status is not CampaignStatus.RUNNING or stop.is_set():
            return progress
        check(progress)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), POLL_S)
        try:
            progress, answered_at = await display.fetch(api, work), time.monotonic()
        except Unreachable as error:
            if time.monotonic() - answered_at > MAX_LOST_S:
                raise
            progress = progress.model_copy(update={"trouble": str(error)})


async def pause(api: Api, path: str) -> None:
    """Pause a campaign or an experiment, unless it has ended in the meantime."""
    with contextlib.suppress(CoordinatorError):
        await api.post(f"{path}/pause")


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A coordinator with something that simulates for it.

    Attributes:
        api: Its API.
        processes: Workers of this machine; None if they are elsewhere.
        stop: Set to stop the work, as by Ctrl-C.
    """

    api: Api
    processes: "WorkerProcesses | None"
    stop: asyncio.Event = field(default_factory=asyncio.Event)

    async def follow(
        self, work: str, display: Display[P], paths: Sequence[str], check: Callable[[P], None] = go_on
    ) -> P:
        """Show the progress of work until it ends, is paused or is stopped; return the last progress.

        If workers of this machine simulate, those that died are replaced, and stopping or cancelling pauses the work.

        Args:
            work: Id of the work.
            display: Fetches and shows the progress.
            paths: Paths of the campaigns or the experiment to pause.
            check: As for `follow`.

        Raises:
            Unavailable: The database of this machine has rejected writes for too long.
        """

        def check_here(progress: P) -> None:
            check(progress)
            if self.processes is not None:
                if progress.trouble_s > MAX_TROUBLE_S:
                    raise Unavailable(
                        f"{progress.trouble}; acknowledged results are stored; continue later with --resume"
                    )
                self.processes.replace_dead()

        try:
            progress = await follow(self.api, work, display, stop=self.stop, check=check_here)
        except asyncio.CancelledError:
            await asyncio.shield(self._pause(paths))
            raise
        if self.stop.is_set():
            await self._pause(paths)
        return progress

    async def _pause(self, paths: Sequence[str]) -> None:
        for path in paths if self.processes is not None else ():
            await pause(self.api, path)
