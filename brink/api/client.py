"""The REST client of a coordinator, over HTTP or in this process on the same database.

Either way the client speaks the REST API, so what works on this machine also works against a remote one.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

import httpx
from pydantic import TypeAdapter, ValidationError

from brink.server.errors import TOKEN_FORM, FieldError, InvalidInput, ServerError
from brink.worker.errors import no_token_words

if TYPE_CHECKING:
    from brink.server.settings import Settings

TIMEOUT: Final = httpx.Timeout(90.0, connect=5.0)
COMPUTED_WAIT_S: Final = 5
"""How long the coordinator may hold a request while it computes the response."""
COMPUTED_POLL_S: Final = 1.0


class Page(Protocol):
    """A page of a list, and what to pass to get the next one; None after the last."""

    @property
    def next(self) -> int | str | None: ...  # noqa: D102


T = TypeVar("T")
PageT = TypeVar("PageT", bound=Page)


class CoordinatorError(ServerError):
    """The coordinator rejected a request or could not be reached; the message can be shown to users.

    Attributes:
        errors: One error for each invalid field of the request, if that is why it was rejected.
    """

    def __init__(self, message: str, errors: Iterable[FieldError] = ()) -> None:
        self.errors = tuple(errors)
        super().__init__(message)


class Unreachable(CoordinatorError):
    """No coordinator answers."""


class Missing(CoordinatorError):
    """The coordinator has no resource with this name."""


class Refused(CoordinatorError):
    """The state of the resource does not allow the request."""


_KINDS: Final[Mapping[int, type[CoordinatorError]]] = {
    httpx.codes.NOT_FOUND: Missing,
    httpx.codes.CONFLICT: Refused,
}


class Api:
    """The REST API of one coordinator.

    `read` and `send` validate a response against its schema; `get` and `post` return the JSON document unchanged.
    """

    def __init__(self, client: httpx.AsyncClient, where: str) -> None:
        self._client = client
        self.where = where

    async def read(self, schema: type[T], path: str, params: Mapping[str, Any] | None = None) -> T:
        """Return the response to a GET request, validated against a schema.

        Args:
            schema: Type of the response: a model, or a list of models.
            path: Path below ``/api/v1``.
            params: Query parameters.

        Raises:
            CoordinatorError: The request failed, or the response does not match the schema.
        """
        answer: T = self._validated(schema, await self.request("GET", path, params=params))
        return answer

    async def send(self, schema: type[T], path: str, content: Any = None, *, method: str = "POST") -> T:
        """Send a request with a body and return the response, validated against a schema.

        Args:
            schema: Type of the response.
            path: Path below ``/api/v1``.
            content: JSON body; None sends no body.
            method: HTTP method.

        Raises:
            CoordinatorError: The request failed, or the response does not match the schema.
        """
        answer: T = self._validated(schema, await self.request(method, path, json=content))
        return answer

    async def pages(
        self, schema: type[PageT], path: str, params: Mapping[str, Any] | None = None
    ) -> AsyncIterator[PageT]:
        """Yield the pages of a list, from the first to the last.

        Args:
            schema: Type of a page.
            path: Path below ``/api/v1``.
            params: Query parameters, such as the ``limit`` of a page.

        Raises:
            CoordinatorError: A request failed, or a response does not match the schema.
        """
        asked = dict(params or {})
        while True:
            page = await self.read(schema, path, asked)
            yield page
            if page.next is None:
                return
            asked["after" if isinstance(page.next, int) else "cursor"] = page.next

    async def read_computed(
        self, schema: type[T], path: str, params: Mapping[str, Any], show: Callable[[str], None]
    ) -> T:
        """Return the response to a GET request for something that the coordinator may still have to compute.

        Args:
            schema: Type of the response.
            path: Path below ``/api/v1``.
            params: Query parameters.
            show: Called with what is still being computed, in words.

        Raises:
            CoordinatorError: A request failed, or the response does not match the schema.
        """
        while True:
            response = await self.request("GET", path, params={"wait_s": COMPUTED_WAIT_S, **params})
            if response.status_code != httpx.codes.ACCEPTED:
                answer: T = self._validated(schema, response)
                return answer
            show(str(response.json()["detail"]))
            await asyncio.sleep(COMPUTED_POLL_S)

    async def get(self, path: str, params: Mapping[str, Any] | None = None) -> Any:
        """Return the decoded JSON response to a GET request.

        Raises:
            CoordinatorError: The request failed.
        """
        return (await self.request("GET", path, params=params)).json()

    async def post(self, path: str, content: Any = None) -> Any:
        """Send a POST request and return the decoded JSON response; None if the response is empty.

        Raises:
            CoordinatorError: The request failed.
        """
        response = await self.request("POST", path, json=content)
        return response.json() if response.content else None

    async def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send a request and return its response.

        Args:
            method: HTTP method.
            path: Path below ``/api/v1``.
            options: Passed on to httpx.

        Raises:
            Unreachable: No coordinator answers.
            CoordinatorError: The coordinator rejected the request.
            InvalidInput: The path has an empty part, or leads elsewhere: an id in it is none.
        """
        _check_path(path)
        try:
            response = await self._client.request(method, f"/api/v1{path}", **options)
        except httpx.HTTPError as error:
            reason = str(error) or type(error).__name__
            raise Unreachable(
                f"no coordinator answers at {self.where} ({reason}); start one with: brink serve"
            ) from None
        if response.is_success:
            return response
        if response.status_code == httpx.codes.UNAUTHORIZED:
            given = "Authorization" in self._client.headers
            raise CoordinatorError(no_token_words(self.where, given=given, scope="user"))
        raise _error_of(response)

    def _validated(self, schema: Any, response: httpx.Response) -> Any:
        try:
            return _adapter(schema).validate_json(response.content)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            place = "/".join(map(str, fault["loc"])) or "the answer"
            raise CoordinatorError(
                f"unexpected answer from {self.where}: {place}: {fault['msg']}; "
                "is it a coordinator of the same version of Brink?"
            ) from None


def _check_path(path: str) -> None:
    for part in path.removeprefix("/").split("/"):
        if part in ("", ".", "..") or any(letter in part for letter in "?#%\\"):
            raise InvalidInput.at("", f"expected an id or a name, got {part!r} in {path}")


@cache
def _adapter(schema: Any) -> TypeAdapter[Any]:
    return TypeAdapter(schema)


def _error_of(response: httpx.Response) -> CoordinatorError:
    """Return the error for a response; its message has one line for each invalid field."""
    try:
        document = response.json()
    except ValueError:
        return CoordinatorError(f"the coordinator answered {response.status_code}: {response.text[:200]}")
    errors = [
        FieldError(pointer=error["pointer"] or "/", message=error["message"], nearest=error.get("nearest"))
        for error in document.get("errors") or []
    ]
    if not errors:
        kind = _KINDS.get(response.status_code, CoordinatorError)
        return kind(str(document.get("detail", document)))
    return CoordinatorError("\n".join(map(str, errors)), errors)


@asynccontextmanager
async def connect(server: str, token: str | None) -> AsyncIterator[Api]:
    """Yield a client for the API of a coordinator over HTTP.

    Args:
        server: URL of the coordinator.
        token: Bearer token; None sends none.

    Raises:
        InvalidInput: The URL or the token is malformed.
    """
    if not server.startswith(("http://", "https://")):
        raise InvalidInput.at("--server", f"expected a URL such as http://127.0.0.1:8700, got {server!r}")
    if token is not None and not all("!" <= letter <= "~" for letter in token):
        raise InvalidInput.at("BRINK_TOKEN", TOKEN_FORM)
    async with httpx.AsyncClient(base_url=server, timeout=TIMEOUT, headers=_headers(token)) as client:
        yield Api(client, server)


@asynccontextmanager
async def in_process(settings: "Settings") -> AsyncIterator[Api]:
    """Yield a client for a coordinator in this process; another coordinator may use the same database.

    Args:
        settings: Settings of the coordinator; they name the database.

    Raises:
        DatabaseError: The database is missing or unusable.
    """
    # Imported here: clients of a running coordinator need neither a web server nor a database.
    from brink.server.app import create_app
    from brink.server.runtime.database import check_database

    check_database(settings)
    app = create_app(settings, sweeping=False)
    token = settings.token.get_secret_value() if settings.token else None
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app),
            base_url="http://brink",
            timeout=TIMEOUT,
            headers=_headers(token),
        ) as client,
    ):
        yield Api(client, settings.database)


def _headers(token: str | None) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"} if token else {}
