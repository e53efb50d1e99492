"""One log line an event: time, level, logger, message, then ``key=value`` for whatever it is about."""

import logging
import sys
from typing import Final

_STANDARD: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class LineFormatter(logging.Formatter):
    """Formats a record on one line, with its extra fields.

    Args:
        worker_id: Stands on every line.
    """

    def __init__(self, worker_id: str) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(name)s: %(message)s")
        self._worker_id = worker_id

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; only a stack, where there is one, takes more."""
        line, *stack = super().format(record).split("\n") if record.exc_info else [super().format(record)]
        fields = {k: v for k, v in vars(record).items() if k not in _STANDARD}
        pairs = [f"worker={self._worker_id}", *(f"{key}={_value(value)}" for key, value in fields.items())]
        return "\n".join((" ".join((" ".join(line.split("\n")), *pairs)), *stack))


def configure_logging(worker_id: str, level: str) -> None:
    """Send the worker's log to standard error.

    Args:
        worker_id: Stands on every line.
        level: ``debug``, ``info``, ``warning`` or ``error``.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LineFormatter(worker_id))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    # It tells of every request at the level at which this program tells of every job.
    logging.getLogger("httpx").setLevel(logging.WARNING)


def _value(value: object) -> str:
    text = " ".join(str(value).split())
    return f'"{text}"' if " " in text or not text else text
