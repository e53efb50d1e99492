"""Commands for whoever keeps a coordinator running: doctor."""

from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from server.cli.options import AsJson, Database, console, print_json, settings_with
from server.db.engine import open_engines
from server.operations.doctor import State, examine

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
