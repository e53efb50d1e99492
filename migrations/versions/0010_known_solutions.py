"""solutions that campaigns start from

Revision ID: 0010
Revises: 0009
"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "known_solutions",
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("place", sa.Integer(), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.Column("is_unsafe", sa.Boolean(), nullable=True),
        sa.Column("robustness", sa.Double(), nullable=True),
        sa.Column("source_id", sa.String(length=16), nullable=True),
        sa.Column("source_number", sa.BigInteger(), nullable=True),
        sa.CheckConstraint(
            "(is_unsafe IS NULL) = (robustness IS NULL)",
            name=op.f("ck_known_solutions_robustness_with_verdict"),
        ),
        sa.ForeignKeyConstraint(
            ["campaign_id"],
            ["campaigns.id"],
            name=op.f("fk_known_solutions_campaign_id_campaigns"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("campaign_id", "place", name=op.f("pk_known_solutions")),
    )


def downgrade() -> None:
    op.drop_table("known_solutions")
