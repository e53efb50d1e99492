"""Small thread pools for costly reads: few at once, few in line, and each with a time limit.

Whoever reads must not keep others waiting. The event loop's default threads are for short queries. What decodes,
computes or renders more than that runs on the threads of a `ReadThreads`, so that it waits only for its like.
"""

import asyncio
import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import Any, Final, TypeVar

from sqlalchemy import Connection

from brink.search.deadline import Deadline, time_limit
from brink.search.errors import OutOfTime
from brink.server.db.engine import Engines
from brink.server.errors import TooCostly, Unavailable

T = TypeVar("T")

MOST_PENDING: Final = 64
"""Maximum number of costly reads of a pool, running ones included."""
RETRY_AFTER_S: Final = 10
STOPPING: Final = "the coordinator is stopping"
_CLOSED: Final = 0.0
"""The due time of functions that end because their threads are closed."""
ASK_FOR_LESS: Final = "request less, for example with a larger d_th, a smaller t_b, eps or limit"


class ReadThreads(ThreadPoolExecutor):
    """A pool of threads whose functions run under a `time_limit`, which ends them.

    Args:
        threads: How many run at once.
        name: Prefix of the threads' names.
        limit_s: Time limit in seconds, including the time that a function waits for others unless `patient`.
        most_pending: Maximum number of functions, running ones included.
        patient: Whether the time that a function waits for others does not count.
        instead: What to do about a function whose time was up.
    """

    def __init__(
        self,
        threads: int,
        name: str,
        *,
        limit_s: float,
        most_pending: int = MOST_PENDING,
        patient: bool = False,
        instead: str = ASK_FOR_LESS,
    ) -> None:
        super().__init__(threads, thread_name_prefix=name)
        self._limit_s = limit_s
        self._patient = patient
        self._instead = instead
        self._most_pending = most_pending
        self._pending: dict[int, Deadline] = {}
        self._changing = Lock()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run a function on one of the threads.

        Returns:
            A future for its result or error. The error is `TooCostly` if its time was up, and `Unavailable` if the
            threads were closed.

        Raises:
            Unavailable: Too many are pending.
        """
        deadline = Deadline(math.inf if self._patient else time.monotonic() + self._limit_s)
        with self._changing:
            if len(self._pending) >= self._most_pending:
                raise Unavailable(
                    f"{len(self._pending)} costly reads are pending, and no more are taken; try again soon",
                    retry_after_s=RETRY_AFTER_S,
                )
            self._pending[id(deadline)] = deadline
        try:
            future: Future[T] = super().submit(self._limited, deadline, lambda: fn(*args, **kwargs))
        except RuntimeError:
            self._pending.pop(id(deadline))
            raise Unavailable(STOPPING) from None
        future.add_done_callback(lambda _: self._pending.pop(id(deadline)))
        return future

    def close(self) -> None:
        """End the running functions, and cancel those in line."""
        with self._changing:
            for deadline in list(self._pending.values()):
                deadline.due_s = _CLOSED
        self.shutdown(cancel_futures=True)

    async def run(self, compute: Callable[[], T]) -> T:
        """Return what a function returns.

        Raises:
            TooCostly: Its time was up.
            Unavailable: Too many functions are pending.
        """
        return await asyncio.get_running_loop().run_in_executor(self, compute)

    async def read(self, engines: Engines, query: Callable[[Connection], T]) -> T:
        """Return the result of a query that is slow, or whose rows are slow to decode; see `run`."""

        def look() -> T:
            with engines.reader.connect() as connection:
                return query(connection)

        return await self.run(look)

    def _limited(self, deadline: Deadline, compute: Callable[[], T]) -> T:
        with self._changing:
            if deadline.due_s == math.inf:
                deadline.due_s = time.monotonic() + self._limit_s
        if deadline.due_s == _CLOSED:
            raise Unavailable(STOPPING)
        if deadline.is_over:
            raise TooCostly(
                f"this read waited longer than the {self._limit_s:g} s it may take; try again when fewer are pending",
                retry_after_s=RETRY_AFTER_S,
            )
        try:
            with time_limit(deadline):
                return compute()
        except OutOfTime:
            if deadline.due_s == _CLOSED:
                raise Unavailable(STOPPING) from None
            raise TooCostly(
                f"this read was ended after {self._limit_s:g} s, its time limit; {self._instead}, or try again "
                "when fewer costly reads are pending",
                retry_after_s=RETRY_AFTER_S,
            ) from None
