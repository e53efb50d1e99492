"""Waking those who wait for work: in the order in which they came, one for each piece of news.

All calls are made on the event loop. A waiter that gives up after it was woken passes its wake-up on, so that none
is lost to a client that has gone.
"""

import asyncio


class Wakeups:
    """A line of waiters."""

    def __init__(self) -> None:
        self._line: dict[asyncio.Future[None], None] = {}
        self.news = 0
        """How often there was any. Who asks for work notes it before, and misses nothing that comes meanwhile."""

    def __len__(self) -> int:
        return len(self._line)

    def wake(self, count: int | None = None) -> None:
        """Wake the first `count` waiters, or all of them."""
        self.news += count != 0
        for waiter in list(self._line)[:count]:
            del self._line[waiter]
            waiter.set_result(None)

    async def wait(self, timeout_s: float, gone: asyncio.Event, *, since: int | None = None) -> bool:
        """Wait in line.

        Args:
            timeout_s: How long to wait.
            gone: Set when the client has gone.
            since: The news that the waiter knows; if there is more, it need not wait.

        Returns:
            Whether there was a wake-up, and somebody is still there to use it.
        """
        if since is not None and since != self.news:
            return not gone.is_set()
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._line[waiter] = None
        left: asyncio.Future[bool] = asyncio.ensure_future(gone.wait())
        used = False
        try:
            await asyncio.wait((waiter, left), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
            used = waiter.done() and not gone.is_set()
        finally:
            left.cancel()
            self._line.pop(waiter, None)
            if waiter.done() and not used:
                self.wake(1)
        return used
