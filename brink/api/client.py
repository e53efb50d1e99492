"""How commands reach a coordinator: over HTTP, or in this process on the same database.

Either way a command speaks the REST API, so that what works here works from afar.
"""

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import httpx

from brink.server.errors import TOKEN_FORM, FieldError, InvalidInput, ServerError

if TYPE_CHECKING:
    from brink.server.settings import Settings

TIMEOUT = httpx.Timeout(90.0, connect=5.0)


class CoordinatorSaid(ServerError):
    """A coordinator refused a request, or none answered; the message is for people."""


class Api:
    """The REST API of one coordinator."""

    def __init__(self, client: httpx.AsyncClient, where: str) -> None:
        self._client = client
        self.where = where

    async def get(self, path: str, params: Mapping[str, Any] | None = None) -> Any:
        """Return what a GET answers, decoded.

        Raises:
            CoordinatorSaid: It was refused.
        """
        return (await self.request("GET", path, params=params)).json()

    async def post(self, path: str, content: Any = None) -> Any:
        """Return what a POST answers, decoded.

        Raises:
            CoordinatorSaid: It was refused.
        """
        response = await self.request("POST", path, json=content)
        return response.json() if response.content else None

    async def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Return the response to a request under ``/api/v1``.

        Raises:
            CoordinatorSaid: It was refused.
        """
        try:
            response = await self._client.request(method, f"/api/v1{path}", **options)
        except httpx.HTTPError as error:
            reason = str(error) or type(error).__name__
            raise CoordinatorSaid(
                f"no coordinator answers at {self.where} ({reason}); start one with: brink serve"
            ) from None
        if response.is_success:
            return response
        if response.status_code == httpx.codes.UNAUTHORIZED:
            raise CoordinatorSaid(
                f"the coordinator at {self.where} wants its token: set the environment variable BRINK_TOKEN to it"
            )
        raise CoordinatorSaid(_what_it_said(response))


def _what_it_said(response: httpx.Response) -> str:
    try:
        document = response.json()
    except ValueError:
        return f"the coordinator answered {response.status_code}: {response.text[:200]}"
    errors = document.get("errors") or []
    if not errors:
        return str(document.get("detail", document))
    lines = []
    for error in errors:
        hint = f" (did you mean {error['nearest']!r}?)" if error.get("nearest") else ""
        lines.append(f"{error['pointer'] or '/'}: {error['message']}{hint}")
    return "\n".join(lines)


@asynccontextmanager
async def connect(server: str, token: str | None) -> AsyncIterator[Api]:
    """Give the API of a coordinator, over HTTP.

    Args:
        server: Its URL.
        token: The bearer token to send; None to send none.

    Raises:
        InvalidInput: The URL or the token is malformed.
    """
    if not server.startswith(("http://", "https://")):
        message = f"expected a URL such as http://127.0.0.1:8700, got {server!r}"
        raise InvalidInput([FieldError(pointer="--server", message=message)])
    if token is not None and not all("!" <= letter <= "~" for letter in token):
        raise InvalidInput([FieldError(pointer="BRINK_TOKEN", message=TOKEN_FORM)])
    async with httpx.AsyncClient(base_url=server, timeout=TIMEOUT, headers=_headers(token)) as client:
        yield Api(client, server)


@asynccontextmanager
async def in_process(settings: "Settings") -> AsyncIterator[Api]:
    """Give the API of a coordinator that runs in this process, on a database that may have another one.

    Args:
        settings: Names the database.

    Raises:
        DatabaseError: There is no database, or it cannot be used as it is.
    """
    # Imported here: a web server and a database, which clients of a running coordinator do not need.
    from brink.server.app import create_app
    from brink.server.runtime.database import check_database

    check_database(settings)
    app = create_app(settings, sweeping=False)
    token = settings.token.get_secret_value() if settings.token else None
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url="http://brink", timeout=TIMEOUT,
            headers=_headers(token),
        ) as client,
    ):  # fmt: skip
        yield Api(client, settings.database)


def _headers(token: str | None) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"} if token else {}
