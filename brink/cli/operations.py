"""Commands for whoever keeps a coordinator running: doctor, export, import, db prune."""

import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from brink.cli.options import (
    AsJson,
    Database,
    brink,
    console,
    database_option,
    file_name,
    print_json,
    settings_with,
)
from brink.server.campaigns.store import CAMPAIGNS
from brink.server.db.engine import open_engines
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.errors import DatabaseError, FieldError, InvalidInput
from brink.server.operations.doctor import State, examine
from brink.server.operations.prune import prune
from brink.server.operations.transfer import export_campaign, import_campaign
from brink.server.runtime.database import check_database, check_exists, prepare_database, shown_url
from brink.server.states import CampaignStatus

db = typer.Typer(help="The database: upgrade it, or say which schema it has.", no_args_is_help=True)

_COLOURS = {State.FINE: "green", State.LOOK: "yellow", State.WRONG: "red"}


def doctor(
    thorough: Annotated[
        bool,
        typer.Option(
            "--thorough", help="Read all checkpoints and distances, too, and compute some distances again."
        ),
    ] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Examine the database, its campaigns, jobs and workers; say what is wrong and what to do.

    Exits with 1 if something is wrong. It changes nothing.

    Example: brink doctor --thorough
    """
    settings = settings_with(database=database)
    check_exists(settings)
    engines = open_engines(settings.database)
    try:
        found = list(examine(settings, engines, thorough=thorough))
    finally:
        engines.dispose()
    if as_json:
        print_json(
            [{"check": f.check, "state": f.state, "found": f.found, "advice": f.advice} for f in found]
        )
    else:
        table = Table(box=None, pad_edge=False, show_header=False)
        for one in found:
            colour = _COLOURS[one.state]
            words = escape(one.found) + (f"\n[dim]{escape(one.advice)}[/dim]" if one.advice else "")
            table.add_row(f"[{colour}]{one.state}[/{colour}]", one.check, words)
        console().print(table)
    raise typer.Exit(1 if any(one.state is State.WRONG for one in found) else 0)


def export(
    campaign: Annotated[str, typer.Argument(help="Campaign id, or the beginning of one.", metavar="ID")],
    out: Annotated[
        Path | None, typer.Option(help="File to write.  [default: NAME-ID.brink]", show_default=False)
    ] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write a campaign and everything that belongs to it to one file, to be kept or taken in elsewhere.

    Example: brink export 3f2a --out traffic.brink
    """
    settings = settings_with(database=database)
    check_database(settings)
    engines = open_engines(settings.database)
    try:
        with engines.reader.connect() as connection:
            found = CAMPAIGNS.get(connection, campaign)
            file = out or Path(f"{file_name(found.body.name)}-{found.id}.brink")
            counts = export_campaign(connection, found.id, file)
    finally:
        engines.dispose()
    _told(
        f"campaign {found.id} written to {file}",
        {"campaign": found.id, "file": str(file)},
        counts,
        as_json,
    )


def import_(
    file: Annotated[Path, typer.Argument(help="A file that brink export wrote.", metavar="FILE")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Take in a campaign from a file. One that was running is paused; its results are not lent to other campaigns.

    Example: brink import traffic.brink
    """
    settings = settings_with(database=database)
    prepare_database(settings)
    engines = open_engines(settings.database)
    try:
        with engines.writer.begin() as connection:
            campaign, counts = import_campaign(connection, file)
            status = CAMPAIGNS.get(connection, campaign).status
    finally:
        engines.dispose()
    _told(f"campaign {campaign} taken in from {file}", {"campaign": campaign}, counts, as_json)
    if status is CampaignStatus.PAUSED and not as_json:
        hint = f"it is paused; go on with: {brink()} resume {campaign}{database_option(settings)}"
        console().print(hint, soft_wrap=True, markup=False)


def _told(words: str, facts: dict[str, str], counts: dict[str, int], as_json: bool) -> None:
    if as_json:
        print_json({**facts, "rows": counts})
        return
    said = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
    console().print(f"{words}: {said}", soft_wrap=True, markup=False)


@db.command("prune")
def prune_(
    ended_days: Annotated[
        float | None, typer.Option(min=0.0, help="Campaigns that ended more than so many days ago go.")
    ] = None,
    traces_days: Annotated[
        float | None,
        typer.Option(min=0.0, help="Traces made more than so many days ago go; replays make them again."),
    ] = None,
    really: Annotated[
        bool, typer.Option("--yes", help="Delete; without it, only say what would go.")
    ] = False,
    database: Database = None,
) -> None:
    """Delete what is older than it may be. Says what would go; deletes it with --yes.

    Example: brink db prune --ended-days 90 --traces-days 14 --yes
    """
    if ended_days is None and traces_days is None:
        raise InvalidInput(
            [
                FieldError(
                    pointer="--ended-days", message="expected this or --traces-days: how old may things be?"
                )
            ]
        )
    settings = settings_with(database=database)
    check_database(settings)
    engines = open_engines(settings.database)
    try:
        with engines.writer.begin() as connection:
            found = prune(
                connection,
                ended=None if ended_days is None else timedelta(days=ended_days),
                traces=None if traces_days is None else timedelta(days=traces_days),
                really=really,
            )
    finally:
        engines.dispose()
    screen = console()
    for campaign, name in found.campaigns:
        screen.print(f"{campaign}  {name}", markup=False)
    said = "deleted" if really else "would be deleted; add --yes"
    screen.print(
        f"{len(found.campaigns)} campaigns with {found.solutions} solutions, {found.traces} traces: {said}",
        markup=False,
    )
    if really and settings.sqlite_file is not None:
        _shrink(settings.sqlite_file)


def _shrink(file: Path) -> None:
    """Give back to the disk what is free in an SQLite file.

    Raises:
        DatabaseError: That cannot be done now.
    """
    try:
        with closing(sqlite3.connect(file)) as connection:
            connection.execute("VACUUM")  # not in a transaction, as all of ours are
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    except sqlite3.Error as error:
        raise DatabaseError(
            f"all that is deleted, but {file} keeps its size ({error}): shrinking needs as much free space as the "
            "file has, and nobody who writes to it; stop the coordinator and say it again"
        ) from None


@db.command("upgrade")
def db_upgrade(database: Database = None) -> None:
    """Bring a database to this version's schema; makes a new one if there is none.

    Example: brink db upgrade --database sqlite:///brink.db
    """
    settings = settings_with(database=database)
    before, after = prepare_database(settings)
    where = shown_url(settings)
    if before == after:
        typer.echo(f"{where}: schema {after} already")
    else:
        typer.echo(f"{where}: upgraded from schema {before or 'none'} to {after}")


@db.command("status")
def db_status(database: Database = None) -> None:
    """Say which schema a database has, and which this version needs.

    Example: brink db status
    """
    settings = settings_with(database=database)
    path: Path | None = settings.sqlite_file
    revision = None
    if path is None or path.exists():
        engines = open_engines(settings.database)
        try:
            revision = current_revision(engines)
        finally:
            engines.dispose()
    typer.echo(f"schema {revision or 'none'}; this version needs {head_revision()}")
    if revision != head_revision():
        raise typer.Exit(1)
