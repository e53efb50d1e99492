"""Checks and converts the values of imported rows, as strictly as the API checks its input.

The columns of the tables say most: types, lengths, what may be null. `_RULES` has what they do not say.
"""

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Final

from pydantic import ValidationError
from sqlalchemy import JSON, BigInteger, Column, Integer

from brink.server.campaigns.body import check_notes
from brink.server.db.types import UtcDateTime
from brink.server.documents import check_printable
from brink.server.operations.export_file import BadFile
from brink.server.seeding import Mode, Outcome
from brink.worker.wire import LARGEST_NUMBER, Completed

_SIGNED: Final = frozenset({"priority", "robustness"})
"""Columns of numbers that may be negative."""
LONGEST_TIMEOUT_S: Final = 7 * 86_400.0
"""Largest wall-clock limit of a job: a worker cannot wait for much longer ones."""
LARGEST_EXACT: Final = 2**53
"""Largest number of a solution: every JSON parser reads it exactly."""
_HASH: Final = re.compile(r"[0-9a-f]{64}")
_ID: Final = re.compile(r"[0-9A-Za-z]{1,16}")


def type_of(column: Column[Any]) -> type[Any]:
    """Return the type of the values of a column."""
    if isinstance(column.type, UtcDateTime):
        return datetime
    if isinstance(column.type, JSON):
        return dict
    wanted: type[Any] = column.type.python_type
    return wanted


def imported_value(value: Any, column: Column[Any], where: str) -> Any:
    """Convert a JSON value to the type of its column.

    Args:
        value: The value: finite numbers, text that can be stored.
        column: The column.
        where: Its line, for error messages.

    Raises:
        BadFile: It is of another type, or out of range.
    """
    if value is None:
        if not column.nullable:
            raise BadFile(f"{where}: {column.name}: expected a {type_of(column).__name__}, got null")
        return None
    try:
        converted = _converted(value, column)
        if (rule := _RULES.get(column.name)) is not None:
            rule(converted)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        at = ".".join(str(part) for part in fault["loc"])
        raise BadFile(f"{where}: {column.name}: {at}: {fault['msg']}") from None
    except (ValueError, OverflowError) as error:
        raise BadFile(f"{where}: {column.name}: {error}") from None
    return converted


def _converted(value: Any, column: Column[Any]) -> Any:
    """Raises: ValueError or OverflowError: The value does not fit into the column."""
    wanted = type_of(column)
    if wanted is datetime:
        return _moment(value)
    if wanted is float and type(value) is int:
        value = float(value)
    if not isinstance(value, wanted) or (wanted is int and isinstance(value, bool)):
        raise ValueError(f"expected a {wanted.__name__}, got {value!r:.60}")
    if wanted is int:
        bits = 64 if isinstance(column.type, BigInteger) or not isinstance(column.type, Integer) else 32
        if not -(2 ** (bits - 1)) <= value < 2 ** (bits - 1):
            raise ValueError(f"expected a {bits}-bit integer")
    if wanted in (int, float) and value < 0 and column.name not in _SIGNED:
        raise ValueError(f"expected a number >= 0, got {value}")
    if wanted is float and abs(value) > LARGEST_NUMBER:
        raise ValueError(f"expected a number of at most {LARGEST_NUMBER:g}, got {value:g}")
    length = getattr(column.type, "length", None)
    if isinstance(value, str) and length and len(value) > length:
        raise ValueError(f"expected at most {length} characters")
    return value


def _moment(value: Any) -> datetime:
    try:
        moment = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        moment = None
    if moment is None or moment.tzinfo is None:
        raise ValueError(f"expected a time with a time zone, got {value!r:.60}")
    return moment.astimezone(UTC)


def _hash(text: str) -> None:
    if not _HASH.fullmatch(text):
        raise ValueError(f"expected a SHA-256 in hexadecimal digits, got {text!r:.60}")


def _identifier(text: str) -> None:
    if not _ID.fullmatch(text):
        raise ValueError(f"expected an id, got {text!r:.60}")


def _name(text: str) -> None:
    if not text:
        raise ValueError("expected a text that is not empty")
    check_printable(text)


def _numbers_by_name(values: Mapping[str, Any]) -> None:
    if not all(type(value) in (int, float) and abs(value) <= LARGEST_NUMBER for value in values.values()):
        raise ValueError(f"expected numbers of at most {LARGEST_NUMBER:g} by name")


def _timeout(value: float) -> None:
    if not 0 < value <= LONGEST_TIMEOUT_S:
        raise ValueError(f"expected a number > 0, of at most {LONGEST_TIMEOUT_S:g}, got {value:g}")


def _number(value: int) -> None:
    if value > LARGEST_EXACT:
        raise ValueError(f"expected at most {LARGEST_EXACT}, got {value}")


_RULES: Final[Mapping[str, Callable[[Any], object]]] = {
    "name": _name,
    "requirement": _name,
    "needs": _name,
    "notes": check_notes,
    "spec_hash": _hash,
    "document_hash": _hash,
    "prompt_hash": _hash,
    "sha256": _hash,
    "source_id": _identifier,
    "origin": check_printable,
    "mode": Mode,
    "outcome": Outcome,
    "objectives": _numbers_by_name,
    "number": _number,
    "timeout_s": _timeout,
    "result": Completed.model_validate_json,
}
"""For each column with further conditions, a check that raises ValueError if a value does not meet them."""
