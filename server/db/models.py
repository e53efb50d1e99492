"""The tables of the database.

A campaign asks for generations of solutions. Each solution that needs a simulation has a job, and a job stores the
outcome of its simulation, which jobs with the same specification hash share. Each table belongs to one package, whose
store modules contain its queries: jobs, sweeps, traces and workers to `brink.server.queue`, most others to
`brink.server.campaigns`.
"""

from datetime import datetime
from enum import StrEnum
from typing import Any, ClassVar

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    UniqueConstraint,
    false,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from brink.server.db.types import Reason, UtcDateTime
from brink.server.states import (
    CampaignStatus,
    FollowUpKind,
    JobKind,
    JobStatus,
    Scope,
    Selection,
    SolutionVerdict,
)

JobId = BigInteger().with_variant(Integer(), "sqlite")


def _one_of(column: str, values: type[StrEnum]) -> CheckConstraint:
    names = ", ".join(f"'{value}'" for value in values)
    return CheckConstraint(f"{column} IN ({names})", name=f"{column}_known")


class Base(DeclarativeBase):
    """Base class of all tables."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        datetime: UtcDateTime(),
        dict[str, Any]: JSON(),
        list[str]: JSON(),
        float: Double(),
        bytes: LargeBinary(),
    }


class CampaignRow(Base):
    """A campaign: its document, its status and its counts."""

    __tablename__ = "campaigns"
    __table_args__ = (
        _one_of("status", CampaignStatus),
        CheckConstraint("generation >= 0", name="generation_counts"),
        CheckConstraint("evaluated >= 0 AND unsafe >= 0 AND failed >= 0", name="counts_count"),
        Index("ix_campaigns_created_at_id", "created_at", "id"),
        Index(
            "ix_campaigns_running",
            "priority",
            "turn",
            sqlite_where=text("status = 'running'"),
            postgresql_where=text("status = 'running'"),
        ),
        Index(
            "ix_campaigns_deleted",
            "deleted_at",
            sqlite_where=text("deleted_at IS NOT NULL"),
            postgresql_where=text("deleted_at IS NOT NULL"),
        ),
    )

    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    document: Mapped[dict[str, Any]]
    document_hash: Mapped[str] = mapped_column(String(64), index=True)
    idempotency_key: Mapped[str | None] = mapped_column(String(200), unique=True)
    status: Mapped[str] = mapped_column(String(16))
    status_reason: Mapped[str] = mapped_column(Reason, default="")
    seed: Mapped[int] = mapped_column(BigInteger)
    priority: Mapped[int] = mapped_column(Integer)
    budget: Mapped[int] = mapped_column(BigInteger)
    generation: Mapped[int] = mapped_column(Integer, default=0)
    generation_end: Mapped[int | None] = mapped_column(BigInteger)
    """First number that belongs to a later generation; None if no later generation is in flight."""
    evaluated: Mapped[int] = mapped_column(BigInteger, default=0)
    unsafe: Mapped[int] = mapped_column(BigInteger, default=0)
    failed: Mapped[int] = mapped_column(BigInteger, default=0)
    measured: Mapped[int] = mapped_column(BigInteger, default=0, server_default="0")
    failures_accepted: Mapped[int] = mapped_column(BigInteger, default=0)
    turn: Mapped[int] = mapped_column(BigInteger, default=0)
    served: Mapped[int] = mapped_column(Integer, default=0, server_default="0")
    sequence: Mapped[int] = mapped_column(BigInteger, default=0, server_default="0")
    notes: Mapped[str] = mapped_column(Text, default="", server_default="")
    search_text: Mapped[str] = mapped_column(Text, default="", server_default="")
    """Name, notes and tags without differences of case, which the databases ignore in different ways."""
    created_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]
    deleted_at: Mapped[datetime | None]
    """When it was deleted: it is hidden, and its rows are being erased."""


class CampaignTagRow(Base):
    """A tag of a campaign."""

    __tablename__ = "campaign_tags"
    __table_args__ = (Index(None, "tag", "campaign_id"),)

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    tag: Mapped[str] = mapped_column(String(40), primary_key=True)


class ExperimentRow(Base):
    """An experiment and its document."""

    __tablename__ = "experiments"

    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    document: Mapped[dict[str, Any]]
    document_hash: Mapped[str] = mapped_column(String(64), index=True)
    idempotency_key: Mapped[str | None] = mapped_column(String(200), unique=True)
    created_at: Mapped[datetime]


class ExperimentCampaignRow(Base):
    """A campaign's membership in an experiment."""

    __tablename__ = "experiment_campaigns"
    __table_args__ = (UniqueConstraint("experiment_id", "place"),)

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    experiment_id: Mapped[str] = mapped_column(ForeignKey("experiments.id", ondelete="CASCADE"))
    place: Mapped[int] = mapped_column(Integer)
    method: Mapped[str] = mapped_column(String(100))
    problem: Mapped[str] = mapped_column(String(100))


class FollowUpRow(Base):
    """A campaign that asks something about solutions of another campaign."""

    __tablename__ = "follow_ups"
    __table_args__ = (
        _one_of("kind", FollowUpKind),
        _one_of("selection", Selection),
        CheckConstraint(
            "(selection = 'boundary') = (t_b IS NOT NULL) AND (selection = 'boundary') = (d_th IS NOT NULL)",
            name="thresholds_of_boundary",
        ),
        CheckConstraint("(kind = 'confirm') = (repeats IS NOT NULL)", name="repeats_confirm"),
        CheckConstraint("repeats >= 2", name="repeats_count"),
    )

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    of_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str] = mapped_column(String(16))
    selection: Mapped[str] = mapped_column(String(16))
    t_b: Mapped[float | None]
    d_th: Mapped[float | None]
    repeats: Mapped[int | None] = mapped_column(Integer)
    """Maximum number of simulations of each solution, with other seeds."""
    numbers: Mapped[list[int]] = mapped_column(JSON)


class GenerationRow(Base):
    """A completed generation's counts and scores: the series for progress and plots."""

    __tablename__ = "generations"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(Integer, primary_key=True)
    evaluated: Mapped[int] = mapped_column(BigInteger)
    unsafe: Mapped[int] = mapped_column(BigInteger)
    failed: Mapped[int] = mapped_column(BigInteger)
    measured: Mapped[int] = mapped_column(BigInteger, default=0, server_default="0")
    best_fitness: Mapped[float | None]
    median_fitness: Mapped[float | None]
    dbs: Mapped[int | None] = mapped_column(Integer)
    """Distinct boundary solutions, if they were counted; see `GenerationSummary`."""
    strict_dbs: Mapped[int | None] = mapped_column(Integer)
    step_s: Mapped[float]
    told_at: Mapped[datetime]


class SolutionRow(Base):
    """A complete solution requested by the algorithm."""

    __tablename__ = "solutions"
    __table_args__ = (
        _one_of("verdict", SolutionVerdict),
        CheckConstraint(
            "(verdict IN ('safe', 'unsafe')) = (robustness IS NOT NULL)", name="robustness_with_verdict"
        ),
        Index("ix_solutions_campaign_id_generation", "campaign_id", "generation"),
    )

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    generation: Mapped[int] = mapped_column(Integer)
    vector: Mapped[bytes]
    seed: Mapped[int] = mapped_column(BigInteger)
    spec_hash: Mapped[str | None] = mapped_column(String(64))
    verdict: Mapped[str] = mapped_column(String(8), default=SolutionVerdict.PENDING)
    robustness: Mapped[float | None]
    objectives: Mapped[dict[str, Any] | None]
    failure: Mapped[str | None] = mapped_column(Reason)
    origin: Mapped[str | None] = mapped_column(String(16))


class KnownSolutionRow(Base):
    """A solution that a campaign started from: with a result that is not its own, or to be simulated first."""

    __tablename__ = "known_solutions"
    __table_args__ = (
        CheckConstraint("(is_unsafe IS NULL) = (robustness IS NULL)", name="robustness_with_verdict"),
    )

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    place: Mapped[int] = mapped_column(Integer, primary_key=True)
    vector: Mapped[bytes]
    is_unsafe: Mapped[bool | None]
    robustness: Mapped[float | None]
    source_id: Mapped[str | None] = mapped_column(String(16))
    """Campaign that simulated it, which may have been deleted; None for a solution of the body."""
    source_number: Mapped[int | None] = mapped_column(BigInteger)


class CheckpointRow(Base):
    """The algorithm's state after the last `tell`, with the neighbour counts of its archive if it has them."""

    __tablename__ = "checkpoints"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    generation: Mapped[int] = mapped_column(Integer)
    document: Mapped[bytes]
    neighbours: Mapped[bytes]
    unsafe_neighbours: Mapped[bytes]
    sha256: Mapped[str] = mapped_column(String(64))


class DistanceBlockRow(Base):
    """Distances from one generation's evaluated solutions to all solutions so far: float32, row-major."""

    __tablename__ = "distance_blocks"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    generation: Mapped[int] = mapped_column(Integer, primary_key=True)
    first_row: Mapped[int] = mapped_column(BigInteger)
    rows: Mapped[int] = mapped_column(Integer)
    columns: Mapped[int] = mapped_column(BigInteger)
    metric_version: Mapped[int] = mapped_column(Integer)
    sha256: Mapped[str] = mapped_column(String(64))
    data: Mapped[bytes]


class JobRow(Base):
    """A simulation for a worker to run."""

    __tablename__ = "jobs"
    __table_args__ = (
        _one_of("status", JobStatus),
        _one_of("kind", JobKind),
        CheckConstraint("attempt >= 0 AND max_attempts >= 1", name="attempts_count"),
        CheckConstraint(
            "(status = 'leased') = (lease_expires_at IS NOT NULL)", name="only_leased_jobs_expire"
        ),
        CheckConstraint("status <> 'leased' OR lease_token IS NOT NULL", name="leases_have_tokens"),
        UniqueConstraint("campaign_id", "number", "kind"),
        Index(
            "ix_jobs_queued",
            "campaign_id",
            "attempt",
            "id",
            sqlite_where=text("status = 'queued' AND kind <> 'trace'"),
            postgresql_where=text("status = 'queued' AND kind <> 'trace'"),
        ),
        Index(
            "ix_jobs_queued_traces",
            "id",
            sqlite_where=text("status = 'queued' AND kind = 'trace'"),
            postgresql_where=text("status = 'queued' AND kind = 'trace'"),
        ),
        Index(
            "ix_jobs_retries",
            "not_before",
            sqlite_where=text("status = 'queued' AND attempt > 0"),
            postgresql_where=text("status = 'queued' AND attempt > 0"),
        ),
        Index(
            "ix_jobs_leased",
            "lease_expires_at",
            sqlite_where=text("status = 'leased'"),
            postgresql_where=text("status = 'leased'"),
        ),
        Index(
            "ix_jobs_lease_worker",
            "lease_worker",
            sqlite_where=text("status = 'leased'"),
            postgresql_where=text("status = 'leased'"),
        ),
        Index("ix_jobs_spec_hash_status", "spec_hash", "status"),
        Index("ix_jobs_campaign_id_status", "campaign_id", "status"),
    )

    id: Mapped[int] = mapped_column(JobId, primary_key=True, autoincrement=True)
    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"))
    number: Mapped[int] = mapped_column(BigInteger)
    kind: Mapped[str] = mapped_column(String(20))
    spec: Mapped[str] = mapped_column(Text)
    spec_hash: Mapped[str] = mapped_column(String(64))
    needs: Mapped[str] = mapped_column(String(128))
    cache: Mapped[bool]
    timeout_s: Mapped[float]
    status: Mapped[str] = mapped_column(String(12))
    attempt: Mapped[int] = mapped_column(Integer, default=0)
    """Number of leases so far, except those that were given back."""
    max_attempts: Mapped[int] = mapped_column(Integer)
    losses: Mapped[int] = mapped_column(Integer, default=0, server_default="0")
    """How many of these leases ran out."""
    max_losses: Mapped[int] = mapped_column(Integer, default=10, server_default="10")
    not_before: Mapped[datetime | None]
    lease_token: Mapped[str | None] = mapped_column(String(64))
    lost_token: Mapped[str | None] = mapped_column(String(64))
    """Token of the last lease if it ran out and nobody has leased the job since."""
    lease_worker: Mapped[str | None] = mapped_column(String(64))
    lease_expires_at: Mapped[datetime | None]
    interrupted: Mapped[bool] = mapped_column(default=False, server_default=false())
    """Whether no coordinator ran during the last lease, which has not been renewed since: its end is not a loss."""
    failed_worker: Mapped[str | None] = mapped_column(String(64))
    result: Mapped[str | None] = mapped_column(Text)
    last_error: Mapped[str | None] = mapped_column(Reason)
    created_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]


class SweepRow(Base):
    """The last sweep of any coordinator, in a single row; there is none before the first sweep."""

    __tablename__ = "sweeps"

    id: Mapped[int] = mapped_column(Integer, primary_key=True)
    swept_at: Mapped[datetime]


class ViolationNameRow(Base):
    """A name that a person gave to a violation, overriding its automatic type."""

    __tablename__ = "violation_names"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    requirement: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    named_at: Mapped[datetime]


class LlmCallRow(Base):
    """A campaign's call to a language model, with the raw reply."""

    __tablename__ = "llm_calls"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    request: Mapped[int] = mapped_column(Integer, primary_key=True)
    turn: Mapped[int] = mapped_column(Integer, primary_key=True)
    prompt_hash: Mapped[str] = mapped_column(String(64))
    mode: Mapped[str] = mapped_column(String(16))
    reply: Mapped[str | None] = mapped_column(Text)
    outcome: Mapped[str] = mapped_column(String(16))
    calls: Mapped[int] = mapped_column(Integer)
    prompt_tokens: Mapped[int | None] = mapped_column(BigInteger)
    completion_tokens: Mapped[int | None] = mapped_column(BigInteger)
    estimated: Mapped[bool]
    cost: Mapped[float | None]
    latency_s: Mapped[float]
    error: Mapped[str | None] = mapped_column(Reason)
    called_at: Mapped[datetime]


class SeedClaimRow(Base):
    """A coordinator's claim to request a campaign's seeds; other coordinators wait until it expires."""

    __tablename__ = "seed_claims"

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    owner: Mapped[str] = mapped_column(String(32))
    expires_at: Mapped[datetime]


class TokenRow(Base):
    """A bearer token; only the digest of its secret is stored."""

    __tablename__ = "tokens"
    __table_args__ = (_one_of("scope", Scope),)

    id: Mapped[str] = mapped_column(String(8), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    scope: Mapped[str] = mapped_column(String(16))
    digest: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]


class TraceRow(Base):
    """The trace of a simulation."""

    __tablename__ = "traces"

    spec_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    data: Mapped[bytes]
    created_at: Mapped[datetime]


NEXT_SEQUENCE = CampaignRow.sequence + 1
"""The new value of a campaign's change counter; a client that knows the previous value notices the change."""


class WorkerRow(Base):
    """A worker that has contacted a coordinator."""

    __tablename__ = "workers"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    host: Mapped[str] = mapped_column(String(255))
    pid: Mapped[int] = mapped_column(BigInteger)
    machine: Mapped[str] = mapped_column(String(128), default="")
    version: Mapped[str] = mapped_column(String(64))
    capabilities: Mapped[list[str]]
    first_seen_at: Mapped[datetime]
    last_seen_at: Mapped[datetime]
    jobs_done: Mapped[int] = mapped_column(BigInteger, default=0)
    jobs_failed: Mapped[int] = mapped_column(BigInteger, default=0)
    drained_at: Mapped[datetime | None]
