"""The dashboard page at `/` with its modules and styles: static files without a build step or external resources."""

from importlib.resources import files
from pathlib import Path
from typing import Final

from fastapi import APIRouter, FastAPI
from fastapi.staticfiles import StaticFiles
from starlette.responses import FileResponse, Response
from starlette.types import Scope

FOLDER: Final = "/dashboard"
STATIC: Final = Path(str(files("brink.server.dashboard"))) / "static"
REVALIDATED: Final = {"Cache-Control": "no-cache"}
"""Browsers revalidate every file, so that files of different versions are never mixed."""

router = APIRouter()


@router.get("/", include_in_schema=False)
async def page() -> FileResponse:
    """Return the dashboard page."""
    return FileResponse(STATIC / "index.html", headers=REVALIDATED)


class _Files(StaticFiles):
    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers.update(REVALIDATED)
        return response


def add_dashboard(app: FastAPI) -> None:
    """Serve the dashboard page and its files."""
    app.include_router(router)
    app.mount(FOLDER, _Files(directory=STATIC), name="dashboard")
