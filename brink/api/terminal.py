"""The one place that writes to the terminal. Control characters in untrusted text are shown, not executed."""

import sys
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from brink.worker.printable import printable


class PlainConsole(Console):
    """A console that shows texts as they are: names and messages may contain square brackets and control characters.

    Args:
        settings: Those of `rich.console.Console`.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **settings)

    def render_str(self, text: str, **settings: Any) -> Text:
        """Return a string as text; the settings are those of `rich.console.Console.render_str`."""
        return super().render_str(printable(text), **settings)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render an object; rich's own control sequences are separate segments."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def echo(text: object, *, nl: bool = True, err: bool = False) -> None:
    """Write text unchanged to a file or a pipe, and made printable to a terminal.

    Args:
        text: The text.
        nl: Whether to end it with a line feed.
        err: Whether to write to standard error.
    """
    stream = sys.stderr if err else sys.stdout
    stream.write((printable(str(text)) if stream.isatty() else str(text)) + "\n" * nl)
    stream.flush()


def plain_table(
    *columns: str,
    rows: Iterable[Sequence[str | Text]] = (),
    right: Collection[str] = (),
    title: str | None = None,
) -> Table:
    """Return a table without borders.

    Args:
        columns: Column headers.
        rows: Its first rows.
        right: Columns aligned to the right.
        title: Title above the table.
    """
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, header_style="dim")
    for name in columns:
        table.add_column(name, justify="right" if name in right else "left")
    for row in rows:
        table.add_row(*row)
    return table
