"""Cursors of lists that are ordered by when things were made, newest first."""

import base64
import re
from datetime import UTC, datetime

from brink.server.errors import FieldError, InvalidInput

LATEST_S = 4e9
"""Later than anything that was made, and a time that every platform can name."""


def cursor_of(moment: datetime, name: str) -> str:
    """Return where a page ends."""
    return base64.urlsafe_b64encode(f"{moment.timestamp()!r} {name}".encode()).decode()


def read_cursor(cursor: str) -> tuple[datetime, str]:
    """Return where a page begins.

    Raises:
        InvalidInput: It is none that was given out.
    """
    known = re.fullmatch(r"(\d+\.\d+) ([0-9a-z]+)", _decoded(cursor))
    if known is None:
        message = "expected the value of `next` of an earlier page"
        raise InvalidInput([FieldError(pointer="/query/cursor", message=message)])
    return datetime.fromtimestamp(min(float(known[1]), LATEST_S), UTC), known[2]


def _decoded(cursor: str) -> str:
    try:
        return base64.urlsafe_b64decode(cursor).decode()
    except ValueError:
        return ""
