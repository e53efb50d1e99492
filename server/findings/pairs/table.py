"""Pairs as tables with one row for each pair: for every renderer, and with all parameters as a file.

`COLUMNS` and `pairs_table` are what the terminal, pages, reports and ``brink findings`` show; `pair_columns` and
`pair_rows` are the files of ``brink pairs`` and the data frame. A new column belongs in both.
"""

from collections.abc import Mapping
from typing import Final

from brink.search.space import SearchSpace
from brink.server.findings.boundary.table import parameter_columns
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView, PairView
from brink.server.findings.pairs.words import extent_words
from brink.server.findings.table import Cell, Column, Format, Row, Table, table_bytes
from brink.server.findings.words import as_sentence

COLUMNS: Final = [
    Column(name="pair", title="pair", format=Format.COUNT, page="pairs/{safe}-{unsafe}"),
    Column(name="change", title="change from the safe to the unsafe drive"),
    Column(name="moved", title="how far", below=True),
    Column(name="common", title="in both", below=True),
    Column(name="smaller", title="a smaller change", below=True),
    Column(name="unsafe_outcome", title="unsafe drive"),
    Column(name="unsafe", title="solution", format=Format.SOLUTION, below=True),
    Column(name="unsafe_again", title="the same with other seeds", below=True),
    Column(name="safe_outcome", title="safe drive"),
    Column(name="safe", title="solution", format=Format.SOLUTION, below=True),
    Column(name="safe_again", title="the same with other seeds", below=True),
    Column(name="confirmation", title="confirmation", format=Format.STATE),
    Column(name="evidence", title="evidence", below=True),
    Column(name="extent", title="differing", below=True),
    Column(name="nature", title="what differs", detail=True),
    Column(name="distance", title="distance", format=Format.NUMBER, detail=True),
    Column(name="component", title="blamed", detail=True),
    Column(name="minimality", title="minimality", detail=True),
]

_PAIR: Final[Mapping[str, type]] = {
    "campaign": str,
    "pair": int,
    "words": str,
    "change": str,
    "moved": str,
    "distance": float,
    "nature": str,
    "checked": bool,
    "same_seed": bool,
    "confirmation": str,
    "component": str,
    "minimality": str,
    "component_outcome": str,
    "minimised_change": str,
    "differing": str,
}
_SIDE: Final[Mapping[str, type]] = {
    "number": int,
    "robustness": float,
    "evaluated": int,
    "seed": int,
    "outcome": str,
    "words": str,
    "again_evaluated": int,
    "again_unsafe": int,
    "again_low": float,
    "again_high": float,
}


def pair_columns(space: SearchSpace) -> dict[str, type]:
    """Return the columns of a table of pairs in a search space, in order, with the type of their values."""
    columns = dict(_PAIR)
    of_a_side = {**_SIDE, **parameter_columns(space)}
    for side in ("safe", "unsafe"):
        columns |= {f"{side}.{name}": kind for name, kind in of_a_side.items()}
    return columns


def pair_rows(view: PairsView) -> list[Row]:
    """Return pairs as rows that have the columns of `pair_columns`."""
    return [_flat(view, pair) for pair in view.pairs]


def pairs_table(view: PairsView, rows: int | None = None) -> Table:
    """Return the first pairs as a table; all of them by default."""
    shown = view.pairs[:rows]
    return Table(
        name="pairs",
        title="Distinct pairs, confirmed ones first",
        columns=COLUMNS,
        rows=[
            [
                pair.place,
                as_sentence(pair.change),
                pair.moved,
                f"in both: {pair.common}" if pair.common else "",
                _smaller(pair),
                pair.unsafe.outcome,
                pair.unsafe.number,
                pair.unsafe.again,
                pair.safe.outcome,
                pair.safe.number,
                pair.safe.again,
                str(pair.confirmation.state),
                ", ".join(pair.evidence),
                extent_words(pair),
                str(pair.nature),
                pair.distance,
                str(pair.component.state),
                str(pair.minimality.state),
            ]
            for pair in shown
        ],
        left_out=view.distinct - len(shown),
        file=f"pairs?eps={view.eps:g}&d_th={view.d_th:g}&limit={MOST_PAIRS}",
    )


def _smaller(pair: PairView) -> str:
    """Return the change that is left once differences were reverted; empty if that is all of it."""
    less = pair.minimality.unsafe
    if less is None or less.change == pair.change:
        return ""
    return f"{'minimal' if less.minimal else 'smaller'} change: {less.change}: {less.outcome}"


def pairs_file(view: PairsView, space: SearchSpace, form: str) -> bytes:
    """Encode pairs as a file: JSON Lines with all details of each pair, or a flat table.

    Args:
        view: The pairs.
        space: Their search space.
        form: ``csv``, ``jsonl`` or ``parquet``.

    Raises:
        InvalidInput: The format is Parquet, and pyarrow is not installed.
    """
    if form == "jsonl":
        return b"".join(pair.model_dump_json().encode() + b"\n" for pair in view.pairs)
    return table_bytes(pair_rows(view), form, pair_columns(space))


def _flat(view: PairsView, pair: PairView) -> dict[str, Cell]:
    row: dict[str, Cell] = {
        "campaign": view.campaign,
        "pair": pair.place,
        "words": pair.words,
        "change": pair.change,
        "moved": pair.moved,
        "distance": pair.distance,
        "nature": str(pair.nature),
        "checked": pair.checked,
        "same_seed": pair.same_seed,
        "confirmation": str(pair.confirmation.state),
        "component": str(pair.component.state),
        "minimality": str(pair.minimality.state),
        "component_outcome": pair.component.outcome,
        "minimised_change": "" if pair.minimality.unsafe is None else pair.minimality.unsafe.change,
        "differing": "; ".join(change.words for change in pair.changes),
    }
    for name, side, share in (
        ("safe", pair.safe, pair.confirmation.safe),
        ("unsafe", pair.unsafe, pair.confirmation.unsafe),
    ):
        row.update(
            {
                f"{name}.number": side.number,
                f"{name}.robustness": side.robustness,
                f"{name}.evaluated": side.evaluated,
                f"{name}.seed": side.seed,
                f"{name}.outcome": side.outcome,
                f"{name}.words": side.words,
                f"{name}.again_evaluated": share.evaluated,
                f"{name}.again_unsafe": share.unsafe,
                f"{name}.again_low": share.low,
                f"{name}.again_high": share.high,
            }
        )
        for component, values in side.parameters.items():
            row.update({f"{name}.{component}.{parameter}": value for parameter, value in values.items()})
    return row
