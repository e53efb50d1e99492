"""Column types that behave the same on SQLite and Postgres."""

import re
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import DateTime, Dialect, Text
from sqlalchemy.types import TypeDecorator

LONGEST_REASON: Final = 8_000
"""Maximum number of characters of a `Reason`: twice that of a worker's message."""
_NOT_STORABLE: Final = re.compile("[\x00\ud800-\udfff]")


class UtcDateTime(TypeDecorator[datetime]):
    """An aware datetime in UTC. SQLite, which has no time zones, stores it naive."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Convert to UTC for storage.

        Raises:
            ValueError: The datetime is naive.
        """
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("expected an aware datetime")
        moment = value.astimezone(UTC)
        return moment.replace(tzinfo=None) if dialect.name == "sqlite" else moment

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return an aware datetime."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Reason(TypeDecorator[str]):
    r"""The reason for a failure, which may quote an exception of a plug-in.

    What no database can store, NUL and lone surrogates, is written out, such as ``\u0000``, and very long words are
    cut: the failure itself must be stored in any case.
    """

    impl = Text
    cache_ok = True

    @property
    def python_type(self) -> type[str]:
        """The type of the values."""
        return str

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        """Return text that can be stored."""
        if value is None:
            return None
        words = value if len(value) <= LONGEST_REASON else f"{value[: LONGEST_REASON - 1]}…"
        return _NOT_STORABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", words)
