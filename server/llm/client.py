"""A client of one OpenAI-compatible endpoint: asks, tries again while that makes sense, learns which form it takes.

Replies are bounded in size and time. The key is read from the environment for each request and kept nowhere; what the
endpoint says is cleared of it before anybody sees it.
"""

import asyncio
import itertools
import json
import logging
import os
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from random import Random
from types import TracebackType
from typing import Final, Self

import httpx

from brink.server.llm.errors import Effort, EndpointAway, LlmError, UnusableReply
from brink.server.llm.faults import fault, refuses_form, status_within
from brink.server.llm.settings import LlmSettings, api_key
from brink.server.llm.wire import (
    JsonObject,
    Messages,
    Mode,
    Reply,
    Usage,
    clean,
    listed_models,
    read_reply,
    request_body,
)
from brink.worker.backoff import Backoff

MOST_REPLY_BYTES: Final = 4 * 1024 * 1024
CONNECT_TIMEOUT_S: Final = 10.0
SHORTEST_SECRET: Final = 8
"""Shorter keys are placeholders that local servers want, such as ``none``; they are not searched for in replies."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Completion:
    """An answer.

    Attributes:
        text: The content.
        finish_reason: Why the model stopped, or None if the endpoint does not say.
        usage: Tokens, or None if the endpoint does not say.
        refusal: Whether the model, or a filter, declined.
        truncated: Whether the model ran into the limit of tokens.
        latency_s: From the answered request to the end of its answer.
        mode: How the form of the reply was asked for.
        attempts: Requests sent, those that were refused or lost included.
        lost: Requests that the endpoint may have worked on, and billed, without an answer that came.
        raw: The body as it came, but for the key.
    """

    text: str
    finish_reason: str | None
    usage: Usage | None
    refusal: bool
    truncated: bool
    latency_s: float
    mode: Mode
    attempts: int
    lost: int
    raw: str = field(repr=False)


@dataclass(slots=True)
class _Trail:
    """What a call took so far. Changes in place."""

    requests: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class _Answer:
    """An HTTP answer, bounded and cleared of the key; an error inside counts as its status."""

    status: int
    headers: httpx.Headers
    raw: str
    latency_s: float


class _FormRefused(Exception):
    """The endpoint refuses the form of the reply that was asked for."""

    def __init__(self, error: LlmError) -> None:
        super().__init__(str(error))
        self.error = error


MaySend = Callable[[int], None]
"""Is told before each request how many were lost so far, and raises OverBudget if no other may follow."""


def _always(lost: int) -> None:
    """Let every request pass."""


class LlmClient:
    """Speaks to one endpoint, within one event loop.

    Args:
        settings: Which endpoint, which model, how long to try.
        environ: Where the key is; the environment of this process if None.
        transport: Replaces the network.
        mode: The form to try first, such as the one that an earlier client found.
        backoff: Waits between tries, where the endpoint names no time.
        pause: Waits for so many seconds.
        rng: Spreads the waits.
        clock: Seconds that only grow.
        now: The date, to which a Retry-After refers.
    """

    def __init__(
        self,
        settings: LlmSettings,
        *,
        environ: Mapping[str, str] | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        mode: Mode = Mode.JSON_SCHEMA,
        backoff: Backoff | None = None,
        pause: Callable[[float], Awaitable[object]] = asyncio.sleep,
        rng: Random | None = None,
        clock: Callable[[], float] = time.monotonic,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.settings = settings
        self._environ = os.environ if environ is None else environ
        self._mode = mode
        self._proven = False
        self._backoff = backoff or Backoff(first_s=1.0, cap_s=30.0)
        self._pause = pause
        self._rng = rng or Random()
        self._clock = clock
        self._now = now
        # Identity: what is unpacked has no bound that could be kept while it is read.
        self._http = httpx.AsyncClient(
            headers={"Accept": "application/json", "Accept-Encoding": "identity"},
            transport=transport,
            timeout=httpx.Timeout(settings.timeout_s, connect=min(CONNECT_TIMEOUT_S, settings.timeout_s)),
            trust_env=not settings.on_this_machine,
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    @property
    def mode(self) -> Mode:
        """The strictest form of a reply that the endpoint is known, or still hoped, to take."""
        return self._mode

    async def complete(
        self,
        messages: Messages,
        schema: JsonObject,
        *,
        mode: Mode | None = None,
        may_send: MaySend = _always,
    ) -> Completion:
        """Ask.

        Args:
            messages: The prompt; it must say the form of the reply too.
            schema: JSON schema of the reply.
            mode: The only form to try; by default the one that works, looser ones after it.
            may_send: Asked before each request.

        Raises:
            EndpointAway: All tries failed, or it asked for a longer pause than allowed.
            LlmFinal: The same call would fail again; the kind of error says why.
            OverBudget: ``may_send`` raised it.
        """
        api_key(self.settings, self._environ)
        began, trail = self._clock(), _Trail()
        try:
            return await self._complete(messages, schema, mode, may_send, trail)
        except LlmError as error:
            elapsed_s = self._clock() - began
            error.effort = Effort(requests=trail.requests, lost=trail.lost, elapsed_s=elapsed_s)
            raise

    async def models(self) -> tuple[str, ...] | None:
        """Return the models that the endpoint lists, or None if it has no list.

        Raises:
            EndpointAway: It does not answer.
            LlmFinal: It refuses.
        """
        answer = await self._exchange("GET", "/models", None)
        if answer.status in (404, 405, 501):
            return None
        if not httpx.codes.is_success(answer.status):
            raise self._fault(answer)
        return listed_models(answer.raw)

    async def _complete(
        self, messages: Messages, schema: JsonObject, only: Mode | None, may_send: MaySend, trail: _Trail
    ) -> Completion:
        mode = only or self._mode
        while True:
            body = request_body(self.settings, messages, mode, schema)
            try:
                answer = await self._answered(body, mode, may_send, trail)
            except _FormRefused as refused:
                looser = mode.looser if only is None else None
                if looser is None:
                    raise refused.error from None
                _LOG.info("%s takes no %s; trying %s", self.settings.endpoint, mode, looser)
                mode = looser
                continue
            reply = self._read(answer, trail)
            if only is None:
                self._mode, self._proven = mode, True
            return _completion(reply, answer, mode, trail)

    def _read(self, answer: _Answer, trail: _Trail) -> Reply:
        try:
            return read_reply(answer.raw)
        except UnusableReply:
            trail.lost += 1
            raise

    async def _answered(self, body: JsonObject, mode: Mode, may_send: MaySend, trail: _Trail) -> _Answer:
        """Return the first answer that is none to try again."""
        for failures in itertools.count(1):
            may_send(trail.lost)
            trail.requests += 1
            try:
                return await self._attempt(body, mode, trail)
            except EndpointAway as away:
                pause_s = self._pause_after(away, failures)
                _LOG.info("language model: %s; trying again in %.1f s", away, pause_s)
            await self._pause(pause_s)
        raise AssertionError("unreachable: the count does not end")

    def _pause_after(self, away: EndpointAway, failures: int) -> float:
        """Return how long to wait, or raise what says that there is nothing to wait for."""
        limit_s = self.settings.max_wait_s
        if failures > self.settings.retries:
            tries = "1 try" if failures == 1 else f"{failures} tries"
            raise EndpointAway(f"{away}; gave up after {tries}") from away
        asked_s = away.retry_after_s
        if asked_s is not None and asked_s > limit_s:
            raise EndpointAway(
                f"{away}; it asks for a pause of {asked_s:.0f} s, longer than max_wait_s ({limit_s:g} s)"
            ) from away
        return asked_s or min(self._backoff.delay_s(failures, self._rng), limit_s)

    async def _attempt(self, body: JsonObject, mode: Mode, trail: _Trail) -> _Answer:
        try:
            answer = await self._exchange("POST", "/chat/completions", body)
        except EndpointAway as away:
            trail.lost += away.lost
            raise
        except UnusableReply:
            trail.lost += 1
            raise
        if httpx.codes.is_success(answer.status):
            return answer
        error = self._fault(answer)
        proven = self._proven and mode is self._mode
        if mode is not Mode.PLAIN and refuses_form(answer.status, answer.raw, proven=proven):
            raise _FormRefused(error)
        raise error

    def _fault(self, answer: _Answer) -> LlmError:
        return fault(answer.status, answer.headers, answer.raw, self.settings, self._now())

    async def _exchange(self, method: str, path: str, body: JsonObject | None) -> _Answer:
        """Send one request and read its answer, in bounded time and space."""
        settings = self.settings
        key = api_key(settings, self._environ)
        secret = key.get_secret_value() if key is not None else ""
        headers = {"Authorization": f"Bearer {secret}"} if secret else {}
        secrets = [secret] if len(secret) >= SHORTEST_SECRET else []
        content = None
        if body is not None:
            headers["Content-Type"] = "application/json"
            content = json.dumps(body).encode()
        request = self._http.build_request(method, settings.endpoint + path, content=content, headers=headers)
        began = self._clock()
        try:
            async with asyncio.timeout(settings.timeout_s):
                response = await self._http.send(request, stream=True)
                try:
                    raw = clean(await _bounded_body(response), secrets)
                finally:
                    await response.aclose()
        except (TimeoutError, httpx.TimeoutException) as error:
            lost = not isinstance(error, httpx.ConnectTimeout | httpx.PoolTimeout)
            raise EndpointAway(
                f"{settings.endpoint}: no answer within {settings.timeout_s:g} s", lost=lost
            ) from None
        except httpx.TransportError as error:
            reason = clean(str(error).encode(), secrets) or type(error).__name__
            lost = not isinstance(error, httpx.ConnectError)
            raise EndpointAway(f"{settings.endpoint}: no answer ({reason})", lost=lost) from None
        status = response.status_code
        if httpx.codes.is_success(status):
            status = status_within(raw) or status
        return _Answer(status, response.headers, raw, self._clock() - began)


async def _bounded_body(response: httpx.Response) -> bytes:
    if response.headers.get("Content-Encoding", "identity") != "identity":
        raise UnusableReply("expected an answer as it is, got a packed one")
    body = bytearray()
    async for chunk in response.aiter_raw():
        body += chunk
        if len(body) > MOST_REPLY_BYTES:
            raise UnusableReply(f"expected an answer of at most {MOST_REPLY_BYTES} bytes, got a longer one")
    return bytes(body)


def _completion(reply: Reply, answer: _Answer, mode: Mode, trail: _Trail) -> Completion:
    return Completion(
        text=reply.text,
        finish_reason=reply.finish_reason,
        usage=reply.usage,
        refusal=reply.refusal,
        truncated=reply.cut_short,
        latency_s=answer.latency_s,
        mode=mode,
        attempts=trail.requests,
        lost=trail.lost,
        raw=answer.raw,
    )
