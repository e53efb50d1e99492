"""What stands before every request: the bearer token, and the bound on bodies."""

import secrets

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.api.problem_details import problem

OPEN_PATHS = ("/healthz", "/readyz", "/docs", "/openapi.json")
"""What says nothing of any campaign: whether the coordinator lives, and what its API is."""
OPEN_FOLDERS = ("/docs-files/",)


class Guards:
    """Refuses requests without the token, and bodies past the bound, before anything reads them."""

    def __init__(self, app: ASGIApp, token: str | None, max_body_bytes: int) -> None:
        self._app = app
        self._token = token
        self._max_body_bytes = max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value for name, value in scope["headers"]}
        if self._token and not _is_open(scope["path"]) and not self._authorised(headers):
            response = problem(
                401,
                "Unauthorised",
                "expected the header 'Authorization: Bearer TOKEN' with this coordinator's token",
                headers={"WWW-Authenticate": "Bearer"},
            )
            await response(scope, receive, send)
            return
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > self._max_body_bytes:
            await self._too_large(scope, receive, send)
            return
        body = _Bounded(receive, self._max_body_bytes)

        async def answer(message: Message) -> None:
            if not body.exceeded:
                await send(message)

        await self._app(scope, body.receive, answer)
        if body.exceeded:
            await self._too_large(scope, receive, send)

    async def _too_large(self, scope: Scope, receive: Receive, send: Send) -> None:
        await problem(413, "Body too large", f"expected at most {self._max_body_bytes} bytes")(
            scope, receive, send
        )

    def _authorised(self, headers: dict[bytes, bytes]) -> bool:
        assert self._token is not None
        given = headers.get(b"authorization", b"")
        return secrets.compare_digest(given, b"Bearer " + self._token.encode())


def _is_open(path: str) -> bool:
    return path in OPEN_PATHS or path.startswith(OPEN_FOLDERS)


class _Bounded:
    """A body that ends at the bound, as if the client had gone: for bodies that come without a length."""

    def __init__(self, receive: Receive, max_bytes: int) -> None:
        self._receive = receive
        self._left = max_bytes

    @property
    def exceeded(self) -> bool:
        """Whether the body went past the bound."""
        return self._left < 0

    async def receive(self) -> Message:
        """Return the next part of the request."""
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        return {"type": "http.disconnect"} if self.exceeded else message
