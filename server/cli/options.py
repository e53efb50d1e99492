"""Options that several commands share, and how a command runs."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console

from server.cli.api import Api, open_api
from server.settings import Settings

T = TypeVar("T")
PLAIN_WIDTH = 140

Database = Annotated[
    str | None,
    typer.Option(
        "--database",
        help="Database URL: sqlite:///FILE or postgresql://… (default: BRINK_DATABASE, else ./brink.db).",
        show_default=False,
    ),
]
Server = Annotated[
    str | None,
    typer.Option(
        "--server",
        envvar="BRINK_SERVER",
        help="URL of a coordinator; without it the database is read directly.",
        show_default=False,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
CampaignId = Annotated[str, typer.Argument(metavar="ID", help="Campaign id, or the beginning of one.")]
CampaignFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Campaign file (YAML or JSON).", show_default=False)
]
Threshold = Annotated[float, typer.Option(min=0.0, max=1.0)]


def settings_with(**given: Any) -> Settings:
    """Return settings from the environment, with what was given on the command line."""
    return Settings(**{name: value for name, value in given.items() if value is not None})


def with_api(server: str | None, database: str | None, work: Callable[[Api], Awaitable[T]]) -> T:
    """Run a command's work against a coordinator, or against the database in this process."""

    async def run() -> T:
        async with open_api(server, settings_with(database=database)) as api:
            return await work(api)

    return asyncio.run(run())


def print_json(document: Any) -> None:
    """Print a document for programs."""
    typer.echo(json.dumps(document, indent=2))


def console() -> Console:
    """Return the console for people; where no terminal says how wide it is, wide enough for our tables."""
    screen = Console(highlight=False)
    return screen if screen.is_terminal else Console(highlight=False, width=PLAIN_WIDTH)
