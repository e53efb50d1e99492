"""A time limit on a computation, for services that share a machine among many.

`time_limit` applies to everything that is called inside its block, in the same thread. The loops that take long,
above all those over blocks of distances, call `check_time`, so that a computation ends soon after its time is up and
does not merely lose the caller who waited for it. Without a limit, results never depend on the clock.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from brink.search.errors import OutOfTime


@dataclass(slots=True)
class Deadline:
    """When a computation must be complete. It may be moved, also by another thread.

    Attributes:
        due_s: Time on the monotonic clock, in seconds.
    """

    due_s: float

    @property
    def is_over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() > self.due_s


_CURRENT: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


@contextmanager
def time_limit(deadline: Deadline) -> Iterator[None]:
    """Limit the time of this block, in place of any enclosing limit."""
    token = _CURRENT.set(deadline)
    try:
        yield
    finally:
        _CURRENT.reset(token)


def check_time() -> None:
    """Check that the time is not up.

    Raises:
        OutOfTime: It is.
    """
    deadline = _CURRENT.get()
    if deadline is not None and deadline.is_over:
        raise OutOfTime("the time for this computation is up")
