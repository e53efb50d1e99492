"""Tags and notes of campaigns: people change them at any time, and find campaigns by them."""

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import insert, text
from support.api import FakeWorker, ball, coordinator, expect, progress, submit
from support.databases import Databases, on_sqlite, sqlite_then_postgres
from support.queue import Queue
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.campaigns.store import CAMPAIGNS, labelled
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignTagRow
from brink.server.db.sql import newest_first

API = "/api/v1/campaigns"


def change(client: httpx.Client, campaign: str, status: int = 200, **fields: Any) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.patch(f"{API}/{campaign}", json=fields), status)
    return found


def listed(client: httpx.Client, **params: Any) -> list[str]:
    """Return the names of the campaigns that are listed, and check that the overview lists the same."""
    names = [one["name"] for one in expect(client.get(API, params=params))["campaigns"]]
    overview = expect(client.get("/api/v1/overview", params=params))
    assert overview["name"] == names
    return names


@on_sqlite
def test_tags_and_notes_are_submitted_and_shown_wherever_a_campaign_is(client: httpx.Client) -> None:
    campaign = submit(client, ball(tags=["Night", "release-4", "night"], notes="Too dark?\r\nAsk Ada."))
    found = expect(client.get(f"{API}/{campaign}"))
    assert (found["tags"], found["notes"]) == (["night", "release-4"], "Too dark?\nAsk Ada.")
    assert (found["body"]["tags"], found["body"]["notes"]) == (found["tags"], found["notes"])
    told = progress(client, campaign)
    assert (told["tags"], told["notes"]) == (found["tags"], found["notes"])
    assert expect(client.get("/api/v1/overview"))["tags"] == [["night", "release-4"]]


@on_sqlite
def test_a_change_keeps_what_it_does_not_name_and_what_was_simulated(client: httpx.Client) -> None:
    campaign = submit(client, ball(tags=["a", "b"], notes="first"))
    digest = FakeWorker(client).work(campaign)["digest"]
    assert change(client, campaign, notes="second")["tags"] == ["a", "b"]
    found = change(client, campaign, add_tags=["C"], remove_tags=["A", "never"])
    assert (found["tags"], found["notes"]) == (["b", "c"], "second")
    assert change(client, campaign[:4], tags=["z"])["tags"] == ["z"]
    found = change(client, campaign, tags=[], notes="")
    assert (found["tags"], found["notes"], found["status"]) == ([], "", "finished")
    assert progress(client, campaign)["digest"] == digest
    change(client, "none", 404, notes="x")


@on_sqlite
def test_pollers_see_a_change_and_nothing_else(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    urls = (f"{API}/{campaign}/progress", "/api/v1/overview")
    tags = {url: client.get(url).headers["ETag"] for url in urls}

    def statuses() -> set[int]:
        return {client.get(url, headers={"If-None-Match": tag}).status_code for url, tag in tags.items()}

    before = progress(client, campaign)["sequence"]
    change(client, campaign)
    change(client, campaign, tags=[], notes="")
    assert progress(client, campaign)["sequence"] == before, "nothing is different"
    assert statuses() == {304}
    change(client, campaign, add_tags=["night"])
    assert progress(client, campaign)["sequence"] == before + 1
    assert statuses() == {200}


@on_sqlite
@pytest.mark.parametrize(
    ("fields", "pointer", "message"),
    [
        ({"tags": ["two words"]}, "/tags/0", "without spaces"),
        ({"tags": [""]}, "/tags/0", "1 to 40"),
        ({"tags": ["x" * 41]}, "/tags/0", "40"),
        ({"tags": [str(n) for n in range(33)]}, "/tags", "32"),
        ({"notes": "a\0b"}, "/notes", "control characters"),
        ({"notes": "x" * 10_001}, "/notes", "10000"),
        ({"tags": ["a"], "add_tags": ["b"]}, "", "not both"),
        ({"name": "other"}, "/name", "unknown field"),
    ],
)
def test_what_is_no_tag_or_note_is_refused(
    client: httpx.Client, fields: dict[str, Any], pointer: str, message: str
) -> None:
    campaign = submit(client, ball(tags=["kept"]))
    [error] = change(client, campaign, 422, **fields)["errors"]
    assert error["pointer"] == pointer
    assert message in error["message"]
    assert expect(client.get(f"{API}/{campaign}"))["tags"] == ["kept"]


@sqlite_then_postgres
def test_a_campaign_has_no_more_tags_than_may_be_submitted(client: httpx.Client) -> None:
    campaign = submit(client, ball(tags=[f"t{n}" for n in range(30)]))
    change(client, campaign, add_tags=["a", "b"])
    [error] = change(client, campaign, 422, add_tags=["c"])["errors"]
    assert error["pointer"] == "/add_tags"
    assert "33" in error["message"]
    change(client, campaign, add_tags=["c"], remove_tags=["a"])


def test_campaigns_are_found_by_tags_and_by_words(client: httpx.Client) -> None:
    submit(client, ball(name="Straße bei Nacht", tags=["Night", "rain"], notes="100% of ÄPFEL_fell"))
    submit(client, ball(name="day", tags=["rain"], notes="Second\nline"))
    submit(client, ball(name="plain"))
    assert listed(client, tag="RAIN") == ["day", "Straße bei Nacht"]
    assert listed(client, tag=["rain", "night"]) == ["Straße bei Nacht"]
    assert listed(client, tag="rai") == []
    for words in ("STRASSE", "nacht bei", "äpfel", "100%", "l_f", "night", "ain NIG"):
        assert listed(client, search=words) == ["Straße bei Nacht"], words
    assert listed(client, search="line second") == ["day"]
    assert listed(client, search="%") == ["Straße bei Nacht"], "no pattern"
    assert listed(client, search="plain", tag="rain") == []
    assert listed(client, search="  ") == ["plain", "day", "Straße bei Nacht"]
    expect(client.get(API, params={"tag": "two words"}), 422)
    expect(client.get(API, params={"search": "\0"}), 422)


def test_neither_case_nor_the_encoding_of_accents_matters(client: httpx.Client) -> None:
    e_acute, i_dotted = "e\u0301", "\u0130"
    submit(client, ball(name=f"{e_acute}clair", tags=[f"{i_dotted}stanbul", "ΟΔΟΣ", "हिन्दी"]))
    for words in ("éclair", f"{e_acute}CLAIR"):
        assert listed(client, search=words) == [f"{e_acute}clair"]
    for tag in (f"{i_dotted}STANBUL", "οδοσ", "οδος", "हिन्दी"):
        assert listed(client, tag=tag) == [f"{e_acute}clair"], tag


@sqlite_then_postgres
@pytest.mark.usefixtures("small_problems")
def test_a_file_without_tags_and_notes_is_as_it_was_before_there_were_any(
    databases: Databases, database_url: str, tmp_path: Path
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(name="Ball"))
        FakeWorker(client).work(campaign)
    file = tmp_path / "ball.brink"
    assert run("export", campaign, "--out", str(file), "--database", database_url).exit_code == 0
    with zipfile.ZipFile(file) as written:
        assert "campaign_tags.jsonl" not in written.namelist()
        assert "notes" not in json.loads(written.read("campaigns.jsonl"))
    with databases.database("other") as elsewhere:
        assert run("import", str(file), "--database", elsewhere).exit_code == 0
        with coordinator(elsewhere) as client:
            found = expect(client.get(f"{API}/{campaign}"))
            assert (found["status"], found["tags"], found["notes"]) == ("finished", [], "")
            assert listed(client, search="BALL") == ["Ball"]


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments), catch_exceptions=False)


TAGS = 1500


def test_tags_are_found_by_an_index(engines: Engines) -> None:
    queue = Queue(engines=engines)
    names = [queue.campaign(0) for _ in range(3)]
    tags = [{"campaign_id": name, "tag": f"t{place}"} for name in names for place in range(TAGS // 3)]
    with engines.writer.begin() as connection:
        connection.execute(insert(CampaignTagRow), tags)
    with engines.writer.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("ANALYZE"))
    query = newest_first(CAMPAIGNS.table, limit=50, before=None).where(*labelled(["t7"], ""))
    sqlite = engines.is_sqlite
    with engines.reader.connect() as connection:
        statement = query.compile(connection.engine, compile_kwargs={"literal_binds": True})
        words = str(statement).replace("%%", "%")
        plan = connection.exec_driver_sql(f"EXPLAIN {'QUERY PLAN ' if sqlite else ''}{words}").all()
    lines = [str(row[-1]) for row in plan]
    about_tags = [line for line in lines if "campaign_tags" in line]
    assert any(
        re.search("ix_campaign_tags_tag_campaign_id|pk_campaign_tags|INDEX", line) for line in about_tags
    ), lines
    assert not any(re.search(r"Seq Scan on campaign_tags|SCAN campaign_tags", line) for line in lines), lines
