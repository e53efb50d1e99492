"""lost leases, counted apart from failed attempts; the time of the last sweep

Jobs that are stored already get the default maximum of lost leases.

Revision ID: 0013
Revises: 0012
"""

import sqlalchemy as sa
from alembic import op

from brink.server.db.types import UtcDateTime

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("losses", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("max_losses", sa.Integer(), nullable=False, server_default="10"))
    op.add_column("jobs", sa.Column("lost_token", sa.String(length=64), nullable=True))
    op.add_column("jobs", sa.Column("interrupted", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.create_table(
        "sweeps",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("swept_at", UtcDateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sweeps")),
    )


def downgrade() -> None:
    op.drop_table("sweeps")
    for column in ("interrupted", "lost_token", "max_losses", "losses"):
        op.drop_column("jobs", column)
