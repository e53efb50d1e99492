"""campaigns that are deleted and whose rows are being erased

Revision ID: 0014
Revises: 0013
"""

import sqlalchemy as sa
from alembic import op

from brink.server.db.types import UtcDateTime

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

_DELETED = sa.text("deleted_at IS NOT NULL")


def upgrade() -> None:
    op.add_column("campaigns", sa.Column("deleted_at", UtcDateTime(timezone=True), nullable=True))
    op.create_index(
        "ix_campaigns_deleted", "campaigns", ["deleted_at"], sqlite_where=_DELETED, postgresql_where=_DELETED
    )


def downgrade() -> None:
    op.drop_index("ix_campaigns_deleted", "campaigns")
    op.execute("DELETE FROM campaigns WHERE deleted_at IS NOT NULL")
    op.drop_column("campaigns", "deleted_at")
