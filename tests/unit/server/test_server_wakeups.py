"""The line of waiting requests."""

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


def test_a_wake_up_goes_to_the_first_in_line() -> None:
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


def test_without_a_count_all_waiters_are_woken() -> None:
    async def body(wakeups: Wakeups) -> None:
        waiters = [waiting(wakeups) for _ in range(5)]
        await queued(wakeups, 5)
        wakeups.wake()
        assert await asyncio.gather(*waiters) == [True] * 5

    on_a_loop(body)


def test_a_wait_times_out() -> None:
    async def body(wakeups: Wakeups) -> None:
        assert not await wakeups.wait(0.001, asyncio.Event())

    on_a_loop(body)


def test_a_wait_ends_when_its_client_disconnects() -> None:
    async def body(wakeups: Wakeups) -> None:
        gone = asyncio.Event()
        waiter = waiting(wakeups, gone)
        await queued(wakeups, 1)
        gone.set()
        assert not await waiter

    on_a_loop(body)


def test_the_wake_up_of_a_disconnected_client_is_passed_on() -> None:
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


def test_the_wake_up_of_a_cancelled_wait_is_passed_on() -> None:
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


def test_waiters_that_time_out_leave_the_line() -> None:
    async def body(wakeups: Wakeups) -> None:
        for _ in range(20):
            await wakeups.wait(0.0001, asyncio.Event())
        assert len(wakeups._line) == 0

    on_a_loop(body)


def test_a_wait_returns_at_once_after_a_change() -> None:
    async def body(wakeups: Wakeups) -> None:
        seen = wakeups.changes
        wakeups.wake(0)
        assert wakeups.changes == seen, "waking nobody is no change"
        wakeups.wake()  # nobody is waiting
        assert await wakeups.wait(LONG_S, asyncio.Event(), since=seen)
        assert not await wakeups.wait(0.001, asyncio.Event(), since=wakeups.changes)

    on_a_loop(body)


def test_a_disconnected_client_does_not_use_a_change() -> None:
    async def body(wakeups: Wakeups) -> None:
        gone = asyncio.Event()
        gone.set()
        seen = wakeups.changes
        wakeups.wake()
        assert not await wakeups.wait(LONG_S, gone, since=seen)

    on_a_loop(body)
