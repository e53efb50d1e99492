"""Decides when campaigns advance: when a generation is complete, when seeds arrive, and at every sweep.

Steps run one at a time on a thread of their own, off the event loop. A campaign stands in line at most once.
"""

import asyncio
import logging
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from sqlalchemy import Connection

from brink.server.campaigns import store
from brink.server.campaigns.advance import Stepper
from brink.server.db.engine import Engines, read
from brink.server.queue.wakeups import Wakeups

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Scheduler:
    """Advances the campaigns of one coordinator process.

    Attributes:
        engines: Where to read which campaigns are due.
        stepper: Takes the steps.
        wakeups: The workers waiting for jobs; woken when a step has enqueued some.
    """

    engines: Engines
    stepper: Stepper
    wakeups: Wakeups
    _due: set[str] = field(default_factory=set)
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _steps: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(max_workers=1, thread_name_prefix="brink-step")
    )

    def advance_soon(self, campaigns: Iterable[str]) -> None:
        """Put campaigns in line to be advanced, unless they are in line already."""
        for campaign in campaigns:
            if campaign in self._due:
                continue
            self._due.add(campaign)
            task = asyncio.get_running_loop().create_task(self._advance(campaign))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _advance(self, campaign: str) -> None:
        loop = asyncio.get_running_loop()

        def step() -> bool:
            # A campaign that becomes due from here on needs another look.
            loop.call_soon_threadsafe(self._due.discard, campaign)
            return self.stepper.advance(campaign)

        try:
            moved = await loop.run_in_executor(self._steps, step)
        except Exception:
            log.exception("the step failed; the sweeper will try again", extra={"campaign": campaign})
            return
        if moved:
            self.wakeups.wake()

    async def sweep(self) -> None:
        """Advance campaigns whose step is due, and drop the state of those that ended or were paused elsewhere."""
        kept = self.stepper.kept

        def look(connection: Connection) -> tuple[list[str], frozenset[str]]:
            return store.running_idle(connection), store.running_among(connection, kept)

        idle, running = await read(self.engines, look)
        for campaign in set(kept) - running:
            self.stepper.forget(campaign)
        self.advance_soon(idle)

    def close(self) -> None:
        """Finish the running step and start no other."""
        self._steps.shutdown(wait=True, cancel_futures=True)
