"""Errors of the coordinator, each with the HTTP status that it becomes.

ServerError
├── InvalidInput      422  input does not say something that can be done; carries a pointer to each field
├── NotFound          404  no such resource
├── Conflict          409  the resource is in a state that does not allow this
├── Unavailable       503  try again later: the database is away, the coordinator is stopping
│   └── NoWorker           no live worker can do it
└── DatabaseError     1    command line only: the database cannot be used as it is
    └── Damaged            of one campaign, which ends with it
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

TOKEN_FORM: Final = "expected printable ASCII characters without spaces, such as: openssl rand -hex 24"
"""What a bearer token must look like, to fit a header."""


class ServerError(Exception):
    """Root of everything that the coordinator raises on purpose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldError:
    """What is wrong with one field.

    Attributes:
        pointer: JSON pointer to the field, such as ``/algorithm/params/radius``.
        message: What was expected, and what came.
        nearest: The valid name that is most like the one that came, if there is one.
    """

    pointer: str
    message: str
    nearest: str | None = None

    def __str__(self) -> str:
        hint = f" (did you mean {self.nearest!r}?)" if self.nearest else ""
        place = f"{self.pointer}: " if self.pointer else ""
        return f"{place}{self.message}{hint}"


class InvalidInput(ServerError):
    """Input does not say something that can be done.

    Attributes:
        errors: One for each field that is wrong.
    """

    def __init__(self, errors: Iterable[FieldError]) -> None:
        self.errors = tuple(errors)
        super().__init__("; ".join(map(str, self.errors)))


class NotFound(ServerError):
    """No such resource."""


class Conflict(ServerError):
    """The resource is in a state that does not allow this."""


class Unavailable(ServerError):
    """Try again later.

    Attributes:
        retry_after_s: After how many seconds.
    """

    def __init__(self, message: str, *, retry_after_s: int = 1) -> None:
        self.retry_after_s = retry_after_s
        super().__init__(message)


class NoWorker(Unavailable):
    """No live worker can do it: somebody has to start one."""


class DatabaseError(ServerError):
    """The database cannot be used as it is."""


class Damaged(DatabaseError):
    """What is stored of a campaign does not fit together."""


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name most like the given one, or None if none is like it."""
    matches = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return matches[0] if matches else None
