"""Following work survives a restart of its coordinator, and gives up when nobody answers for long."""

import asyncio
from collections.abc import Callable

import httpx
import pytest
from support.progress import PROGRESS

from brink.api import following
from brink.api.client import Api, Unreachable
from brink.api.following import Silent, follow
from brink.server.api.schemas import Progress

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
