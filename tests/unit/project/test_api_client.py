"""The client validates the answers of a coordinator and turns every failure into one readable error."""

import asyncio
import json
from typing import Any

import httpx
import pytest
from support.traces import make_trace

from brink.api.client import Api, CoordinatorError
from brink.api.results import run_episode
from brink.server.api.schemas import WorkerView
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.views import DbsCell
from brink.server.findings.combinations.views import TechniqueLevel


def read(schema: Any, answer: httpx.Response) -> Any:
    """Read an answer from a coordinator that gives the same one to every request."""

    async def work() -> Any:
        transport = httpx.MockTransport(lambda _: answer)
        async with httpx.AsyncClient(transport=transport, base_url="http://c") as client:
            return await Api(client, "http://c").read(schema, "/anything")

    return asyncio.run(work())


def test_an_answer_is_read_into_its_schema_and_dumps_to_the_same_document() -> None:
    worker = {
        "id": "w",
        "host": "h",
        "pid": 1,
        "version": "0",
        "capabilities": ["ball@1"],
        "first_seen_at": "2026-01-02T03:04:05.678901Z",
        "last_seen_at": "2026-01-02T03:04:06Z",
        "seen_s_ago": 1.0,
        "live": True,
        "draining": False,
        "jobs_done": 2,
        "jobs_failed": 0,
        "jobs_held": 1,
    }
    [found] = read(list[WorkerView], httpx.Response(200, json=[worker]))
    assert found.live
    assert json.dumps(found.model_dump(mode="json")) == json.dumps(worker)


@pytest.mark.parametrize(
    "path", ["/campaigns//progress", "/campaigns/../jobs", "/campaigns/a?b", "/campaigns/"]
)
def test_a_path_with_an_empty_or_foreign_id_is_not_requested(path: str) -> None:
    async def work() -> None:
        transport = httpx.MockTransport(lambda _: pytest.fail("it was requested"))
        async with httpx.AsyncClient(transport=transport, base_url="http://c") as client:
            await Api(client, "http://c").get(path)

    with pytest.raises(InvalidInput, match="expected an id or a name, got"):
        asyncio.run(work())


def test_an_unexpected_answer_names_the_field() -> None:
    answer = httpx.Response(200, json={"technique": "rain", "level": "high", "levels": 3})
    with pytest.raises(CoordinatorError, match=r"unexpected answer from http://c: level: .*same version"):
        read(TechniqueLevel, answer)


def test_an_answer_that_is_no_json_is_an_error_of_the_coordinator() -> None:
    with pytest.raises(CoordinatorError, match="unexpected answer from http://c: the answer: Invalid JSON"):
        read(DbsCell, httpx.Response(200, text="<html>"))


def test_a_rejected_request_lists_every_wrong_field() -> None:
    errors = [{"pointer": "/seed", "message": "expected a number", "nearest": None}]
    errors.append({"pointer": "/bugdet", "message": "unknown field", "nearest": "budget"})
    answer = httpx.Response(422, json={"detail": "invalid", "errors": errors})
    with pytest.raises(CoordinatorError) as caught:
        read(DbsCell, answer)
    assert str(caught.value).splitlines() == [
        "seed: expected a number",
        "bugdet: unknown field (did you mean 'budget'?)",
    ]


def test_a_kept_trace_is_read_and_its_episode_not_run_again() -> None:
    # It may be that of a simulator which this machine no longer has.
    trace = make_trace()

    def answer(request: httpx.Request) -> httpx.Response:
        assert request.url.path.endswith("/campaigns/3f2a/solutions/4/trace"), "only the trace is requested"
        return httpx.Response(200, content=trace.to_bytes())

    async def work() -> bytes:
        async with httpx.AsyncClient(transport=httpx.MockTransport(answer), base_url="http://c") as client:
            return (await run_episode(Api(client, "http://c"), "3f2a", 4)).to_bytes()

    assert asyncio.run(work()) == trace.to_bytes()
