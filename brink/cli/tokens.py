"""Commands for tokens: create, list, revoke. They work on the database: whoever can read it may do everything."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table
from sqlalchemy import Connection

from brink.cli.options import AsJson, Database, console, print_json, settings_with
from brink.server.access.authentication import TOKEN_CACHE_S
from brink.server.access.tokens import create_token, list_tokens, revoke_token
from brink.server.db.engine import open_engines
from brink.server.runtime.database import check_database, prepare_database, shown_url
from brink.server.states import Scope

token = typer.Typer(
    help="Tokens, without which a coordinator answers nobody once there is one.", no_args_is_help=True
)


@contextmanager
def _connected(database: str | None, *, new: bool = False) -> Iterator[Connection]:
    settings = settings_with(database=database)
    if new:
        prepare_database(settings)
    else:
        check_database(settings)
    engines = open_engines(settings.database)
    try:
        with engines.writer.begin() as connection:
            yield connection
    finally:
        engines.dispose()


@token.command()
def create(
    name: Annotated[str, typer.Argument(help="What you call it: who has it, or what for.", metavar="NAME")],
    scope: Annotated[
        Scope,
        typer.Option(
            help="read: look at everything; user: submit and steer campaigns, too; worker: lease and report jobs "
            "and nothing else; admin: everything."
        ),
    ],
    days: Annotated[
        float | None, typer.Option(min=0.01, max=36_500, help="It ends after so many days.")
    ] = None,
    database: Database = None,
) -> None:
    """Create a token and print it, once. From then on the coordinator answers nobody without one.

    Example: brink token create --scope worker "the cluster"
    """
    if not 1 <= len(name) <= 200 or not name.isprintable():
        raise typer.BadParameter("expected 1 to 200 printable characters", param_hint="NAME")
    with _connected(database, new=True) as connection:
        made = create_token(connection, scope, name, None if days is None else timedelta(days=days))
    typer.echo(made)
    typer.echo(
        f"a token of {shown_url(settings_with(database=database))}, shown this once; give it on as BRINK_TOKEN. "
        f"It works within {TOKEN_CACHE_S:g} s",
        err=True,
    )


@token.command("list")
def list_(database: Database = None, as_json: AsJson = False) -> None:
    """List tokens, without what is secret of them.

    Example: brink token list
    """
    with _connected(database) as connection:
        found = list_tokens(connection)
    now = datetime.now(UTC)
    if as_json:
        print_json(
            [
                {
                    "id": one.id, "name": one.name, "scope": one.scope, "created_at": one.created_at.isoformat(),
                    "expires_at": one.expires_at.isoformat() if one.expires_at else None,
                    "revoked_at": one.revoked_at.isoformat() if one.revoked_at else None,
                }
                for one in found
            ]
        )  # fmt: skip
        return
    if not found:
        console().print("no tokens; brink token create NAME --scope user makes one")
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("id", "scope", "name", "created", "state"):
        table.add_column(column)
    for one in found:
        ends = f"until {one.expires_at:%Y-%m-%d %H:%M} UTC" if one.expires_at else "works"
        state = "revoked" if one.revoked_at else ends if one.is_valid(now) else "ended"
        table.add_row(one.id, one.scope, escape(one.name), f"{one.created_at:%Y-%m-%d %H:%M}", state)
    console().print(table)


@token.command()
def revoke(
    token_id: Annotated[
        str, typer.Argument(help="Id of the token: the third part of it, or see list.", metavar="ID")
    ],
    database: Database = None,
) -> None:
    """End a token.

    Example: brink token revoke 1f3a90bc
    """
    with _connected(database) as connection:
        revoke_token(connection, token_id)
    console().print(f"token {token_id} ends within {TOKEN_CACHE_S:g} s")
