"""Tables of findings: columns with names, units and formats, rows of plain values, and their files.

Every renderer (terminal, Markdown, HTML, CSV, data frame, dashboard) shows any table from this alone.
"""

import io
import json
from collections.abc import Mapping, Sequence
from enum import StrEnum
from importlib.util import find_spec
from types import UnionType
from typing import Annotated, Final, TypeAlias

from pydantic import Field

from brink.extras import install_command
from brink.server.csv_text import csv_text
from brink.server.errors import InvalidInput
from brink.server.views import View

Cell: TypeAlias = str | int | float | bool | None
Row: TypeAlias = dict[str, Cell]

FORMATS: Final = ("csv", "jsonl", "parquet")
MOST_ROWS: Final = 1_000
"""Most rows of a table that is asked for over HTTP."""


class Format(StrEnum):
    """How the values of a column are written; every value may be missing."""

    TEXT = "text"
    COUNT = "count"
    NUMBER = "number"
    SHARE = "share"
    """A fraction of 1, shown in per cent."""
    FLAG = "flag"
    SOLUTION = "solution"
    """Number of a solution of the campaign."""
    STATE = "state"
    """A state in a word or two, such as ``unsafe`` or ``confirmed``, which a page may colour."""

    @property
    def type(self) -> type:
        """Type of the values."""
        types = {Format.COUNT: int, Format.SOLUTION: int, Format.FLAG: bool}
        return types.get(self, float if self.is_numeric else str)

    @property
    def is_numeric(self) -> bool:
        """Whether values are numbers, which are aligned to the right."""
        return self in (Format.COUNT, Format.NUMBER, Format.SHARE)


class Column(View):
    """A column of a table."""

    name: Annotated[str, Field(description="Name in files and data frames.")]
    title: Annotated[str, Field(description="Heading, in words.")]
    unit: str = ""
    format: Format = Format.TEXT
    detail: Annotated[
        bool, Field(description="Whether only files and data frames have it: a page is too narrow.")
    ] = False
    optional: Annotated[bool, Field(description="Whether values may be missing.")] = False
    below: Annotated[
        bool, Field(description="Whether a page writes it below the column before it, to save width.")
    ] = False
    page: Annotated[
        str,
        Field(
            description="Page of the campaign that a value links to, with names of columns in braces, such as "
            "`pairs/{safe}-{unsafe}`; empty for none. Solutions link to their pages without it."
        ),
    ] = ""

    @property
    def heading(self) -> str:
        """The title with the unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


class Table(View):
    """A table of a finding."""

    name: str
    title: str
    columns: list[Column]
    rows: Annotated[list[list[Cell]], Field(description="One value per column.")]
    left_out: Annotated[int, Field(description="Rows that were left out, after these.")] = 0
    file: Annotated[
        str,
        Field(
            description="Path of a file with more columns, below the campaign's and with a query; empty for none."
        ),
    ] = ""

    @property
    def shown(self) -> list[Column]:
        """The columns that a page shows, without those that it writes below another one."""
        return [column for column in self.columns if not column.detail and not column.below]

    def texts(self, most: int | None = None) -> list[list[str]]:
        """Return the first rows as texts, in the columns that a page shows; what is below is on its own line."""
        rows = []
        for row in self.rows[:most]:
            texts: list[str] = []
            for cell, column in zip(row, self.columns, strict=True):
                text = cell_text(cell, column.format)
                if column.below and text:
                    what = f"{column.title} " if column.format is Format.SOLUTION else ""
                    texts[-1] = f"{texts[-1]}\n{what}{text}"
                elif not column.detail and not column.below:
                    texts.append(text)
            rows.append(texts)
        return rows

    def records(self) -> list[Row]:
        """Return the rows with their values by column name."""
        names = [column.name for column in self.columns]
        return [dict(zip(names, row, strict=True)) for row in self.rows]

    def types(self) -> dict[str, type]:
        """Return the type of the values of each column."""
        return {column.name: column.format.type for column in self.columns}

    def optional_types(self) -> dict[str, type | UnionType]:
        """Return the same with None where values may be missing."""
        return {
            column.name: column.format.type | None if column.optional else column.format.type
            for column in self.columns
        }

    def to_bytes(self, form: str) -> bytes:
        """Encode the table as a file.

        Args:
            form: One of `FORMATS`.

        Raises:
            InvalidInput: The format is Parquet, and pyarrow is not installed.
        """
        return table_bytes(self.records(), form, self.types())


def cell_text(cell: Cell, form: Format) -> str:
    """Return a value as displayed; empty if it is missing."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return cell
    if form is Format.SHARE:
        return share_text(cell)
    return {Format.COUNT: f"{cell:,}", Format.SOLUTION: f"{cell}"}.get(form, f"{cell:.3g}")


def share_text(share: float) -> str:
    """Return a share in whole per cent, or more precisely where that would be 0 or 100."""
    return f"{share:.0%}" if share in (0, 1) or 0.01 <= share <= 0.99 else f"{share:.2%}"


def table_bytes(rows: Sequence[Row], form: str, columns: Mapping[str, type]) -> bytes:
    """Encode rows as a file.

    Args:
        rows: Rows that all have the same columns.
        form: One of `FORMATS`.
        columns: Columns of a table without rows, with the type of their values.

    Raises:
        InvalidInput: The format is Parquet, and pyarrow is not installed.
    """
    if form == "parquet":
        return _parquet(rows, columns)
    if form == "csv":
        header = list(rows[0] if rows else columns)
        return csv_text([header, *([row[name] for name in header] for row in rows)]).encode()
    return "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode()


def has_parquet() -> bool:
    """Return whether pyarrow, which Parquet needs, is installed."""
    return find_spec("pyarrow") is not None


def _parquet(rows: Sequence[Row], columns: Mapping[str, type]) -> bytes:
    if not has_parquet():
        message = f"Parquet needs pyarrow, which is not installed: {install_command('analysis')}"
        raise InvalidInput.at("/query/format", message)
    # Imported here: an optional extra that takes a second to load.
    import pyarrow as pa
    import pyarrow.parquet as pq

    if rows:
        table = pa.Table.from_pylist([_of_one_type(row, mixed) for mixed in [_mixed(rows)] for row in rows])
    else:
        kinds = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
        table = pa.schema([(name, kinds[kind]) for name, kind in columns.items()]).empty_table()
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()


def _mixed(rows: Sequence[Row]) -> frozenset[str]:
    """Return the columns whose values have several types; int and float count as one."""
    kinds: dict[str, set[type]] = {}
    for row in rows:
        for name, value in row.items():
            if value is not None:
                number = isinstance(value, int | float) and not isinstance(value, bool)
                kinds.setdefault(name, set()).add(float if number else type(value))
    return frozenset(name for name, found in kinds.items() if len(found) > 1)


def _of_one_type(row: Row, mixed: frozenset[str]) -> Row:
    return {name: str(value) if name in mixed and value is not None else value for name, value in row.items()}
