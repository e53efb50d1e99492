"""What goes into the queue's SQL, and what comes out of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from sqlalchemy import Row

from brink.worker.wire import LeasedJob

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
class LeaseWanted:
    """A worker that asks for jobs.

    Attributes:
        worker: Its id.
        capabilities: What it can run.
        max_jobs: Most jobs that it wants.
        terms: How they are granted to it.
    """

    worker: str
    capabilities: tuple[str, ...]
    max_jobs: int
    terms: LeaseTerms


@dataclass(frozen=True, slots=True, kw_only=True)
class Grants:
    """What workers get.

    Attributes:
        jobs: For each that asked.
        campaigns: Whose jobs these are.
    """

    jobs: Sequence[list[LeasedJob]]
    campaigns: frozenset[str]


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
class Loss:
    """An attempt at a job that came to nothing.

    Attributes:
        worker: Who held it.
        reason: In words.
        final: Whether the job is in quarantine now.
    """

    job: int
    campaign: str
    worker: str
    attempt: int
    reason: str
    final: bool

    @property
    def fields(self) -> dict[str, object]:
        """What the log says of it."""
        return {
            "campaign": self.campaign, "job": self.job, "worker": self.worker, "attempt": self.attempt,
            "reason": self.reason.partition("\n")[0],
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What became of reported outcomes.

    Attributes:
        statuses: ``accepted``, ``duplicate`` or ``stale``, in the order of the outcomes.
        campaigns: Campaigns that have no open episode left because of them.
        owners: The campaign of each job that is known.
        quarantined: Jobs that will not be tried again.
    """

    statuses: tuple[str, ...]
    campaigns: tuple[str, ...]
    owners: Mapping[int, str] = field(default_factory=dict)
    quarantined: tuple[Loss, ...] = ()
