"""The rendering of all errors as problem+json (RFC 9457)."""

import logging
from collections.abc import Sequence
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sqlalchemy.exc import DBAPIError
from starlette.exceptions import HTTPException

from brink.server.db.writer import is_transient
from brink.server.documents import field_errors
from brink.server.errors import (
    Conflict,
    FieldError,
    InvalidInput,
    NotFound,
    NotRecorded,
    NoWorker,
    TooCostly,
    Unavailable,
)
from brink.sim.errors import PluginMissing

MEDIA_TYPE = "application/problem+json"
log = logging.getLogger(__name__)


NO_WORKER = "No worker"
"""Title of errors that starting a worker resolves; the dashboard then shows how to do that."""
_UNAVAILABLE: Final = {NoWorker: NO_WORKER, TooCostly: "Too costly"}
"""Titles of errors that may not occur later."""


NOT_RECORDED = "Not recorded"
"""Title of errors about a trace that can be requested; clients that may do so then request it."""


def problem(
    status: int,
    title: str,
    detail: str,
    errors: Sequence[FieldError] = (),
    headers: dict[str, str] | None = None,
) -> JSONResponse:
    """Return an error response.

    Args:
        status: HTTP status.
        title: Kind of error.
        detail: What is wrong and what to do.
        errors: Errors in individual input fields.
        headers: Additional response headers.
    """
    content: dict[str, Any] = {"type": "about:blank", "title": title, "status": status, "detail": detail}
    if errors:
        content["errors"] = [
            {"pointer": e.pointer, "message": e.message, "nearest": e.nearest} for e in errors
        ]
    return JSONResponse(content, status_code=status, media_type=MEDIA_TYPE, headers=headers)


def install(app: FastAPI) -> None:
    """Render every error of an app as problem+json."""

    @app.exception_handler(InvalidInput)
    async def invalid(_: Request, error: InvalidInput) -> JSONResponse:
        return problem(422, "Invalid input", str(error), error.errors)

    @app.exception_handler(RequestValidationError)
    async def unreadable(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = field_errors(error.errors(), _body_model(request))
        return problem(422, "Invalid input", "; ".join(map(str, errors)), errors)

    @app.exception_handler(NotFound)
    async def missing(_: Request, error: NotFound) -> JSONResponse:
        title = NOT_RECORDED if isinstance(error, NotRecorded) else "Not found"
        return problem(404, title, str(error))

    @app.exception_handler(Conflict)
    async def conflict(_: Request, error: Conflict) -> JSONResponse:
        return problem(409, "Conflict", str(error))

    @app.exception_handler(Unavailable)
    async def unavailable(_: Request, error: Unavailable) -> JSONResponse:
        title = _UNAVAILABLE.get(type(error), "Unavailable")
        return problem(503, title, str(error), headers={"Retry-After": str(error.retry_after_s)})

    @app.exception_handler(PluginMissing)
    async def not_importable(_: Request, error: PluginMissing) -> JSONResponse:
        log.info("%s", error)  # the answer says it, too
        return problem(500, "Plug-in missing", str(error))

    @app.exception_handler(DBAPIError)
    async def database_away(request: Request, error: DBAPIError) -> JSONResponse:
        if not is_transient(error):
            return await unexpected(request, error)
        log.error("database: %s", error.orig)
        return problem(503, "Unavailable", "the database did not answer", headers={"Retry-After": "1"})

    @app.exception_handler(HTTPException)
    async def http(_: Request, error: HTTPException) -> JSONResponse:
        return problem(error.status_code, "Error", str(error.detail), headers=dict(error.headers or {}))

    @app.exception_handler(Exception)
    async def unexpected(request: Request, error: Exception) -> JSONResponse:
        log.exception("%s %s failed", request.method, request.url.path, exc_info=error)
        return problem(500, "Internal error", "internal error in the coordinator; see its log")


def describe(app: FastAPI) -> None:
    """Document all errors in the OpenAPI document as problem+json."""
    original = app.openapi

    def openapi() -> dict[str, Any]:
        document = original()
        for operations in document["paths"].values():
            for operation in operations.values():
                # The framework documents its own format of validation errors, which is never sent.
                operation["responses"].pop("422", None)
                for status, answer in operation["responses"].items():
                    content = answer.get("content", {})
                    if status[0] in "45" and (schema := content.pop("application/json", None)):
                        content[MEDIA_TYPE] = schema
        return document

    app.openapi = openapi  # type: ignore[method-assign]


def _body_model(request: Request) -> type[BaseModel] | None:
    field = getattr(request.scope.get("route"), "body_field", None)
    annotation = getattr(getattr(field, "field_info", None), "annotation", None)
    return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None
