"""repeats of solutions with other seeds

Revision ID: 0007
Revises: 0006
"""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "repeats",
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("of_id", sa.String(length=16), nullable=False),
        sa.Column("t_b", sa.Double(), nullable=False),
        sa.Column("d_th", sa.Double(), nullable=False),
        sa.Column("repeats", sa.Integer(), nullable=False),
        sa.Column("numbers", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["campaign_id"],
            ["campaigns.id"],
            name=op.f("fk_repeats_campaign_id_campaigns"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["of_id"], ["campaigns.id"], name=op.f("fk_repeats_of_id_campaigns"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("campaign_id", name=op.f("pk_repeats")),
    )
    op.create_index(op.f("ix_repeats_of_id"), "repeats", ["of_id"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_repeats_of_id"), table_name="repeats")
    op.drop_table("repeats")
