"""Tables of findings in the terminal."""

from rich.console import Console
from rich.table import Table as TerminalTable

from brink.cli.options import plain_table
from brink.server.findings.table import Table


def terminal_table(table: Table, shown: int | None = None) -> TerminalTable:
    """Return the first rows of a table for the terminal."""
    columns = table.shown
    drawn = plain_table(*(one.heading for one in columns))
    for place, column in enumerate(columns):
        drawn.columns[place].justify = "right" if column.format.is_numeric else "left"
    for row in table.texts(shown):
        drawn.add_row(*row)
    return drawn


def print_table(screen: Console, table: Table, shown: int | None = None, *, more: str = "") -> None:
    """Print the first rows of a table, and how many more there are.

    Args:
        screen: Where to print.
        table: The table.
        shown: Most rows to print.
        more: How to see the others.
    """
    if not table.rows:
        return
    screen.print(terminal_table(table, shown))
    hidden = len(table.rows[shown:] if shown is not None else []) + table.left_out
    if hidden:
        screen.print(f"… and {hidden:,} more{f': {more}' if more else ''}", style="dim", soft_wrap=True)
