"""What every database must do: migrate to this version's tables, once, whole or not at all."""

import json
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from sqlalchemy import Connection, insert, inspect, select, text
from sqlalchemy.exc import IntegrityError
from support.databases import Databases
from support.queue import Queue

from brink.server.campaigns.body import search_text
from brink.server.db import upgrade as upgrading
from brink.server.db.engine import Engines, open_engines
from brink.server.db.models import Base, CampaignRow, FollowUpRow, JobRow, SolutionRow, TraceRow
from brink.server.db.upgrade import alembic_config, current_revision, head_revision, upgrade
from brink.server.errors import DatabaseError


@pytest.fixture
def empty_url(databases: Databases) -> Iterator[str]:
    with databases.database("empty", migrated=False) as url:
        yield url


@pytest.fixture
def empty(empty_url: str) -> Iterator[Engines]:
    engines = open_engines(empty_url)
    yield engines
    engines.dispose()


def test_the_models_are_what_the_migrations_make(empty: Engines) -> None:
    assert upgrade(empty) == (None, head_revision())
    with empty.reader.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []


def test_the_checks_of_the_models_are_what_the_migrations_make(empty: Engines) -> None:
    upgrade(empty)
    inspector = inspect(empty.reader)
    for table in Base.metadata.sorted_tables:
        wanted = {str(c.name) for c in table.constraints if type(c).__name__ == "CheckConstraint"}
        made = {str(check["name"]) for check in inspector.get_check_constraints(table.name)}
        assert made == wanted, table.name


def test_an_upgrade_keeps_what_is_stored(empty: Engines) -> None:
    migrate(empty, "upgrade", "0001")
    moment = datetime(2026, 1, 2, tzinfo=UTC)
    with empty.writer.begin() as connection:
        insert_old_campaign(connection, "a", "Old", {"generation_size": 60}, status="running")
        connection.execute(
            text(
                "INSERT INTO solutions (campaign_id, number, generation, vector, seed, verdict, robustness)"
                " VALUES ('a', 7, 0, :vector, 5, 'unsafe', -1.5)"
            ),
            {"vector": b"1234"},
        )
        connection.execute(
            text(
                "INSERT INTO jobs (campaign_id, number, kind, spec, spec_hash, needs, cache, timeout_s, status,"
                " attempt, max_attempts, result, created_at)"
                " VALUES ('a', 7, 'episode', '{}', 'h', 'n', true, 1.0, 'done', 1, 3, '{}', :moment)"
            ),
            {"moment": moment.isoformat(" ") if empty.writer.dialect.name == "sqlite" else moment},
        )
    assert upgrade(empty) == ("0001", head_revision())
    with empty.reader.connect() as connection:
        campaign = connection.execute(select(CampaignRow)).one()
        assert (campaign.name, campaign.measured, campaign.generation_end) == ("Old", 0, None)
        assert (campaign.notes, campaign.search_text) == ("", search_text("Old", "", [])), "it can be found"
        params = campaign.document["algorithm"]["params"]
        assert params == {"generation_size": 60, "in_flight": 1}, "it goes on with one generation in flight"
        kept = select(SolutionRow.number, SolutionRow.vector, SolutionRow.verdict, SolutionRow.robustness)
        assert connection.execute(kept).one() == (7, b"1234", "unsafe", -1.5)
        job = select(JobRow.number, JobRow.kind, JobRow.status, JobRow.failed_worker)
        assert connection.execute(job).one() == (7, "episode", "done", None)
    migrate(empty, "downgrade", "0001")
    with empty.reader.connect() as connection:
        assert connection.execute(text("SELECT number FROM solutions")).scalars().all() == [7]
    assert upgrade(empty) == ("0001", head_revision())


def test_follow_ups_get_a_kind_and_a_selection(empty: Engines) -> None:
    migrate(empty, "upgrade", "0015")
    keep: dict[str, Any] = {"keep": [True]}
    former: tuple[tuple[str, dict[str, Any], float, float, int, list[int]], ...] = (
        ("Old: boundary again", {}, 0.1, 0.2, 50, [4, 2]),
        ("Old: boundary again", {}, 1.0, 0.0, 50, [4, 2, 7]),
        ("Old: 2 solutions again", {}, 1.0, 0.0, 12, [7, 2]),
        ("Old: boundary again: solution 3 again", keep, 1.0, 0.0, 30, [3]),
        ("Old: 1 unsafe drive with ground truth", {}, 1.0, 0.0, 1, [3]),
        ("Old: 1 pair minimised", {}, 1.0, 0.0, 0, [3, 5]),
    )
    expected = [
        ("confirm", "boundary", 0.1, 0.2, 50, [4, 2]),
        ("confirm", "boundary", 1.0, 0.0, 50, [4, 2, 7]),
        ("confirm", "numbers", None, None, 12, [7, 2]),
        ("confirm", "pairs", None, None, 30, [3]),
        ("component", "pairs", None, None, None, [3]),
        ("minimise", "pairs", None, None, None, [3, 5]),
    ]
    with empty.writer.begin() as connection:
        insert_old_campaign(connection, "of", "Old", {})
        for place, (name, params, *stored, numbers) in enumerate(former):
            insert_old_campaign(connection, f"c{place}", name, params)
            connection.execute(
                text("INSERT INTO repeats VALUES (:id, 'of', :t_b, :d_th, :repeats, :numbers)"),
                {"id": f"c{place}", **dict(zip(("t_b", "d_th", "repeats"), stored, strict=True))}
                | {"numbers": json.dumps(numbers)},
            )
    assert upgrade(empty) == ("0015", head_revision())
    row = FollowUpRow
    query = select(row.kind, row.selection, row.t_b, row.d_th, row.repeats, row.numbers)
    with empty.reader.connect() as connection:
        assert list(map(tuple, connection.execute(query.order_by(row.campaign_id)))) == expected
        assert set(connection.execute(select(row.of_id)).scalars()) == {"of"}
    migrate(empty, "downgrade", "0015")
    again = "SELECT t_b, d_th, repeats FROM repeats ORDER BY campaign_id"
    with empty.reader.connect() as connection:
        found = list(map(tuple, connection.execute(text(again))))
        assert found == [(t_b, d_th, repeats) for _, _, t_b, d_th, repeats, _ in former]
    upgrade(empty)
    with empty.reader.connect() as connection:
        assert list(map(tuple, connection.execute(query.order_by(row.campaign_id)))) == expected


def insert_old_campaign(
    connection: Connection, campaign: str, name: str, params: dict[str, Any], status: str = "finished"
) -> None:
    moment = datetime(2026, 1, 2, tzinfo=UTC)
    connection.execute(
        text(
            "INSERT INTO campaigns (id, name, document, document_hash, status, status_reason, seed, priority,"
            " budget, generation, evaluated, unsafe, failed, failures_accepted, turn, created_at)"
            " VALUES (:id, :name, :document, 'h', :status, '', 1, 0, 9, 1, 3, 1, 0, 0, 0, :moment)"
        ),
        {
            "id": campaign,
            "name": name,
            "status": status,
            "document": json.dumps({"algorithm": {"id": "random@1", "params": params}}),
            "moment": moment.isoformat(" ") if connection.dialect.name == "sqlite" else moment,
        },
    )


@pytest.mark.parametrize(
    "broken",
    [
        {"kind": "other"},
        {"selection": "other"},
        {"kind": "component"},
        {"repeats": None},
        {"repeats": 1},
        {"t_b": None},
        {"selection": "numbers", "t_b": None},
        {"selection": "pairs"},
    ],
)
def test_a_follow_up_that_makes_no_sense_is_not_stored(engines: Engines, broken: dict[str, object]) -> None:
    queue = Queue(engines=engines)
    sound: dict[str, Any] = {"campaign_id": queue.campaign(0), "of_id": queue.campaign(0), "kind": "confirm"}
    sound |= {"selection": "boundary", "t_b": 1.0, "d_th": 0.0, "repeats": 2, "numbers": [1]}
    with pytest.raises(IntegrityError), engines.writer.begin() as connection:
        connection.execute(insert(FollowUpRow).values({**sound, **broken}))
    with engines.writer.begin() as connection:
        connection.execute(insert(FollowUpRow).values(sound))


def migrate(engines: Engines, direction: str, revision: str) -> None:
    config = alembic_config()
    with engines.writer.begin() as connection:
        config.attributes["connection"] = connection
        getattr(command, direction)(config, revision)


def test_upgrading_twice_changes_nothing(empty: Engines) -> None:
    upgrade(empty)
    assert upgrade(empty) == (head_revision(), head_revision())
    assert current_revision(empty) == head_revision()


def failing_migrations(folder: Path) -> Config:
    """Return migrations whose second step fails after its first statement."""
    shutil.copytree(str(files("brink.migrations")), folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "versions" / "9999_fails.py").write_text(
        textwrap.dedent(
            f"""
            import sqlalchemy as sa
            from alembic import op

            revision, down_revision, branch_labels, depends_on = "9999", {head_revision()!r}, None, None


            def upgrade():
                op.create_table("half", sa.Column("id", sa.Integer, primary_key=True))
                raise RuntimeError("no further")
            """
        )
    )
    config = Config()
    config.set_main_option("script_location", str(folder))
    return config


@pytest.mark.parametrize("start", ["nothing", "head"])
def test_a_failed_migration_leaves_nothing_behind(
    empty: Engines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: str
) -> None:
    if start == "head":
        upgrade(empty)
    before = set(inspect(empty.reader).get_table_names())
    revision = current_revision(empty)
    config = failing_migrations(tmp_path / "failing")
    with monkeypatch.context() as patched:
        patched.setattr(upgrading, "alembic_config", lambda: config)
        with pytest.raises(RuntimeError, match="no further"):
            upgrade(empty)
    assert set(inspect(empty.reader).get_table_names()) == before
    assert current_revision(empty) == revision
    upgrade(empty)
    assert current_revision(empty) == head_revision()


def test_two_processes_that_race_to_upgrade_both_succeed(empty_url: str) -> None:
    program = textwrap.dedent(
        """
        import multiprocessing, sys
        from brink.server.db.engine import open_engines
        from brink.server.db.upgrade import upgrade
        forked = multiprocessing.get_context("fork")  # so that the modules are imported once
        start = forked.Barrier(3)

        def race():
            engines = open_engines(sys.argv[1])
            start.wait(60)
            said = " ".join(map(str, upgrade(engines)))
            sys.stdout.write(said + "\\n")
            sys.stdout.flush()
            engines.dispose()

        racers = [forked.Process(target=race) for _ in range(3)]
        for racer in racers:
            racer.start()
        for racer in racers:
            racer.join()
        sys.exit(any(racer.exitcode for racer in racers))
        """
    )
    raced = subprocess.run(
        [sys.executable, "-c", program, empty_url], capture_output=True, text=True, timeout=60, check=False
    )
    assert raced.returncode == 0, raced.stderr
    head = head_revision()
    assert sorted(raced.stdout.splitlines()) == sorted([f"None {head}", f"{head} {head}", f"{head} {head}"])


def test_a_newer_schema_is_refused_in_one_clear_line(empty: Engines) -> None:
    upgrade(empty)
    with empty.writer.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '7777'"))
    with pytest.raises(DatabaseError) as caught:
        upgrade(empty)
    message = str(caught.value)
    assert "'7777' is not known" in message
    assert "update Brink" in message
    assert "\n" not in message


def test_a_database_that_cannot_be_reached_is_told_in_one_line(tmp_path: Path) -> None:
    for url in ("postgresql://nobody:secret@127.0.0.1:1/nothing", f"sqlite:///{tmp_path}/no/such/folder.db"):
        engines = open_engines(url)
        with pytest.raises(DatabaseError) as caught:
            upgrade(engines)
        assert "\n" not in str(caught.value)
        assert "secret" not in str(caught.value)
        engines.dispose()


def test_a_file_that_is_no_database_is_told(tmp_path: Path) -> None:
    file = tmp_path / "notes.db"
    file.write_text("not a database, but long enough to be taken for one " * 50)
    engines = open_engines(f"sqlite:///{file}")
    with pytest.raises(DatabaseError, match="not a database"):
        upgrade(engines)
    engines.dispose()


def test_moments_come_back_as_they_went_in(engines: Engines) -> None:
    moment = datetime(2026, 3, 1, 12, 0, 0, 123456, tzinfo=timezone(timedelta(hours=5)))
    with engines.writer.begin() as connection:
        connection.execute(insert(TraceRow).values(spec_hash="a", data=b"\0\xff", created_at=moment))
    with engines.reader.connect() as connection:
        row = connection.execute(select(TraceRow.created_at, TraceRow.data)).one()
    assert row.created_at == moment
    assert row.created_at.tzinfo is UTC
    assert bytes(row.data) == b"\0\xff"


def test_a_moment_without_a_zone_is_refused(engines: Engines) -> None:
    with pytest.raises(Exception, match="aware"), engines.writer.begin() as connection:
        connection.execute(insert(TraceRow).values(spec_hash="a", data=b"", created_at=datetime(2026, 1, 1)))


@pytest.mark.parametrize(
    "broken",
    [
        {"status": "lost"},
        {"status": "leased"},
        {"status": "leased", "lease_token": "t"},
        {"attempt": -1},
        {"kind": "other"},
        {"campaign_id": "nobody"},
    ],
)
def test_a_job_that_breaks_an_invariant_is_not_stored(engines: Engines, broken: dict[str, object]) -> None:
    campaign = Queue(engines=engines).campaign(0)
    sound = {
        "campaign_id": campaign,
        "number": 1,
        "kind": "episode",
        "spec": "{}",
        "spec_hash": "h",
        "needs": "x",
        "cache": True,
        "timeout_s": 1.0,
        "status": "queued",
        "attempt": 0,
        "max_attempts": 3,
        "created_at": datetime.now(UTC),
    }
    with pytest.raises(IntegrityError), engines.writer.begin() as connection:
        connection.execute(insert(JobRow).values({**sound, **broken}))
    with engines.writer.begin() as connection:
        connection.execute(insert(JobRow).values(sound))
    with pytest.raises(IntegrityError), engines.writer.begin() as connection:
        connection.execute(insert(JobRow).values(sound))


def test_readers_see_one_snapshot(engines: Engines) -> None:
    with engines.reader.connect() as reading:
        assert reading.execute(select(TraceRow.spec_hash)).all() == []
        with engines.writer.begin() as writing:
            writing.execute(insert(TraceRow).values(spec_hash="a", data=b"", created_at=datetime.now(UTC)))
        assert reading.execute(select(TraceRow.spec_hash)).all() == []
    with engines.reader.connect() as reading:
        assert reading.execute(select(TraceRow.spec_hash)).scalars().all() == ["a"]


def test_a_connection_that_is_in_use_while_the_engines_are_disposed_is_closed_in_the_end(
    database_url: str,
) -> None:
    engines = open_engines(database_url)
    for engine in (engines.writer, engines.reader):
        with engine.connect() as connection:
            connection.execute(text("SELECT 1"))
            driver = connection.connection.dbapi_connection
            assert driver is not None
            engines.dispose()
        with pytest.raises(Exception, match="closed"):
            driver.cursor().execute("SELECT 1")
