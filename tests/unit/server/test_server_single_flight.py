"""The single-flight cache."""

import asyncio
import threading
from collections.abc import Callable, Coroutine

import pytest

from brink.server.errors import Unavailable
from brink.server.single_flight import SingleFlightCache


class Counted:
    """Returns the number of its calls; can be made to wait or to fail."""

    def __init__(self) -> None:
        self.times = 0
        self.go = threading.Event()
        self.go.set()
        self.fails = False

    def __call__(self) -> int:
        self.times += 1
        assert self.go.wait(10)
        if self.fails:
            raise ValueError("not this time")
        return self.times


def on_a_loop(test: Callable[[], Coroutine[None, None, None]]) -> Callable[[], None]:
    return lambda: asyncio.run(test())


@on_a_loop
async def test_concurrent_requests_share_one_computation_and_survive_a_cancelled_one() -> None:
    cache, compute = SingleFlightCache[int](capacity=2), Counted()
    compute.go.clear()
    requests = [asyncio.ensure_future(cache.get("a", 0, compute)) for _ in range(3)]
    await asyncio.sleep(0)
    requests[0].cancel()
    compute.go.set()
    values = await asyncio.gather(*requests, return_exceptions=True)
    assert isinstance(values[0], asyncio.CancelledError)
    assert values[1:] == [1, 1]
    assert await cache.get("a", 0, compute) == 1


@on_a_loop
async def test_a_new_version_replaces_the_old_one() -> None:
    cache, compute = SingleFlightCache[int](capacity=2), Counted()
    values = [await cache.get("a", version, compute) for version in (0, 1, 1, 0)]
    assert values == [1, 2, 2, 3]


@on_a_loop
async def test_a_failure_is_raised_and_not_cached() -> None:
    cache, compute = SingleFlightCache[int](capacity=2), Counted()
    compute.fails = True
    with pytest.raises(ValueError, match="not this time"):
        await cache.get("a", 0, compute)
    compute.fails = False
    assert await cache.get("a", 0, compute) == 2


@on_a_loop
async def test_the_least_recently_used_value_is_dropped() -> None:
    cache, compute = SingleFlightCache[int](capacity=2), Counted()
    values = [await cache.get(key, 0, compute) for key in "abacab"]
    assert values == [1, 2, 1, 3, 1, 4]


@on_a_loop
async def test_a_request_above_the_limit_is_rejected_until_a_computation_ends() -> None:
    cache, compute = SingleFlightCache[int](capacity=4, max_pending=2), Counted()
    compute.go.clear()
    pending = [cache.start(key, 0, compute) for key in "ab"]
    with pytest.raises(Unavailable, match="2 others are being computed"):
        await cache.get("c", 0, compute)
    assert cache.start("a", 0, compute) is pending[0], "pending values can be waited for"
    compute.go.set()
    await asyncio.gather(*pending)
    assert await cache.get("c", 0, compute) == 3
