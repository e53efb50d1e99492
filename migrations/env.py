"""Runs the migrations on the connection opened and locked by `brink.server.db.upgrade`, within its transaction."""

from alembic import context
from sqlalchemy import Connection

from brink.server.db.engine import open_engines
from brink.server.db.models import Base
from brink.server.settings import Settings


def _migrate(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=True,
        compare_type=True,
        transaction_per_migration=False,
    )
    context.run_migrations()


connection: Connection | None = context.config.attributes.get("connection")
if connection is not None:
    _migrate(connection)
else:
    with open_engines(Settings().database).writer.begin() as opened:
        _migrate(opened)
