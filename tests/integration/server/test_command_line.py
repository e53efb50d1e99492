"""The command line: help with examples for every command, and one clear line for every failure."""

import json
import shlex
import socket
import sqlite3
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
import yaml
from PIL import Image
from sqlalchemy import text, update
from support.api import FakeWorker, ball, coordinator, expect, listening_coordinator, settings_for, submit
from support.databases import Databases, sqlite_then_postgres
from support.queue import Queue
from typer.testing import CliRunner

from brink.cli import campaigns, commands
from brink.cli.commands import app
from brink.cli.main import main
from brink.cli.options import database_option
from brink.server.db import engine
from brink.server.db.engine import Engines, open_engines
from brink.server.db.models import CampaignRow, CheckpointRow, DistanceBlockRow, JobRow
from brink.server.db.sql import database_now
from brink.server.db.upgrade import upgrade
from brink.server.operations.doctor import State, examine
from brink.server.runtime.coordinator import PortInUse, local_coordinator
from brink.server.settings import Settings
from brink.sim.catalogue import PLUGINS_VARIABLE, import_plugin_modules
from brink.worker.wire import JobFailed

MTQ = {
    "name": "mtq",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "mlcshe@1"},
    "budget": {"simulations": 150},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """The output of a command and its exit status."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The single line on standard error of a command that failed."""
        assert self.status == 1, self
        (line,) = self.err.strip().splitlines()
        assert line.startswith("brink: ")
        return line


Command = Callable[..., Ended]


@pytest.fixture
def brink(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Command:
    """Runs the command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("BRINK_DATABASE", "BRINK_SERVER", "BRINK_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str) -> Ended:
        monkeypatch.setattr(sys, "argv", ["brink", *arguments])
        status = 0
        capsys.readouterr()
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
        out, err = capsys.readouterr()
        return Ended(status=status, out=out, err=err)

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


def test_wrong_usage_exits_with_status_2(brink: Command) -> None:
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
def test_unknown_field_in_a_file_is_one_line(brink: Command, tmp_path: Path, command: list[str]) -> None:
    said = brink(*command, campaign_file(tmp_path, bugdet={}))
    assert "campaign.yaml: line 5: bugdet: unknown field" in said.line
    assert "did you mean 'budget'?" in said.line
    assert not (tmp_path / "brink.db").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("name: [", "line 1, column 8: expected"),
        ("- 1", "expected a campaign with name"),
        ("\0", "not YAML: unacceptable character"),
        ("", "name, problem, algorithm and budget"),
        (f"name: x\nseed: 0x{'f' * 5_000}", "line 2, column 7: expected a number of at most"),
        ("name: x\nseed: !!bool abc", "line 2, column 7: expected a value of type bool, got 'abc'"),
    ],
)
def test_file_without_campaign_is_one_line(brink: Command, tmp_path: Path, content: str, words: str) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text(content)
    assert words in brink("run", str(file)).line


def test_non_ascii_token_is_one_line_without_it(brink: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BRINK_TOKEN", "schlüssel")
    line = brink("status").line
    assert "BRINK_TOKEN: expected printable ASCII" in line
    assert "schl" not in line


@pytest.mark.parametrize(
    "command", [("status",), ("results", "3f2a"), ("experiment", "list"), ("worker",)], ids=" ".join
)
def test_rejected_token_is_told_from_a_missing_one(
    brink: Command,
    database_url: str,
    small_problems: None,
    monkeypatch: pytest.MonkeyPatch,
    command: tuple[str, ...],
) -> None:
    with listening_coordinator(database_url, token="secret") as client:
        arguments = (*command, "--server", str(client.base_url))
        said = brink(*arguments)
        assert (said.status, "requires a token: set the environment variable BRINK_TOKEN" in said.err) == (
            1,
            True,
        )
        monkeypatch.setenv("BRINK_TOKEN", "wrong")
        said = brink(*arguments)
        assert (said.status, "token rejected: " in said.err, "wrong" in said.err) == (1, True, False)


IDS = [
    ("results",),
    ("status",),
    ("pause",),
    ("delete", "--yes"),
    ("pairs",),
    ("export",),
    ("monitor", "fit"),
    ("compare",),
    ("experiment", "status"),
    ("experiment", "cancel"),
    ("replay", "1", "--out", "x.png"),
]


@pytest.mark.parametrize("given", ["", "b", "../jobs", "3f?x", "campaign.yaml"])
@pytest.mark.parametrize("command", IDS, ids=" ".join)
def test_what_is_no_id_matches_nothing(brink: Command, command: tuple[str, ...], given: str) -> None:
    place = 2 if command[0] in ("experiment", "monitor") else 1
    said = brink(*command[:place], given, *command[place:])
    assert said.status == 2
    assert f"expected an id, or at least its first 2 characters, such as 3f2a; got {given!r}" in said.err
    assert ("brink run campaign.yaml --resume" in said.err) == (given == "campaign.yaml")


def test_interrupt_is_one_line(brink: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "app", interrupted)
    said = brink("status")
    assert (said.status, said.err) == (130, "brink: interrupted\n")


def test_campaign_that_cannot_run_is_one_line(brink: Command, tmp_path: Path) -> None:
    said = brink("run", campaign_file(tmp_path, problem={"id": "mqt@1"}))
    assert "did you mean 'mtq@1'?" in said.line
    said = brink("run", campaign_file(tmp_path, budget={"simulations": 5}))
    assert ": budget.simulations: expected at least the 100" in said.line


def test_unreachable_coordinator_is_one_line(brink: Command, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    for arguments in (["submit", campaign_file(tmp_path)], ["status"], ["results", "abcd"]):
        line = brink(*arguments, "--server", url).line
        assert url in line
        assert "brink serve" in line


@sqlite_then_postgres
def test_database_without_a_schema_says_how_to_get_one(brink: Command, databases: Databases) -> None:
    with databases.database("empty", migrated=False) as url:
        if databases.backend == "sqlite":
            Path(url.removeprefix("sqlite:///")).touch()
        assert "brink db upgrade" in brink("status", "--database", url).line
        said = brink("db", "upgrade", "--database", url)
        assert (said.status, "upgraded from schema none" in said.out) == (0, True)
        assert brink("db", "status", "--database", url).status == 0
        assert "no campaigns yet" in brink("status", "--database", url).out


def test_newer_schema_is_one_line(brink: Command, databases: Databases, tmp_path: Path) -> None:
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


def test_port_in_use_is_one_line(brink: Command, databases: Databases, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, databases.database() as url:
        port = str(taken.getsockname()[1])
        for arguments in (["serve"], ["run", campaign_file(tmp_path)]):
            line = brink(*arguments, "--port", port, "--database", url).line
            assert f"127.0.0.1:{port}" in line
            assert "--port" in line


def test_run_takes_another_port_if_the_usual_one_is_in_use(database_url: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = settings_for(database_url, port=taken.getsockname()[1])
        with (
            pytest.raises(PortInUse, match="Address already in use"),
            local_coordinator(settings, tmp_path / "log"),
        ):
            pass
        with local_coordinator(settings, tmp_path / "log", any_port=True) as workers:
            assert httpx.get(f"{workers.url}/healthz").status_code == 200
            assert not workers.url.endswith(f":{settings.port}")
    with local_coordinator(settings, tmp_path / "log", any_port=True) as workers:
        assert workers.url.endswith(f":{settings.port}"), "the address of the last run is that of the next"


def test_commands_read_the_same_from_a_database_and_from_a_server(
    brink: Command, database_url: str, small_problems: None, tmp_path: Path
) -> None:
    with listening_coordinator(database_url) as client:
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
            wrong = brink("status", "zzzz", *place).line
            where = place[1] if place[0] == "--server" else ""
            assert f"campaign 'zzzz': no such campaign in {where}" in wrong
            assert f"which has {campaign} (" in wrong
            shown = shlex.join(place).replace("postgresql://", "postgresql+psycopg://")
            assert wrong.endswith(f"list them with: brink status {shown}")
        again = brink("results", campaign, "--out", "boundary.txt", *places[0])
        assert ".csv, .jsonl, .parquet or .json" in again.line


def test_campaigns_are_controlled_by_command(
    brink: Command, databases: Databases, small_problems: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaigns, "RETRY_PAGE", 7)
    with databases.database("steered") as url, listening_coordinator(url) as client:
        whole = {"max_failed_share": 0.6}  # paused once the generation is complete
        campaign = submit(client, ball(simulations=100, execution=whole))
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


def test_commands_that_only_read_create_no_database(brink: Command, tmp_path: Path) -> None:
    for command in (
        ["doctor"],
        ["token", "list"],
        ["token", "revoke", "x"],
        ["db", "prune", "--ended-days", "1"],
    ):
        assert f"no database at {Path.cwd() / 'brink.db'}: run" in brink(*command).line
    assert list(tmp_path.glob("*.db*")) == []


def test_hints_do_not_show_the_password_of_the_database(monkeypatch: pytest.MonkeyPatch) -> None:
    url = "postgresql://brink:s3cret@db/brink"
    monkeypatch.delenv("BRINK_DATABASE", raising=False)
    assert database_option(Settings(database=url)) == " --database 'postgresql+psycopg://brink:***@db/brink'"
    assert database_option(Settings()) == ""
    monkeypatch.setenv("BRINK_DATABASE", url)
    assert database_option(Settings()) == "", "the next command inherits it"


@pytest.mark.parametrize("database", ["sqlite:///my runs.db", "sqlite:///a;b.db"])
def test_hints_can_be_pasted(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BRINK_DATABASE", raising=False)
    option = database_option(Settings(database=database))
    assert len(shlex.split(f"brink status{option}")) == 4, option


def test_database_error_is_one_line(brink: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert brink("db", "upgrade").status == 0
    monkeypatch.setattr(engine, "SQLITE_BUSY_S", 0.05)
    with closing(sqlite3.connect(tmp_path / "brink.db")) as other:
        other.execute("BEGIN IMMEDIATE")
        assert brink("token", "revoke", "00000000").line == "brink: database: database is locked"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "sheet.gif"], "--out: sheet.gif: expected a file name that ends in .png, .jpg or .jpeg"),
        (["--out", "gone/sheet.png"], "--out: gone: no such folder"),
        (["--out", "s.png", "--image", "gone.png"], "--image: gone.png: no such file"),
        (["--out", "s.png", "--image", "."], "--image: .: not a file"),
        (["--out", "s.png", "--image", "text.png"], "text.png: expected an image (PNG, JPEG"),
        (["--out", "s.png", "--gene", "smog"], "--gene: unknown perturbation 'smog'; "),
        (["--out", "s.png", "--gene", "smog"], "did you mean 'smoke'?"),
    ],
)
def test_bad_contact_sheet_option_fails_before_work(brink: Command, arguments: list[str], words: str) -> None:
    Path("text.png").write_text("no picture")
    shown = brink("perturbations", "show", *arguments)
    assert shown.out == ""
    assert words in shown.line
    assert not Path("s.png").exists()


SENSITIVITY: dict[str, Any] = {
    "name": "known",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "mlcshe@1", "params": {"archive_size": 3}},
    "budget": {"simulations": 120},
    "seed": 7,
}


@pytest.mark.long("runs a campaign")
def test_archive_is_scored_with_other_settings(listening_client: httpx.Client, tmp_path: Path) -> None:
    client = listening_client
    campaign = submit(client, ball(simulations=80))
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    picture = tmp_path / "sensitivity.png"
    command = ["sensitivity", "rescore", campaign, "--server", str(client.base_url), "--radius", "0.1,0.3"]
    said = CliRunner().invoke(app, [*command, "--p-th", "0.5", "--json", "--picture", str(picture)])
    assert said.exit_code == 0, said.output
    found = json.loads(said.output)
    assert [one["radius"] for one in found["by_radius"]] == [0.1, 0.2, 0.3], (
        "the campaign's own radius is included"
    )
    assert [one["p_th"] for one in found["by_p_th"]] == [0.1, 0.5]
    boundary = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))
    own = found["by_radius"][1]
    assert (own["dbs"], own["strict_dbs"]) == (boundary["dbs"], boundary["strict_dbs"])
    assert found["by_p_th"][0] == own
    with Image.open(picture) as drawn:
        assert drawn.width == 1600
    people = CliRunner().invoke(app, command)
    assert "this campaign" in people.output


@pytest.mark.long("runs an experiment")
def test_searches_with_other_settings_become_an_experiment(databases: Databases, tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(yaml.safe_dump(SENSITIVITY))
    out = tmp_path / "out"
    with databases.database() as url:
        command = ["sensitivity", "rerun", str(file), "--parameter", "population_size", "--values", "5,10"]
        said = CliRunner().invoke(
            app, [*command, "--seeds", "2", "--workers", "1", "--database", url, "--out", str(out)]
        )
        assert said.exit_code == 0, said.output
    written = yaml.safe_load((out / "known--population_size.yaml").read_text())
    assert [one["params"] for one in written["algorithms"]] == [
        {"archive_size": 3, "population_size": size} for size in (5, 10)
    ]
    assert written["seeds"] == [7, 8]
    [folder] = [path for path in out.iterdir() if path.is_dir()]
    found = json.loads((folder / "sensitivity.json").read_text())
    assert list(found) == ["5", "10"]
    assert all(len(one["dbs"]) == len(one["strict"]) == 2 for one in found.values())
    assert (folder / "report.html").stat().st_size > 10_000
    with Image.open(folder / "sensitivity.png") as drawn:
        assert drawn.width == 1600


@pytest.mark.long("runs an experiment")
def test_an_experiment_runs_at_the_chosen_size(databases: Databases, tmp_path: Path) -> None:
    file, out = tmp_path / "study.yaml", tmp_path / "out"
    study = {
        "name": "study",
        "problems": [{"id": "mtq@1"}],
        "seeds": {"count": 9},
        "budget": {"simulations": 1300},
        "algorithms": [{"name": "one", "id": "random@1"}, {"name": "other", "id": "random@1"}],
    }
    file.write_text(yaml.safe_dump(study))
    size = ["--seeds", "2", "--simulations", "100"]
    with databases.database() as url:
        command = [
            "experiment",
            "run",
            str(file),
            *size,
            "--workers",
            "1",
            "--database",
            url,
            "--out",
            str(out),
        ]
        first = CliRunner().invoke(app, [*command, "--json"])
        assert first.exit_code == 0, first.output
        again = CliRunner().invoke(app, [*command, "--resume", "--json"])
        assert again.exit_code == 0, again.output
    found, same = (json.loads(one.stdout) for one in (first, again))
    assert [one["evaluated"] for one in found["repeats"]] == [100] * 4
    assert same["id"] == found["id"]


def diagnose(
    database_url: str, engines: Engines, *, restored: bool = False
) -> Mapping[str, tuple[State, str]]:
    checks = examine(Settings(database=database_url), engines, thorough=True, restored=restored)
    return {one.check: (one.state, one.found) for one in checks}


@pytest.fixture
def finished(database_url: str, small_problems: None) -> str:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=60))
        FakeWorker(client).work(campaign)
    return campaign


def test_sound_database_passes_every_check(database_url: str, engines: Engines, finished: str) -> None:
    checks = diagnose(database_url, engines)
    assert {state for state, _ in checks.values()} == {State.FINE}
    assert {"database", "schema", "clock", "workers", "leases", "jobs", "campaigns", "stored"} <= set(checks)
    assert "distances of 64 solutions verified" in checks["stored"][1]


@sqlite_then_postgres
def test_doctor_names_stuck_work_and_missing_workers(
    database_url: str, engines: Engines, finished: str
) -> None:
    queue = Queue(engines=engines)
    queue.campaign(3, needs="rare@1")
    idle = queue.campaign(0)
    (job,) = queue.lease(max_jobs=1, capabilities=("rare@1",))
    with engines.writer.begin() as connection:
        past = database_now(connection) - timedelta(seconds=100)
        connection.execute(update(JobRow).where(JobRow.id == job.job).values(lease_expires_at=past))
        connection.execute(update(CampaignRow).where(CampaignRow.id == idle).values(created_at=past))
    copy = diagnose(database_url, engines, restored=True)
    assert {state for state, _ in copy.values()} == {State.FINE}, "nothing runs on a restored backup"
    assert set(copy).isdisjoint({"clock", "workers", "leases", "campaigns"})
    checks = diagnose(database_url, engines)
    assert checks["workers"][0] is State.WRONG
    assert "2 queued jobs need rare@1" in checks["workers"][1]
    assert checks["leases"] == (State.WRONG, "1 of 1 expired over 30 s ago and were not reclaimed")
    assert checks["campaigns"][0] is State.WRONG
    assert idle in checks["campaigns"][1]


@sqlite_then_postgres
def test_doctor_points_at_quarantined_jobs(database_url: str, engines: Engines) -> None:
    queue = Queue(engines=engines)
    queue.campaign(1)
    queue.fail(*queue.lease(), final=True)
    state, words = diagnose(database_url, engines)["jobs"]
    assert (state, "1 quarantined" in words) == (State.LOOK, True)


@pytest.mark.parametrize("table", [CheckpointRow, DistanceBlockRow])
def test_doctor_finds_damage(database_url: str, engines: Engines, finished: str, table: type[Any]) -> None:
    column = "document" if table is CheckpointRow else "data"
    with engines.writer.begin() as connection:
        connection.execute(update(table).values({column: b"damaged"}))
    state, words = diagnose(database_url, engines)["stored"]
    assert state is State.WRONG
    assert finished in words
    assert "damaged" in words


def test_doctor_names_wrong_distances(database_url: str, engines: Engines, finished: str) -> None:
    with engines.writer.begin() as connection:
        numbers = text("UPDATE solutions SET vector = :other WHERE number = 0")
        connection.execute(numbers, {"other": b"\0" * 8 * 2})
    state, words = diagnose(database_url, engines)["stored"]
    assert state is State.WRONG
    assert "differ" in words or "expected" in words, words


def test_doctor_names_a_missing_database(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["doctor", "--json", "--database", "postgresql://nobody@127.0.0.1:9/none"])
    assert run.exit_code == 1
    (only,) = json.loads(run.stdout)
    assert (only["check"], only["state"]) == ("database", "wrong")
    empty = CliRunner().invoke(app, ["doctor", "--database", f"sqlite:///{tmp_path}/none.db"])
    assert empty.exit_code == 1


@pytest.mark.parametrize("command", [["serve", "--port", "0"], ["run", "FILE"]])
def test_a_missing_plug_in_is_one_line(
    brink: Command, command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PLUGINS_VARIABLE, "nowhere_plugin")
    import_plugin_modules.cache_clear()
    file = campaign_file(tmp_path)
    said = brink(*(file if one == "FILE" else one for one in command))
    import_plugin_modules.cache_clear()
    assert "brink: plug-in module 'nowhere_plugin'" in said.line
    assert not (tmp_path / "brink.db").exists()
