"""The states and kinds of campaigns, jobs, solutions and tokens: plain enumerations, cheap to import."""

from enum import StrEnum


class CampaignStatus(StrEnum):
    """Where a campaign stands."""

    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    CANCELLED = "cancelled"
    FAILED = "failed"


class JobStatus(StrEnum):
    """Where a job stands. `queued` and `leased` are open; the others are final."""

    QUEUED = "queued"
    LEASED = "leased"
    DONE = "done"
    QUARANTINED = "quarantined"
    CANCELLED = "cancelled"


class JobKind(StrEnum):
    """What a job is for."""

    EPISODE = "episode"
    DATASET = "dataset-evaluation"
    TRACE = "trace"


class SolutionVerdict(StrEnum):
    """What is known of a solution."""

    PENDING = "pending"
    SAFE = "safe"
    UNSAFE = "unsafe"
    MEASURED = "measured"
    FAILED = "failed"


class Scope(StrEnum):
    """What a token permits.

    Attributes:
        READ: Read everything.
        USER: Read everything, submit and control campaigns.
        WORKER: Lease and report jobs, and nothing else.
        ADMIN: Everything, including deletion.
    """

    READ = "read"
    USER = "user"
    WORKER = "worker"
    ADMIN = "admin"
