"""Commands on the database itself: db, token, doctor, export, import.

They need no coordinator and no token: anyone with access to the database can do everything.
"""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from brink.api.terminal import echo
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    console,
    database_option,
    fields,
    file_name,
    plain_table,
    print_json,
    print_line,
    program,
    settings_with,
)
from brink.server.errors import DatabaseError, InvalidInput
from brink.server.seeding import seeder
from brink.server.states import CampaignStatus, Scope

if TYPE_CHECKING:
    from brink.server.db.engine import Engines
    from brink.server.operations.prune import Pruned
    from brink.server.settings import Settings

db = typer.Typer(help="Upgrade or prune the database, or show its schema version.", no_args_is_help=True)
token = typer.Typer(
    help="Create, list and revoke tokens. Once one exists, the coordinator rejects requests without a token.",
    no_args_is_help=True,
)


@contextmanager
def _opened(
    settings: "Settings", prepare: "Callable[[Settings], object] | None" = None
) -> "Iterator[Engines]":
    """Yield a database after it was checked, or prepared in another way, such as created or upgraded."""
    from brink.server.db.engine import open_engines
    from brink.server.runtime.database import check_database

    (prepare or check_database)(settings)
    engines = open_engines(settings.database)
    try:
        yield engines
    finally:
        engines.dispose()


def doctor(
    thorough: Annotated[
        bool,
        typer.Option(
            "--thorough", help="Read all results, checkpoints and distances, and recompute some distances."
        ),
    ] = False,
    restored: Annotated[
        bool,
        typer.Option(
            "--restored", help="Check only what is stored, in a database that was restored from a backup."
        ),
    ] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Check the database, its campaigns, jobs and workers; report problems and how to fix them.

    Exits with 1 if something is wrong. It changes nothing.

    Example: brink doctor --thorough
    """
    from brink.server.operations.doctor import State, examine
    from brink.server.runtime.database import check_exists

    settings = settings_with(database=database)
    with _opened(settings, check_exists) as engines:
        found = list(examine(settings, engines, thorough=thorough, restored=restored))
    if as_json:
        print_json([fields(one, "check", "state", "found", "advice") for one in found])
    else:
        table = Table(box=None, pad_edge=False, show_header=False)
        colours = {State.FINE: "green", State.LOOK: "yellow", State.WRONG: "red"}
        for one in found:
            finding = Text.assemble(one.found, (f"\n{one.advice}" if one.advice else "", "dim"))
            table.add_row(Text(one.state, colours[one.state]), one.check, finding)
        console().print(table)
    raise typer.Exit(1 if any(one.state is State.WRONG for one in found) else 0)


def export(
    campaign: CampaignId,
    out: Annotated[
        Path | None, typer.Option(help="File to write.  [default: NAME-ID.brink]", show_default=False)
    ] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write a campaign with all its data and follow-ups to one file, to archive it or import it elsewhere.

    Example: brink export campaign 3f2a --out traffic.brink
    """
    from brink.server.campaigns.store import CAMPAIGNS
    from brink.server.operations.transfer import export_campaign

    with _opened(settings_with(database=database)) as engines, engines.reader.connect() as connection:
        found = CAMPAIGNS.get(connection, campaign)
        file = out or Path(f"{file_name(found.body.name)}-{found.id}.brink")
        counts = export_campaign(connection, found.id, file)
    facts = {"campaign": found.id, "file": str(file)}
    _print_transfer(f"campaign {found.id} written to {file}", facts, counts, as_json)


def import_(
    file: Annotated[Path, typer.Argument(help="File written by `brink export`.", metavar="FILE")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Read a campaign and its follow-ups from a file.

    Running campaigns become paused. Other campaigns cannot reuse the results of imported ones. A campaign that may
    still run can use only the language models and keys that BRINK_LLM_ENDPOINTS allows.

    Example: brink import traffic.brink
    """
    from brink.server.campaigns.store import CAMPAIGNS
    from brink.server.operations.export_file import open_export
    from brink.server.operations.transfer import import_campaign
    from brink.server.runtime.database import prepare_database

    settings = settings_with(database=database)
    access = seeder().access(settings.llm_endpoints)
    with (
        open_export(file) as export,  # first, so that a file that is none leaves no database behind
        _opened(settings, prepare_database) as engines,
        engines.writer.begin() as connection,
    ):
        campaigns, counts = import_campaign(connection, export, access)
        found = [CAMPAIGNS.get(connection, campaign) for campaign in campaigns]
    _print_transfer(
        f"campaign {campaigns[0]} imported from {file}", {"campaign": campaigns[0]}, counts, as_json
    )
    for campaign in found:
        if campaign.status is CampaignStatus.PAUSED and not as_json:
            which = "it" if campaign.id == campaigns[0] else f"its follow-up {campaign.id}"
            resume = f"{program()} resume {campaign.id}{database_option(settings)}"
            print_line(f"{which} is paused; continue it with: {resume}")


def _print_transfer(line: str, facts: dict[str, str], counts: dict[str, int], as_json: bool) -> None:
    if as_json:
        print_json({**facts, "rows": counts})
        return
    rows = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
    print_line(f"{line}: {rows}")


@db.command("prune")
def prune_(
    ended_days: Annotated[
        float | None, typer.Option(min=0.0, help="Delete campaigns that ended more than this many days ago.")
    ] = None,
    traces_days: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Delete traces recorded more than this many days ago; replays record them again."
        ),
    ] = None,
    confirmed: Annotated[
        bool, typer.Option("--yes", help="Delete; without it, only show what would be deleted.")
    ] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Delete old campaigns and traces. Without --yes, only show what would be deleted.

    A campaign goes together with its follow-ups, and with the other campaigns of its experiment, once all of them
    ended that long ago.

    Example: brink db prune --ended-days 90 --traces-days 14 --yes
    """
    from brink.server.campaigns.deletion import erase_all
    from brink.server.operations.prune import prune

    if ended_days is None and traces_days is None:
        raise InvalidInput.at(
            "--ended-days",
            "expected this option, --traces-days or both: the age in days from which to delete",
        )
    settings = settings_with(database=database)
    with _opened(settings) as engines:
        with engines.writer.begin() as connection:
            found = prune(
                connection,
                ended=None if ended_days is None else timedelta(days=ended_days),
                traces=None if traces_days is None else timedelta(days=traces_days),
                really=confirmed,
            )
        if confirmed:
            erase_all(engines)
    _print_pruned(found, deleted=confirmed, as_json=as_json)
    if confirmed and settings.sqlite_file is not None:
        _shrink(settings.sqlite_file)


def _print_pruned(found: "Pruned", *, deleted: bool, as_json: bool) -> None:
    if as_json:
        campaigns = [
            {
                **fields(one, "id", "name", "status", "follow_up_of"),
                "finished_at": one.finished_at.isoformat() if one.finished_at else None,
            }
            for one in found.campaigns
        ]
        print_json({"deleted": deleted, "campaigns": campaigns, **fields(found, "solutions", "traces")})
        return
    for one in found.campaigns:
        of = f"  follow-up of {one.follow_up_of}" if one.follow_up_of else ""
        print_line(f"{one.id}  {one.name}{of}")
    outcome = "deleted" if deleted else "would be deleted; add --yes"
    print_line(
        f"{len(found.campaigns)} campaigns with {found.solutions} solutions, {found.traces} traces: {outcome}"
    )


def _shrink(file: Path) -> None:
    """Release the free pages of an SQLite file to the file system.

    Raises:
        DatabaseError: The file cannot be shrunk now.
    """
    try:
        with closing(sqlite3.connect(file)) as connection:
            connection.execute("VACUUM")  # impossible in a transaction, which our engines always use
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    except sqlite3.Error as error:
        raise DatabaseError(
            f"the old data is deleted, but {file} keeps its size ({error}). Shrinking needs as much free disk space "
            "as the file occupies, and no other writer: stop the coordinator and run the command again"
        ) from None


@db.command("upgrade")
def db_upgrade(database: Database = None) -> None:
    """Upgrade a database to the schema of this version, or create it.

    Example: brink db upgrade --database sqlite:///brink.db
    """
    from brink.server.runtime.database import prepare_database, shown_url

    settings = settings_with(database=database)
    before, after = prepare_database(settings)
    where = shown_url(settings)
    if before == after:
        echo(f"{where}: schema {after} is up to date")
    else:
        echo(f"{where}: upgraded from schema {before or 'none'} to {after}")


@db.command("status")
def db_status(database: Database = None) -> None:
    """Show the schema version of a database, and the one that this version of Brink needs.

    Example: brink db status
    """
    from brink.server.db.upgrade import current_revision, head_revision
    from brink.server.runtime.database import check_exists

    settings = settings_with(database=database)
    path: Path | None = settings.sqlite_file
    revision = None
    if path is None or path.exists():
        with _opened(settings, check_exists) as engines:
            revision = current_revision(engines)
    echo(f"schema {revision or 'none'}; this version needs {head_revision()}")
    if revision != head_revision():
        raise typer.Exit(1)


@token.command()
def create(
    name: Annotated[str, typer.Argument(help="Name of the token: its owner or its purpose.", metavar="NAME")],
    scope: Annotated[
        Scope,
        typer.Option(
            help="read: view everything; user: also submit and control campaigns; worker: only lease and report "
            "jobs; admin: everything."
        ),
    ],
    days: Annotated[
        float | None, typer.Option(min=0.01, max=36_500, help="The token expires after this many days.")
    ] = None,
    database: Database = None,
) -> None:
    """Create a token and print it once. From then on, the coordinator rejects requests without a token.

    Example: brink token create --scope worker "the cluster"
    """
    from brink.server.access.authentication import TOKEN_CACHE_S
    from brink.server.access.tokens import create_token
    from brink.server.runtime.database import prepare_database, shown_url

    if not 1 <= len(name) <= 200 or not name.isprintable():
        raise typer.BadParameter("expected 1 to 200 printable characters", param_hint="NAME")
    settings = settings_with(database=database)
    with _opened(settings, prepare_database) as engines, engines.writer.begin() as connection:
        created = create_token(connection, scope, name, None if days is None else timedelta(days=days))
    echo(created)
    echo(
        f"a token for {shown_url(settings)}, shown only once; pass it on as BRINK_TOKEN. "
        f"It becomes valid within {TOKEN_CACHE_S:g} s",
        err=True,
    )


@token.command("list")
def list_(database: Database = None, as_json: AsJson = False) -> None:
    """List tokens, without their secret parts.

    Example: brink token list
    """
    from brink.server.access.tokens import list_tokens

    with _opened(settings_with(database=database)) as engines, engines.writer.begin() as connection:
        found = list_tokens(connection)
    if as_json:
        times = ("created_at", "expires_at", "revoked_at")
        print_json(
            [
                fields(one, "id", "name", "scope")
                | {name: at and at.isoformat() for name, at in fields(one, *times).items()}
                for one in found
            ]
        )
        return
    if not found:
        console().print("no tokens yet; create one with: brink token create NAME --scope user")
        return
    now = datetime.now(UTC)
    table = plain_table("id", "scope", "name", "created", "state")
    for one in found:
        valid = f"valid until {one.expires_at:%Y-%m-%d %H:%M} UTC" if one.expires_at else "valid"
        state = "revoked" if one.revoked_at else valid if one.is_valid(now) else "expired"
        table.add_row(one.id, one.scope, one.name, f"{one.created_at:%Y-%m-%d %H:%M}", state)
    console().print(table)


@token.command()
def revoke(
    token_id: Annotated[
        str, typer.Argument(help="Id of the token: its third part, as in `brink token list`.", metavar="ID")
    ],
    database: Database = None,
) -> None:
    """Revoke a token.

    Example: brink token revoke 1f3a90bc
    """
    from brink.server.access.authentication import TOKEN_CACHE_S
    from brink.server.access.tokens import revoke_token

    with _opened(settings_with(database=database)) as engines, engines.writer.begin() as connection:
        revoke_token(connection, token_id)
    console().print(f"token {token_id} will be rejected within {TOKEN_CACHE_S:g} s")
