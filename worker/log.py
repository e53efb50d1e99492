"""One log record an event, on one line: as text for people, or as JSON for whatever gathers logs.

What an event is about stands in fields of its own, given as ``extra=``: ``campaign``, ``generation``, ``job``,
``worker``, ``attempt``, ``reason`` and so on. Text shows them as ``key=value`` behind the message. Coordinator and
workers both log through here, so that one campaign can be followed through all of them.
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

FORMAT_VARIABLE: Final = "BRINK_LOG_FORMAT"
LEVEL_VARIABLE: Final = "BRINK_LOG_LEVEL"
OURS: Final = ("brink", "uvicorn", "__main__")
"""Packages that may say everything. Libraries say no more than INFO: what they tell of at DEBUG is not ours to vouch
for, headers with tokens included."""
_TALKATIVE: Final = ("httpx", "alembic")
"""They tell of every request, or of every start, at the level at which this program tells of a campaign."""

_STANDARD: Final = frozenset(vars(logging.makeLogRecord({}))) | {
    "message", "asctime", "taskName", "color_message",
}  # fmt: skip
_OWN: Final = ("time", "level", "logger", "message", "stack")
_NOTHING: Final[Mapping[str, object]] = MappingProxyType({})
_about: ContextVar[Mapping[str, object]] = ContextVar("about", default=_NOTHING)


class LogFormat(StrEnum):
    """How log records are written."""

    TEXT = "text"
    JSON = "json"


class LogLevel(StrEnum):
    """The least severe records that are written."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@contextmanager
def about(**fields: object) -> Iterator[None]:
    """Give every record of this block, in this task or thread, some fields more."""
    before = _about.set({**_about.get(), **fields})
    try:
        yield
    finally:
        _about.reset(before)


class LineFormatter(logging.Formatter):
    """Formats a record as a line of text, with its fields.

    Args:
        always: Fields that stand on every line.
    """

    def __init__(self, **always: object) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(name)s: %(message)s")
        self._always = always

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; only a stack, where there is one, takes more."""
        line, *stack = super().format(record).split("\n") if record.exc_info else [super().format(record)]
        pairs = [f"{key}={_as_text(value)}" for key, value in _fields(record, self._always).items()]
        return "\n".join((" ".join((" ".join(line.split("\n")), *pairs)), *stack))


class JsonFormatter(logging.Formatter):
    """Formats a record as a JSON object on one line, with its fields beside time, level, logger and message.

    Args:
        always: Fields that stand in every object.
    """

    def __init__(self, **always: object) -> None:
        super().__init__()
        self._always = always

    def format(self, record: logging.LogRecord) -> str:
        """Return the object; a stack is one of its fields."""
        moment = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        document: dict[str, object] = {
            "time": moment.replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        for key, value in _fields(record, self._always).items():
            document[f"{key}_" if key in _OWN else key] = _as_json(value)
        if record.exc_info:
            document["stack"] = self.formatException(record.exc_info)
        return json.dumps(document, default=str, ensure_ascii=False)


def configure_logging(level: LogLevel, log_format: LogFormat, **always: object) -> None:
    """Send the log of this program to standard error.

    Args:
        level: The least severe records of ours that are written.
        log_format: How they are written.
        always: Fields of every record, such as the worker's id.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_formatter(log_format, always))
    handler.addFilter(_ours_or_info)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    for name in _TALKATIVE:
        logging.getLogger(name).setLevel(logging.WARNING)


def environment_format() -> LogFormat:
    """Return the format that the environment names; text if it names none.

    Raises:
        SettingsError: There is no such format.
    """
    return _from_environment(FORMAT_VARIABLE, LogFormat.TEXT)


def environment_level() -> LogLevel:
    """Return the level that the environment names; info if it names none.

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


def _ours_or_info(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.INFO or record.name.partition(".")[0] in OURS


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
    return {**always, **_about.get(), **extra}


def _as_text(value: object) -> str:
    text = " ".join(str(value).split())
    return f'"{text}"' if " " in text or not text else text


def _as_json(value: object) -> object:
    """Return a value that JSON can carry; NaN and infinity it cannot."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
