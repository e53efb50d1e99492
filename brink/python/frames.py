"""Results as pandas data frames; pandas is imported on first use."""

from collections.abc import Mapping, Sequence
from types import UnionType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from brink.extras import install_command
from brink.search.archive import Archive
from brink.search.errors import MissingExtra
from brink.search.parameters import Categorical
from brink.search.space import BoolArray, SearchSpace
from brink.server.findings.table import Table

if TYPE_CHECKING:
    import pandas as pd

_DTYPES: Final[Mapping[type | UnionType, str]] = {
    int: "int64",
    float: "float64",
    bool: "bool",
    str: "str",
    int | None: "Int64",
    bool | None: "boolean",
}
_MAY_BE_MISSING: Final = (float, int | None, bool | None)
"""Types of columns that may be None in some rows or all, so that pandas cannot tell them from the values."""


def data_frame(columns: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> "pd.DataFrame":
    """Return a data frame of columns, or of rows.

    Raises:
        MissingExtra: pandas is not installed.
    """
    frame: pd.DataFrame = _pandas().DataFrame(columns)
    return frame


def typed_frame(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, type | UnionType]) -> "pd.DataFrame":
    """Return a data frame of rows, with the right columns and types even without rows.

    Args:
        rows: Rows that have these columns, and possibly others.
        columns: Columns with the type of their values; whole numbers and truth values that may be missing as
            ``int | None`` and ``bool | None``.

    Raises:
        MissingExtra: pandas is not installed.
    """
    if rows:
        dtypes = {name: _DTYPES[kind] for name, kind in columns.items() if kind in _MAY_BE_MISSING}
        return data_frame(rows).astype(dtypes)
    pd = _pandas()
    return data_frame(
        {name: pd.Series([], dtype=_DTYPES.get(kind, "object")) for name, kind in columns.items()}
    )


def table_frame(table: Table) -> "pd.DataFrame":
    """Return a table of findings as a data frame, including its hidden columns.

    Raises:
        MissingExtra: pandas is not installed.
    """
    return typed_frame(table.records(), table.optional_types())


def types_of(row: Mapping[str, Any]) -> dict[str, type]:
    """Return the types of the values of a row, as columns for `typed_frame`."""
    return {
        name: float if name.startswith(("robustness.", "violated_at_s.")) else type(value)
        for name, value in row.items()
    }


def _pandas() -> Any:
    try:
        import pandas as pd
    except ImportError:
        raise MissingExtra(f"data frames need pandas: {install_command('analysis')}") from None
    return pd


def archive_frame(archive: Archive, space: SearchSpace, active: BoolArray | None = None) -> "pd.DataFrame":
    """Return evaluated solutions as a data frame, one row each.

    Args:
        archive: The solutions.
        space: Their search space.
        active: Which parameters were active in each episode, shape ``(n, d)``; the others are left empty. None keeps
            all.

    Returns:
        The columns ``number``, one for each parameter (as component.parameter, unless there is one component only),
        ``unsafe``, ``robustness``, ``fitness``, ``neighbours`` and ``unsafe_neighbours``.
    """
    columns: dict[str, Any] = {"number": archive.numbers}
    parameters = [one for component in space.components for one in component.parameters]
    for place, (name, parameter) in enumerate(zip(parameter_columns(space), parameters, strict=True)):
        values = archive.vectors[:, place]
        shown = values != (parameter.absent if parameter.when else np.nan)
        if active is not None:
            shown &= active[:, place]
        if isinstance(parameter, Categorical):
            columns[name] = [
                parameter.choices[int(value)] if on else None
                for value, on in zip(values.tolist(), shown.tolist(), strict=True)
            ]
        else:
            columns[name] = np.where(shown, parameter.shown(values), np.nan)
    return data_frame(
        {
            **columns,
            "unsafe": archive.unsafe,
            "robustness": archive.robustness,
            "fitness": archive.fitness,
            "neighbours": archive.neighbours,
            "unsafe_neighbours": archive.unsafe_neighbours,
        }
    )


def parameter_columns(space: SearchSpace) -> list[str]:
    """Return the names of a space's parameters in data frames."""
    single = len(space.components) == 1
    return [
        one.name if single else f"{component.name}.{one.name}"
        for component in space.components
        for one in component.parameters
    ]
