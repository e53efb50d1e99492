"""Small thread pools for costly reads: few at once, few in line, and each with a time limit.

Whoever reads must not keep others waiting. The event loop's default threads are for short queries. What decodes,
computes or renders more than that runs on the threads of a `ReadThreads`, so that it waits only for its like.
"""

import asyncio
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


class ReadThreads(ThreadPoolExecutor):
    """A pool of threads whose functions run under a `time_limit`, which ends them.

    Args:
        threads: How many run at once.
        name: Prefix of the threads' names.
        limit_s: Time limit in seconds, including the time that a function waits for others.
        most_pending: Maximum number of functions, running ones included.
    """

    def __init__(self, threads: int, name: str, *, limit_s: float, most_pending: int = MOST_PENDING) -> None:
        super().__init__(threads, thread_name_prefix=name)
        self._limit_s = limit_s
        self._most_pending = most_pending
        self._pending: dict[int, Deadline] = {}
        self._changing = Lock()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run a function on one of the threads.

        Returns:
            A future for its result or error. The error is `TooCostly` if its time was up.

        Raises:
            Unavailable: Too many are pending.
        """
        deadline = Deadline(time.monotonic() + self._limit_s)
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
            raise Unavailable("the coordinator is stopping") from None
        future.add_done_callback(lambda _: self._pending.pop(id(deadline)))
        return future

    def close(self) -> None:
        """End the running functions, and cancel those in line."""
        for deadline in list(self._pending.values()):
            deadline.due_s = 0.0
        self.shutdown(cancel_futures=True)

    async def run(self, compute: Callable[[], T]) -> T:
        """Return what a function returns.

        Raises:
            TooCostly: Its time was up.
            Unavailable: Too many functions are pending.
        """
        return await asyncio.get_running_loop().run_in_executor(self, compute)

    async def read(self, engines: Engines, query: Callable[[Connection], T]) -> T:
        """Return what a query returns that takes long, or whose rows take long to decode; see `run`."""

        def look() -> T:
            with engines.reader.connect() as connection:
                return query(connection)

        return await self.run(look)

    def _limited(self, deadline: Deadline, compute: Callable[[], T]) -> T:
        if deadline.is_over:
            raise TooCostly(
                f"this read waited for others for more than the {self._limit_s:g} s that it may take; try again "
                "when fewer are made",
                retry_after_s=RETRY_AFTER_S,
            )
        try:
            with time_limit(deadline):
                return compute()
        except OutOfTime:
            raise TooCostly(
                f"this read was ended after {self._limit_s:g} s, the most that it may take; ask for less, such as a "
                "larger d_th, a smaller t_b, eps or limit, or try again when fewer costly reads are made",
                retry_after_s=RETRY_AFTER_S,
            ) from None
