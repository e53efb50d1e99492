"""measurements on data sets: job kind, verdict, counts; the worker that failed a job; the machine of a worker

SQLite cannot alter a CHECK constraint, so its tables are recreated; reflection would lose the other ones, so they are
spelled out.

Revision ID: 0002
Revises: 0001
"""

import sqlalchemy as sa
from alembic import op

import brink.server.db.types

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

QUEUED = sa.text("status = 'queued'")
QUEUED_WORK = sa.text("status = 'queued' AND kind <> 'trace'")
QUEUED_TRACES = sa.text("status = 'queued' AND kind = 'trace'")
TRIED = sa.text("status = 'queued' AND attempt > 0")


def upgrade() -> None:
    for table in ("campaigns", "generations"):
        op.add_column(table, sa.Column("measured", sa.BigInteger(), nullable=False, server_default="0"))
    op.add_column("workers", sa.Column("machine", sa.String(length=128), nullable=False, server_default=""))
    op.add_column("jobs", sa.Column("failed_worker", sa.String(length=64), nullable=True))
    _change(
        kinds=("episode", "dataset-evaluation", "trace"),
        kind_length=20,
        verdicts=("pending", "safe", "unsafe", "measured", "failed"),
    )
    op.drop_index("ix_jobs_queued", "jobs", if_exists=True)
    op.create_index("ix_jobs_retries", "jobs", ["not_before"], sqlite_where=TRIED, postgresql_where=TRIED)
    op.create_index(
        "ix_jobs_queued",
        "jobs",
        ["campaign_id", "attempt", "id"],
        sqlite_where=QUEUED_WORK,
        postgresql_where=QUEUED_WORK,
    )
    op.create_index(
        "ix_jobs_queued_traces", "jobs", ["id"], sqlite_where=QUEUED_TRACES, postgresql_where=QUEUED_TRACES
    )


def downgrade() -> None:
    op.execute("DELETE FROM jobs WHERE kind = 'dataset-evaluation'")
    op.execute("DELETE FROM solutions WHERE verdict = 'measured'")
    _change(kinds=("episode", "trace"), kind_length=8, verdicts=("pending", "safe", "unsafe", "failed"))
    op.drop_index("ix_jobs_queued", "jobs", if_exists=True)
    op.drop_index("ix_jobs_queued_traces", "jobs", if_exists=True)
    op.drop_index("ix_jobs_retries", "jobs", if_exists=True)
    op.create_index(
        "ix_jobs_queued", "jobs", ["kind", "campaign_id", "id"], sqlite_where=QUEUED, postgresql_where=QUEUED
    )
    for table in ("campaigns", "generations"):
        op.drop_column(table, "measured")
    op.drop_column("jobs", "failed_worker")
    op.drop_column("workers", "machine")


def _change(*, kinds: tuple[str, ...], kind_length: int, verdicts: tuple[str, ...]) -> None:
    if op.get_bind().dialect.name == "sqlite":
        _remake("jobs", _jobs(kinds, kind_length))
        _remake("solutions", _solutions(verdicts))
        _index_again()
        return
    op.drop_constraint(op.f("ck_jobs_kind_known"), "jobs", type_="check")
    op.alter_column("jobs", "kind", type_=sa.String(length=kind_length))
    op.create_check_constraint(op.f("ck_jobs_kind_known"), "jobs", f"kind IN ({_listed(kinds)})")
    op.drop_constraint(op.f("ck_solutions_verdict_known"), "solutions", type_="check")
    op.create_check_constraint(
        op.f("ck_solutions_verdict_known"), "solutions", f"verdict IN ({_listed(verdicts)})"
    )


def _listed(values: tuple[str, ...]) -> str:
    return ", ".join(f"'{value}'" for value in values)


def _remake(name: str, elements: list[sa.schema.SchemaItem]) -> None:
    columns = ", ".join(f'"{element.name}"' for element in elements if isinstance(element, sa.Column))
    op.create_table(f"{name}_remade", *elements)
    op.execute(f"INSERT INTO {name}_remade ({columns}) SELECT {columns} FROM {name}")
    op.drop_table(name)
    op.rename_table(f"{name}_remade", name)


def _campaign_key(table: str) -> sa.ForeignKeyConstraint:
    name = op.f(f"fk_{table}_campaign_id_campaigns")
    return sa.ForeignKeyConstraint(["campaign_id"], ["campaigns.id"], name=name, ondelete="CASCADE")


def _jobs(kinds: tuple[str, ...], kind_length: int) -> list[sa.schema.SchemaItem]:
    return [
        sa.Column(
            "id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False
        ),
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.String(length=kind_length), nullable=False),
        sa.Column("spec", sa.Text(), nullable=False),
        sa.Column("spec_hash", sa.String(length=64), nullable=False),
        sa.Column("needs", sa.String(length=128), nullable=False),
        sa.Column("cache", sa.Boolean(), nullable=False),
        sa.Column("timeout_s", sa.Double(), nullable=False),
        sa.Column("status", sa.String(length=12), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("max_attempts", sa.Integer(), nullable=False),
        sa.Column("not_before", brink.server.db.types.UtcDateTime(timezone=True), nullable=True),
        sa.Column("lease_token", sa.String(length=64), nullable=True),
        sa.Column("lease_worker", sa.String(length=64), nullable=True),
        sa.Column("lease_expires_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=True),
        sa.Column("failed_worker", sa.String(length=64), nullable=True),
        sa.Column("result", sa.Text(), nullable=True),
        sa.Column("last_error", sa.Text(), nullable=True),
        sa.Column("created_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=False),
        sa.Column("finished_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(status = 'leased') = (lease_expires_at IS NOT NULL)",
            name=op.f("ck_jobs_only_leased_jobs_expire"),
        ),
        sa.CheckConstraint(f"kind IN ({_listed(kinds)})", name=op.f("ck_jobs_kind_known")),
        sa.CheckConstraint(
            "status <> 'leased' OR lease_token IS NOT NULL", name=op.f("ck_jobs_leases_have_tokens")
        ),
        sa.CheckConstraint(
            "status IN ('queued', 'leased', 'done', 'quarantined', 'cancelled')",
            name=op.f("ck_jobs_status_known"),
        ),
        sa.CheckConstraint("attempt >= 0 AND max_attempts >= 1", name=op.f("ck_jobs_attempts_count")),
        _campaign_key("jobs"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
        sa.UniqueConstraint("campaign_id", "number", "kind", name=op.f("uq_jobs_campaign_id_number_kind")),
    ]


def _solutions(verdicts: tuple[str, ...]) -> list[sa.schema.SchemaItem]:
    return [
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("generation", sa.Integer(), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=False),
        sa.Column("spec_hash", sa.String(length=64), nullable=True),
        sa.Column("verdict", sa.String(length=8), nullable=False),
        sa.Column("robustness", sa.Double(), nullable=True),
        sa.Column("objectives", sa.JSON(), nullable=True),
        sa.Column("failure", sa.Text(), nullable=True),
        sa.CheckConstraint(
            "(verdict IN ('safe', 'unsafe')) = (robustness IS NOT NULL)",
            name=op.f("ck_solutions_robustness_with_verdict"),
        ),
        sa.CheckConstraint(f"verdict IN ({_listed(verdicts)})", name=op.f("ck_solutions_verdict_known")),
        _campaign_key("solutions"),
        sa.PrimaryKeyConstraint("campaign_id", "number", name=op.f("pk_solutions")),
    ]


def _index_again() -> None:
    """Recreate the unchanged indexes that were dropped with the tables."""
    leased = sa.text("status = 'leased'")
    op.create_index("ix_jobs_leased", "jobs", ["lease_expires_at"], sqlite_where=leased)
    op.create_index("ix_jobs_lease_worker", "jobs", ["lease_worker"], sqlite_where=leased)
    op.create_index("ix_jobs_spec_hash_status", "jobs", ["spec_hash", "status"])
    op.create_index("ix_jobs_campaign_id_status", "jobs", ["campaign_id", "status"])
    op.create_index("ix_solutions_campaign_id_generation", "solutions", ["campaign_id", "generation"])
