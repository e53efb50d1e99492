"""The page of the API, with its scripts and styles: it must work where there is no way out to the internet."""

from importlib.resources import files
from typing import Final

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.staticfiles import StaticFiles
from starlette.responses import HTMLResponse

FOLDER: Final = "/docs-files"

# No closure over the app: FastAPI remembers the functions of thousands of routes, and with it each app that was made.
router = APIRouter()


@router.get("/docs", include_in_schema=False)
async def page(request: Request) -> HTMLResponse:
    """Return the page, which reads the OpenAPI document."""
    root = request.scope.get("root_path", "")
    app = request.app
    return get_swagger_ui_html(
        openapi_url=f"{root}{app.openapi_url}",
        title=app.title,
        swagger_js_url=f"{root}{FOLDER}/swagger-ui-bundle.js",
        swagger_css_url=f"{root}{FOLDER}/swagger-ui.css",
        swagger_favicon_url=f"{root}{FOLDER}/favicon.png",
    )


def add_docs(app: FastAPI) -> None:
    """Serve the page and its files."""
    app.include_router(router)
    app.mount(FOLDER, StaticFiles(directory=str(files("fastapi_offline") / "static")), name="docs-files")
