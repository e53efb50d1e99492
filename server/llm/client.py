"""A client of one OpenAI-compatible endpoint: sends prompts, retries, and finds a reply format that works.

Replies are bounded in size and time. `LlmAccess` says for each request whether it may be sent, and with which key.
The key is never stored, never sent along a redirect, and removed from everything that the endpoint returns.
"""

import asyncio
import itertools
import logging
import math
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from random import Random
from typing import Final

import httpx

from brink.server.llm.access import LlmAccess
from brink.server.llm.protocol import (
    EndpointUnavailable,
    JsonObject,
    LlmError,
    Messages,
    OverBudget,
    Reply,
    UnusableReply,
    embedded_status,
    error_from,
    parse_models,
    read_reply,
    rejects_form,
    request_body,
    sanitize,
)
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import Mode
from brink.worker.backoff import Backoff

MAX_REPLY_BYTES: Final = 4 * 1024 * 1024
CONNECT_TIMEOUT_S: Final = 10.0
SHORTEST_TRY_S: Final = 1.0
"""With less time left than this, no try is begun; sooner if the limits themselves are as short."""
MIN_SECRET_CHARS: Final = 8
"""Shorter keys are placeholders for local servers, such as ``none``; they are not removed from replies."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Answer:
    """An HTTP response of bounded size, without the key; the status of an embedded error replaces its own."""

    status: int
    headers: httpx.Headers
    raw: str


@dataclass(slots=True, kw_only=True)
class Call:
    """The limits and the progress of a call. Mutable.

    Attributes:
        tries: Maximum number of tries with one form of the reply.
        deadline_s: Time on the client's clock at which the call is given up, whatever it is waiting for.
        requests: HTTP requests sent, including those that were rejected or lost.
        lost: Those of them that the endpoint may have processed and billed without delivering a usable reply.
        failures: What happened to the requests after which another one could be tried, oldest first.
        latency_s: Time from sending the last request to the end of its response.
    """

    tries: int = 1
    deadline_s: float = math.inf
    requests: int = 0
    lost: int = 0
    failures: list[str] = field(default_factory=list)
    latency_s: float = 0.0

    def before_request(self) -> None:
        """Called before each request.

        Raises:
            OverBudget: The request must not be sent.
        """

    @property
    def words(self) -> str:
        """The failures in words, such as ``HTTP 500 (2 tries), then timed out after 25 s (1 try)``."""
        runs = [(what, len(list(same))) for what, same in itertools.groupby(self.failures)]
        return ", then ".join(f"{what} ({count} {'try' if count == 1 else 'tries'})" for what, count in runs)


def looser(mode: Mode) -> Mode:
    """Return the next mode to try after a mode other than the last."""
    modes = list(Mode)
    return modes[modes.index(mode) + 1]


class LlmClient(AbstractAsyncContextManager["LlmClient", None]):
    """A client of one endpoint, for use in one event loop.

    Args:
        settings: Endpoint, model, and retry limits.
        access: Decides whether the endpoint may be used, and has the key.
        transport: HTTP transport; the network if None.
        mode: The form to try first, such as the one that an earlier client found.
        backoff: Pauses between tries, unless the endpoint requests one.
        pause: Sleeps for a number of seconds.
        rng: Adds jitter to the pauses.
        clock: Monotonic clock, in seconds.
        now: Returns the current time, to which a Retry-After date is relative.

    Attributes:
        mode: The strictest form of the reply that the endpoint has not rejected.
    """

    def __init__(
        self,
        settings: LlmSettings,
        *,
        access: LlmAccess,
        transport: httpx.AsyncBaseTransport | None = None,
        mode: Mode = Mode.JSON_SCHEMA,
        backoff: Backoff | None = None,
        pause: Callable[[float], Awaitable[object]] = asyncio.sleep,
        rng: Random | None = None,
        clock: Callable[[], float] = time.monotonic,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.settings = settings
        self._access = access
        self.mode = mode
        self._proven = False
        self._backoff = backoff or Backoff(first_s=1.0, cap_s=30.0)
        self._pause = pause
        self._rng = rng or Random()
        self.clock = clock
        self._now = now
        self._shortest_try_s = min(SHORTEST_TRY_S, settings.timeout_s, 0.1 * settings.delay_limit_s)
        self._time_is_up = f"the time for this request is up (max_delay_s, {settings.delay_limit_s:g} s)"
        # Compressed bodies are not accepted: the size limit could not be enforced while reading them.
        self._http = httpx.AsyncClient(
            headers={"Accept": "application/json", "Accept-Encoding": "identity"},
            transport=transport,
            follow_redirects=False,
            timeout=httpx.Timeout(settings.timeout_s, connect=min(CONNECT_TIMEOUT_S, settings.timeout_s)),
            trust_env=not settings.on_this_machine,
        )

    async def __aexit__(self, *raised: object) -> None:
        await self._http.aclose()

    async def complete(
        self, messages: Messages, schema: JsonObject, call: Call, *, only: Mode | None = None
    ) -> Reply:
        """Send a prompt until it succeeds or fails for good, with looser forms where one is rejected.

        Args:
            messages: The prompt, which must also describe the form of the reply.
            schema: JSON schema of the reply.
            call: Limits of the call; the requests are counted there.
            only: The only form to try; by default `mode`, then looser ones.

        Raises:
            EndpointUnavailable: A try failed, and no other is left or allowed; the message says why.
            OverBudget: The budget, or the time left, does not allow any try.
            LlmError: Repeating the call would fail again; the subclass gives the reason.
        """
        self._access.key(self.settings)
        mode, failures, detail = only or self.mode, 0, ""
        while True:
            limit_s = self._time_for_a_try(call, detail)
            body = request_body(self.settings, messages, mode, schema)
            call.requests += 1
            began = self.clock()
            try:
                answer = await self._exchange("POST", "/chat/completions", body, limit_s)
                if only is None and self._rejects(mode, answer):
                    call.failures.append(f"{mode} refused")
                    mode, failures, detail = looser(mode), 0, ""
                    _LOG.info("%s does not accept this form; trying %s", self.settings.endpoint, mode)
                    continue
                call.latency_s = self.clock() - began
                reply = read_reply(self._successful(answer).raw)
            except EndpointUnavailable as error:
                call.lost += error.lost
                call.failures.append(error.what)
                failures, detail = failures + 1, error.detail
                pause_s = self._pause_after(error, failures, call)
                _LOG.info("language model: %s; trying again in %.1f s", error, pause_s)
            except LlmError as error:
                call.lost += error.lost
                raise
            else:
                if only is None:
                    self.mode, self._proven = mode, True
                return reply
            await self._pause(pause_s)

    async def models(self) -> tuple[str, ...] | None:
        """Return the models that the endpoint lists, or None if it has no list.

        Raises:
            LlmError: It does not respond, or rejects the request.
        """
        answer = await self._exchange("GET", "/models", None, self.settings.timeout_s)
        if answer.status in (404, 405, 501):
            return None
        return parse_models(self._successful(answer).raw)

    def _rejects(self, mode: Mode, answer: _Answer) -> bool:
        """Return whether the endpoint rejects the requested form of the reply."""
        if mode is Mode.PLAIN or httpx.codes.is_success(answer.status):
            return False
        return rejects_form(answer.status, answer.raw, proven=self._proven and mode is self.mode)

    def _successful(self, answer: _Answer) -> _Answer:
        """Return an answer if it is successful.

        Raises:
            LlmError: It is not.
        """
        if httpx.codes.is_success(answer.status):
            return answer
        raise error_from(answer.status, answer.headers, answer.raw, self.settings, self._now())

    def _gave_up(self, call: Call, detail: str, reason: str) -> EndpointUnavailable:
        """Return the error of a call that is given up after failed tries."""
        what = f"{call.words}: {detail}" if detail else call.words
        return EndpointUnavailable(self.settings.endpoint, f"{what}; {reason}" if reason else what)

    def _time_for_a_try(self, call: Call, detail: str) -> float:
        """Return the maximum duration of the next try, in seconds.

        Args:
            call: The call.
            detail: What the endpoint said about the last try.

        Raises:
            OverBudget: The budget, or the time left, does not allow any try.
            EndpointUnavailable: It allows no other try.
        """
        left_s = call.deadline_s - self.clock()
        try:
            self._check_time(left_s)
            call.before_request()
        except OverBudget as error:
            if not call.failures:
                raise
            raise self._gave_up(call, detail, f"no other try: {error}") from error
        return min(self.settings.timeout_s, left_s)

    def _check_time(self, left_s: float) -> None:
        if left_s < self._shortest_try_s:
            raise OverBudget(self._time_is_up)

    def _pause_after(self, error: EndpointUnavailable, failures: int, call: Call) -> float:
        """Return the pause before the next try, in seconds.

        Raises:
            EndpointUnavailable: No other try is allowed; the message says what happened, and why.
        """
        settings, asked_s = self.settings, error.retry_after_s
        pause_s = asked_s or min(self._backoff.delay_s(failures, self._rng), settings.max_wait_s)
        if failures >= call.tries:
            reason = ""
        elif asked_s is not None and asked_s > settings.max_wait_s:
            reason = (
                f"it asks for a pause of {asked_s:.0f} s, longer than max_wait_s ({settings.max_wait_s:g} s)"
            )
        elif self.clock() + pause_s + self._shortest_try_s > call.deadline_s:
            asks = f"it asks for a pause of {asked_s:.0f} s, but " if asked_s else ""
            reason = f"{asks}{self._time_is_up}"
        else:
            return pause_s
        raise self._gave_up(call, error.detail, reason) from error

    async def _exchange(self, method: str, path: str, body: JsonObject | None, limit_s: float) -> _Answer:
        """Send one request and read the response, within the limits of time and size."""
        settings = self.settings
        key = self._access.key(settings)
        secret = key.get_secret_value() if key is not None else ""
        headers = {"Authorization": f"Bearer {secret}"} if secret else {}
        secrets = [secret] if len(secret) >= MIN_SECRET_CHARS else []
        sending = self._http.stream(method, settings.endpoint + path, json=body, headers=headers)
        try:
            async with asyncio.timeout(limit_s), sending as response:
                raw = sanitize(await _bounded_body(response), secrets)
        except (TimeoutError, httpx.TimeoutException) as error:
            lost = not isinstance(error, httpx.ConnectTimeout | httpx.PoolTimeout)
            waited_s = limit_s if lost else min(CONNECT_TIMEOUT_S, limit_s)
            what = f"{'timed out' if lost else 'no connection'} after {round(waited_s, 2):g} s"
            raise EndpointUnavailable(settings.endpoint, what, lost=lost) from None
        except httpx.TransportError as error:
            reason = sanitize(str(error).encode(), secrets) or type(error).__name__
            lost = not isinstance(error, httpx.ConnectError)
            what = "connection broken" if lost else "no connection"
            raise EndpointUnavailable(settings.endpoint, what, reason, lost=lost) from None
        status = response.status_code
        if httpx.codes.is_success(status):
            status = embedded_status(raw) or status
        return _Answer(status, response.headers, raw)


async def _bounded_body(response: httpx.Response) -> bytes:
    if response.headers.get("Content-Encoding", "identity") != "identity":
        raise UnusableReply("expected an uncompressed response, got a compressed one")
    body = bytearray()
    async for chunk in response.aiter_raw():
        body += chunk
        if len(body) > MAX_REPLY_BYTES:
            raise UnusableReply(f"expected a response of at most {MAX_REPLY_BYTES} bytes, got a longer one")
    return bytes(body)
