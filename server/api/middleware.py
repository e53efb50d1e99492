"""Middleware in front of every request: who may do what, how often and how much, and how long it took."""

import asyncio
import logging
import math
import re
import secrets
import time
from typing import Final

from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from brink.server.access.gate import Gate
from brink.server.access.tokens import allows
from brink.server.api.context import CALLER
from brink.server.api.problem_details import problem
from brink.server.api.service import FOLDER as DOCS_FOLDER
from brink.server.dashboard import page
from brink.server.metrics import Metrics
from brink.server.settings import LOOPBACK
from brink.worker.log import log_fields

OPEN_PATHS = ("/", "/healthz", "/readyz", "/docs", "/openapi.json")
"""What says nothing of any campaign: whether the coordinator lives, what its API is, a page that asks for a token."""
OPEN_FOLDERS = (f"{DOCS_FOLDER}/", f"{page.FOLDER}/")
SLOWEST_BYTES_PER_S = 10_000.0
"""What a body that takes longer than a stall must come with on the whole."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
}
"""Of every answer. There are none for other origins: no page of another one may read anything."""
_DOCS_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "frame-ancestors 'none'"
)
"""The page of the API is another's, and starts itself by a script within."""

log = logging.getLogger(__name__)


class AccessMiddleware:
    """Refuses who may not, and bodies past the bound, before anything reads them."""

    def __init__(self, app: ASGIApp, gate: Gate | None, max_body_bytes: int, stall_s: float) -> None:
        self._app = app
        self._gate = gate
        self._max_body_bytes = max_body_bytes
        self._stall_s = stall_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        policy = _DOCS_POLICY if scope["path"] == "/docs" else None

        async def safer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if policy is not None:
                    headers["Content-Security-Policy"] = policy
            await send(message)

        refusal = _unheard_of(scope)
        if refusal is None and not _is_open(scope["path"]):
            refusal = await self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, safer)
            return
        await self._bounded(scope, receive, safer)

    async def _refusal(self, scope: Scope) -> Response | None:
        """Return the answer to a request that may not be served, or None."""
        if self._gate is None:
            return None
        try:
            if not await self._gate.closed():
                return from_elsewhere(scope)
            given = Headers(scope=scope).get("authorization", "")
            caller = await self._gate.caller(given.encode("latin-1"))
        except SQLAlchemyError as error:
            log.warning("tokens cannot be read: %s", error)
            return problem(503, "Unavailable", "tokens cannot be read from the database now; try again")
        if caller is None:
            address = scope["client"][0] if scope.get("client") else "unknown"
            if wait_s := self._gate.stranger_wait_s(address):
                return _too_many(wait_s)
            return problem(
                401,
                "Unauthorised",
                "expected the header 'Authorization: Bearer TOKEN' with a token of this coordinator that holds",
                headers={"WWW-Authenticate": "Bearer"},
            )
        if wait_s := self._gate.wait_s(caller):
            return _too_many(wait_s)
        scope[CALLER] = caller
        if not allows(caller.scope, scope["method"], scope["path"]):
            return problem(
                403, "Forbidden",
                f"this token's scope is {caller.scope}; expected one that covers {scope['method']} {scope['path']}",
            )  # fmt: skip
        return None

    async def _bounded(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {name.lower(): value for name, value in scope["headers"]}
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > self._max_body_bytes:
            await self._too_large(scope, receive, send)
            return
        body = _Bounded(receive, self._max_body_bytes, self._stall_s)

        async def answer(message: Message) -> None:
            if not (body.exceeded or body.late):
                await send(message)

        await self._app(scope, body.receive, answer)
        if body.exceeded:
            await self._too_large(scope, receive, send)
        elif body.late:
            await problem(
                408, "Request timeout", "expected the whole body sooner", headers={"Connection": "close"}
            )(scope, receive, send)

    async def _too_large(self, scope: Scope, receive: Receive, send: Send) -> None:
        await problem(413, "Body too large", f"expected at most {self._max_body_bytes} bytes")(
            scope, receive, send
        )


def _unheard_of(scope: Scope) -> Response | None:
    """Refuse a path with control characters: a route may match one that ends in a line feed, a scope would not."""
    if scope["path"].isprintable():
        return None
    return problem(404, "Not found", "expected a path of printable characters")


def _too_many(wait_s: float) -> Response:
    return problem(
        429, "Too many requests", "expected fewer requests a second",
        headers={"Retry-After": str(max(1, math.ceil(wait_s)))},
    )  # fmt: skip


def _is_open(path: str) -> bool:
    return path in OPEN_PATHS or path.startswith(OPEN_FOLDERS)


class _Bounded:
    """A body that ends at the bound, or when it takes too long to come, as if the client had gone."""

    def __init__(self, receive: Receive, max_bytes: int, stall_s: float) -> None:
        self._receive = receive
        self._max_bytes = max_bytes
        self._come = 0
        self._ended = False
        self._began_s = time.monotonic()
        self._stall_s = stall_s
        self.late = False
        """Whether it took too long."""

    @property
    def exceeded(self) -> bool:
        """Whether the body went past the bound."""
        return self._come > self._max_bytes

    async def receive(self) -> Message:
        """Return the next part of the request; after its last one, wait for the client to go."""
        if self._ended:
            return await self._receive()
        due_s = self._began_s + self._stall_s + self._come / SLOWEST_BYTES_PER_S
        try:
            async with asyncio.timeout(max(0.0, due_s - time.monotonic())):
                message = await self._receive()
        except TimeoutError:
            self.late = True
            return {"type": "http.disconnect"}
        self._come += len(message.get("body", b""))
        self._ended = not message.get("more_body", False)
        return {"type": "http.disconnect"} if self.exceeded else message


_READS: Final = frozenset({"GET", "HEAD"})
_OWN_SITE: Final = frozenset({"same-origin", "none"})


def from_elsewhere(scope: Scope) -> Response | None:
    """Return the refusal of a request that another site's page had a browser make, or None."""
    headers = Headers(scope=scope)
    host = headers.get("host", "").lower()
    if _name(host) not in LOOPBACK:
        return problem(
            421, "Misdirected request",
            "expected a name of this machine, such as 127.0.0.1 or localhost; a coordinator without tokens serves "
            "under no other",
        )  # fmt: skip
    origin = headers.get("origin")
    foreign = origin is not None and origin.partition("://")[2].lower() != host
    fetched = headers.get("sec-fetch-site", "none") not in _OWN_SITE
    opened = headers.get("sec-fetch-mode") == "navigate"
    if (foreign and scope["method"] not in _READS) or (fetched and not opened):
        return problem(
            403, "Forbidden", "expected no request for a page of another site; make a token for that"
        )
    return None


def _name(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


REQUEST_ID: Final = b"x-request-id"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_PLAIN_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


class MetricsMiddleware:
    """Measures what happens within.

    Every request has an id: that of its ``X-Request-ID`` if it looks like one, such as a proxy gives, else one of
    its own. The answer carries it, and so does whatever is logged meanwhile. Headers, queries and bodies are never
    logged.

    Args:
        app: What happens within.
        metrics: Where times are counted.
        access_log: Whether requests are logged as what happened (INFO), not as a detail (DEBUG).
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, *, access_log: bool = False) -> None:
        self._app = app
        self._metrics = metrics
        self._level = logging.INFO if access_log else logging.DEBUG

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), 0
        request_id = _request_id(scope)

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                named = (REQUEST_ID, request_id.encode())
                message = {**message, "headers": [*message.get("headers", ()), named]}
            await send(message)

        with log_fields(request=request_id):
            try:
                await self._app(scope, receive, noted)
            finally:
                method = scope["method"] if scope["method"] in _METHODS else "other"
                # Not the path: it has ids in it, and strangers could make up any number of them.
                route = getattr(scope.get("route"), "path", "none")
                taken_s = time.perf_counter() - began
                self._metrics.requests.labels(method, route, f"{status // 100}xx").observe(taken_s)
                if log.isEnabledFor(self._level):
                    fields = {"method": method, "route": route, "status": status, **_ids(scope)}
                    log.log(self._level, "request", extra={**fields, "duration_ms": round(1000 * taken_s, 1)})


def _request_id(scope: Scope) -> str:
    given: bytes = next((value for name, value in scope["headers"] if name == REQUEST_ID), b"")
    return given.decode() if _PLAIN_ID.fullmatch(given) else secrets.token_hex(8)


def _ids(scope: Scope) -> dict[str, object]:
    """Return which campaign and job a path names."""
    named = scope.get("path_params", {})
    return {
        field: named[parameter]
        for parameter, field in (("campaign_id", "campaign"), ("job", "job"))
        if parameter in named
    }
