"""The states and kinds of campaigns, jobs, solutions and tokens: plain enumerations, cheap to import."""

from enum import StrEnum


class CampaignStatus(StrEnum):
    """The status of a campaign."""

    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    CANCELLED = "cancelled"
    FAILED = "failed"


class JobStatus(StrEnum):
    """The status of a job. `queued` and `leased` jobs are open; the other states are final."""

    QUEUED = "queued"
    LEASED = "leased"
    DONE = "done"
    QUARANTINED = "quarantined"
    CANCELLED = "cancelled"


class JobKind(StrEnum):
    """The purpose of a job."""

    EPISODE = "episode"
    DATASET = "dataset-evaluation"
    TRACE = "trace"


class SolutionVerdict(StrEnum):
    """The verdict on a solution."""

    PENDING = "pending"
    SAFE = "safe"
    UNSAFE = "unsafe"
    MEASURED = "measured"
    FAILED = "failed"


class Scope(StrEnum):
    """The access that a token grants.

    Attributes:
        READ: Viewing everything.
        USER: Viewing everything, and submitting and controlling campaigns.
        WORKER: Leasing and reporting jobs, nothing else.
        ADMIN: Everything, including deletion.
    """

    READ = "read"
    USER = "user"
    WORKER = "worker"
    ADMIN = "admin"


class OutcomeKind(StrEnum):
    """Which requirements a simulation violated."""

    HELD = "held"
    """None that was recorded."""
    OTHER = "other"
    """None of those that decide the verdict, but another one."""
    VIOLATED = "violated"
    """One of those that decide the verdict."""
