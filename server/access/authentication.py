"""Authentication of requests by bearer token, and rate limits.

Tokens are cached, so it takes a few seconds until a new token is accepted or a revoked one is rejected.
"""

import asyncio
import secrets
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from brink.server.access.tokens import StoredToken, list_tokens, parse_token_id, token_digest
from brink.server.db.engine import Engines
from brink.server.states import Scope

TOKEN_CACHE_S: Final = 5.0
UNAUTHENTICATED_PER_S: Final = 20.0
"""Requests per second from one address without a valid token."""

_MAX_BUCKETS: Final = 10_000
_OPERATOR: Final = "the coordinator's own"


@dataclass(frozen=True, slots=True)
class Caller:
    """The owner of the token that a request carries."""

    id: str
    scope: Scope


class _Bucket:
    """A token bucket that holds one second's worth of requests. Mutable."""

    __slots__ = ("_at", "_left")

    def __init__(self, rate: float, now: float) -> None:
        self._left, self._at = max(1.0, rate), now

    def take(self, rate: float, now: float) -> float:
        """Take one request from the bucket; return 0, or how long to wait until one is available, in seconds."""
        self._left = min(max(1.0, rate), self._left + (now - self._at) * rate)
        self._at = now
        if self._left >= 1.0:
            self._left -= 1.0
            return 0.0
        return (1.0 - self._left) / rate


class Authenticator:
    """Checks tokens and request rates.

    Args:
        engines: Database with the tokens.
        token: Token that the coordinator was started with, if any; its scope is admin.
        exposed: Whether other machines can connect; a token is then always required.
        rate_limit: Requests per second for each token; 0 for no limit.
        clock: Monotonic clock, in seconds.
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
        self._read_at = -TOKEN_CACHE_S
        self._reading = asyncio.Lock()
        # A separate thread, so that heartbeats do not wait for reads of archives.
        self._reader = ThreadPoolExecutor(1, thread_name_prefix="brink-access")
        self._buckets: dict[str, _Bucket] = {}

    async def requires_token(self) -> bool:
        """Return whether requests need a token: if one is set, other machines can connect, or any was ever stored.

        Expired and revoked tokens count; otherwise, a coordinator would accept everyone once its last token expires.
        """
        if self._own is not None or self._exposed:
            return True
        await self._refresh()
        return bool(self._known)

    async def caller(self, authorization: bytes) -> Caller | None:
        """Return the owner of the token in an Authorization header, or None if the token is not valid."""
        if self._own is not None and secrets.compare_digest(authorization, self._own):
            return Caller(_OPERATOR, Scope.ADMIN)
        kind, _, given = authorization.partition(b" ")
        token = given.decode("ascii", errors="replace")
        token_id = parse_token_id(token) if kind == b"Bearer" else None
        if token_id is None:
            return None
        await self._refresh()
        stored = self._known.get(token_id)
        # Always compare, so that timing does not reveal which ids exist.
        same = secrets.compare_digest(token_digest(token), stored.digest if stored is not None else "0" * 64)
        if stored is None or not same or not stored.is_valid(datetime.now(UTC)):
            return None
        return Caller(stored.id, stored.scope)

    def wait_s(self, caller: Caller) -> float:
        """Count a request against the limit of its token; return 0, or how long the client must wait, in seconds."""
        return self._take(f"token {caller.id}", self._rate_limit)

    def unauthenticated_wait_s(self, address: str) -> float:
        """Count a request without a valid token; return 0, or how long the client must wait, in seconds."""
        return self._take(f"address {address}", UNAUTHENTICATED_PER_S)

    def _take(self, name: str, rate: float) -> float:
        if rate <= 0:
            return 0.0
        now = self._clock()
        if len(self._buckets) >= _MAX_BUCKETS and name not in self._buckets:
            self._buckets.clear()
        return self._buckets.setdefault(name, _Bucket(rate, now)).take(rate, now)

    async def _refresh(self) -> None:
        age = self._clock() - self._read_at
        if age < TOKEN_CACHE_S or (age < 2 * TOKEN_CACHE_S and self._reading.locked()):
            return  # in the second case another request is refreshing the cache
        async with self._reading:
            if self._clock() - self._read_at < TOKEN_CACHE_S:
                return

            def read() -> dict[str, StoredToken]:
                with self._engines.reader.connect() as connection:
                    return {token.id: token for token in list_tokens(connection)}

            self._known = await asyncio.get_running_loop().run_in_executor(self._reader, read)
            self._read_at = self._clock()
