"""Logging of coordinator and workers: one line per event, as text for people or as JSON for log collectors.

What an event is about is given in fields, passed as ``extra=``: ``campaign``, ``generation``, ``job``, ``worker``,
``attempt``, ``reason`` and so on. The text format appends them to the message as ``key=value``. All processes use the
same fields, so that one campaign can be followed through their logs.
"""

import json
import logging
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from enum import StrEnum
from types import MappingProxyType
from typing import Final, TypeVar, assert_never

from brink.worker.errors import SettingsError
from brink.worker.printable import printable

FORMAT_VARIABLE: Final = "BRINK_LOG_FORMAT"
LEVEL_VARIABLE: Final = "BRINK_LOG_LEVEL"
DEBUG_PACKAGES: Final = ("brink", "uvicorn", "__main__")
"""Packages whose DEBUG records are written. Other libraries are limited to INFO: their DEBUG records may contain
secrets, such as headers with tokens."""
_NOISY: Final = ("httpx", "alembic")
"""Libraries that log every request or every start at INFO; limited to WARNING."""

_STANDARD: Final = frozenset(vars(logging.makeLogRecord({}))) | {
    "message",
    "asctime",
    "taskName",
    "color_message",
}
_RESERVED: Final = ("time", "level", "logger", "message", "stack")
_NO_FIELDS: Final[Mapping[str, object]] = MappingProxyType({})
_context: ContextVar[Mapping[str, object]] = ContextVar("log_fields", default=_NO_FIELDS)


class LogFormat(StrEnum):
    """Format of log records."""

    TEXT = "text"
    JSON = "json"


class LogLevel(StrEnum):
    """Minimum severity of the records that are written."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@contextmanager
def log_fields(**fields: object) -> Iterator[None]:
    """Add fields to every record logged inside this block, in this task or thread."""
    before = _context.set({**_context.get(), **fields})
    try:
        yield
    finally:
        _context.reset(before)


class LineFormatter(logging.Formatter):
    """Formats a record and its fields as one line of text.

    Args:
        always: Fields of every line.
    """

    def __init__(self, **always: object) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(name)s: %(message)s")
        self._always = always

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, followed by the lines of the stack if there is one."""
        line, *stack = super().format(record).split("\n") if record.exc_info else [super().format(record)]
        pairs = [f"{key}={_as_text(value)}" for key, value in _fields(record, self._always).items()]
        return printable("\n".join((" ".join((" ".join(line.split("\n")), *pairs)), *stack)))


class JsonFormatter(logging.Formatter):
    """Formats a record as a JSON object on one line: time, level, logger, message and its fields.

    Args:
        always: Fields of every object.
    """

    def __init__(self, **always: object) -> None:
        super().__init__()
        self._always = always

    def format(self, record: logging.LogRecord) -> str:
        """Return the object; the stack, if there is one, is a field."""
        moment = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        document: dict[str, object] = {
            "time": moment.replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        for key, value in _fields(record, self._always).items():
            document[f"{key}_" if key in _RESERVED else key] = _as_json(value)
        if record.exc_info:
            document["stack"] = self.formatException(record.exc_info)
        return printable(json.dumps(document, default=str, ensure_ascii=False))


def configure_logging(level: LogLevel, log_format: LogFormat, **always: object) -> None:
    """Write the log of this program to standard error.

    Args:
        level: Minimum severity of the records that are written.
        log_format: Format of the records.
        always: Fields of every record, such as the worker's id.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_formatter(log_format, always))
    handler.addFilter(_allows)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    for name in _NOISY:
        logging.getLogger(name).setLevel(logging.WARNING)


def environment_format() -> LogFormat:
    """Return the log format given in the environment; text by default.

    Raises:
        SettingsError: There is no such format.
    """
    return _from_environment(FORMAT_VARIABLE, LogFormat.TEXT)


def environment_level() -> LogLevel:
    """Return the log level given in the environment; info by default.

    Raises:
        SettingsError: There is no such level.
    """
    return _from_environment(LEVEL_VARIABLE, LogLevel.INFO)


Choice = TypeVar("Choice", bound=StrEnum)


def _from_environment(variable: str, default: Choice) -> Choice:
    named = os.environ.get(variable) or default.value
    kind = type(default)
    try:
        return kind(named.lower())
    except ValueError:
        choices = ", ".join(kind)
        raise SettingsError(variable, f"expected one of {choices}, got {named!r}") from None


def _allows(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.INFO or record.name.partition(".")[0] in DEBUG_PACKAGES


def _formatter(log_format: LogFormat, always: Mapping[str, object]) -> logging.Formatter:
    match log_format:
        case LogFormat.TEXT:
            return LineFormatter(**always)
        case LogFormat.JSON:
            return JsonFormatter(**always)
        case _:
            assert_never(log_format)


def _fields(record: logging.LogRecord, always: Mapping[str, object]) -> dict[str, object]:
    extra = {key: value for key, value in vars(record).items() if key not in _STANDARD and key[0] != "_"}
    return {**always, **_context.get(), **extra}


def _as_text(value: object) -> str:
    text = " ".join(str(value).split())
    return f'"{text}"' if " " in text or not text else text


def _as_json(value: object) -> object:
    """Return the value, or its text if it is NaN or infinite, which JSON cannot represent."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
