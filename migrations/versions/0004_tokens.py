"""bearer tokens

Revision ID: 0004
Revises: 0003
"""

import sqlalchemy as sa
from alembic import op

import brink.server.db.types

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(length=8), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("scope", sa.String(length=16), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("created_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=False),
        sa.Column("expires_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", brink.server.db.types.UtcDateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "scope IN ('read', 'user', 'worker', 'admin')", name=op.f("ck_tokens_scope_known")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_tokens")),
    )


def downgrade() -> None:
    op.drop_table("tokens")
