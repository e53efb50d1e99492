"""The HTTP client retries short failures, backs off, and tells retryable errors from final ones."""

import json
import logging
from collections.abc import Iterator
from random import Random

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.worker.backoff import Backoff, Outage
from brink.worker.client import CoordinatorClient
from brink.worker.errors import CoordinatorUnavailable, RequestRefused, UnexpectedReply
from brink.worker.wire import JobFailed, JobResult, LeaseRequest, ResultsRequest, WorkerIdentity

WORKER = WorkerIdentity(id="w")
LEASE = LeaseRequest(worker=WORKER, capabilities=["faulty@1"], wait_s=1.0)
GRANT = {"jobs": [], "lease_s": 60.0}


class Script(httpx.BaseTransport):
    """A transport that answers requests in turn and records them."""

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


@pytest.mark.parametrize(("token", "header"), [("secret", "Bearer secret"), (None, None)])
def test_a_request_is_json_with_a_bearer_token(token: str | None, header: str | None) -> None:
    script = Script(httpx.Response(200, json=GRANT))
    with client(script, token=token) as c:
        assert c.lease(LEASE).lease_s == 60.0
    [request] = script.requests
    assert str(request.url) == "http://coordinator/api/v1/jobs/lease"
    assert request.headers.get("Authorization") == header
    assert request.headers["Content-Type"] == "application/json"
    assert json.loads(request.content) == LEASE.model_dump()


@pytest.mark.parametrize(
    "failure",
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
def test_a_transient_failure_is_retried_with_growing_pauses(failure: httpx.Response | Exception) -> None:
    pauses: list[float] = []
    with client(Script(failure, failure, httpx.Response(200, json=GRANT)), pauses) as c:
        c.lease(LEASE)
    assert len(pauses) == 2
    assert 0.05 <= pauses[0] <= 0.1 <= pauses[1] <= 0.2


@pytest.mark.parametrize(
    ("failure", "attempts"), [(httpx.ConnectError("refused"), 4), (httpx.ReadTimeout("slow"), 1)]
)
def test_a_lasting_failure_is_retried_and_a_timeout_is_not(failure: Exception, attempts: int) -> None:
    script = Script(*[failure] * 4)
    with client(script) as c, pytest.raises(CoordinatorUnavailable, match=f"no answer .{failure}"):
        c.lease(LEASE)
    assert len(script.requests) == attempts


def test_a_short_retry_after_is_obeyed() -> None:
    pauses: list[float] = []
    script = Script(httpx.Response(429, headers={"Retry-After": "1"}), httpx.Response(200, json=GRANT))
    with client(script, pauses) as c:
        c.lease(LEASE)
    assert pauses == [1.0]


def test_a_long_retry_after_is_raised_to_the_caller() -> None:
    script = Script(httpx.Response(503, headers={"Retry-After": "30"}))
    with client(script) as c, pytest.raises(CoordinatorUnavailable) as caught:
        c.lease(LEASE)
    assert caught.value.retry_after_s == 30.0


@pytest.mark.parametrize("value", ["Wed, 21 Oct 2026 07:28:00 GMT", "-3", "inf", "nan", ""])
def test_a_retry_after_that_is_not_a_number_of_seconds_is_ignored(value: str) -> None:
    script = Script(httpx.Response(503, headers={"Retry-After": value}), httpx.Response(200, json=GRANT))
    pauses: list[float] = []
    with client(script, pauses) as c:
        c.lease(LEASE)
    assert 0.05 <= pauses[0] <= 0.1


@pytest.mark.parametrize("status", [400, 403, 404, 413, 422])
def test_a_refusal_is_final_and_gives_the_detail_on_one_line(status: int) -> None:
    script = Script(
        httpx.Response(
            status, json={"title": "No", "detail": "max_jobs:\n  expected 1 to 256", "status": status}
        )
    )
    with client(script) as c, pytest.raises(RequestRefused) as caught:
        c.lease(LEASE)
    assert caught.value.status == status
    assert str(caught.value) == f"http://coordinator: lease returned {status} No: max_jobs: expected 1 to 256"
    assert len(script.requests) == 1


@pytest.mark.parametrize(
    ("token", "words"),
    [
        (
            None,
            "the coordinator at http://coordinator requires a token: set the environment variable BRINK_TOKEN",
        ),
        (
            "wrong",
            "token rejected: the coordinator at http://coordinator does not know it, or it was revoked",
        ),
    ],
)
def test_a_rejected_token_is_told_from_a_missing_one(token: str | None, words: str) -> None:
    transport = Script(httpx.Response(401, json={"title": "Unauthorised", "detail": "no", "status": 401}))
    with (
        CoordinatorClient("http://coordinator", token=token, transport=transport) as c,
        pytest.raises(RequestRefused) as caught,
    ):
        c.lease(LEASE)
    assert str(caught.value).startswith(words)
    assert "brink token create NAME --scope worker" in str(caught.value)
    assert token is None or token not in str(caught.value)
    assert len(transport.requests) == 1, "trying again would not help"


def test_a_refusal_that_is_not_problem_json_is_quoted() -> None:
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
def test_an_unexpected_reply_asks_whether_this_is_a_coordinator(answer: httpx.Response) -> None:
    with client(Script(answer)) as c, pytest.raises(UnexpectedReply, match="Is this the address"):
        c.lease(LEASE)


def test_a_report_reply_needs_one_status_per_result() -> None:
    failed = JobFailed(reason="error", message="no")
    request = ResultsRequest(worker=WORKER, results=[JobResult(job=1, token="t", outcome=failed)])
    script = Script(httpx.Response(200, json={"statuses": [], "lease": None}))
    with client(script) as c, pytest.raises(UnexpectedReply, match="one status for each of 1 results"):
        c.report(request)


@given(failures=st.integers(1, 10_000), seed=st.integers(0, 2**32))
def test_backoff_doubles_up_to_its_cap_with_jitter(failures: int, seed: int) -> None:
    delay_s = Backoff(first_s=0.5, cap_s=10.0).delay_s(failures, Random(seed))
    longest_s = min(10.0, 0.5 * 2 ** min(failures - 1, 20))
    assert longest_s / 2 <= delay_s <= longest_s


def test_an_outage_is_logged_at_growing_intervals_and_its_end_once(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    outage = Outage("http://c", Backoff(first_s=0.5, cap_s=10.0), Random(1), clock=lambda: now_s)
    logged_at_s = []
    with caplog.at_level(logging.INFO):
        for second in range(1000):
            now_s = float(second)
            outage.record_failure(CoordinatorUnavailable("no answer"), unsent=3)
            if caplog.records:
                logged_at_s.append(second)
                caplog.clear()
        outage.record_success()
        outage.record_success()
    assert logged_at_s == [0, 5, 15, 35, 75, 155, 315, 615, 915]
    assert [record.getMessage() for record in caplog.records] == ["the coordinator at http://c is back"]


def test_an_outage_waits_as_long_as_the_coordinator_asks() -> None:
    outage = Outage("http://c", Backoff(first_s=0.5, cap_s=10.0), Random(1), clock=lambda: 0.0)
    assert outage.record_failure(CoordinatorUnavailable("busy", retry_after_s=42.0), unsent=0) == 42.0


def test_without_a_token_no_authorization_header_is_sent() -> None:
    script = Script(httpx.Response(200, json=GRANT))
    with client(script) as c:
        c.lease(LEASE)
    assert "Authorization" not in script.requests[0].headers


def test_a_lasting_failure_is_raised_after_the_last_attempt() -> None:
    script = Script(*[httpx.ConnectError("refused")] * 4)
    with (
        client(script) as c,
        pytest.raises(CoordinatorUnavailable, match=r"http://coordinator: no answer \(refused\)"),
    ):
        c.lease(LEASE)
    assert len(script.requests) == 4


def test_a_timeout_is_raised_without_a_retry() -> None:
    script = Script(httpx.ReadTimeout("slow"))
    with client(script) as c, pytest.raises(CoordinatorUnavailable):
        c.lease(LEASE)
    assert len(script.requests) == 1
