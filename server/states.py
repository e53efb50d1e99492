"""The states and kinds of campaigns, jobs, solutions and tokens: plain enumerations, cheap to import."""

from enum import StrEnum


class CampaignStatus(StrEnum):
    """The status of a campaign."""

    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    CANCELLED = "cancelled"
    FAILED = "failed"


ENDED = (CampaignStatus.FINISHED, CampaignStatus.CANCELLED, CampaignStatus.FAILED)


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


class FollowUpKind(StrEnum):
    """The question of a follow-up; its module in `brink.server.campaigns.follow_ups.kinds` has the same name."""

    CONFIRM = "confirm"
    """How often is each solution unsafe with other seeds?"""
    COMPONENT = "component"
    """Is each solution unsafe with ground truth in place of the component, in the same episode?"""
    MINIMISE = "minimise"
    """Which differences between the two solutions of each pair matter?"""
    SHARPEN = "sharpen"
    """Where exactly between the two solutions of each pair does it turn?"""


class Selection(StrEnum):
    """How the solutions of a follow-up were chosen."""

    BOUNDARY = "boundary"
    """The distinct boundary at two thresholds."""
    NUMBERS = "numbers"
    """Named by a user, by number."""
    PAIRS = "pairs"
    """Sides of pairs across the boundary."""


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


class CheckResult(StrEnum):
    """Whether a detector meets a requirement."""

    MET = "met"
    NOT_MET = "not met"
    TOO_LITTLE = "not enough data"
    NO_DATA = "no data"
    """No informative drive: the target was never in sight, or errors of the type are not measured."""
