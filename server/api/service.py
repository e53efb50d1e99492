"""Routes of the service itself: health, metrics, access rights, the catalogue, the API documentation."""

import asyncio
import logging
from importlib.resources import files
from typing import Annotated, Final

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import JSONResponse, PlainTextResponse
from fastapi.staticfiles import StaticFiles
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import Field
from sqlalchemy import text
from starlette.responses import HTMLResponse

from brink.server.api.context import Services, caller_of
from brink.server.api.problem_details import problem
from brink.server.api.queue_metrics import queue_metrics
from brink.server.api.schemas import AlgorithmView, ProblemView
from brink.server.db.engine import read
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.errors import DatabaseError
from brink.server.findings.kind import reported_by
from brink.server.problems.catalogue import describe_algorithms, describe_problems
from brink.server.states import Scope
from brink.server.user_code import USER_CODE
from brink.server.views import View

log = logging.getLogger(__name__)
root = APIRouter(tags=["operations"])
"""Routes outside /api/v1."""
router = APIRouter()
READY_S = 5.0
FOLDER: Final = "/docs-files"
OPENAPI: Final = "/openapi.json"


@root.get("/healthz", response_class=PlainTextResponse)
async def healthz() -> str:
    """Return 200 if the process is alive."""
    return "ok\n"


@root.get("/readyz", response_class=PlainTextResponse)
async def readyz(services: Services) -> Response:
    """Return 200 if the database can be read and written and has this version's schema; otherwise 503.

    Also 503 if so many calls of plug-ins have not returned that no further campaign with plug-ins can go on.
    """
    try:
        loop = asyncio.get_running_loop()
        revision = await loop.run_in_executor(None, current_revision, services.engines)
        writing = asyncio.wrap_future(services.queue.writer.submit(lambda c: c.execute(text("SELECT 1"))))
        await asyncio.wait_for(writing, READY_S)
        if trouble := services.queue.writer.trouble:  # reads succeed even on a full disk
            log.warning("not ready: %s", trouble.reason)
            return problem(503, "Not ready", "the database has been rejecting writes; see the log")
        if USER_CODE.is_full:
            return problem(503, "Not ready", "too many calls of plug-ins have not returned; see the log")
    except DatabaseError as error:  # its message names the database, and this path is public
        log.warning("not ready: %s", error)
        return problem(503, "Not ready", "the database does not respond; see the log")
    except TimeoutError:
        return problem(503, "Not ready", "the database does not accept writes")
    if revision != head_revision():
        return problem(503, "Not ready", f"schema {revision}, expected {head_revision()}")
    return PlainTextResponse("ready\n")


@root.get("/metrics", response_class=PlainTextResponse)
async def metrics(services: Services) -> Response:
    """Return metrics of campaigns, jobs, workers and this process in the Prometheus text format."""
    registry = await read(services.engines, lambda connection: queue_metrics(connection, services.settings))
    content = generate_latest(registry) + generate_latest(services.metrics.registry)
    return Response(content, media_type=CONTENT_TYPE_LATEST)


class AccessView(View):
    """Access rights of the caller."""

    tokens: Annotated[bool, Field(description="Whether this coordinator requires tokens.")]
    scope: Annotated[Scope, Field(description="Scope of the token; admin if none is required.")]


@router.get("/access", tags=["access"])
async def get_access(request: Request) -> AccessView:
    """Return the access rights of the caller. Like every path, it responds with 401 without a valid token."""
    caller = caller_of(request)
    return AccessView(tokens=caller is not None, scope=Scope.ADMIN if caller is None else caller.scope)


@router.get("/problems", tags=["catalogue"])
def get_problems() -> list[ProblemView]:
    """List the problems with the JSON schemas of their parameters."""
    return [ProblemView.model_validate(item) for item in describe_problems(reported_by)]


@router.get("/algorithms", tags=["catalogue"])
def get_algorithms() -> list[AlgorithmView]:
    """List the algorithms with the JSON schemas of their parameters."""
    return [AlgorithmView.model_validate(item) for item in describe_algorithms()]


# Not closures over the app: FastAPI caches route functions, which would keep every app of a test run alive.
@root.get(OPENAPI, include_in_schema=False)
def get_openapi(request: Request) -> JSONResponse:
    """Return the OpenAPI document. It takes a second to make, hence in a thread."""
    app: FastAPI = request.app
    return JSONResponse(app.openapi())


@root.get("/docs", include_in_schema=False)
async def docs_page(request: Request) -> HTMLResponse:
    """Return Swagger UI."""
    root = request.scope.get("root_path", "")
    app = request.app
    return get_swagger_ui_html(
        openapi_url=f"{root}{OPENAPI}",
        title=app.title,
        swagger_js_url=f"{root}{FOLDER}/swagger-ui-bundle.js",
        swagger_css_url=f"{root}{FOLDER}/swagger-ui.css",
        swagger_favicon_url=f"{root}{FOLDER}/favicon.png",
    )


def add_docs(app: FastAPI) -> None:
    """Serve the files of Swagger UI."""
    app.mount(FOLDER, StaticFiles(directory=str(files("fastapi_offline") / "static")), name="docs-files")
