"""The client tells what can be tried again from what cannot, and tries again itself while that is cheap."""

import json
from collections.abc import Iterator
from random import Random

import httpx
import pytest

from brink.worker.backoff import Backoff
from brink.worker.client import CoordinatorClient
from brink.worker.errors import CoordinatorAway, RequestRefused, UnexpectedReply
from brink.worker.wire import (
    HeartbeatRequest,
    JobFailed,
    JobResult,
    LeaseRequest,
    ResultsRequest,
    WorkerIdentity,
)

WORKER = WorkerIdentity(id="w")
LEASE = LeaseRequest(worker=WORKER, capabilities=["faulty@1"], wait_s=1.0)
GRANT = {"jobs": [], "lease_s": 60.0}


class Script(httpx.BaseTransport):
    """Answers requests in turn, and keeps them."""

    def __init__(self, *answers: httpx.Response | Exception) -> None:
        self.requests: list[httpx.Request] = []
        self._answers: Iterator[httpx.Response | Exception] = iter(answers)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        answer = next(self._answers)
        if isinstance(answer, Exception):
            raise answer
        return answer


def client(script: Script, pauses: list[float] | None = None, token: str | None = None) -> CoordinatorClient:
    return CoordinatorClient(
        "http://coordinator/",
        token=token,
        transport=script,
        backoff=Backoff(first_s=0.1, cap_s=1.0),
        pause=(pauses if pauses is not None else []).append,
        rng=Random(1),
    )


def test_a_request_is_json_with_the_token_at_the_right_address() -> None:
    script = Script(httpx.Response(200, json=GRANT))
    with client(script, token="secret") as c:
        assert c.lease(LEASE).lease_s == 60.0
    [request] = script.requests
    assert str(request.url) == "http://coordinator/api/v1/jobs/lease"
    assert request.headers["Authorization"] == "Bearer secret"
    assert request.headers["Content-Type"] == "application/json"
    assert json.loads(request.content) == LEASE.model_dump()


def test_without_a_token_no_authorisation_is_sent() -> None:
    script = Script(httpx.Response(200, json=GRANT))
    with client(script) as c:
        c.lease(LEASE)
    assert "Authorization" not in script.requests[0].headers


@pytest.mark.parametrize(
    "trouble",
    [
        httpx.ConnectError("refused"),
        httpx.RemoteProtocolError("closed"),
        httpx.ReadError("reset"),
        httpx.Response(500),
        httpx.Response(503),
        httpx.Response(429),
        httpx.Response(408),
    ],
)
def test_a_short_disturbance_is_tried_again_with_growing_pauses(trouble: httpx.Response | Exception) -> None:
    pauses: list[float] = []
    with client(Script(trouble, trouble, httpx.Response(200, json=GRANT)), pauses) as c:
        c.lease(LEASE)
    assert len(pauses) == 2
    assert 0.05 <= pauses[0] <= 0.1 <= pauses[1] <= 0.2


def test_a_long_disturbance_is_left_to_the_caller() -> None:
    script = Script(*[httpx.ConnectError("refused")] * 4)
    with (
        client(script) as c,
        pytest.raises(CoordinatorAway, match=r"http://coordinator: no answer \(refused\)"),
    ):
        c.lease(LEASE)
    assert len(script.requests) == 4


def test_a_timeout_is_left_to_the_caller_at_once() -> None:
    script = Script(httpx.ReadTimeout("slow"))
    with client(script) as c, pytest.raises(CoordinatorAway):
        c.lease(LEASE)
    assert len(script.requests) == 1


def test_a_short_retry_after_is_obeyed_here() -> None:
    pauses: list[float] = []
    script = Script(httpx.Response(429, headers={"Retry-After": "1"}), httpx.Response(200, json=GRANT))
    with client(script, pauses) as c:
        c.lease(LEASE)
    assert pauses == [1.0]


def test_a_long_retry_after_is_left_to_the_caller() -> None:
    script = Script(httpx.Response(503, headers={"Retry-After": "30"}))
    with client(script) as c, pytest.raises(CoordinatorAway) as caught:
        c.lease(LEASE)
    assert caught.value.retry_after_s == 30.0


@pytest.mark.parametrize("value", ["Wed, 21 Oct 2026 07:28:00 GMT", "-3", "inf", "nan", ""])
def test_a_retry_after_that_is_no_number_of_seconds_falls_back_to_the_backoff(value: str) -> None:
    script = Script(httpx.Response(503, headers={"Retry-After": value}), httpx.Response(200, json=GRANT))
    pauses: list[float] = []
    with client(script, pauses) as c:
        c.lease(LEASE)
    assert 0.05 <= pauses[0] <= 0.1


@pytest.mark.parametrize("status", [400, 401, 403, 404, 413, 422])
def test_a_refusal_is_final_and_tells_the_detail_on_one_line(status: int) -> None:
    script = Script(
        httpx.Response(
            status, json={"title": "No", "detail": "max_jobs:\n  expected 1 to 256", "status": status}
        )
    )
    with client(script) as c, pytest.raises(RequestRefused) as caught:
        c.lease(LEASE)
    assert caught.value.status == status
    assert str(caught.value) == f"http://coordinator: lease answered {status} No: max_jobs: expected 1 to 256"
    assert len(script.requests) == 1


def test_a_refusal_that_is_no_problem_document_is_told_as_it_is() -> None:
    script = Script(httpx.Response(404, text="<html>\nnot here</html>"))
    with client(script) as c, pytest.raises(RequestRefused, match="404 <html> not here</html>"):
        c.lease(LEASE)


@pytest.mark.parametrize(
    "answer",
    [
        httpx.Response(200, text="<html>hello</html>"),
        httpx.Response(200, json={"jobs": []}),
        httpx.Response(302, headers={"Location": "http://elsewhere/"}),
        httpx.Response(204),
    ],
)
def test_what_does_not_speak_the_wire_is_no_coordinator(answer: httpx.Response) -> None:
    with client(Script(answer)) as c, pytest.raises(UnexpectedReply, match="Is this the address"):
        c.lease(LEASE)


def test_a_report_without_one_status_a_result_is_not_believed() -> None:
    failed = JobFailed(reason="error", message="no")
    request = ResultsRequest(worker=WORKER, results=[JobResult(job=1, token="t", outcome=failed)])
    script = Script(httpx.Response(200, json={"statuses": [], "lease": None}))
    with client(script) as c, pytest.raises(UnexpectedReply, match="one status for each of 1 results"):
        c.report(request)


def test_a_heartbeat_tells_what_is_held() -> None:
    script = Script(httpx.Response(200, json={"held": [3], "lease_s": 60.0}))
    with client(script) as c:
        assert c.heartbeat(HeartbeatRequest(worker=WORKER, leases=[])).held == [3]
