"""Tables."""

import io
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Final, TypeAlias

from brink.extras import install_command
from brink.server.csv_text import csv_text
from brink.server.errors import InvalidInput

Cell: TypeAlias = str | int | float | bool | None


Row: TypeAlias = dict[str, Cell]


FORMATS: Final = ("csv", "jsonl", "parquet")


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
