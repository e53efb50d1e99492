"""boundary solutions are counted with each generation only of searches for the boundary

Revision ID: 0015
Revises: 0014
"""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

_COUNTS = ("dbs", "strict_dbs")


def upgrade() -> None:
    with op.batch_alter_table("generations") as table:
        for name in _COUNTS:
            table.alter_column(name, existing_type=sa.Integer(), nullable=True)


def downgrade() -> None:
    for name in _COUNTS:
        op.execute(f"UPDATE generations SET {name} = 0 WHERE {name} IS NULL")
    with op.batch_alter_table("generations") as table:
        for name in _COUNTS:
            table.alter_column(name, existing_type=sa.Integer(), nullable=False)
