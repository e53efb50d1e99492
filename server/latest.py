"""Values that take long to compute and are asked for again and again: computed once for all who ask."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Generic, TypeVar

V = TypeVar("V")


@dataclass(slots=True)
class Latest(Generic[V]):
    """The values that were asked for last, each of one version of one thing.

    Attributes:
        most: How many are kept.
        threads: Where they are computed; the event loop's own threads if there are none.
    """

    most: int
    threads: Executor | None = None
    _kept: OrderedDict[Hashable, tuple[int, asyncio.Future[V]]] = field(default_factory=OrderedDict)

    def soon(self, name: Hashable, version: int, compute: Callable[[], V]) -> asyncio.Future[V]:
        """Return the value of one version of a thing, which is being computed if nobody asked for it before.

        What failed is computed again when it is asked for again.

        Args:
            name: The thing.
            version: Of it; a value of another version is dropped.
            compute: Returns the value, in a thread.
        """
        kept = self._kept.get(name)
        if kept is None or kept[0] != version or _failed(kept[1]):
            found = asyncio.get_running_loop().run_in_executor(self.threads, compute)
            self._kept[name] = kept = version, found
        self._kept.move_to_end(name)
        while len(self._kept) > self.most:
            self._kept.popitem(last=False)
        return kept[1]

    async def get(self, name: Hashable, version: int, compute: Callable[[], V]) -> V:
        """Return what `soon` promises; who goes away meanwhile leaves it to the others."""
        return await asyncio.shield(self.soon(name, version, compute))


def _failed(future: asyncio.Future[V]) -> bool:
    return future.done() and (future.cancelled() or future.exception() is not None)
