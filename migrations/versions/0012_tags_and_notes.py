"""tags and notes of campaigns

Revision ID: 0012
Revises: 0011
"""

from unicodedata import normalize

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

_CAMPAIGNS = sa.table(
    "campaigns", sa.column("id", sa.String), sa.column("name", sa.String), sa.column("search_text", sa.Text)
)


def upgrade() -> None:
    op.create_table(
        "campaign_tags",
        sa.Column("campaign_id", sa.String(length=16), nullable=False),
        sa.Column("tag", sa.String(length=40), nullable=False),
        sa.ForeignKeyConstraint(
            ["campaign_id"],
            ["campaigns.id"],
            name=op.f("fk_campaign_tags_campaign_id_campaigns"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("campaign_id", "tag", name=op.f("pk_campaign_tags")),
    )
    op.create_index(
        op.f("ix_campaign_tags_tag_campaign_id"), "campaign_tags", ["tag", "campaign_id"], unique=False
    )
    op.add_column("campaigns", sa.Column("notes", sa.Text(), nullable=False, server_default=""))
    op.add_column("campaigns", sa.Column("search_text", sa.Text(), nullable=False, server_default=""))
    connection = op.get_bind()
    for row in connection.execute(sa.select(_CAMPAIGNS.c.id, _CAMPAIGNS.c.name)).all():
        # Name, no tags, no notes; like `brink.server.campaigns.body.search_text`.
        searched = normalize("NFC", normalize("NFD", f"{row.name}\n\n").casefold())
        connection.execute(_CAMPAIGNS.update().where(_CAMPAIGNS.c.id == row.id).values(search_text=searched))


def downgrade() -> None:
    op.drop_column("campaigns", "search_text")
    op.drop_column("campaigns", "notes")
    op.drop_index(op.f("ix_campaign_tags_tag_campaign_id"), table_name="campaign_tags")
    op.drop_table("campaign_tags")
