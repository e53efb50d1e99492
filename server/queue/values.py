"""What goes into the queue's SQL, and what comes out of it."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from sqlalchemy import Row

JobRecord: TypeAlias = Row[*tuple[Any, ...]]
"""Some columns of a job."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseTerms:
    """How leases are granted.

    Attributes:
        lease_s: How long a lease holds.
        retry_backoff_s: Wait before the first retry; doubles each time.
        live_workers: Workers that share the queue now, at least 1.
        elsewhere: What live workers other than the one that asks can run.
    """

    lease_s: float
    retry_backoff_s: float
    live_workers: int
    elsewhere: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a worker reports of one job.

    Attributes:
        result: The completed episode as JSON text, without its trace, or None if it failed.
        trace: The trace, if there is one.
        error: Why it failed.
        final: Whether trying again is pointless.
    """

    job: int
    token: str
    result: str | None
    trace: bytes | None = None
    error: str = ""
    final: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What became of reported outcomes.

    Attributes:
        statuses: ``accepted``, ``duplicate`` or ``stale``, in the order of the outcomes.
        campaigns: Campaigns that have no open episode left because of them.
    """

    statuses: tuple[str, ...]
    campaigns: tuple[str, ...]
