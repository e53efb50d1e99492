"""What the commands of `brink bench` share: how far a measurement is, and tables of figures beside their targets."""

from collections.abc import Callable

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from brink.cli.options import console, print_json
from brink.sim.figures import Row


def teller(progress: Progress) -> Callable[[str, int, int], None]:
    """Return what shows how far each part of a measurement is: bars, or lines where bars cannot be drawn."""
    parts: dict[str, TaskID] = {}
    tenths: dict[str, int] = {}
    bars = progress.console.is_terminal

    def tell(part: str, done: int, total: int) -> None:
        if part not in parts:
            parts[part] = progress.add_task(part, total=total)
        progress.update(parts[part], completed=done, visible=bars and done < total)
        tenth = 10 * done // max(1, total)
        if not bars and tenths.get(part) != tenth:
            progress.console.print(f"{part}: {done} of {total}", highlight=False)
        tenths[part] = tenth

    return tell


def print_figures(rows: list[Row], *, as_json: bool) -> None:
    """Print measured figures beside their targets; exit with 1 if one is missed."""
    if as_json:
        print_json([{name: getattr(row, name) for name in row.__slots__} for row in rows])
    else:
        table = figure_table("what", "value", "target", "", "of")
        for row in rows:
            table.add_row(row.what, f"{row.value:.4g}", row.target, said(row.met), row.note)
        console().print(table)
    if any(row.met is False for row in rows):
        raise typer.Exit(1)


def bars(screen: Console) -> Progress:
    """Return what shows how far measurements are."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=screen, transient=True,
    )  # fmt: skip


def figure_table(*columns: str) -> Table:
    """Return a table whose figures are aligned to the right."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index == 0 or name in ("target", "", "of") else "right")
    return table


def said(met: bool | None) -> str:
    """Return whether a target is met, in words."""
    return {None: "", True: "met", False: "MISSED"}[met]
