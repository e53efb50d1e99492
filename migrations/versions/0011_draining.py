"""workers that are to finish their jobs and exit

Revision ID: 0011
Revises: 0010
"""

import sqlalchemy as sa
from alembic import op

from brink.server.db.types import UtcDateTime

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("workers", sa.Column("drained_at", UtcDateTime(), nullable=True))


def downgrade() -> None:
    op.drop_column("workers", "drained_at")
