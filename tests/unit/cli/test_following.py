"""Following work survives a restart of its coordinator, and pauses what this machine simulates when it is stopped."""

import asyncio
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from support.progress import PROGRESS

from brink.api import following
from brink.api.client import Api, Unreachable
from brink.api.following import Session, Silent, follow
from brink.server.api.schemas import Progress
from brink.server.errors import Unavailable

RUNNING = {**PROGRESS, "status": "running"}


class Shown(Silent):
    """Keeps the troubles that were shown."""

    def __init__(self) -> None:
        self.troubles: list[str | None] = []

    def show(self, progress: Progress) -> None:
        self.troubles.append(progress.trouble)


def followed(answer: Callable[[httpx.Request], httpx.Response], display: Shown) -> Progress:
    async def work() -> Progress:
        transport = httpx.MockTransport(answer)
        async with httpx.AsyncClient(transport=transport, base_url="http://c:8700") as client:
            return await follow(Api(client, "http://c:8700"), "3f2a", display)

    return asyncio.run(work())


def answers(*documents: dict[str, object] | None) -> Callable[[httpx.Request], httpx.Response]:
    """Return a transport that answers with each document in turn; with None it refuses the connection."""
    left = iter(documents)

    def answer(request: httpx.Request) -> httpx.Response:
        document = next(left)
        if document is None:
            raise httpx.ConnectError("refused", request=request)
        return httpx.Response(200, json=document)

    return answer


def test_a_restart_of_the_coordinator_is_shown_and_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "POLL_S", 0.0)
    display = Shown()
    ended = followed(answers(RUNNING, None, None, RUNNING, {**RUNNING, "status": "finished"}), display)
    assert ended.status == "finished"
    away = "no coordinator answers at http://c:8700 (refused); start one with: brink serve"
    assert display.troubles == [None, away, away, None, None]


def test_following_ends_if_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Unreachable):
        followed(answers(None), Shown())
    monkeypatch.setattr(following, "POLL_S", 0.0)
    monkeypatch.setattr(following, "MAX_LOST_S", 0.0)
    with pytest.raises(Unreachable):
        followed(answers(RUNNING, None), Shown())


class Workers:
    """Stand for worker processes: one dies between any two requests."""

    replaced = 0

    def replace_dead(self) -> int:
        self.replaced += 1
        return 1


def stopped(*, here: bool, cancel: bool, **changes: object) -> tuple[list[str], Workers]:
    """Follow work that runs until it is stopped or cancelled; return the requests that changed something."""
    posted: list[str] = []
    workers = Workers()

    async def work() -> None:
        stop = asyncio.Event()

        def answer(request: httpx.Request) -> httpx.Response:
            if request.method == "POST":
                posted.append(request.url.path.removeprefix("/api/v1"))
            elif workers.replaced > 1 or not here:
                stop.set()
            return httpx.Response(200, json={**RUNNING, **changes})

        async with httpx.AsyncClient(
            transport=httpx.MockTransport(answer), base_url="http://c:8700"
        ) as client:
            processes: Any = workers if here else None
            session = Session(api=Api(client, "http://c:8700"), processes=processes)
            task = asyncio.create_task(session.follow("3f2a", Silent(), ["/campaigns/3f2a"]))
            await stop.wait()
            if cancel:
                task.cancel()
            else:
                session.stop.set()
            await asyncio.wait([task])
            assert task.cancelled() is cancel
            if not cancel:
                task.result()

    asyncio.run(asyncio.wait_for(work(), 20.0))
    return posted, workers


@pytest.mark.parametrize("cancel", [False, True])
def test_what_this_machine_simulates_is_paused_when_it_is_stopped(
    cancel: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "POLL_S", 0.01)
    posted, workers = stopped(here=True, cancel=cancel)
    assert posted == ["/campaigns/3f2a/pause"]
    assert workers.replaced > 1, "dead workers are replaced"
    posted, _ = stopped(here=False, cancel=cancel)
    assert posted == [], "workers elsewhere go on"


def test_a_run_gives_up_if_the_database_rejects_writes_for_long() -> None:
    async def work() -> None:
        document = {**RUNNING, "trouble": "disk full", "trouble_s": 9.0}
        transport = httpx.MockTransport(lambda _: httpx.Response(200, json=document))
        async with httpx.AsyncClient(transport=transport, base_url="http://c:8700") as client:
            processes: Any = Workers()
            session = Session(api=Api(client, "http://c:8700"), processes=processes)
            await session.follow("3f2a", Silent(), ["/campaigns/3f2a"])

    with pytest.raises(Unavailable, match="disk full; acknowledged results are stored"):
        asyncio.run(work())
