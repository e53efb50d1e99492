"""Times every request, by the route that served it."""

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.metrics import Metrics

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class Measured:
    """Measures what happens within."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), 0

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, noted)
        finally:
            method = scope["method"] if scope["method"] in _METHODS else "other"
            # Not the path: it has ids in it, and strangers could make up any number of them.
            route = getattr(scope.get("route"), "path", "none")
            taken_s = time.perf_counter() - began
            self._metrics.requests.labels(method, route, f"{status // 100}xx").observe(taken_s)
