"""campaigns with several generations in flight

Random search keeps several in flight by default from here on; campaigns that were submitted before keep one.

Revision ID: 0009
Revises: 0008
"""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

_CAMPAIGNS = sa.table("campaigns", sa.column("id", sa.String), sa.column("document", sa.JSON))


def upgrade() -> None:
    op.add_column("campaigns", sa.Column("generation_end", sa.BigInteger(), nullable=True))
    connection = op.get_bind()
    for row in connection.execute(sa.select(_CAMPAIGNS)).all():
        algorithm = row.document.get("algorithm", {})
        if algorithm.get("id") == "random@1" and "params" in algorithm:
            algorithm["params"].setdefault("in_flight", 1)
            connection.execute(
                _CAMPAIGNS.update().where(_CAMPAIGNS.c.id == row.id).values(document=row.document)
            )


def downgrade() -> None:
    op.drop_column("campaigns", "generation_end")
