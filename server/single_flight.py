"""A single-flight cache: concurrent requests for a value share one computation."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from brink.server.errors import Unavailable

V = TypeVar("V")


@dataclass(slots=True)
class SingleFlightCache(Generic[V]):
    """The most recently used values, one version for each key.

    Attributes:
        capacity: Maximum number of values.
        threads: Where values are computed; the default threads of the event loop if None.
        max_pending: Maximum number of computations, queued ones included; unlimited if None.
    """

    capacity: int
    threads: Executor | None = None
    max_pending: int | None = None
    _pending: int = 0
    _values: OrderedDict[Hashable, tuple[int, asyncio.Future[V]]] = field(default_factory=OrderedDict)

    def start(self, key: Hashable, version: int, compute: Callable[[], V]) -> asyncio.Future[V]:
        """Return a future for a value, starting the computation unless it is cached or pending. Failures are retried.

        Args:
            key: What the value belongs to.
            version: The version of the value; the value of any other version is dropped.
            compute: Returns the value; called in a thread.

        Raises:
            Unavailable: Too many computations are pending.
        """
        entry = self._values.get(key)
        if entry is None or entry[0] != version or _failed(entry[1]):
            self._values[key] = entry = version, self._compute(compute)
        self._values.move_to_end(key)
        while len(self._values) > self.capacity:
            self._values.popitem(last=False)
        return entry[1]

    def _compute(self, compute: Callable[[], V]) -> asyncio.Future[V]:
        if self.max_pending is not None and self._pending >= self.max_pending:
            raise Unavailable(f"{self._pending} others are being computed; try again soon", retry_after_s=2)
        value = asyncio.get_running_loop().run_in_executor(self.threads, compute)
        self._pending += 1
        value.add_done_callback(self._on_done)
        return value

    def _on_done(self, value: asyncio.Future[V]) -> None:
        self._pending -= 1
        if not value.cancelled():
            value.exception()  # whoever asked may have gone, and then nobody else looks at it

    async def get(self, key: Hashable, version: int, compute: Callable[[], V]) -> V:
        """Return a value as `start` does, once it is computed. Cancelling this does not cancel the computation.

        Args:
            key: What the value belongs to.
            version: The version of the value.
            compute: Returns the value; called in a thread.

        Raises:
            Unavailable: Too many computations are pending.
        """
        return await asyncio.shield(self.start(key, version, compute))


def _failed(future: asyncio.Future[V]) -> bool:
    return future.done() and (future.cancelled() or future.exception() is not None)
