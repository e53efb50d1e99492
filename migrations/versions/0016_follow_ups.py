"""follow-ups with a kind and a selection

They were rows of ``repeats``. 0 repeats meant *minimise*, 1 *component* and more *confirm*. The thresholds (1, 0)
meant solutions named by number or sides of pairs, unless the name of the campaign says that the boundary at these
thresholds was meant. Campaigns that simulate sides of pairs until a verdict is confirmed have the setting ``keep``.

Revision ID: 0016
Revises: 0015
"""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None

_CAMPAIGNS = sa.table(
    "campaigns", sa.column("id", sa.String), sa.column("name", sa.String), sa.column("document", sa.JSON)
)
_SHARED = {
    "campaign_id": sa.String,
    "of_id": sa.String,
    "t_b": sa.Double,
    "d_th": sa.Double,
    "repeats": sa.Integer,
    "numbers": sa.JSON,
}
_REPEATS = sa.table("repeats", *map(sa.column, _SHARED, _SHARED.values()))
_FOLLOW_UPS = sa.table(
    "follow_ups",
    *map(sa.column, _SHARED, _SHARED.values()),
    sa.column("kind", sa.String),
    sa.column("selection", sa.String),
)
_EVERY = (1.0, 0.0)
_KINDS = {0: "minimise", 1: "component"}


def upgrade() -> None:
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
        sa.CheckConstraint(
            "kind IN ('confirm', 'component', 'minimise')", name=op.f("ck_follow_ups_kind_known")
        ),
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
    op.create_index(op.f("ix_follow_ups_of_id"), "follow_ups", ["of_id"], unique=False)
    connection = op.get_bind()
    stored = sa.select(_REPEATS, _CAMPAIGNS.c.name, _CAMPAIGNS.c.document["algorithm"].label("algorithm"))
    for row in connection.execute(stored.join(_CAMPAIGNS, _CAMPAIGNS.c.id == _REPEATS.c.campaign_id)).all():
        connection.execute(_FOLLOW_UPS.insert().values(_converted(row)))
    op.drop_index(op.f("ix_repeats_of_id"), table_name="repeats")
    op.drop_table("repeats")


def _converted(row: Any) -> dict[str, Any]:
    kind, selection = _KINDS.get(row.repeats, "confirm"), "pairs"
    if kind == "confirm":
        if (row.t_b, row.d_th) != _EVERY or row.name.endswith(": boundary again"):
            selection = "boundary"
        elif not row.algorithm["params"].get("keep"):
            selection = "numbers"
    return {
        "campaign_id": row.campaign_id,
        "of_id": row.of_id,
        "kind": kind,
        "selection": selection,
        "t_b": row.t_b if selection == "boundary" else None,
        "d_th": row.d_th if selection == "boundary" else None,
        "repeats": row.repeats if kind == "confirm" else None,
        "numbers": row.numbers,
    }


def downgrade() -> None:
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
    number = sa.case({kind: repeats for repeats, kind in _KINDS.items()}, value=_FOLLOW_UPS.c.kind)
    t_b, d_th = _EVERY
    former = sa.select(
        _FOLLOW_UPS.c.campaign_id,
        _FOLLOW_UPS.c.of_id,
        sa.func.coalesce(_FOLLOW_UPS.c.t_b, t_b),
        sa.func.coalesce(_FOLLOW_UPS.c.d_th, d_th),
        sa.func.coalesce(_FOLLOW_UPS.c.repeats, number),
        _FOLLOW_UPS.c.numbers,
    )
    op.execute(_REPEATS.insert().from_select(list(_SHARED), former))
    op.drop_index(op.f("ix_follow_ups_of_id"), table_name="follow_ups")
    op.drop_table("follow_ups")
