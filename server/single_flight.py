"""Values that take long to compute and are asked for again and again: computed once for all who ask."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from brink.server.errors import Unavailable

V = TypeVar("V")


@dataclass(slots=True)
class Latest(Generic[V]):
    """The values that were asked for last, each of one version of one thing.

    Attributes:
        most: How many are kept.
        threads: Where they are computed; the event loop's own threads if there are none.
        most_waiting: How many may be under way, those that wait for a thread included; any number if it is None.
    """

    most: int
    threads: Executor | None = None
    most_waiting: int | None = None
    _under_way: int = 0
    _kept: OrderedDict[Hashable, tuple[int, asyncio.Future[V]]] = field(default_factory=OrderedDict)

    def soon(self, name: Hashable, version: int, compute: Callable[[], V]) -> asyncio.Future[V]:
        """Return the value of one version of a thing, which is being computed if nobody asked for it before.

        What failed is computed again when it is asked for again.

        Args:
            name: The thing.
            version: Of it; a value of another version is dropped.
            compute: Returns the value, in a thread.

        Raises:
            Unavailable: Too many are under way.
        """
        kept = self._kept.get(name)
        if kept is None or kept[0] != version or _failed(kept[1]):
            self._kept[name] = kept = version, self._begin(compute)
        self._kept.move_to_end(name)
        while len(self._kept) > self.most:
            self._kept.popitem(last=False)
        return kept[1]

    def _begin(self, compute: Callable[[], V]) -> asyncio.Future[V]:
        if self.most_waiting is not None and self._under_way >= self.most_waiting:
            raise Unavailable(f"{self._under_way} others are being computed; ask again soon", retry_after_s=2)
        found = asyncio.get_running_loop().run_in_executor(self.threads, compute)
        self._under_way += 1
        found.add_done_callback(self._ended)
        return found

    def _ended(self, _: asyncio.Future[V]) -> None:
        self._under_way -= 1

    async def get(self, name: Hashable, version: int, compute: Callable[[], V]) -> V:
        """Return what `soon` promises; who goes away meanwhile leaves it to the others."""
        return await asyncio.shield(self.soon(name, version, compute))


def _failed(future: asyncio.Future[V]) -> bool:
    return future.done() and (future.cancelled() or future.exception() is not None)
