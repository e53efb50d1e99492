"""Middleware for every request: authentication, rate and size limits, security headers, metrics, access log."""

import itertools
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

from brink.server.access.authentication import Authenticator
from brink.server.access.tokens import allows
from brink.server.api.body_limits import BodyLimit, LimitedBody, body_limit
from brink.server.api.context import CALLER
from brink.server.api.problem_details import problem
from brink.server.api.service import FOLDER as DOCS_FOLDER
from brink.server.dashboard import page
from brink.server.metrics import Metrics
from brink.server.settings import LOOPBACK
from brink.worker.log import log_fields

OPEN_PATHS = ("/", "/healthz", "/readyz", "/docs", "/openapi.json")
"""Paths that need no token, since they reveal nothing about campaigns."""
OPEN_FOLDERS = (f"{DOCS_FOLDER}/", f"{page.FOLDER}/")

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
}
"""Headers of every response. There are no CORS headers: pages from other origins may not read anything."""
_DOCS_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "frame-ancestors 'none'"
)
"""Policy for Swagger UI, which starts with an inline script."""

log = logging.getLogger(__name__)


class AccessMiddleware:
    """Authenticates requests, limits their rate and size, and sets security headers.

    Args:
        app: The inner application.
        authenticator: Checks tokens and rates; with None, everyone is served.
        max_body_bytes: Largest accepted body of any path; see `brink.server.api.body_limits`.
        stall_s: How long a body may take to arrive, unless it is large.
    """

    def __init__(
        self, app: ASGIApp, authenticator: Authenticator | None, max_body_bytes: int, stall_s: float
    ) -> None:
        self._app = app
        self._authenticator = authenticator
        self._max_body_bytes = max_body_bytes
        self._stall_s = stall_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        policy = _DOCS_POLICY if scope["path"] == "/docs" else None

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if policy is not None:
                    headers["Content-Security-Policy"] = policy
            await send(message)

        refusal = _unprintable_path(scope)
        if refusal is None and not _is_open(scope["path"]):
            refusal = await self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, send_with_headers)
            return
        await self._serve_limited(scope, receive, send_with_headers)

    async def _refusal(self, scope: Scope) -> Response | None:
        """Return the response that rejects a request, or None if it may be served."""
        if self._authenticator is None:
            return None
        try:
            if not await self._authenticator.requires_token():
                return cross_site_refusal(scope)
            given = Headers(scope=scope).get("authorization", "")
            caller = await self._authenticator.caller(given.encode("latin-1"))
        except SQLAlchemyError as error:
            log.warning("cannot read tokens: %s", error)
            return problem(
                503, "Unavailable", "the database is unavailable, so tokens cannot be checked; try again"
            )
        if caller is None:
            address = scope["client"][0] if scope.get("client") else "unknown"
            if wait_s := self._authenticator.unauthenticated_wait_s(address):
                return _rate_limited(wait_s)
            return problem(
                401,
                "Unauthorised",
                "expected the header 'Authorization: Bearer TOKEN' with a valid token of this coordinator",
                headers={"WWW-Authenticate": "Bearer"},
            )
        if wait_s := self._authenticator.wait_s(caller):
            return _rate_limited(wait_s)
        scope[CALLER] = caller
        if not allows(caller.scope, scope["method"], scope["path"]):
            return problem(
                403,
                "Forbidden",
                f"this token's scope is {caller.scope}, which does not allow {scope['method']} {scope['path']}",
            )
        return None

    async def _serve_limited(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {name.lower(): value for name, value in scope["headers"]}
        length = headers.get(b"content-length", b"0")
        limit = body_limit(scope["path"], self._max_body_bytes)
        if not length.isdigit() or int(length) > limit.max_bytes:
            await _too_large(limit)(scope, receive, send)
            return
        body = LimitedBody(receive, limit, self._stall_s)

        started = False

        async def send_unless_cut(message: Message) -> None:
            nonlocal started
            started = started or not (body.exceeded or body.late)
            if started:
                await send(message)

        await self._app(scope, body.receive, send_unless_cut)
        if started:
            return
        if body.exceeded:
            await _too_large(limit)(scope, receive, send)
        elif body.late:
            await problem(
                408, "Request timeout", "the body took too long to arrive", headers={"Connection": "close"}
            )(scope, receive, send)


def _unprintable_path(scope: Scope) -> Response | None:
    """Reject a path with control characters: routes may match a trailing line feed, but scope checks do not."""
    if scope["path"].isprintable():
        return None
    return problem(404, "Not found", "expected only printable characters in the path")


def _too_large(limit: BodyLimit) -> Response:
    return problem(413, "Body too large", limit.words())


def _rate_limited(wait_s: float) -> Response:
    return problem(
        429,
        "Too many requests",
        "rate limit exceeded; see the header Retry-After",
        headers={"Retry-After": str(max(1, math.ceil(wait_s)))},
    )


def _is_open(path: str) -> bool:
    return path in OPEN_PATHS or path.startswith(OPEN_FOLDERS)


_READS: Final = frozenset({"GET", "HEAD"})
_OWN_SITE: Final = frozenset({"same-origin", "none"})


def cross_site_refusal(scope: Scope) -> Response | None:
    """Return the response that rejects a browser's request on behalf of another site, or None."""
    headers = Headers(scope=scope)
    host = headers.get("host", "").lower()
    if _host_name(host) not in LOOPBACK:
        return problem(
            421,
            "Misdirected request",
            "expected a loopback host name such as 127.0.0.1 or localhost; a coordinator without tokens accepts no "
            "other",
        )
    origin = headers.get("origin")
    foreign = origin is not None and origin.partition("://")[2].lower() != host
    fetched = headers.get("sec-fetch-site", "none") not in _OWN_SITE
    reads = scope["method"] in _READS  # which change nothing
    followed = reads and headers.get("sec-fetch-mode") == "navigate"
    if (foreign and not reads) or (fetched and not followed):
        return problem(403, "Forbidden", "cross-site requests are not allowed without a token")
    return None


def _host_name(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


REQUEST_ID: Final = b"x-request-id"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_PLAIN_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


class MetricsMiddleware:
    """Measures and logs requests, and gives each an id.

    The id is taken from a well-formed ``X-Request-ID``, which a proxy may set, or generated. The response carries it,
    and so do all log records of the request. Headers, queries and bodies are never logged.

    Args:
        app: The inner application.
        metrics: Where durations are recorded.
        access_log: Whether requests are logged at INFO instead of DEBUG.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, *, access_log: bool = False) -> None:
        self._app = app
        self._metrics = metrics
        self._level = logging.INFO if access_log else logging.DEBUG
        # Counted, because reading random bytes for every request would each time let another thread go first.
        self._series, self._numbers = secrets.token_hex(4), itertools.count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), 0
        request_id = _given_id(scope) or f"{self._series}{next(self._numbers) % 2**32:08x}"

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                named = (REQUEST_ID, request_id.encode())
                message = {**message, "headers": [*message.get("headers", ()), named]}
            await send(message)

        with log_fields(request=request_id):
            try:
                await self._app(scope, receive, send_with_id)
            finally:
                method = scope["method"] if scope["method"] in _METHODS else "other"
                # Not the path: it contains ids, so clients could create any number of label values.
                route = getattr(scope.get("route"), "path", "none")
                taken_s = time.perf_counter() - began
                self._metrics.requests.labels(method, route, f"{status // 100}xx").observe(taken_s)
                if log.isEnabledFor(self._level):
                    fields = {"method": method, "route": route, "status": status, **_ids(scope)}
                    log.log(self._level, "request", extra={**fields, "duration_ms": round(1000 * taken_s, 1)})


def _given_id(scope: Scope) -> str:
    """Return the well-formed id that a request carries, or an empty string."""
    given: bytes = next((value for name, value in scope["headers"] if name == REQUEST_ID), b"")
    return given.decode() if _PLAIN_ID.fullmatch(given) else ""


def _ids(scope: Scope) -> dict[str, object]:
    """Return the log fields for the campaign and job that a path names."""
    named = scope.get("path_params", {})
    return {
        field: named[parameter]
        for parameter, field in (("campaign_id", "campaign"), ("job", "job"))
        if parameter in named
    }
