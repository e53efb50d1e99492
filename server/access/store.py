"""The SQL of tokens."""

from datetime import timedelta

from sqlalchemy import Connection, insert, or_, select, update

from brink.server.access.tokens import StoredToken, digest_of, new_token
from brink.server.db.models import TokenRow
from brink.server.db.sql import database_now
from brink.server.errors import NotFound
from brink.server.states import Scope


def create_token(connection: Connection, scope: Scope, name: str, expires_in: timedelta | None = None) -> str:
    """Store a new token and return it; nobody can see it again."""
    token_id, token = new_token(scope)
    now = database_now(connection)
    connection.execute(
        insert(TokenRow).values(
            id=token_id, name=name, scope=scope, digest=digest_of(token), created_at=now,
            expires_at=None if expires_in is None else now + expires_in, revoked_at=None,
        )
    )  # fmt: skip
    return token


def list_tokens(connection: Connection) -> list[StoredToken]:
    """Return all tokens, the oldest first."""
    query = select(TokenRow.__table__).order_by(TokenRow.created_at, TokenRow.id)
    return [
        StoredToken(
            id=row.id, name=row.name, scope=Scope(row.scope), digest=row.digest, created_at=row.created_at,
            expires_at=row.expires_at, revoked_at=row.revoked_at,
        )
        for row in connection.execute(query)
    ]  # fmt: skip


def revoke_token(connection: Connection, token_id: str) -> None:
    """End a token.

    Raises:
        NotFound: There is none with this id that holds.
    """
    changed = connection.execute(
        update(TokenRow)
        .where(TokenRow.id == token_id, TokenRow.revoked_at.is_(None))
        .values(revoked_at=database_now(connection))
    )
    if changed.rowcount == 0:
        raise NotFound(f"token {token_id}: no such token, or it is revoked already; see: brink token list")


def any_token(connection: Connection, *, that_holds: bool = True) -> bool:
    """Return whether there is a token that may be used, or whether there ever was one."""
    query = select(TokenRow.id).limit(1)
    if that_holds:
        now = database_now(connection)
        ends = or_(TokenRow.expires_at.is_(None), TokenRow.expires_at > now)
        query = query.where(TokenRow.revoked_at.is_(None), ends)
    return connection.execute(query).first() is not None
