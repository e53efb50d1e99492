"""The command line: help with examples everywhere, and one clear line for what goes wrong."""

import json
import socket
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from support.api import FakeWorker, ball, coordinator, submit
from support.databases import Databases
from typer.testing import CliRunner

from brink.cli import campaigns, commands
from brink.cli.commands import app
from brink.cli.main import main
from brink.cli.options import database_option
from brink.server.db import engine
from brink.server.db.engine import Engines, open_engines
from brink.server.db.upgrade import upgrade
from brink.server.settings import Settings
from brink.worker.wire import JobFailed

MTQ = {
    "name": "mtq", "problem": {"id": "mtq@1"}, "algorithm": {"id": "mlcshe@1"}, "budget": {"simulations": 150},
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What a command said, and how it ended."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line that a failure says."""
        assert self.status == 1, self
        (line,) = self.err.strip().splitlines()
        assert line.startswith("brink: ")
        return line


Command = Callable[..., Said]


@pytest.fixture
def brink(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Command:
    """Run the command in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    for name in ("BRINK_DATABASE", "BRINK_SERVER", "BRINK_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str) -> Said:
        monkeypatch.setattr(sys, "argv", ["brink", *arguments])
        status = 0
        capsys.readouterr()
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
        out, err = capsys.readouterr()
        return Said(status=status, out=out, err=err)

    return run


def campaign_file(folder: Path, **changes: Any) -> str:
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump({**MTQ, **changes}))
    return str(file)


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if hasattr(command, "list_commands"):
        for name in command.list_commands(None):
            yield from leaves(command.get_command(None, name), (*path, name))
    else:
        yield path


COMMANDS = sorted(leaves(typer.main.get_command(app)))


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example(command: tuple[str, ...]) -> None:
    answer = CliRunner().invoke(app, [*command, "--help"])
    assert answer.exit_code == 0, answer.output
    assert f"Example: brink {' '.join(command)}" in " ".join(answer.output.split())


def test_the_commands_of_the_design_are_there() -> None:
    names = {command[0] for command in COMMANDS}
    assert {"run", "serve", "worker", "submit", "status", "results", "plot", "replay", "db"} <= names


def test_calling_it_wrongly_exits_2(brink: Command) -> None:
    for arguments in (
        ["runn"],
        ["run"],
        ["run", "x.yaml", "--workers", "0"],
        ["results", "x", "--t-b", "2"],
        ["worker", "--workers", "2"],
    ):
        said = brink(*arguments)
        assert said.status == 2, arguments
        assert "Usage" in said.err


@pytest.mark.parametrize("command", [["run"], ["submit"]])
def test_an_unknown_field_in_a_file_is_one_line(brink: Command, tmp_path: Path, command: list[str]) -> None:
    said = brink(*command, campaign_file(tmp_path, bugdet={}))
    assert "/bugdet: unknown field" in said.line
    assert "did you mean 'budget'?" in said.line
    assert not (tmp_path / "brink.db").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("name: [", "line 1, column 8: expected"),
        ("- 1", "expected a campaign with name"),
        ("\0", "not YAML: unacceptable character"),
        ("", "name, problem, algorithm and budget"),
    ],
)
def test_a_file_that_is_no_campaign_is_one_line(
    brink: Command, tmp_path: Path, content: str, words: str
) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text(content)
    assert words in brink("run", str(file)).line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\nproblem:\n\tid: y\n", "line 3, column 1: a tab"),
        ("name: x\nseed: 1\nname: y\n", "line 3, column 1: 'name' is given twice"),
        (
            "name: x\nproblem: mtq@1\nalgorithm: {id: mlcshe@1}\nbudget: {simulations: 1}\n",
            "a mapping with id, params",
        ),
    ],
)
def test_what_is_wrong_in_a_file_is_shown(brink: Command, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(text)
    assert message in brink("run", str(file)).line


def test_a_server_that_is_no_url_is_one_line(brink: Command) -> None:
    assert "expected a URL such as http://" in brink("status", "--server", "localhost:8700").line


def test_a_token_that_no_header_can_carry_is_one_line(
    brink: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BRINK_TOKEN", "schlüssel")
    line = brink("status").line
    assert "BRINK_TOKEN: expected printable ASCII" in line
    assert "schl" not in line


def test_a_missing_token_is_named(brink: Command, database_url: str, small_problems: None) -> None:
    with coordinator(database_url, token="secret") as client:
        assert "BRINK_TOKEN" in brink("status", "--server", str(client.base_url)).line


def test_ctrl_c_is_one_line(brink: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "app", interrupted)
    said = brink("status")
    assert (said.status, said.err) == (130, "brink: interrupted\n")


def test_a_file_that_is_missing_is_one_line(brink: Command) -> None:
    assert "nowhere.yaml: No such file" in brink("run", "nowhere.yaml").line


def test_a_campaign_that_cannot_run_is_one_line(brink: Command, tmp_path: Path) -> None:
    said = brink("run", campaign_file(tmp_path, problem={"id": "mqt@1"}))
    assert "did you mean 'mtq@1'?" in said.line
    said = brink("run", campaign_file(tmp_path, budget={"simulations": 5}))
    assert "/budget/simulations: expected at least the 100" in said.line


def test_a_coordinator_that_is_away_is_one_line(brink: Command, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    for arguments in (["submit", campaign_file(tmp_path)], ["status"], ["results", "abcd"]):
        line = brink(*arguments, "--server", url).line
        assert url in line
        assert "brink serve" in line


def test_no_database_is_one_line(brink: Command) -> None:
    assert "brink run FILE" in brink("status").line


def test_a_database_without_a_schema_says_how_to_get_one(brink: Command, databases: Databases) -> None:
    with databases.database("empty", migrated=False) as url:
        if databases.backend == "sqlite":
            Path(url.removeprefix("sqlite:///")).touch()
        assert "brink db upgrade" in brink("status", "--database", url).line
        said = brink("db", "upgrade", "--database", url)
        assert (said.status, "upgraded from schema none" in said.out) == (0, True)
        assert brink("db", "status", "--database", url).status == 0
        assert "no campaigns yet" in brink("status", "--database", url).out


def test_a_newer_schema_is_one_line(brink: Command, databases: Databases, tmp_path: Path) -> None:
    with databases.database("newer", migrated=False) as url:
        newer(url)
        commands = (["status"], ["serve", "--port", "0"], ["run", campaign_file(tmp_path)], ["db", "upgrade"])
        for arguments in commands:
            line = brink(*arguments, "--database", url).line
            assert "7777" in line, arguments


def newer(url: str) -> None:
    engines: Engines = open_engines(url)
    upgrade(engines)
    with engines.writer.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '7777'")
    engines.dispose()


def test_a_port_in_use_is_one_line(brink: Command, databases: Databases, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, databases.database() as url:
        port = str(taken.getsockname()[1])
        for arguments in (["serve"], ["run", campaign_file(tmp_path)]):
            line = brink(*arguments, "--port", port, "--database", url).line
            assert f"127.0.0.1:{port}" in line
            assert "--port" in line


def test_listening_to_other_machines_without_a_token_is_one_line(brink: Command, tmp_path: Path) -> None:
    assert "BRINK_TOKEN" in brink("serve", "--host", "0.0.0.0", "--port", "0").line
    assert not (tmp_path / "brink.db").exists()


def test_commands_say_the_same_from_the_database_and_from_afar(
    brink: Command, database_url: str, small_problems: None, tmp_path: Path
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        done = FakeWorker(client).work(campaign)
        places = (["--database", database_url], ["--server", str(client.base_url)])
        for place in places:
            status = json.loads(brink("status", campaign[:4], *place, "--json").out)
            assert (status["id"], status["digest"]) == (campaign, done["digest"])
            assert status["quarantined_jobs"] == []
            (listed,) = json.loads(brink("status", *place, "--json").out)["campaigns"]
            assert listed["id"] == campaign
            boundary = json.loads(
                brink("results", campaign, "--t-b", "0.3", "--d-th", "0.1", *place, "--json").out
            )
            assert boundary["dbs"] == len(boundary["solutions"])
            for name in ("boundary.csv", "boundary.jsonl", "boundary.parquet", "boundary.json"):
                said = brink("results", campaign, "--out", name, *place)
                assert (said.status, name in said.out) == (0, True)
                assert (tmp_path / name).stat().st_size > 0
            people = brink("status", campaign, *place).out
            assert "finished" in people
            assert done["digest"] in people
            assert "no such campaign" in brink("status", "zzzz", *place).line
        again = brink("results", campaign, "--out", "boundary.txt", *places[0])
        assert ".csv, .jsonl, .parquet or .json" in again.line


def test_campaigns_are_steered_by_command(
    brink: Command, databases: Databases, small_problems: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaigns, "RETRY_PAGE", 7)
    with databases.database("steered") as url, coordinator(url) as client:
        campaign = submit(client, ball(simulations=100))
        afar, near = ("--server", str(client.base_url)), ("--database", url)
        assert "brink resume" in brink("pause", campaign[:4], *afar).out
        assert FakeWorker(client).lease() == []
        assert "is running" in brink("resume", campaign, *near).out
        FakeWorker(client, judge=lambda _: JobFailed(reason="invalid", message="no")).work(campaign)
        assert "paused" in brink("status", campaign, *afar).out
        assert "20 jobs are back in the queue" in brink("retry", campaign, *afar).out
        assert "0 jobs" in brink("retry", campaign, *afar).out
        assert "cancel it before deleting it" in brink("delete", campaign, "--yes", *afar).line
        assert "its results are kept" in brink("cancel", campaign, *near).out
        assert "to pause it, it must be running" in brink("pause", campaign, *near).line
        assert "is deleted" in brink("delete", campaign, "--yes", *afar).out
        assert "no such campaign" in brink("status", campaign, *afar).line
        assert "no such campaign" in brink("delete", campaign, "--yes", *near).line


def test_what_only_looks_makes_no_database(brink: Command, tmp_path: Path) -> None:
    for command in (
        ["doctor"],
        ["token", "list"],
        ["token", "revoke", "x"],
        ["db", "prune", "--ended-days", "1"],
    ):
        assert "no database at brink.db" in brink(*command).line
    assert list(tmp_path.glob("*.db*")) == []


def test_a_file_that_cannot_be_shrunk_is_one_line_after_what_went(
    brink: Command, database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*given: Any, **named: Any) -> Any:
        if named:  # ours have settings
            return connect(*given, **named)
        raise sqlite3.OperationalError("database or disk is full")

    url = f"sqlite:///{tmp_path}/a.db"
    connect = sqlite3.connect
    assert brink("db", "upgrade", "--database", url).status == 0
    monkeypatch.setattr(sqlite3, "connect", full)
    said = brink("db", "prune", "--ended-days", "1", "--yes", "--database", url)
    assert "0 campaigns" in said.out
    assert "database or disk is full" in said.line


def test_hints_keep_the_password_of_the_database(monkeypatch: pytest.MonkeyPatch) -> None:
    url = "postgresql://brink:s3cret@db/brink"
    monkeypatch.delenv("BRINK_DATABASE", raising=False)
    assert database_option(Settings(database=url)) == " --database postgresql+psycopg://brink:***@db/brink"
    assert database_option(Settings()) == ""
    monkeypatch.setenv("BRINK_DATABASE", url)
    assert database_option(Settings()) == "", "the next command has it, too"


def test_a_database_that_fails_is_one_line(
    brink: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert brink("db", "upgrade").status == 0
    monkeypatch.setattr(engine, "SQLITE_BUSY_S", 0.05)
    with closing(sqlite3.connect(tmp_path / "brink.db")) as other:
        other.execute("BEGIN IMMEDIATE")
        assert brink("token", "revoke", "00000000").line == "brink: database: database is locked"


def test_a_submission_with_a_key_is_one_campaign(
    brink: Command, database_url: str, small_problems: None, tmp_path: Path
) -> None:
    file = campaign_file(tmp_path)
    with coordinator(database_url) as client:
        url = str(client.base_url)
        watched = brink("submit", file, "--server", url, "--key", "k", "--watch")
        assert watched.status == 0
        assert "is finished" in watched.out
        again = json.loads(brink("submit", file, "--server", url, "--key", "k", "--json").out)
        assert again["id"] in watched.out
