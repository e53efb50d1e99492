"""longer turns: the number of jobs that a campaign has handed out in its turn

Revision ID: 0005
Revises: 0004
"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("campaigns", sa.Column("served", sa.Integer(), server_default="0", nullable=False))


def downgrade() -> None:
    op.drop_column("campaigns", "served")
