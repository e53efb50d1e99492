"""Options that several commands share, access to the API, and output as text and as JSON."""

import asyncio
import json
import os
import shutil
import sys
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.text import Text

from brink.api.client import Api, CoordinatorError, Missing, connect, in_process
from brink.api.terminal import PlainConsole, echo
from brink.api.terminal import plain_table as plain_table
from brink.search.sequential import FIRST
from brink.server.documents import parse_yaml
from brink.server.errors import SHORTEST_ID, FieldError, InvalidInput
from brink.worker.log import LogFormat, LogLevel

if TYPE_CHECKING:
    from pydantic import ValidationError

    from brink.server.settings import Settings

T = TypeVar("T")
PLAIN_WIDTH = 160
IDS_SHOWN = 3
"""Ids to list if one is not found."""
_LISTS = {"campaign": "status", "experiment": "experiment list"}
"""The command that lists what an id may stand for."""
RESULTS = Path("brink-results")
"""Default folder for results."""

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
        help="URL of a coordinator. Without it, the command opens the database itself.",
        show_default=False,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def check_ids(given: str | list[str] | None) -> str | list[str] | None:
    """Return ids as they were given, on the command line; an empty or malformed one matches nothing.

    Raises:
        typer.BadParameter: An id is not one, nor the beginning of one.
    """
    for one in [given] if isinstance(given, str) else given or ():
        if len(one) < SHORTEST_ID or not (one.isascii() and one.isalnum()):
            words = (
                f"expected an id, or at least its first {SHORTEST_ID} characters, such as 3f2a; got {one!r}"
            )
            if one.endswith((".yaml", ".yml", ".json")):
                words += (
                    f"; the last run of a file is continued with: {program()} run {quote(str(one))} --resume"
                )
            else:
                words += f"; {program()} status lists campaigns, {program()} experiment list experiments"
            raise typer.BadParameter(words)
    return given


CampaignId = Annotated[
    str, typer.Argument(metavar="ID", help="Campaign id or a unique prefix of it.", callback=check_ids)
]
CampaignFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Campaign file (YAML or JSON).", show_default=False)
]
LogFormatOption = Annotated[
    LogFormat | None,
    typer.Option(
        "--log-format",
        case_sensitive=False,
        help="Log format (default: BRINK_LOG_FORMAT, else text).",
        show_default=False,
    ),
]
LogLevelOption = Annotated[
    LogLevel | None,
    typer.Option(
        "--log-level",
        case_sensitive=False,
        show_default=False,
        help="Lowest level to log (default: BRINK_LOG_LEVEL, else info).",
    ),
]
Odd = Annotated[
    list[str] | None,
    typer.Option(
        "--odd",
        metavar="NAME=LIMIT",
        show_default=False,
        help="Limit a parameter, as problem.params.odd does: 'scenario.weather=[clear, rain]', "
        "'scenario.speed={min: 5, max: 12}', 'behaviour.x=3'. May be given several times.",
    ),
]
Confirmed = Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")]
Alpha = Annotated[
    float,
    typer.Option(
        "--alpha",
        min=0.0001,
        max=0.5,
        help="Corrected p value up to which a difference is significant. Tables as in the paper keep 0.01.",
    ),
]
Workers = Annotated[int, typer.Option(min=1, max=256, help="Number of worker processes.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Resume the latest run of this file, or show it if it has finished.")
]
New = Annotated[bool, typer.Option("--new", help="Start a new run even if an earlier one is unfinished.")]
Port = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=65535,
        show_default=False,
        help="Port of the coordinator; 0 picks a free one (default: 8700, or a free one if that is in use).",
    ),
]
ConfirmPairs = Annotated[
    int | None,
    typer.Option(
        "--confirm",
        metavar="R",
        min=2,
        max=10_000,
        show_default=False,
        help="Simulate both sides of every pair up to R times with other seeds first, such as 30, until it is "
        f"confirmed or refuted. Fewer than {FIRST} can refute pairs, but confirm none.",
    ),
]
WithGroundTruth = Annotated[
    bool,
    typer.Option(
        "--component", help="Simulate each unsafe side with ground truth in place of the component first."
    ),
]
FitnessThreshold = Annotated[
    float, typer.Option("--t-b", min=0.0, max=1.0, help="Maximum fitness of a boundary solution.")
]
DistanceThreshold = Annotated[
    float,
    typer.Option("--d-th", min=0.0, max=1.0, help="Minimum distance between distinct boundary solutions."),
]


def settings_with(**given: Any) -> "Settings":
    """Return settings from the environment, overridden by command-line options.

    Raises:
        InvalidInput: A setting is invalid. The message names its variable and never shows a secret.
    """
    # Imported here: clients of a running coordinator do not need its settings.
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


def named_values(
    option: str, given: Sequence[str] | None, example: str, read: Callable[[str], Any] = parse_yaml
) -> dict[str, Any]:
    """Return the values that an option NAME=VALUE gives, by name.

    Args:
        option: The option, for messages.
        given: What the user said, each time that the option was given.
        example: What it might have been.
        read: Reads a value; by default as YAML.

    Raises:
        InvalidInput: One is not a name and a value, or a name is given twice.
    """
    values: dict[str, Any] = {}
    for one in given or ():
        name, _, value = map(str.strip, one.partition("="))
        unexpected = InvalidInput.at(option, f"expected NAME=VALUE, such as {example}; got {one!r}")
        if not (name and value):
            raise unexpected
        if name in values:
            raise InvalidInput.at(option, f"{name} is given twice: expected one value")
        try:
            values[name] = read(value)
        except ValueError:
            raise unexpected from None
    return values


def read_odd(given: Sequence[str] | None) -> dict[str, Any]:
    """Return the limits that the option ``--odd`` gives, by parameter.

    Raises:
        InvalidInput: One is not a name and a limit, or a name is given twice.
    """
    return named_values("--odd", given, "scenario.speed=5")


def program() -> str:
    """Return the `brink` command for use in hints, with its path if it is not on PATH and with its plug-ins."""
    from brink.sim.catalogue import PLUGINS_VARIABLE

    called = Path(sys.argv[0])
    found = shutil.which(called.name)
    if called.name != "brink" or (found and Path(found).resolve() == called.resolve()):
        name = "brink"  # also when called from Python
    else:
        name = min(os.path.relpath(called), str(called.absolute()), key=len)
    plugins = filter(None, os.environ.get(PLUGINS_VARIABLE, "").split(","))
    return " ".join([quote(name), *(f"--plugin {quote(plugin)}" for plugin in plugins)])


def database_option(settings: "Settings") -> str:
    """Return the option that names the database, without its password, for hints.

    Empty for the default database and for that of the environment: the next command finds those by itself.
    """
    from brink.server.runtime.database import shown_url
    from brink.server.settings import Settings

    usual = {Settings.model_fields["database"].default, os.environ.get("BRINK_DATABASE")}
    return "" if settings.database in usual else f" --database {quote(shown_url(settings))}"


def place_option(server: str | None, database: str | None) -> str:
    """Return the option that names the coordinator or the database, as given to the command, for hints."""
    return f" --server {quote(server)}" if server else database_option(settings_with(database=database))


def database_place(settings: "Settings") -> str:
    """Describe the location of a database: the path of its file, or its URL without the password."""
    from brink.server.runtime.database import shown_url

    file = settings.sqlite_file
    return shown_url(settings) if file is None else str(file.absolute())


async def naming_ids(api: Api, place: str, option: str, work: Callable[[], Awaitable[T]]) -> T:
    """Do work; if it names a missing campaign or experiment, say where it was looked up, and what exists there.

    Args:
        api: The API of a coordinator.
        place: Where the coordinator or its database is, in words.
        option: The option that names it in hints; empty for the default database.
        work: The work.

    Raises:
        CoordinatorError: A request failed.
    """
    try:
        return await work()
    except Missing as error:
        for noun, command in _LISTS.items():
            if str(error).endswith(f"no such {noun}"):
                there = await _some_ids(api, f"{noun}s")
                raise Missing(
                    f"{error} in {place}, {there}; list them with: {program()} {command}{option}"
                ) from None
        raise


async def _some_ids(api: Api, noun: str) -> str:
    """List the newest campaigns or experiments of a coordinator in a few words."""
    if noun == "campaigns":  # without follow-ups, as `brink status` lists them
        listed = await api.get("/overview", {"limit": IDS_SHOWN + 1, "follow_ups": "hidden"})
        found = [f"{one} ({name})" for one, name in zip(listed["id"], listed["name"], strict=True)]
    else:
        page = await api.get(f"/{noun}", {"limit": IDS_SHOWN + 1})
        found = [f"{one['id']} ({one['name']})" for one in page[noun]]
    if not found:
        return "which has none"
    more = ", …" if len(found) > IDS_SHOWN else ""
    return f"which has {', '.join(found[:IDS_SHOWN])}{more}"


def with_api(server: str | None, database: str | None, work: Callable[[Api], Awaitable[T]]) -> T:
    """Call `work` with the API of a coordinator, and return its result.

    Args:
        server: URL of the coordinator; None opens the database in this process.
        database: URL of the database; None takes the default one.
        work: Called with the API.

    Raises:
        CoordinatorError: A request failed.
        DatabaseError: The database is missing or unusable.
        InvalidInput: The URL or the token is malformed.
    """
    # Not returned by the task: `asyncio.run` formats the finished task, which takes long for arrays.
    results: list[T] = []

    async def run() -> None:
        if server is None:
            settings = settings_with(database=database)
            opened, place = in_process(settings), database_place(settings)
        else:
            opened, place = connect(server, os.environ.get("BRINK_TOKEN") or None), server
        async with opened as api:
            with_option = place_option(server, database)
            results.append(await naming_ids(api, place, with_option, lambda: work(api)))

    asyncio.run(run())
    return results[0]


def delete_confirmed(
    path: str, what: str, *, confirmed: bool, server: str | None, database: str | None
) -> None:
    """Delete a campaign or an experiment once the user has confirmed, after listing its follow-ups.

    Args:
        path: Path of the resource.
        what: Description of the resource, for the prompt.
        confirmed: Delete without asking.
        server: URL of the coordinator; None opens the database in this process.
        database: URL of the database; None takes the default one.

    Raises:
        CoordinatorError: The resource cannot be deleted.
    """
    from brink.server.api.schemas import Deletion

    if not confirmed:
        doomed = with_api(server, database, lambda api: api.read(Deletion, f"{path}/deletion"))
        follow_ups = [one for one in doomed.campaigns if one.follow_up_of]
        for one in follow_ups:
            print_line(f"{one.id}  {one.name}  follow-up of {one.follow_up_of}")
        also = f" and {len(follow_ups)} follow-ups" if follow_ups else ""
        typer.confirm(f"delete {what}{also}? This cannot be undone", abort=True)
    with_api(server, database, lambda api: api.request("DELETE", path))
    print_line(f"{what} is deleted")


@contextmanager
def about_file(file: Path) -> Iterator[None]:
    """Locate in a campaign or experiment file the fields that were rejected, here or by a coordinator.

    Raises:
        InvalidInput: The file is invalid, or the coordinator rejected it.
    """
    from brink.server.documents import errors_in_file, placed_in_file

    try:
        with errors_in_file(file):
            yield
    except CoordinatorError as error:
        if not error.errors:
            raise
        raise InvalidInput(placed_in_file(error.errors, file)) from None


def print_json(document: Any) -> None:
    """Print a value as JSON."""
    echo(json.dumps(document, indent=2))


def write_json(file: Path, document: Any) -> None:
    """Write a value to a file as JSON."""
    file.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def fields(value: Any, *names: str) -> dict[str, Any]:
    """Return some attributes of an object by name; without names, all slots of a dataclass."""
    return {name: getattr(value, name) for name in names or value.__slots__}


def console(*, stderr: bool = False) -> Console:
    """Return a console; if it is not a terminal, it is wide enough for the tables of all commands."""
    screen = PlainConsole(stderr=stderr)
    if screen.is_terminal or stderr:
        return screen
    return PlainConsole(width=PLAIN_WIDTH)


def print_line(text: str) -> None:
    """Print a line without wrapping."""
    console().print(text, soft_wrap=True)


def print_sentence(screen: Console, text: str | Text, style: str | None = None) -> None:
    """Print a sentence that contains nothing to paste: wrapped on a terminal, on one line elsewhere."""
    screen.print(text, soft_wrap=not screen.is_terminal, style=style)


def check_out(file: Path, *endings: str, option: str = "--out", make_folder: bool = False) -> None:
    """Check that a file can be written, before anything slow begins.

    Args:
        file: The file.
        endings: Endings of its name, of which it must have one; without any, all are allowed.
        option: The option that names the file, for messages.
        make_folder: Whether to make the folder if there is none.

    Raises:
        InvalidInput: The name ends in something else, or the file cannot be written.
    """
    if endings and file.suffix.lower() not in endings:
        names = " or ".join(filter(None, [", ".join(endings[:-1]), endings[-1]]))
        raise InvalidInput.at(option, f"{file}: expected a file name that ends in {names}")
    if make_folder:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput.at(option, f"expected a folder, {file.parent}: {error.strerror}") from None
    if not file.parent.is_dir():
        raise InvalidInput.at(option, f"{file.parent}: no such folder")
    if file.is_dir():
        raise InvalidInput.at(option, f"expected a file, {file} is a folder")
    if not os.access(file.parent, os.W_OK):
        raise InvalidInput.at(option, f"{file.parent} is not writable")


def check_picture(file: Path | None) -> None:
    """Check that a picture can be written, before anything slow begins; its folder is made if there is none.

    Raises:
        InvalidInput: It cannot, or its name ends in something other than .png, .svg or .pdf.
    """
    if file is not None:
        check_out(file, ".png", ".svg", ".pdf", option="--picture", make_folder=True)


def file_name(name: str) -> str:
    """Return the name of a campaign or an experiment in a form that is safe in file names."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in name)[:60]
