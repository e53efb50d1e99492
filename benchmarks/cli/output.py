"""Shared by all measurements: progress, tables of figures and targets, JSON, and the exit status."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from rich.console import RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBars
from rich.table import Table

from benchmarks.measurement import Progress, Row
from brink.cli.options import console, fields, plain_table, print_json

Processes = Annotated[int, typer.Option(min=1, help="Number of processes.")]


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Yield a progress callback that draws bars on a terminal, and otherwise prints a line every 10%."""
    screen = console(stderr=True)
    bars = ProgressBars(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=screen,
        transient=True,
    )
    parts: dict[str, TaskID] = {}
    tenths: dict[str, int] = {}

    def report(part: str, done: int, total: int) -> None:
        if part not in parts:
            parts[part] = bars.add_task(part, total=total)
        bars.update(parts[part], completed=done, visible=screen.is_terminal and done < total)
        tenth = 10 * done // max(1, total)
        if not screen.is_terminal and tenths.get(part) != tenth:
            screen.print(f"{part}: {done} of {total}", highlight=False)
        tenths[part] = tenth

    with bars:
        yield report


def conclude(document: Any, *shown: RenderableType, as_json: bool, missed: bool = False) -> None:
    """Print a measurement as JSON or as text, and exit with 1 if it misses a target.

    Args:
        document: JSON document of the measurement.
        shown: Tables and lines of the text output.
        as_json: Whether to print the document.
        missed: Whether a target is missed.
    """
    if as_json:
        print_json(document)
    else:
        screen = console()
        for part in shown:
            screen.print(part)
    if missed:
        raise typer.Exit(1)


def conclude_rows(measured: Iterable[Row], *, as_json: bool) -> None:
    """Print measured figures with their targets, and exit with 1 if a target is missed."""
    rows = list(measured)
    conclude([fields(row) for row in rows], rows_table(rows), as_json=as_json, missed=any_missed(rows))


def rows_table(rows: Iterable[Row], form: str = ".4g") -> Table:
    """Return a table of measured figures with their targets.

    Args:
        rows: The figures.
        form: Format of their values.
    """
    return value_table(
        ("what", "value", "target", "", "of"),
        ((row.what, format(row.value, form), row.target, met_text(row.met), row.note) for row in rows),
    )


def any_missed(rows: Iterable[Row]) -> bool:
    """Return whether a figure misses its target."""
    return any(row.met is False for row in rows)


def value_table(columns: Sequence[str], rows: Iterable[Sequence[object]] = ()) -> Table:
    """Return a table whose values are aligned to the right."""
    table = plain_table(*columns, right={*columns[1:]} - {"target", "", "of"})
    for row in rows:
        table.add_row(*map(str, row))
    return table


def met_text(met: bool | None) -> str:
    """Return whether a target is met; empty if there is none."""
    return {None: "", True: "met", False: "MISSED"}[met]
