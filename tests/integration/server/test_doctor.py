"""The examination: what is fine is called fine, and each thing that can go wrong is named with what to do."""

import json
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text, update
from support.api import FakeWorker, ball, coordinator, submit
from support.queue import Queue
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, CheckpointRow, DistanceBlockRow, JobRow
from brink.server.db.sql import database_now
from brink.server.operations.doctor import State, examine
from brink.server.settings import Settings


def found(database_url: str, engines: Engines) -> Mapping[str, tuple[State, str]]:
    checks = examine(Settings(database=database_url), engines, thorough=True)
    return {one.check: (one.state, one.found) for one in checks}


@pytest.fixture
def finished(database_url: str, small_problems: None) -> str:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=60))
        FakeWorker(client).work(campaign)
    return campaign


def test_a_sound_database_is_called_so(database_url: str, engines: Engines, finished: str) -> None:
    checks = found(database_url, engines)
    assert {state for state, _ in checks.values()} == {State.FINE}
    assert {"database", "schema", "clock", "workers", "leases", "jobs", "campaigns", "stored"} <= set(checks)
    assert "distances of 64 solutions verified" in checks["stored"][1]


def test_what_is_stuck_or_lacking_is_named(database_url: str, engines: Engines, finished: str) -> None:
    queue = Queue(engines=engines)
    queue.campaign(3, needs="rare@1")
    idle = queue.campaign(0)
    (job,) = queue.lease(max_jobs=1, capabilities=("rare@1",))
    with engines.writer.begin() as connection:
        past = database_now(connection) - timedelta(seconds=100)
        connection.execute(update(JobRow).where(JobRow.id == job.job).values(lease_expires_at=past))
        connection.execute(update(CampaignRow).where(CampaignRow.id == idle).values(created_at=past))
    checks = found(database_url, engines)
    assert checks["workers"][0] is State.WRONG
    assert "2 queued jobs need rare@1" in checks["workers"][1]
    assert checks["leases"] == (State.WRONG, "1 of 1 expired over 30 s ago and were not taken back")
    assert checks["campaigns"][0] is State.WRONG
    assert idle in checks["campaigns"][1]


def test_jobs_in_quarantine_are_worth_a_look(database_url: str, engines: Engines) -> None:
    queue = Queue(engines=engines)
    queue.campaign(1)
    queue.fail(*queue.lease(), final=True)
    state, words = found(database_url, engines)["jobs"]
    assert (state, "1 quarantined" in words) == (State.LOOK, True)


@pytest.mark.parametrize("table", [CheckpointRow, DistanceBlockRow])
def test_what_is_damaged_is_named(
    database_url: str, engines: Engines, finished: str, table: type[Any]
) -> None:
    column = "document" if table is CheckpointRow else "data"
    with engines.writer.begin() as connection:
        connection.execute(update(table).values({column: b"damaged"}))
    state, words = found(database_url, engines)["stored"]
    assert state is State.WRONG
    assert finished in words
    assert "damaged" in words


def test_distances_that_are_not_what_they_should_be_are_named(
    database_url: str, engines: Engines, finished: str
) -> None:
    with engines.writer.begin() as connection:
        numbers = text("UPDATE solutions SET vector = :other WHERE number = 0")
        connection.execute(numbers, {"other": b"\0" * 8 * 2})
    state, words = found(database_url, engines)["stored"]
    assert state is State.WRONG
    assert "differ" in words or "expected" in words, words


def test_a_database_that_is_not_there_is_named(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["doctor", "--json", "--database", "postgresql://nobody@127.0.0.1:9/none"])
    assert run.exit_code == 1
    (only,) = json.loads(run.stdout)
    assert (only["check"], only["state"]) == ("database", "wrong")
    empty = CliRunner().invoke(app, ["doctor", "--database", f"sqlite:///{tmp_path}/none.db"])
    assert empty.exit_code == 1


def test_the_command_says_it_to_people(database_url: str, finished: str) -> None:
    run = CliRunner().invoke(app, ["doctor", "--database", database_url])
    assert run.exit_code == 0, run.output
    assert "fine" in run.stdout
