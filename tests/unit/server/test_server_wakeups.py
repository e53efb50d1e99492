"""The line of those who wait for work."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from brink.server.queue.wakeups import Wakeups

LONG_S = 30.0


def on_a_loop(body: Callable[[Wakeups], Awaitable[None]]) -> None:
    async def run() -> None:
        await asyncio.wait_for(body(Wakeups()), LONG_S)

    asyncio.run(run())


async def queued(wakeups: Wakeups, count: int) -> None:
    while len(wakeups) < count:
        await asyncio.sleep(0)


def waiting(wakeups: Wakeups, gone: asyncio.Event | None = None, s: float = LONG_S) -> asyncio.Task[bool]:
    return asyncio.create_task(wakeups.wait(s, gone or asyncio.Event()))


def test_news_wakes_the_first_in_line() -> None:
    async def body(wakeups: Wakeups) -> None:
        first = waiting(wakeups)
        await queued(wakeups, 1)
        second = waiting(wakeups)
        await queued(wakeups, 2)
        wakeups.wake(1)
        assert await first
        assert not second.done()
        wakeups.wake(1)
        assert await second

    on_a_loop(body)


def test_news_without_a_number_wakes_all() -> None:
    async def body(wakeups: Wakeups) -> None:
        waiters = [waiting(wakeups) for _ in range(5)]
        await queued(wakeups, 5)
        wakeups.wake()
        assert await asyncio.gather(*waiters) == [True] * 5

    on_a_loop(body)


def test_a_wait_ends_without_news() -> None:
    async def body(wakeups: Wakeups) -> None:
        assert not await wakeups.wait(0.001, asyncio.Event())

    on_a_loop(body)


def test_a_client_that_goes_ends_its_wait() -> None:
    async def body(wakeups: Wakeups) -> None:
        gone = asyncio.Event()
        waiter = waiting(wakeups, gone)
        await queued(wakeups, 1)
        gone.set()
        assert not await waiter

    on_a_loop(body)


def test_a_wake_up_of_a_client_that_has_gone_is_passed_on() -> None:
    async def body(wakeups: Wakeups) -> None:
        gone = asyncio.Event()
        first = waiting(wakeups, gone)
        await queued(wakeups, 1)
        second = waiting(wakeups)
        await queued(wakeups, 2)
        wakeups.wake(1)
        gone.set()
        assert not await first
        assert await second

    on_a_loop(body)


def test_a_wake_up_of_a_wait_that_is_cancelled_is_passed_on() -> None:
    async def body(wakeups: Wakeups) -> None:
        first = waiting(wakeups)
        await queued(wakeups, 1)
        second = waiting(wakeups)
        await queued(wakeups, 2)
        wakeups.wake(1)
        first.cancel()
        with pytest.raises(asyncio.CancelledError):
            await first
        assert await second

    on_a_loop(body)


def test_those_who_gave_up_leave_the_line() -> None:
    async def body(wakeups: Wakeups) -> None:
        for _ in range(20):
            await wakeups.wait(0.0001, asyncio.Event())
        assert len(wakeups._line) == 0

    on_a_loop(body)


def test_news_since_the_last_look_needs_no_wait() -> None:
    async def body(wakeups: Wakeups) -> None:
        news = wakeups.news
        wakeups.wake(0)
        assert wakeups.news == news, "none is none"
        wakeups.wake()  # with nobody in line
        assert await wakeups.wait(LONG_S, asyncio.Event(), since=news)
        assert not await wakeups.wait(0.001, asyncio.Event(), since=wakeups.news)

    on_a_loop(body)


def test_who_has_gone_has_no_use_for_news() -> None:
    async def body(wakeups: Wakeups) -> None:
        gone = asyncio.Event()
        gone.set()
        news = wakeups.news
        wakeups.wake()
        assert not await wakeups.wait(LONG_S, gone, since=news)

    on_a_loop(body)
