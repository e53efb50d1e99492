"""A campaign's prior knowledge: solutions known before its search begins, and the table that stores them.

They are never solutions of the campaign: they have no number, no job and no episode, and its archive, counts, digest
and pairs are made without them. See docs/adr/0043-warm-starts.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Self

import numpy as np
from sqlalchemy import Connection, case, func, insert, select

from brink.search.algorithm import Known
from brink.search.errors import SpaceError
from brink.search.space import FloatArray, SearchSpace
from brink.server.campaigns.body import KnownSolution
from brink.server.db.models import KnownSolutionRow
from brink.server.errors import FieldError, InvalidInput, nearest

_MOST_ERRORS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownRecord:
    """One solution that a campaign starts from.

    Attributes:
        vector: The complete solution as little-endian float64 values.
        unsafe: Its verdict; None if it has no result and is simulated first.
        robustness: Its robustness; None without a result.
        source: Id of the campaign that simulated it; None if the campaign's body has it.
        number: Its number in that campaign.
    """

    vector: bytes
    unsafe: bool | None = None
    robustness: float | None = None
    source: str | None = None
    number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCounts:
    """How much prior knowledge a campaign has.

    Attributes:
        results: Results that it did not simulate itself.
        unsafe: Unsafe ones among them.
        points: Solutions without a result, which it simulated first.
    """

    results: int
    unsafe: int
    points: int

    @classmethod
    def of(cls, records: Sequence[KnownRecord]) -> Self:
        """Return the counts of records."""
        results = [record for record in records if record.unsafe is not None]
        unsafe = sum(bool(record.unsafe) for record in results)
        return cls(results=len(results), unsafe=unsafe, points=len(records) - len(results))


def known_of(records: Sequence[KnownRecord], dimension: int) -> Known:
    """Return the prior knowledge of a search.

    Args:
        records: The solutions, in their order.
        dimension: Length of a solution's vector.
    """
    results = [record for record in records if record.unsafe is not None]
    points = [record for record in records if record.unsafe is None]

    def rows(some: Sequence[KnownRecord]) -> FloatArray:
        return np.frombuffer(b"".join(one.vector for one in some), "<f8").reshape(-1, dimension)

    return Known(
        rows=rows(results),
        unsafe=np.array([record.unsafe for record in results], np.bool_),
        robustness=np.array([record.robustness for record in results], np.float64),
        points=rows(points),
    )


def given_records(space: SearchSpace, solutions: Sequence[KnownSolution]) -> list[KnownRecord]:
    """Return the solutions of a campaign's body.

    Args:
        space: The campaign's search space.
        solutions: The solutions.

    Raises:
        InvalidInput: With a pointer to each invalid value, and to each solution that is given twice.
    """
    errors: list[FieldError] = []
    records: list[KnownRecord] = []
    first: dict[bytes, int] = {}
    for place, solution in enumerate(solutions):
        if len(errors) >= _MOST_ERRORS:
            break
        pointer = f"/start_from/solutions/{place}"
        row = encoded_row(space, solution.values, f"{pointer}/values", errors)
        if row is None:
            continue
        vector = row.astype("<f8").tobytes()
        if first.setdefault(vector, place) != place:
            message = f"expected each solution once; this is the same as solution {first[vector]}"
            errors.append(FieldError(pointer=pointer, message=message))
        unsafe = None if solution.robustness is None else solution.robustness < 0
        records.append(KnownRecord(vector=vector, unsafe=unsafe, robustness=solution.robustness))
    if errors:
        raise InvalidInput(errors[:_MOST_ERRORS])
    return records


def encoded_row(
    space: SearchSpace, values: Mapping[str, Any], pointer: str, errors: list[FieldError]
) -> FloatArray | None:
    """Return the row of values by component.parameter; None, with `errors` extended, if they are invalid."""
    names = space.column_names()
    wrong = [
        FieldError(
            pointer=f"{pointer}/{name.replace('~', '~0').replace('/', '~1')}",
            message="unknown parameter; expected component.parameter",
            nearest=nearest(name, names),
        )
        for name in islice((one for one in values if one not in names), _MOST_ERRORS)
    ]
    wrong += [
        FieldError(pointer=f"{pointer}/{name}", message="missing; every parameter is required")
        for name, parameter in zip(names, space.parameters, strict=True)
        if name not in values and not parameter.when
    ]
    if not wrong:
        parts = {
            component.name: {
                p.name: values[name]
                for p in component.parameters
                if (name := f"{component.name}.{p.name}") in values
            }
            for component in space.components
        }
        try:
            return space.join(space.encode(parts))
        except SpaceError as error:
            name, _, message = str(error).partition(": ")
            at = (f"{pointer}/{name}", message) if name in names else (pointer, str(error))
            wrong = [FieldError(pointer=at[0], message=at[1])]
    errors += wrong
    return None


def insert_known(connection: Connection, campaign_id: str, records: Sequence[KnownRecord]) -> None:
    """Store the prior knowledge of a new campaign.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        records: The solutions, in their order.
    """
    if records:
        connection.execute(
            insert(KnownSolutionRow),
            [
                {
                    "campaign_id": campaign_id,
                    "place": place,
                    "vector": record.vector,
                    "is_unsafe": record.unsafe,
                    "robustness": record.robustness,
                    "source_id": record.source,
                    "source_number": record.number,
                }
                for place, record in enumerate(records)
            ],
        )


def read_known(
    connection: Connection, campaign_id: str, *, after: int = -1, limit: int | None = None
) -> list[KnownRecord]:
    """Return the prior knowledge of a campaign, in its order; empty if it has none.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        after: The last place of the previous page.
        limit: Maximum number of solutions; None for all.
    """
    table = KnownSolutionRow
    query = (
        select(table.vector, table.is_unsafe, table.robustness, table.source_id, table.source_number)
        .where(table.campaign_id == campaign_id, table.place > after)
        .order_by(table.place)
        .limit(limit)
    )
    return [
        KnownRecord(
            vector=row.vector,
            unsafe=row.is_unsafe,
            robustness=row.robustness,
            source=row.source_id,
            number=row.source_number,
        )
        for row in connection.execute(query)
    ]


def count_known(connection: Connection, campaign_id: str) -> KnownCounts:
    """Return how much prior knowledge a campaign has."""
    table = KnownSolutionRow
    query = select(
        func.count(table.is_unsafe), func.sum(case((table.is_unsafe.is_(True), 1), else_=0)), func.count()
    ).where(table.campaign_id == campaign_id)
    results, unsafe, together = connection.execute(query).one()
    return KnownCounts(results=results, unsafe=unsafe or 0, points=together - results)
