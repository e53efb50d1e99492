"""Decides about each request: does it need a token, whose is it, may it do this, and so often.

Tokens are read from the database and remembered for a few seconds: a new one works, and a revoked one ends, that much
later.
"""

import asyncio
import secrets
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from brink.server.access.store import list_tokens
from brink.server.access.tokens import StoredToken, digest_of, id_within
from brink.server.db.engine import Engines
from brink.server.states import Scope

REMEMBERED_S: Final = 5.0
STRANGERS_PER_S: Final = 20.0
"""Requests with no token, or a wrong one, that one address may make."""

_MOST_BUCKETS: Final = 10_000
_OPERATOR: Final = "the coordinator's own"


@dataclass(frozen=True, slots=True)
class Caller:
    """Whose token a request carries."""

    id: str
    scope: Scope


class _Bucket:
    """Fills with a steady rate, holds what comes in one second, and gives one a request. Changes in place."""

    __slots__ = ("_at", "_left")

    def __init__(self, rate: float, now: float) -> None:
        self._left, self._at = max(1.0, rate), now

    def take(self, rate: float, now: float) -> float:
        """Take one; return 0, or how long to wait for it."""
        self._left = min(max(1.0, rate), self._left + (now - self._at) * rate)
        self._at = now
        if self._left >= 1.0:
            self._left -= 1.0
            return 0.0
        return (1.0 - self._left) / rate


class Gate:
    """Knows the tokens of one coordinator.

    Args:
        engines: Where they are stored.
        token: The one that the coordinator was started with, if any: it may do everything.
        exposed: Whether other machines can come: then nobody is served without a token.
        rate_limit: Requests a second of one token; 0 for no limit.
        clock: Seconds that only grow.
    """

    def __init__(
        self,
        engines: Engines,
        *,
        token: str | None,
        exposed: bool,
        rate_limit: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._engines = engines
        self._own = None if token is None else b"Bearer " + token.encode()
        self._exposed = exposed
        self._rate_limit = rate_limit
        self._clock = clock
        self._known: dict[str, StoredToken] = {}
        self._read_at = -REMEMBERED_S
        self._reading = asyncio.Lock()
        # Of its own: heartbeats must not wait for archives that others read.
        self._reader = ThreadPoolExecutor(1, thread_name_prefix="brink-gate")
        self._buckets: dict[str, _Bucket] = {}

    async def closed(self) -> bool:
        """Return whether requests need a token: one is set, other machines can come, or there ever was a token.

        Were it those that hold, a coordinator would open to everybody when its last token ends.
        """
        if self._own is not None or self._exposed:
            return True
        await self._refresh()
        return bool(self._known)

    async def caller(self, authorization: bytes) -> Caller | None:
        """Return whose token a header carries; None if it is none that holds."""
        if self._own is not None and secrets.compare_digest(authorization, self._own):
            return Caller(_OPERATOR, Scope.ADMIN)
        kind, _, given = authorization.partition(b" ")
        token = given.decode("ascii", errors="replace")
        token_id = id_within(token) if kind == b"Bearer" else None
        if token_id is None:
            return None
        await self._refresh()
        stored = self._known.get(token_id)
        # A comparison in any case: how long it takes says nothing about which ids there are.
        same = secrets.compare_digest(digest_of(token), stored.digest if stored is not None else "0" * 64)
        if stored is None or not same or not stored.holds(datetime.now(UTC)):
            return None
        return Caller(stored.id, stored.scope)

    def wait_s(self, caller: Caller) -> float:
        """Count a request of a token; return 0, or after how long it may come again."""
        return self._take(f"token {caller.id}", self._rate_limit)

    def stranger_wait_s(self, address: str) -> float:
        """Count a request without a token that holds; return 0, or after how long another may come."""
        return self._take(f"address {address}", STRANGERS_PER_S)

    def _take(self, name: str, rate: float) -> float:
        if rate <= 0:
            return 0.0
        now = self._clock()
        if len(self._buckets) >= _MOST_BUCKETS and name not in self._buckets:
            self._buckets.clear()
        return self._buckets.setdefault(name, _Bucket(rate, now)).take(rate, now)

    async def _refresh(self) -> None:
        age = self._clock() - self._read_at
        if age < REMEMBERED_S or (age < 2 * REMEMBERED_S and self._reading.locked()):
            return  # in the latter case somebody is reading them
        async with self._reading:
            if self._clock() - self._read_at < REMEMBERED_S:
                return

            def read() -> dict[str, StoredToken]:
                with self._engines.reader.connect() as connection:
                    return {token.id: token for token in list_tokens(connection)}

            self._known = await asyncio.get_running_loop().run_in_executor(self._reader, read)
            self._read_at = self._clock()
