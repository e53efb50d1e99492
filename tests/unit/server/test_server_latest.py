"""Values that are computed once for all who ask."""

import asyncio
import threading

import pytest

from brink.server.errors import Unavailable
from brink.server.single_flight import Latest


class Counted:
    """Something that is computed, and counts how often; it may be made to wait or to fail."""

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


def test_who_asks_meanwhile_waits_for_the_same() -> None:
    async def work() -> None:
        latest, compute = Latest[int](most=2), Counted()
        compute.go.clear()
        asked = [asyncio.ensure_future(latest.get("a", 0, compute)) for _ in range(3)]
        await asyncio.sleep(0)
        asked[0].cancel()
        compute.go.set()
        found = await asyncio.gather(*asked, return_exceptions=True)
        assert isinstance(found[0], asyncio.CancelledError)
        assert found[1:] == [1, 1]
        assert await latest.get("a", 0, compute) == 1

    asyncio.run(work())


def test_another_version_takes_the_place_of_the_one_before() -> None:
    async def work() -> None:
        latest, compute = Latest[int](most=2), Counted()
        found = [await latest.get("a", version, compute) for version in (0, 1, 1, 0)]
        assert found == [1, 2, 2, 3]

    asyncio.run(work())


def test_a_failure_is_told_and_tried_again() -> None:
    async def work() -> None:
        latest, compute = Latest[int](most=2), Counted()
        compute.fails = True
        with pytest.raises(ValueError, match="not this time"):
            await latest.get("a", 0, compute)
        compute.fails = False
        assert await latest.get("a", 0, compute) == 2

    asyncio.run(work())


def test_what_nobody_asked_for_longest_goes_first() -> None:
    async def work() -> None:
        latest, compute = Latest[int](most=2), Counted()
        found = [await latest.get(name, 0, compute) for name in "abacab"]
        assert found == [1, 2, 1, 3, 1, 4]

    asyncio.run(work())


def test_who_asks_for_one_too_many_is_sent_away_until_one_is_done() -> None:
    async def work() -> None:
        latest, compute = Latest[int](most=4, most_waiting=2), Counted()
        compute.go.clear()
        asked = [latest.soon(name, 0, compute) for name in "ab"]
        with pytest.raises(Unavailable, match="2 others are being computed"):
            await latest.get("c", 0, compute)
        assert latest.soon("a", 0, compute) is asked[0], "what is under way already may be waited for"
        compute.go.set()
        await asyncio.gather(*asked)
        assert await latest.get("c", 0, compute) == 3

    asyncio.run(work())
