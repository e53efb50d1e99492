"""Commands that watch a campaign say when no worker is connected, each time that the last one vanishes."""

import asyncio
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support.progress import PROGRESS

from brink.api import following
from brink.api.client import Api
from brink.api.live import waits_words
from brink.cli.campaigns import waiting_words, watch_campaign
from brink.server.api.schemas import Progress
from brink.sim.catalogue import worker_for

SERVER = "http://c:8700"


def stands(**changes: Any) -> dict[str, Any]:
    return {**PROGRESS, "queued": 60, "leased": 0, "workers": 0, **changes}


def words(**changes: Any) -> str:
    return waiting_words(Progress.model_validate(stands(**changes)), SERVER)


def test_waiting_names_the_command_that_starts_a_worker() -> None:
    assert words() == ("waiting: no worker is connected; start one with: brink worker --server http://c:8700")


SUMO = {"unrunnable": {"sumo@1": 60}, "waits_for": {"sumo@1": worker_for("sumo@1")}}


def test_waiting_names_the_missing_extra_or_plug_in() -> None:
    assert words(**SUMO) == (
        "waiting: no worker is connected; start a worker with the extra sumo (sumo@1) with: "
        "brink worker --server http://c:8700"
    )
    assert words(workers=2, **SUMO) == (
        "waiting: no connected worker provides sumo@1; start a worker with the extra sumo (sumo@1) "
        "with: brink worker --server http://c:8700"
    )
    function = words(unrunnable={"function-1a2b@1": 3})
    assert function == (
        "waiting: no worker is connected; run the Python program that called brink.search() (function-1a2b@1) again"
    )
    assert worker_for("carla@1") == "a worker with the plug-in that provides carla@1"
    assert worker_for("brink-drive@3") == "a worker (brink-drive@3)"
    one = Progress.model_validate(stands(**SUMO, workers=2))
    assert waits_words(one) == ["60 jobs wait for a worker with the extra sumo (sumo@1)"]


@pytest.mark.parametrize(
    "changes",
    [
        {"workers": 1},
        {"leased": 3},
        {"queued": 0},
        {"status": "paused"},
        {"status": "finished"},
        {"workers": 2, "unrunnable": {"carla@1": 59}},
    ],
)
def test_nothing_is_said_while_something_happens(changes: dict[str, Any]) -> None:
    assert words(**changes) == ""


@pytest.mark.parametrize("as_json", [False, True])
def test_watching_says_it_once_each_time(
    as_json: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(following, "POLL_S", 0.0)
    seen = [stands(), stands(), stands(workers=1, leased=4), stands(), stands(), stands(status="finished")]
    answers: Iterator[dict[str, Any]] = iter(seen)

    async def work() -> bool:
        transport = httpx.MockTransport(lambda _: httpx.Response(200, json=next(answers)))
        async with httpx.AsyncClient(transport=transport, base_url=SERVER) as client:
            return await watch_campaign(Api(client, SERVER), "3f2a", as_json=as_json)

    assert asyncio.run(work())
    shown = capsys.readouterr()
    assert (shown.err if as_json else shown.out).count("no worker is connected") == 2
    assert not as_json or "waiting" not in shown.out
