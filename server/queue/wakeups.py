"""Waking those who wait for work: in the order in which they came, one for each piece of news.

All calls are made on the event loop. A waiter that gives up after it was woken passes its wake-up on, so that none
is lost to a client that has gone.
"""

import asyncio
from collections import deque


class Wakeups:
    """A line of waiters."""

    def __init__(self) -> None:
        self._line: deque[asyncio.Future[None]] = deque()

    def __len__(self) -> int:
        return sum(not waiter.done() for waiter in self._line)

    def wake(self, count: int | None = None) -> None:
        """Wake the first `count` waiters, or all of them."""
        while self._line and (count is None or count > 0):
            waiter = self._line.popleft()
            if waiter.done():
                continue
            waiter.set_result(None)
            if count is not None:
                count -= 1

    async def wait(self, timeout_s: float, gone: asyncio.Event) -> bool:
        """Wait in line.

        Args:
            timeout_s: How long to wait.
            gone: Set when the client has gone.

        Returns:
            Whether there was a wake-up, and somebody is still there to use it.
        """
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._line.append(waiter)
        left: asyncio.Future[bool] = asyncio.ensure_future(gone.wait())
        try:
            await asyncio.wait((waiter, left), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            left.cancel()
            woken = waiter.done()
            if not woken:
                waiter.cancel()
        if woken and gone.is_set():
            self.wake(1)
            return False
        return woken
