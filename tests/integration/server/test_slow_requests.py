"""What takes long, such as a film or a submission that loads a network, keeps nobody else waiting."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, eventually, expect, submit
from test_traces_over_the_api import finished, traces

import brink.server.campaigns.plan
from brink.server.campaigns.service import SLOW_AT_ONCE
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Trace

MANY = 40
"""More than any machine has threads for the rest."""


class Stuck:
    """What does not end until it is told to."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self.within = 0

    def __call__(self, *_: Any) -> Any:
        with self._lock:
            self.within += 1
        self._ended.wait(60)
        raise InvalidEpisode("not a trace")

    def end(self) -> None:
        self._ended.set()


@contextmanager
def asking(client: httpx.Client, method: str, path: str, **options: Any) -> Iterator[list[int]]:
    """Ask many times at once; give what came, when all has."""
    statuses: list[int] = []

    def ask() -> None:
        statuses.append(httpx.request(method, f"{client.base_url}{path}", timeout=60, **options).status_code)

    threads = [threading.Thread(target=ask) for _ in range(MANY)]
    for thread in threads:
        thread.start()
    try:
        yield statuses
    finally:
        for thread in threads:
            thread.join()


def is_served(client: httpx.Client) -> None:
    """Check that others are answered meanwhile."""
    for path in ("/readyz", "/api/v1/campaigns", "/metrics", "/api/v1/jobs"):
        assert client.get(path).status_code == 200
    assert FakeWorker(client, capabilities=("nothing",)).lease() == []


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_drawing_keeps_nobody_waiting(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = finished(client, FakeWorker(client))
    path = f"/api/v1/campaigns/{campaign}/solutions/3"
    client.get(f"{path}/trace", params={"wait_s": 0})
    worker = FakeWorker(client, judge=traces(b"the trace"))
    worker.report(worker.lease())
    stuck = Stuck()
    monkeypatch.setattr(Trace, "from_bytes", stuck)
    with asking(client, "GET", f"{path}/replay.mp4") as statuses:
        try:
            eventually(lambda: stuck.within == SLOW_AT_ONCE, "some are drawn")
            is_served(client)
            expect(client.post("/api/v1/campaigns", json=ball(seed=2)), 201)
        finally:
            stuck.end()
    assert statuses == [409] * MANY


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_a_submission_that_is_checked_keeps_nobody_waiting(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    submit(client, ball())
    stuck = Stuck()

    def checked(*given: Any) -> Any:
        try:
            return stuck(*given)
        except InvalidEpisode:
            return usual(*given)

    usual = brink.server.campaigns.plan.check_submission
    monkeypatch.setattr(brink.server.campaigns.plan, "check_submission", checked)
    with asking(client, "POST", "/api/v1/campaigns", json=ball(seed=2, simulations=20)) as statuses:
        try:
            eventually(lambda: stuck.within == SLOW_AT_ONCE, "some are checked")
            is_served(client)
        finally:
            stuck.end()
    assert statuses == [201] * MANY
