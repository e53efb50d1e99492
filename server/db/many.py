"""Statements about many rows that read the same whatever their number: databases and SQLAlchemy keep their plans."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import BindParameter, Connection, Integer, Text, bindparam, func, update
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.engine.interfaces import Dialect
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.sql import column
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement
from sqlalchemy.types import TypeDecorator, TypeEngine


class _Listed(TypeDecorator[Sequence[Any]]):
    """A list as one parameter: an array on Postgres, JSON on SQLite."""

    impl = Text
    cache_ok = True

    def __init__(self, item: TypeEngine[Any]) -> None:
        super().__init__()
        self.item = item

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[Any]:
        return dialect.type_descriptor(Text() if dialect.name == "sqlite" else ARRAY(self.item))

    def process_bind_param(self, value: Sequence[Any] | None, dialect: Dialect) -> Any:
        values = list(value or ())
        return json.dumps(values) if dialect.name == "sqlite" else values


class _Among(FunctionElement[bool]):
    """Whether the first of its arguments is an element of the second."""

    type: TypeEngine[Any] = (
        Integer()
    )  # a Boolean is compared with 1 on SQLite, which then finds no index for it
    inherit_cache = True


@compiles(_Among, "sqlite")
def _among_sqlite(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    left, right = element.clauses
    values = compiler.process(right, **options)
    return f"{compiler.process(left, **options)} IN (SELECT value FROM json_each({values}))"


@compiles(_Among)
def _among_arrays(element: _Among, compiler: SQLCompiler, **options: Any) -> str:
    left, right = element.clauses
    return f"{compiler.process(left, **options)} = ANY ({compiler.process(right, **options)})"


def among(attribute: InstrumentedAttribute[Any], name: str) -> FunctionElement[bool]:
    """Return the condition that a column's value is in the list that the parameter `name` will give."""
    return _Among(attribute, bindparam(name, type_=_Listed(attribute.type)))


class UpdateEach:
    """An update that gives every row values of its own, in one statement, or on SQLite in one loop of the driver.

    Args:
        key: The column by which rows are found.
        each: The columns that get values of their own.
        values: What the other columns get: the same expression for all rows, which may have parameters.
    """

    def __init__(
        self, key: InstrumentedAttribute[Any], each: Sequence[InstrumentedAttribute[Any]], **values: Any
    ) -> None:
        columns = [key, *each]
        self._names = [attribute.key for attribute in columns]
        table = key.class_
        singly: dict[str, Any] = {attribute.key: bindparam(f"each_{attribute.key}") for attribute in each}
        self._singly = update(table).where(key == bindparam(f"each_{key.key}")).values({**singly, **values})
        arrays: list[BindParameter[Any]] = [
            bindparam(f"each_{attribute.key}", type_=ARRAY(attribute.type)) for attribute in columns
        ]
        given = (
            func.unnest(*arrays)
            .table_valued(*(column(attribute.key, attribute.type) for attribute in columns))
            .render_derived(name="given")
        )
        together = {attribute.key: given.c[attribute.key] for attribute in each}
        self._together = update(table).where(key == given.c[key.key]).values({**together, **values})

    def run(
        self, connection: Connection, rows: Sequence[Sequence[Any]], same: Mapping[str, Any] | None = None
    ) -> None:
        """Update rows.

        Args:
            connection: Where.
            rows: For each its key, then a value for each of the columns.
            same: The parameters of the expressions that are the same for all.
        """
        if not rows:
            return
        same = same or {}
        names = [f"each_{name}" for name in self._names]
        if connection.dialect.name == "sqlite":
            connection.execute(self._singly, [{**dict(zip(names, row, strict=True)), **same} for row in rows])
        else:
            columns = [list(values) for values in zip(*rows, strict=True)]
            connection.execute(self._together, {**dict(zip(names, columns, strict=True)), **same})
