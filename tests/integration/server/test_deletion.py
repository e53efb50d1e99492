"""Deletion in pieces: at once for everybody who looks, without keeping others waiting, and finished in the end."""

import json
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import Connection, func, insert, select, update
from support.api import FakeWorker, await_erasure, ball, coordinator, expect, finish, row_counts
from support.databases import Databases, sqlite_then_postgres
from support.queue import Queue
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.campaigns import deletion
from brink.server.campaigns.deletion import erase_piece, mark_deleted, marked_campaigns
from brink.server.db.engine import Engines, open_engines
from brink.server.db.models import CampaignRow, DistanceBlockRow, JobRow, SolutionRow, TraceRow
from brink.server.errors import Conflict
from brink.server.queue import job_store

API = "/api/v1/campaigns"
Piece = Callable[[Connection, str], bool]


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each transaction delete a few rows only."""
    monkeypatch.setattr(deletion, "PIECE_ROWS", 7)


@pytest.fixture
def nothing_is_erased(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Let no piece delete anything, until the function that this returns is called."""
    erasing = threading.Event()
    whole: Piece = erase_piece

    def piece(connection: Connection, campaign_id: str) -> bool:
        return erasing.is_set() and whole(connection, campaign_id)

    monkeypatch.setattr(deletion, "erase_piece", piece)
    return erasing.set


def sixty(**changes: Any) -> dict[str, Any]:
    """Return the body of a campaign with exactly 60 solutions and jobs, in three generations."""
    algorithm = {"id": "random@1", "params": {"generation_size": 20}}
    return ball(algorithm=algorithm, execution={"keep_traces": 0}, **changes)


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments), catch_exceptions=False)


def counted(queue: Queue, table: Any) -> int:
    return queue.run(lambda c: int(c.execute(select(func.count()).select_from(table)).scalar_one()))


@pytest.mark.usefixtures("small_pieces")
def test_a_deleted_campaign_is_erased_in_small_transactions(
    client: httpx.Client, engines: Engines, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign, kept = (finish(client, sixty(seed=seed)) for seed in (1, 2))
    before = row_counts(engines)
    removed = []

    def piece(connection: Connection, campaign_id: str) -> bool:
        rows = select(func.count()).select_from(SolutionRow.__table__.join(CampaignRow.__table__))
        jobs = select(func.count()).select_from(JobRow.__table__)
        counts = [connection.execute(one).scalar_one() for one in (rows, jobs)]
        is_done = erase_piece(connection, campaign_id)
        removed.append(sum(counts) - sum(connection.execute(one).scalar_one() for one in (rows, jobs)))
        return is_done

    monkeypatch.setattr(deletion, "erase_piece", piece)
    expect(client.delete(f"{API}/{campaign}"), 204)
    await_erasure(engines)
    assert max(removed) <= 7
    assert sum(removed) >= 120, "60 solutions and their jobs"
    after = row_counts(engines)
    for name in ("campaigns", "checkpoints", "distance_blocks", "generations", "jobs", "solutions"):
        assert 2 * after[name] == before[name] > 0
    assert FakeWorker(client).lease() == []
    assert len(expect(client.get(f"{API}/{kept}/boundary", params={"t_b": 1, "d_th": 0}))["solutions"]) == 60


def test_nobody_finds_a_deleted_campaign_that_is_not_erased_yet(
    client: httpx.Client, engines: Engines, nothing_is_erased: Callable[[], None]
) -> None:
    headers = {"Idempotency-Key": "again"}
    submitted = client.post(API, json=ball(tags=["night"], execution={"cache": False}), headers=headers)
    campaign = expect(submitted, 201)["id"]
    FakeWorker(client).work(campaign)
    again = expect(client.post(f"{API}/{campaign}/repeats", json={"numbers": [0], "repeats": 2}), 201)[
        "campaign"
    ]
    FakeWorker(client).work(again)
    expect(client.delete(f"{API}/{campaign}"), 204)
    with engines.reader.connect() as connection:
        assert set(marked_campaigns(connection)) == {campaign, again}
    for one in (campaign, again):
        for path in ("", "/progress", "/boundary", "/findings", "/solutions", "/repeats", "/archive.npz"):
            expect(client.get(f"{API}/{one}{path}"), 404)
        expect(client.delete(f"{API}/{one}"), 404)
        assert "no such campaign" in expect(client.get(f"{API}/{one[:6]}"), 404)["detail"]
    assert expect(client.get(API))["campaigns"] == []
    assert expect(client.get(API, params={"tag": "night"}))["campaigns"] == []
    assert expect(client.get("/api/v1/overview"))["total"] == 0
    assert "brink_campaigns{" not in client.get("/metrics").text
    new = expect(client.post(API, json=ball(), headers=headers), 201)["id"]
    assert new != campaign, "its idempotency key is free"
    nothing_is_erased()
    await_erasure(engines)
    assert row_counts(engines)["campaigns"] == 1


def test_others_are_served_while_a_campaign_is_erased(
    client: httpx.Client, engines: Engines, nothing_is_erased: Callable[[], None]
) -> None:
    """As long as nothing is erased, the eraser tries again and again; it must let others write in between."""
    campaign = finish(client, ball())
    expect(client.delete(f"{API}/{campaign}"), 204)
    other = finish(client, ball(seed=2, execution={"cache": False}))
    with engines.reader.connect() as connection:
        assert marked_campaigns(connection) == [campaign]
    nothing_is_erased()
    await_erasure(engines)
    assert expect(client.get(f"{API}/{other}"))["status"] == "finished"


@pytest.mark.usefixtures("small_problems", "small_pieces")
def test_an_interrupted_deletion_goes_on_with_the_next_coordinator(
    database_url: str, engines: Engines, nothing_is_erased: Callable[[], None]
) -> None:
    with coordinator(database_url) as client:
        campaign = finish(client, sixty())
        expect(client.delete(f"{API}/{campaign}"), 204)
    assert row_counts(engines)["solutions"] == 60
    queue = Queue(engines=engines)
    queue.run(lambda connection: erase_piece(connection, campaign))
    assert row_counts(engines)["jobs"] < 60, "half erased"
    nothing_is_erased()
    with coordinator(database_url) as client:
        await_erasure(engines)
        expect(client.get(f"{API}/{campaign}"), 404)
    assert {name for name, count in row_counts(engines).items() if count} <= {"workers"}


@pytest.mark.long("runs campaigns")
@pytest.mark.usefixtures("small_pieces")
def test_an_experiment_is_deleted_at_once_and_erased_in_pieces(
    client: httpx.Client, engines: Engines, nothing_is_erased: Callable[[], None]
) -> None:
    one = ball()
    document = {
        "name": "small",
        "problems": [one["problem"]],
        "algorithms": [one["algorithm"]],
        "seeds": [1, 2],
        "budget": one["budget"],
    }
    experiment = expect(client.post("/api/v1/experiments", json=document), 201)
    members = [member["campaign"] for member in experiment["members"]]
    for campaign in members:
        FakeWorker(client).work(campaign)
    expect(client.delete(f"/api/v1/experiments/{experiment['id']}"), 204)
    for path in (f"/api/v1/experiments/{experiment['id']}", *(f"{API}/{campaign}" for campaign in members)):
        expect(client.get(path), 404)
    assert expect(client.get("/api/v1/experiments"))["experiments"] == []
    assert row_counts(engines)["campaigns"] == 2
    nothing_is_erased()
    await_erasure(engines)
    assert {name for name, count in row_counts(engines).items() if count} <= {"workers"}


@pytest.mark.long("runs campaigns")
@pytest.mark.usefixtures("small_problems")
def test_what_is_being_erased_is_neither_verified_nor_exported_nor_replaced(
    databases: Databases, tmp_path: Path
) -> None:
    file = str(tmp_path / "ball.brink")
    with databases.database("some") as url:
        with coordinator(url) as client:
            campaign = finish(client, ball())
        engines = open_engines(url)
        assert run("export", campaign, "--out", file, "--database", url).exit_code == 0
        queue = Queue(engines=engines)
        queue.run(lambda connection: mark_deleted(connection, [campaign]))
        queue.run(lambda c: c.execute(update(CampaignRow).values(deleted_at=CampaignRow.created_at)))
        queue.run(lambda c: job_store.delete_some(c, campaign, 10))
        queue.be_away(seconds=3600)
        told = run("doctor", "--thorough", "--database", url)
        assert (told.exit_code, "missing" in told.output) == (0, False)
        with pytest.raises(Conflict, match="was deleted and is still being erased"):
            run("import", file, "--database", url)
        engines.dispose()


def tree(client: httpx.Client) -> tuple[str, str, str]:
    """Return a campaign that has ended, its repeats that have ended, and repeats of these that are running."""
    first = finish(client, ball())
    found = [first]
    for repeats in (2, 3):
        asked = client.post(f"{API}/{found[-1]}/repeats", json={"numbers": [0], "repeats": repeats})
        found.append(expect(asked, 201)["campaign"])
        if repeats == 2:
            FakeWorker(client).work(found[-1])
    return found[0], found[1], found[2]


def let_end_long_ago(engines: Engines, *campaigns: str) -> None:
    with engines.writer.begin() as connection:
        ended = update(CampaignRow).where(CampaignRow.id.in_(campaigns))
        connection.execute(ended.values(finished_at=datetime(2020, 1, 1, tzinfo=UTC)))


def pruned(database_url: str, *options: str) -> list[str]:
    """Run ``brink db prune`` for campaigns that ended a month ago; return the campaigns that it names."""
    said = run("db", "prune", "--ended-days", "30", "--json", "--database", database_url, *options)
    return [one["id"] for one in json.loads(said.stdout)["campaigns"]]


@sqlite_then_postgres
def test_retention_deletes_a_tree_of_follow_ups_when_all_of_it_is_old(
    client: httpx.Client, engines: Engines, database_url: str
) -> None:
    first, repeats, again = tree(client)
    let_end_long_ago(engines, first, repeats)
    held = FakeWorker(client).lease()
    assert pruned(database_url, "--yes") == []
    assert set(FakeWorker(client).report(held)) == {"accepted"}, "of the follow-up of a follow-up"
    FakeWorker(client).work(again)
    assert pruned(database_url, "--yes") == [], "the last of them ended just now"
    let_end_long_ago(engines, again)
    assert pruned(database_url) == [first, repeats, again], "all that goes is named"
    said = run("db", "prune", "--ended-days", "30", "--database", database_url)
    assert [line.split()[0] for line in said.stdout.splitlines()[:-1]] == [first, repeats, again]
    assert f"follow-up of {repeats}" in said.stdout.splitlines()[2]
    assert pruned(database_url, "--yes") == [first, repeats, again]
    assert row_counts(engines)["campaigns"] == 0


def test_nothing_deletes_a_tree_with_a_campaign_that_has_not_ended(
    client: httpx.Client, engines: Engines
) -> None:
    first, repeats, again = tree(client)
    queue = Queue(engines=engines)
    for root in (first, repeats, again):
        with pytest.raises(Conflict, match=f"campaign {again}.* is running: cancel it before deleting it"):
            queue.run(partial(mark_deleted, roots=[root]))
        assert again in expect(client.delete(f"{API}/{root}"), 409)["detail"]
    doomed = expect(client.get(f"{API}/{first}/deletion"))["campaigns"]
    assert [(one["id"], one["follow_up_of"]) for one in doomed] == [
        (first, None),
        (repeats, first),
        (again, repeats),
    ]
    expect(client.post(f"{API}/{again}/cancel"))
    expect(client.delete(f"{API}/{first}"), 204)
    for one in (first, repeats, again):
        expect(client.get(f"{API}/{one}"), 404)


def test_traces_and_large_distances_are_erased_a_few_at_a_time(
    queue: Queue, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_store, "TRACES_A_PIECE", 2)
    monkeypatch.setattr(deletion, "PIECE_BYTES", 100)
    campaign = queue.campaign(5)

    def fill(connection: Connection) -> None:
        now = connection.execute(select(CampaignRow.created_at)).scalar_one()
        hashes = connection.execute(select(JobRow.spec_hash)).scalars().all()
        traces = [{"spec_hash": one, "data": b"t", "created_at": now} for one in hashes]
        connection.execute(insert(TraceRow), traces)
        blocks = [
            {
                "campaign_id": campaign,
                "generation": generation,
                "first_row": 0,
                "rows": rows,
                "columns": 4,
                "metric_version": 1,
                "sha256": "",
                "data": np.zeros((rows, 4), "<f4").tobytes(),
            }
            for generation, rows in enumerate((3, 3, 9, 1, 1))
        ]
        connection.execute(insert(DistanceBlockRow), blocks)

    queue.run(fill)
    queue.run(lambda c: c.execute(update(CampaignRow).values(status="finished")))
    queue.run(lambda connection: mark_deleted(connection, [campaign]))
    left = []
    while not queue.run(lambda connection: erase_piece(connection, campaign)):
        left.append([counted(queue, table) for table in (TraceRow, JobRow, DistanceBlockRow)])
    assert left == [[3, 5, 5], [1, 5, 5], [0, 0, 3], [0, 0, 2]]
    assert counted(queue, CampaignRow) == counted(queue, DistanceBlockRow) == counted(queue, SolutionRow) == 0
