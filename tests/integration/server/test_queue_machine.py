"""The queue against a small model in memory: whatever is asked in whatever order, both stand the same."""

from pathlib import Path

import pytest
from sqlalchemy.exc import IntegrityError
from support.databases import Databases
from support.queue_faults import FAULTS, Fault, made
from support.queue_machine import on_postgres, on_sqlite, run_machine

from brink.server.db.engine import open_engines

pytestmark = pytest.mark.timeout(300)

HISTORIES = 100
MORE_HISTORIES = 500


def test_the_queue_stands_where_its_model_stands(databases: Databases, sqlite_file: Path) -> None:
    if databases.backend == "sqlite":
        run_machine(on_sqlite(sqlite_file), examples=HISTORIES)
        return
    with databases.database() as url:
        engines = open_engines(url)
        try:
            run_machine(on_postgres(engines), examples=HISTORIES)
        finally:
            engines.dispose()


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_the_model_notices_every_fault(fault: Fault, sqlite_file: Path) -> None:
    # Another error would say that a fault does not run, not that the model noticed it.
    with made(fault), pytest.raises((AssertionError, IntegrityError)):
        run_machine(on_sqlite(sqlite_file), examples=MORE_HISTORIES, shrinks=False)
