"""Bearer tokens: how they look, what is kept of them, what each scope may do."""

import hashlib
import re
import secrets
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from brink.server.states import Scope

ID_BYTES: Final = 4
SECRET_BYTES: Final = 24
_FORM: Final = re.compile(r"brink_(?P<scope>[a-z]+)_(?P<id>[0-9a-f]{8})_[0-9a-f]{48}")
_JOBS: Final = ("/api/v1/jobs/lease", "/api/v1/jobs/heartbeat", "/api/v1/jobs/results")
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
    return scope is Scope.USER and not _deletes_for_good(method, path)


def _deletes_for_good(method: str, path: str) -> bool:
    return method == "DELETE" and re.fullmatch(r"/api/v1/(campaigns|experiments)/[^/]*/?", path) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredToken:
    """What is kept of a token: never the token itself.

    Attributes:
        id: A part of the token that may be shown.
        name: What somebody calls it.
        scope: What it is for.
        digest: SHA-256 of the token, in hexadecimal digits.
        created_at: When.
        expires_at: When it ends by itself; None if it does not.
        revoked_at: When it was revoked; None if it was not.
    """

    id: str
    name: str
    scope: Scope
    digest: str
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None

    def holds(self, now: datetime) -> bool:
        """Return whether it may be used."""
        return self.revoked_at is None and (self.expires_at is None or self.expires_at > now)


def new_token(scope: Scope) -> tuple[str, str]:
    """Return a new token's id, and the token, to be shown once."""
    token_id = secrets.token_hex(ID_BYTES)
    return token_id, f"brink_{scope}_{token_id}_{secrets.token_hex(SECRET_BYTES)}"


def id_within(token: str) -> str | None:
    """Return the id in a token, or None if it has not the form of one."""
    found = _FORM.fullmatch(token)
    return found["id"] if found is not None else None


def digest_of(token: str) -> str:
    """Return what is kept of a token. It is random enough that a slow hash would add nothing."""
    return hashlib.sha256(token.encode()).hexdigest()
