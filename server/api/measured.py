"""Times every request, names it, and tells of it in the log, by the route that served it."""

import logging
import re
import secrets
import time
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from brink.server.metrics import Metrics
from brink.worker.log import log_fields

REQUEST_ID: Final = b"x-request-id"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_PLAIN_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")

log = logging.getLogger(__name__)


class Measured:
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
