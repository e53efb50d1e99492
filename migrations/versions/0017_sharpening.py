"""follow-ups that bring pairs to thresholds

SQLite cannot change a check of a table, so the table is made again there.

Revision ID: 0017
Revises: 0016
"""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_BEFORE = ("confirm", "component", "minimise")
_COLUMNS = "campaign_id, of_id, kind, selection, t_b, d_th, repeats, numbers"


def upgrade() -> None:
    _allow((*_BEFORE, "sharpen"))


def downgrade() -> None:
    op.execute("DELETE FROM follow_ups WHERE kind = 'sharpen'")
    _allow(_BEFORE)


def _allow(kinds: tuple[str, ...]) -> None:
    known = f"kind IN ({', '.join(repr(kind) for kind in kinds)})"
    if op.get_bind().dialect.name == "postgresql":
        op.drop_constraint(op.f("ck_follow_ups_kind_known"), "follow_ups", type_="check")
        op.create_check_constraint(op.f("ck_follow_ups_kind_known"), "follow_ups", known)
        return
    op.drop_index(op.f("ix_follow_ups_of_id"), table_name="follow_ups")
    op.rename_table("follow_ups", "follow_ups_before")
    _create(known)
    op.execute(f"INSERT INTO follow_ups ({_COLUMNS}) SELECT {_COLUMNS} FROM follow_ups_before")
    op.drop_table("follow_ups_before")
    op.create_index(op.f("ix_follow_ups_of_id"), "follow_ups", ["of_id"], unique=False)


def _create(known: str) -> None:
    op.create_table(
        "follow_ups",
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("of_id", sa.String(length=16), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("selection", sa.String(length=16), nullable=False),
        sa.Column("t_b", sa.Double(), nullable=True),
        sa.Column("d_th", sa.Double(), nullable=True),
        sa.Column("repeats", sa.Integer(), nullable=True),
        sa.Column("numbers", sa.JSON(), nullable=False),
        sa.CheckConstraint(known, name=op.f("ck_follow_ups_kind_known")),
        sa.CheckConstraint(
            "selection IN ('boundary', 'numbers', 'pairs')", name=op.f("ck_follow_ups_selection_known")
        ),
        sa.CheckConstraint(
            "(selection = 'boundary') = (t_b IS NOT NULL) AND (selection = 'boundary') = (d_th IS NOT NULL)",
            name=op.f("ck_follow_ups_thresholds_of_boundary"),
        ),
        sa.CheckConstraint(
            "(kind = 'confirm') = (repeats IS NOT NULL)", name=op.f("ck_follow_ups_repeats_confirm")
        ),
        sa.CheckConstraint("repeats >= 2", name=op.f("ck_follow_ups_repeats_count")),
        sa.ForeignKeyConstraint(
            ["campaign_id"],
            ["campaigns.id"],
            name=op.f("fk_follow_ups_campaign_id_campaigns"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["of_id"], ["campaigns.id"], name=op.f("fk_follow_ups_of_id_campaigns"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("campaign_id", name=op.f("pk_follow_ups")),
    )
