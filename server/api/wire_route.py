"""Routes of the worker's messages: described and refused as every other, but read and written by pydantic alone.

These three are most of what a coordinator serves.
"""

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect

JSON = "application/json"


class WireRoute(APIRoute):
    """A route whose function takes ``message``, ``request`` and ``services``, and returns a message."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what serves a request."""
        serve, usual = self.endpoint, super().get_route_handler()
        model: type[BaseModel] = self.endpoint.__annotations__["message"]

        async def handle(request: Request) -> Response:
            if request.headers.get("content-type") != JSON:
                return await usual(request)
            try:
                message = model.model_validate_json(await request.body())
            except ClientDisconnect:  # or a body that is too large, or late, which the guards answer
                return Response(status_code=400)
            except ValidationError:
                return await usual(request)  # which says what is wrong
            reply = await serve(message=message, request=request, services=request.app.state.context)
            return Response(reply.model_dump_json(), media_type=JSON)

        return handle
