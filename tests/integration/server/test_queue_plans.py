"""How the databases find jobs: by the indexes that hold open jobs alone, without knowing what is asked for."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Engine, event
from support.queue import Queue

from server.db.engine import open_engines


def statements_of(engine: Engine, statements: list[tuple[str, Any]]) -> None:
    @event.listens_for(engine, "before_cursor_execute")
    def keep(connection: Any, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        statements.append((statement, parameters))


@pytest.mark.parametrize(
    ("asks", "index"),
    [
        ("lease_worker IN", "ix_jobs_lease_worker"),
        ("AS retries", "ix_jobs_retries"),
        ("ORDER BY jobs.id", "ix_jobs_queued"),
    ],
)
def test_a_lease_finds_jobs_by_the_indexes_of_open_jobs(
    tmp_path: Path, sqlite_file: Path, asks: str, index: str
) -> None:
    file = shutil.copyfile(sqlite_file, tmp_path / "brink.db")
    engines = open_engines(f"sqlite:///{file}")
    queue, said = Queue(engines=engines), list[tuple[str, Any]]()
    try:
        queue.campaign(3)
        statements_of(engines.writer, said)
        queue.lease(max_jobs=1)
        statement, parameters = next(one for one in said if one[0].startswith("SELECT") and asks in one[0])
        # Without their values, as in a plan that Postgres makes for a prepared statement.
        unknown = tuple(None for _ in parameters)
        with engines.writer.connect() as connection:
            plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", unknown).all()
    finally:
        engines.dispose()
    assert any(index in row[-1] for row in plan), plan
