"""Bearer tokens: their format, their scopes, and how they are stored."""

import hashlib
import re
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import Connection, insert, or_, select, update

from brink.server.db.models import TokenRow
from brink.server.db.sql import database_now
from brink.server.errors import NotFound
from brink.server.states import Scope

ID_BYTES: Final = 4
SECRET_BYTES: Final = 24
_FORM: Final = re.compile(r"brink_(?P<scope>[a-z]+)_(?P<id>[0-9a-f]{8})_[0-9a-f]{48}")
_JOBS: Final = ("/api/v1/jobs/lease", "/api/v1/jobs/heartbeat", "/api/v1/jobs/results")
_DRAINS: Final = re.compile(r"/api/v1/workers/[^/]*/drain/?")
"""Draining a worker requires the rights to start another one."""
_READS: Final = frozenset({"GET", "HEAD"})


def allows(scope: Scope, method: str, path: str) -> bool:
    """Return whether a scope covers a request.

    Args:
        scope: The scope of the caller's token.
        method: HTTP method of the request.
        path: Path of the request, such as ``/api/v1/campaigns``.
    """
    if scope is Scope.ADMIN:
        return True
    if path in _JOBS:
        return scope is Scope.WORKER
    if scope is Scope.WORKER:
        return False
    if method in _READS:
        return True
    return scope is Scope.USER and not _deletes_for_good(method, path) and not _DRAINS.fullmatch(path)


def _deletes_for_good(method: str, path: str) -> bool:
    return method == "DELETE" and re.fullmatch(r"/api/v1/(campaigns|experiments)/[^/]*/?", path) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredToken:
    """The stored record of a token, which never contains the token itself.

    Attributes:
        id: Public part of the token.
        name: Name given by its creator.
        scope: What the token may be used for.
        digest: SHA-256 of the token in hexadecimal.
        created_at: Time of creation.
        expires_at: Time of expiry; None if the token does not expire.
        revoked_at: Time of revocation; None if the token was not revoked.
    """

    id: str
    name: str
    scope: Scope
    digest: str
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None

    def is_valid(self, now: datetime) -> bool:
        """Return whether the token is neither revoked nor expired."""
        return self.revoked_at is None and (self.expires_at is None or self.expires_at > now)


def new_token(scope: Scope) -> tuple[str, str]:
    """Generate a token; return its id, and the token itself, which is shown only once."""
    token_id = secrets.token_hex(ID_BYTES)
    return token_id, f"brink_{scope}_{token_id}_{secrets.token_hex(SECRET_BYTES)}"


def parse_token_id(token: str) -> str | None:
    """Return the id in a token, or None if the token is malformed."""
    found = _FORM.fullmatch(token)
    return found["id"] if found is not None else None


def token_digest(token: str) -> str:
    """Return the stored digest of a token. Tokens are random enough that a slow hash would add no security."""
    return hashlib.sha256(token.encode()).hexdigest()


def create_token(connection: Connection, scope: Scope, name: str, expires_in: timedelta | None = None) -> str:
    """Store a new token and return it; it cannot be read again later.

    Args:
        connection: Write connection.
        scope: What the token may be used for.
        name: Human-readable name.
        expires_in: Lifetime; None for a token that does not expire.
    """
    token_id, token = new_token(scope)
    now = database_now(connection)
    connection.execute(
        insert(TokenRow).values(
            id=token_id,
            name=name,
            scope=scope,
            digest=token_digest(token),
            created_at=now,
            expires_at=None if expires_in is None else now + expires_in,
            revoked_at=None,
        )
    )
    return token


def list_tokens(connection: Connection) -> list[StoredToken]:
    """Return all tokens, oldest first."""
    query = select(TokenRow.__table__).order_by(TokenRow.created_at, TokenRow.id)
    return [
        StoredToken(**{**row, "scope": Scope(row["scope"])}) for row in connection.execute(query).mappings()
    ]


def revoke_token(connection: Connection, token_id: str) -> None:
    """Revoke a token.

    Raises:
        NotFound: No token has this id, or it is already revoked.
    """
    changed = connection.execute(
        update(TokenRow)
        .where(TokenRow.id == token_id, TokenRow.revoked_at.is_(None))
        .values(revoked_at=database_now(connection))
    )
    if changed.rowcount == 0:
        raise NotFound(f"token {token_id}: no such token, or already revoked; see: brink token list")


def any_token(connection: Connection, *, valid_only: bool = True) -> bool:
    """Return whether a valid token exists or, if ``valid_only`` is false, whether any token was ever stored."""
    query = select(TokenRow.id).limit(1)
    if valid_only:
        now = database_now(connection)
        unexpired = or_(TokenRow.expires_at.is_(None), TokenRow.expires_at > now)
        query = query.where(TokenRow.revoked_at.is_(None), unexpired)
    return connection.execute(query).first() is not None
