"""Fast routes for the worker protocol: nearly all requests of a busy coordinator are on them.

The framework's routing, validation and clean-up take longer than serving such a request, so they are bypassed. The
routes are also part of the application, which documents them and serves every method but POST.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import Any, Final

from fastapi import Request, Response
from fastapi.routing import APIRoute
from pydantic import ValidationError
from starlette.middleware.exceptions import ExceptionMiddleware
from starlette.requests import ClientDisconnect
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, ExceptionHandler, Receive, Scope, Send

from brink.server.documents import invalid_input
from brink.server.errors import InvalidInput
from brink.worker.wire import Message

JSON: Final = "application/json"
LARGE_BYTES: Final = 256 * 1024
"""Larger messages are parsed outside the event loop."""


class WireRoute(APIRoute):
    """A fast route for functions that take ``message``, ``request`` and ``services`` and return a message.

    Messages are programs' words, so their types are strict: the text ``"8"`` is not a number.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the request handler, which parses and writes JSON without the framework's overhead."""
        return self.respond

    async def respond(self, request: Request) -> Response:
        """Serve a request."""
        try:
            body = await request.body()
        except ClientDisconnect:  # or the body was too large or too slow: the middleware responds
            return Response(status_code=400)
        _check_content_type(request)
        services = request.app.state.context
        model: type[Message] = self.endpoint.__annotations__["message"]
        if len(body) <= LARGE_BYTES:
            message = _parse(model, body)
        else:
            message = await asyncio.get_running_loop().run_in_executor(services.decoding, _parse, model, body)
        reply = await self.endpoint(message=message, request=request, services=services)
        return Response(reply.model_dump_json(), media_type=JSON)


class WireMiddleware:
    """Serves POST requests to some routes itself, and passes on all others.

    Args:
        app: The application with the other routes.
        routes: The routes; those that are no `WireRoute` are left to the application.
        prefix: What precedes the routes' paths.
        handlers: The application's handlers of errors.
    """

    def __init__(
        self, app: ASGIApp, routes: Iterable[BaseRoute], prefix: str, handlers: Mapping[Any, ExceptionHandler]
    ) -> None:
        self._app = app
        self._routes = {prefix + route.path: route for route in routes if isinstance(route, WireRoute)}
        unexpected = (500, Exception)  # the server logs these
        expected = {error: handle for error, handle in handlers.items() if error not in unexpected}
        self._wire = ExceptionMiddleware(self._serve, handlers=expected)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_wire = scope["type"] == "http" and scope["method"] == "POST" and scope["path"] in self._routes
        await (self._wire if is_wire else self._app)(scope, receive, send)

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        route = scope["route"] = self._routes[scope["path"]]
        response = await route.respond(Request(scope, receive, send))
        await response(scope, receive, send)


def _check_content_type(request: Request) -> None:
    """Check that a request's body is JSON.

    Raises:
        InvalidInput: It is of another type, or has none.
    """
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != JSON:
        raise InvalidInput.at("", f"expected the header 'Content-Type: {JSON}', got {given[:100]!r}")


def _parse(model: type[Message], body: bytes) -> Message:
    """Parse a message.

    Raises:
        InvalidInput: With a pointer to each invalid field, unless there are very many.
    """
    try:
        return model.model_validate_json(body, strict=True)
    except ValidationError as error:
        raise invalid_input(error, model) from None
