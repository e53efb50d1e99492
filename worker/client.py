"""HTTP client for the three requests of a worker, over kept-alive connections.

The client retries a short failure quickly and a few times. A longer one raises `CoordinatorUnavailable`, so that the
caller can retry with the outcomes it has by then.
"""

import json
import math
import time
from collections.abc import Callable
from random import Random
from types import TracebackType
from typing import Final, Self, TypeVar

import httpx
from pydantic import ValidationError

from brink.worker.backoff import Backoff
from brink.worker.errors import CoordinatorUnavailable, RequestRefused, UnexpectedReply, no_token_words
from brink.worker.wire import (
    HeartbeatReply,
    HeartbeatRequest,
    LeaseReply,
    LeaseRequest,
    Message,
    ResultsReply,
    ResultsRequest,
)

API_PATH = "/api/v1/jobs"
CONNECT_TIMEOUT_S: Final = 5.0
REPLY_TIMEOUT_S: Final = 15.0
"""Time limit for a reply, in addition to the wait that a lease request asks for."""

LONGEST_RETRY_AFTER_S: Final = 1.0
"""A longer Retry-After is left to the caller."""

_RETRYABLE: Final = frozenset({httpx.codes.REQUEST_TIMEOUT, httpx.codes.TOO_MANY_REQUESTS})
"""Client errors that are not the request's fault: the network was slow, or the rate limit was exceeded."""

Reply = TypeVar("Reply", bound=Message)


class CoordinatorClient:
    """Client of one coordinator; thread-safe, as `httpx.Client` is.

    Args:
        server: Base URL, such as ``http://127.0.0.1:8700``.
        token: Bearer token, or None.
        transport: Replacement for the network, for tests.
        attempts: Attempts per request before `CoordinatorUnavailable` is raised, >= 1.
        backoff: Waits between attempts.
        pause: Function that sleeps for a number of seconds.
        rng: Source of the jitter.
    """

    def __init__(
        self,
        server: str,
        *,
        token: str | None = None,
        transport: httpx.BaseTransport | None = None,
        attempts: int = 4,
        backoff: Backoff | None = None,
        pause: Callable[[float], object] = time.sleep,
        rng: Random | None = None,
    ) -> None:
        self.server = server.rstrip("/")
        self._attempts = attempts
        self._backoff = backoff or Backoff(first_s=0.1, cap_s=1.0)
        self._pause = pause
        self._rng = rng or Random()
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        self._http = httpx.Client(
            base_url=self.server,
            headers=headers,
            transport=transport,
            limits=httpx.Limits(max_keepalive_connections=4, keepalive_expiry=120.0),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def lease(self, request: LeaseRequest) -> LeaseReply:
        """Lease jobs.

        Raises:
            CoordinatorUnavailable: The coordinator did not respond, or asked to retry later.
            RequestRefused: The coordinator refused the request.
            UnexpectedReply: The server does not speak this version of the wire protocol.
        """
        return self._post("lease", request, LeaseReply, wait_s=request.wait_s)

    def heartbeat(self, request: HeartbeatRequest) -> HeartbeatReply:
        """Renew leases; raises as `lease` does."""
        return self._post("heartbeat", request, HeartbeatReply)

    def report(self, request: ResultsRequest) -> ResultsReply:
        """Report outcomes, and lease the next jobs if the request asks for them.

        Raises:
            CoordinatorUnavailable: As `lease` does.
            RequestRefused: As `lease` does.
            UnexpectedReply: As `lease` does, and if the statuses do not match the results.
        """
        wait_s = 0.0 if request.lease is None else request.lease.wait_s
        reply = self._post("results", request, ResultsReply, wait_s=wait_s)
        if [status.job for status in reply.statuses] != [result.job for result in request.results]:
            raise UnexpectedReply(
                f"{self.server}: expected one status for each of {len(request.results)} results, in order"
            )
        return reply

    def _post(self, name: str, request: Message, reply_type: type[Reply], *, wait_s: float = 0.0) -> Reply:
        body = request.model_dump_json().encode()
        for failures in range(1, self._attempts + 1):
            try:
                return self._attempt(name, body, reply_type, wait_s)
            except CoordinatorUnavailable as error:
                pause_s = error.retry_after_s
                if pause_s is None:
                    pause_s = self._backoff.delay_s(failures, self._rng)
                # After a timeout the caller has already waited long enough to decide anew.
                timed_out = isinstance(error.__cause__, httpx.TimeoutException)
                if failures == self._attempts or timed_out or pause_s > LONGEST_RETRY_AFTER_S:
                    raise
            self._pause(pause_s)
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _attempt(self, name: str, body: bytes, reply_type: type[Reply], wait_s: float) -> Reply:
        timeout = httpx.Timeout(REPLY_TIMEOUT_S + wait_s, connect=CONNECT_TIMEOUT_S)
        try:
            response = self._http.post(f"{API_PATH}/{name}", content=body, timeout=timeout)
        except httpx.TransportError as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise CoordinatorUnavailable(f"{self.server}: no answer ({reason})") from error
        if response.status_code == httpx.codes.OK:
            return self._parse(response.content, reply_type)
        message = f"{self.server}: {name} returned {_explain(response)}"
        if response.status_code >= 500 or response.status_code in _RETRYABLE:
            raise CoordinatorUnavailable(
                message, retry_after_s=_retry_after_s(response), status=response.status_code
            )
        if response.status_code == httpx.codes.UNAUTHORIZED:
            words = no_token_words(self.server, given="Authorization" in self._http.headers, scope="worker")
            raise RequestRefused(words, status=response.status_code)
        if response.status_code >= 400:
            raise RequestRefused(message, status=response.status_code)
        raise UnexpectedReply(f"{message}; expected 200. Is this the address of a Brink coordinator?")

    def _parse(self, content: bytes, reply_type: type[Reply]) -> Reply:
        try:
            return reply_type.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"])
            raise UnexpectedReply(
                f"{self.server}: expected a {reply_type.__name__}: {place or 'body'}: {first['msg']}. "
                "Is this the address of a Brink coordinator of this version?"
            ) from error


def _explain(response: httpx.Response) -> str:
    """Return the status and the problem+json detail on one line."""
    try:
        problem = response.json()
    except (json.JSONDecodeError, UnicodeDecodeError):
        problem = None
    if isinstance(problem, dict):
        parts = [str(problem[key]) for key in ("title", "detail") if problem.get(key)]
        text = ": ".join(parts) or response.text
    else:
        text = response.text
    return f"{response.status_code} {' '.join(text.split())[:400] or response.reason_phrase}"


def _retry_after_s(response: httpx.Response) -> float | None:
    """Return the seconds of Retry-After, or None if the header is absent, malformed, or a date."""
    try:
        seconds = float(response.headers["Retry-After"])
    except (KeyError, ValueError):
        return None
    return seconds if math.isfinite(seconds) and seconds >= 0 else None
