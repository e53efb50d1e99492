"""Errors of the coordinator, with the HTTP status that each becomes.

ServerError
├── InvalidInput      422  the input is invalid; has a pointer to each invalid field
├── NotFound          404  there is no such resource
│   └── NotRecorded        there is no trace, but one can be recorded
├── Conflict          409  the state of the resource does not allow the request
├── Unavailable       503  try again later: the database is unavailable, the coordinator is stopping
│   ├── NoWorker           no live worker can do the work
│   └── TooCostly          a read took longer than one may take
└── DatabaseError          command line only, exit code 1: the database cannot be used as it is
    └── Damaged            the stored data of one campaign is inconsistent
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

TOKEN_FORM: Final = "expected printable ASCII characters without spaces, such as: openssl rand -hex 24"
"""The format of a bearer token, which must fit into a header."""


SHORTEST_ID: Final = 2
"""Minimum number of characters by which a campaign or an experiment can be named."""


LONGEST_POINTER: Final = 500
LONGEST_MESSAGE: Final = 2_000
"""Maximum number of characters of an error's pointer and message, which may quote the input."""
LONGEST_NAME: Final = 200
"""Longer names are similar to none: comparing them takes a time that grows with their length."""


class ServerError(Exception):
    """Base class of all errors that the server package raises deliberately."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldError:
    """An error in one field.

    Attributes:
        pointer: JSON pointer to the field, such as ``/algorithm/params/radius``.
        message: What was expected, and what was given.
        nearest: The most similar valid name, if any.
        place: Where the field is for somebody who wrote it in a file, such as ``x.yaml: line 7: algorithm.id``; empty
            if it came otherwise.
    """

    pointer: str
    message: str
    nearest: str | None = None
    place: str = ""

    def __post_init__(self) -> None:
        """Truncate quotations of very long input, so that a response is not larger than the request."""
        object.__setattr__(self, "pointer", _cut(self.pointer, LONGEST_POINTER))
        object.__setattr__(self, "message", _cut(self.message, LONGEST_MESSAGE))

    def __str__(self) -> str:
        hint = f" (did you mean {self.nearest!r}?)" if self.nearest else ""
        place = self.place or field_name(self.pointer)
        return f"{place}: {self.message}{hint}" if place else f"{self.message}{hint}"


def field_name(pointer: str) -> str:
    """Return the name of a field as in a campaign file, such as ``problem.params.requirement``.

    Args:
        pointer: JSON pointer to the field, or what was given elsewhere, such as the name of an option.
    """
    if not pointer.startswith("/"):
        return pointer
    parts = [part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:] if part]
    if parts == ["path", "campaign_id"]:  # messages about a campaign name it
        return ""
    if parts[:1] in (["query"], ["path"]):
        parts = parts[1:]
    return "".join(f"[{part}]" if part.isdecimal() else f".{part}" for part in parts).removeprefix(".")


class InvalidInput(ServerError):
    """The input is invalid.

    Attributes:
        errors: One error for each invalid field.
    """

    def __init__(self, errors: Iterable[FieldError]) -> None:
        self.errors = tuple(errors)
        super().__init__("; ".join(map(str, self.errors)))

    @classmethod
    def at(cls, pointer: str, message: str) -> Self:
        """Return the error of a single field."""
        return cls([FieldError(pointer=pointer, message=message)])


class NotFound(ServerError):
    """There is no such resource."""


class NotRecorded(NotFound):
    """No trace of an episode is kept, and nobody has asked for one."""


class Conflict(ServerError):
    """The state of the resource does not allow the request."""


class Unavailable(ServerError):
    """The request may succeed later.

    Attributes:
        retry_after_s: Suggested delay before the next try.
    """

    def __init__(self, message: str, *, retry_after_s: int = 1) -> None:
        self.retry_after_s = retry_after_s
        super().__init__(message)


class NoWorker(Unavailable):
    """No live worker can do the work; one has to be started."""


class TooCostly(Unavailable):
    """A read exceeded its time limit. Retrying may be faster later; a smaller read is."""


class DatabaseError(ServerError):
    """The database cannot be used as it is."""


class Damaged(DatabaseError):
    """The stored data of a campaign is inconsistent."""


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name most similar to the given one, or None if none is similar."""
    if len(name) > LONGEST_NAME:
        return None
    matches = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return matches[0] if matches else None


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
