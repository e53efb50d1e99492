"""Options that several commands share, and how a command runs."""

import asyncio
import json
import os
import shutil
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console

from brink.api.client import Api, connect, in_process
from brink.server.errors import FieldError, InvalidInput
from brink.worker.log import LogFormat, LogLevel

if TYPE_CHECKING:
    from pydantic import ValidationError

    from brink.server.settings import Settings

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
LogFormatOption = Annotated[
    LogFormat | None,
    typer.Option(
        "--log-format", case_sensitive=False, help="Of the log (default: BRINK_LOG_FORMAT, else text).",
        show_default=False,
    ),
]  # fmt: skip
LogLevelOption = Annotated[
    LogLevel | None,
    typer.Option(
        "--log-level", case_sensitive=False, show_default=False,
        help="Least severe lines of the log (default: BRINK_LOG_LEVEL, else info).",
    ),
]  # fmt: skip
Sure = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
Workers = Annotated[int, typer.Option(min=1, max=256, help="Worker processes.")]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Go on with what this file started last, or show it if it is finished."),
]
New = Annotated[bool, typer.Option("--new", help="Start anew even if this file was started before.")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port of the coordinator; 0 takes a free one.")]
Threshold = Annotated[float, typer.Option(min=0.0, max=1.0)]


def settings_with(**given: Any) -> "Settings":
    """Return settings from the environment, with what was given on the command line.

    Raises:
        InvalidInput: A setting is not what was expected; names its variable, and never shows a secret.
    """
    # Imported here, and below: clients of a running coordinator need no settings of one.
    from pydantic import ValidationError

    from brink.server.settings import Settings

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        raise InvalidInput(_setting_errors(error, given)) from None


def _setting_errors(error: "ValidationError", given: dict[str, Any]) -> list[FieldError]:
    errors = []
    for item in error.errors(include_url=False):
        name = str(item["loc"][0])
        place = f"--{name}" if given.get(name) is not None else f"BRINK_{name.upper()}"
        shown = "" if name == "token" else f", got {item['input']!r}"
        message = item["msg"].removeprefix("Value error, ")
        errors.append(FieldError(pointer=place, message=f"{message[0].lower()}{message[1:]}{shown}"))
    return errors


def brink() -> str:
    """Return how this command was called, for hints that can be pasted: its path if it is not found without."""
    from brink.sim.catalogue import PLUGINS_VARIABLE

    called = Path(sys.argv[0])
    found = shutil.which(called.name)
    if called.name != "brink" or (found and Path(found).resolve() == called.resolve()):
        name = "brink"  # otherwise called from Python
    else:
        name = min(os.path.relpath(called), str(called.absolute()), key=len)
    plugins = filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(","))
    return " ".join([name, *(f"--plugin {plugin}" for plugin in plugins)])


def database_option(settings: "Settings") -> str:
    """Return the option that names the database in a hint, without its password.

    Empty for the default one, and for that of the environment, which the next command has as well.
    """
    from brink.server.runtime.database import shown_url
    from brink.server.settings import Settings

    usual = {Settings.model_fields["database"].default, os.environ.get("BRINK_DATABASE")}
    return "" if settings.database in usual else f" --database {shown_url(settings)}"


def with_api(server: str | None, database: str | None, work: Callable[[Api], Awaitable[T]]) -> T:
    """Run a command's work against a coordinator, or against the database in this process."""

    async def run() -> T:
        if server is None:
            opened = in_process(settings_with(database=database))
        else:
            opened = connect(server, os.environ.get("BRINK_TOKEN") or None)
        async with opened as api:
            return await work(api)

    return asyncio.run(run())


def look_at(path: str, server: str | None, database: str | None) -> dict[str, Any]:
    """Return what a route answers."""

    async def work(api: Api) -> dict[str, Any]:
        found: dict[str, Any] = await api.get(path)
        return found

    return with_api(server, database, work)


def change(path: str, verb: str, server: str | None, database: str | None) -> dict[str, Any]:
    """Have something done with what a path names, and return how it stands then."""

    async def work(api: Api) -> dict[str, Any]:
        found: dict[str, Any] = await api.post(f"{path}/{verb}")
        return found

    return with_api(server, database, work)


def delete_after_asking(
    path: str, what: str, *, sure: bool, server: str | None, database: str | None
) -> None:
    """Delete what a path names, unless the user is asked and says no."""
    if not sure:
        typer.confirm(f"delete {what}? Nothing brings it back", abort=True)
    with_api(server, database, lambda api: api.request("DELETE", path))
    say(f"{what} is deleted")


def print_json(document: Any) -> None:
    """Print a document for programs."""
    typer.echo(json.dumps(document, indent=2))


def console() -> Console:
    """Return the console for people; where no terminal says how wide it is, wide enough for our tables."""
    screen = Console(highlight=False)
    return screen if screen.is_terminal else Console(highlight=False, width=PLAIN_WIDTH)


def check_picture(file: Path | None) -> None:
    """Refuse a file that no picture can be drawn into, before anything takes long.

    Raises:
        InvalidInput: Its name has another ending than .png, .svg or .pdf.
    """
    if file is not None and file.suffix.lower() not in (".png", ".svg", ".pdf"):
        message = f"{file}: expected a file name that ends in .png, .svg or .pdf"
        raise InvalidInput([FieldError(pointer="--picture", message=message)])


def say(words: str) -> None:
    """Print a sentence as it is, however long."""
    console().print(words, soft_wrap=True, markup=False)


def file_name(name: str) -> str:
    """Return a campaign's name as a part of a file's name."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in name)[:60]
