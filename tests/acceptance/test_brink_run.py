"""`brink run`: one command from a campaign file to results, stopped and gone on with at will."""

import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.api import ball, undisturbed_digest
from support.databases import Databases, sqlite_then_postgres
from support.processes import BRINK, TOY, Program, brink, site
from typer.testing import CliRunner

from brink.cli.commands import app

BALL = ball(
    seed=3,
    simulations=120,
    problem={"id": "ball@1", "params": {"slow_s": 0.05}},
    algorithm={"id": "mlcshe@1", "params": {"population_size": 6, "archive_size": 2}},
)


def written(folder: Path, body: dict[str, Any]) -> str:
    file = folder / "my campaign.yaml"
    file.write_text(yaml.safe_dump(body))
    return str(file)


KNOWN_BOUNDARY: dict[str, Any] = {
    "name": "known boundary",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "mlcshe@1"},
    "budget": {"simulations": 120},
    "seed": 1,
}


@sqlite_then_postgres
def test_a_campaign_file_becomes_results(
    databases: Databases, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("run", written(tmp_path, KNOWN_BOUNDARY), "--workers", "1", "--resume", "--database")
    with databases.database(migrated=False) as url:
        said = brink(*command, url, cwd=tmp_path)
        assert said.returncode == 0, said.stderr
        assert "distinct boundary solutions" in said.stdout
        assert "archive sha256 " in said.stdout
        place = re.escape(url.removeprefix("sqlite:///").partition("@")[2] or url.removeprefix("sqlite:///"))
        assert re.search(
            rf"no earlier campaign of .*campaign.yaml, unchanged, in .*{place}: this", said.stdout
        )
        [page] = re.findall(r"watch it in a browser until it ends: http://127.0.0.1:\d+(/\S+)", said.stdout)
        again = rf"look at it again: \S*brink serve --database \S*{place}'?, then open http://127.0.0.1:8700{page}\n"
        assert re.search(again, said.stdout), said.stdout
        monkeypatch.chdir(tmp_path)
        shown = CliRunner().invoke(app, [*command, url, "--no-pictures"])  # importing takes longer than this
        assert shown.exit_code == 0, shown.output
        assert "finished earlier, on " in shown.stdout
        assert "no earlier" not in shown.stdout
    (folder,) = (tmp_path / "brink-results").glob("known-boundary-*")
    assert list(folder.glob("*.png"))


@pytest.mark.long("runs two campaigns")
@pytest.mark.usefixtures("small_problems")
def test_a_run_beside_a_coordinator_on_the_same_file_changes_neither(tmp_path: Path) -> None:
    """Each has a campaign and a worker of its own, and workers take jobs of both campaigns."""
    file, database = written(tmp_path, BALL), f"sqlite:///{tmp_path}/brink.db"
    other = {**BALL, "seed": 4}
    command = [BRINK, "run", file, "--database", database, "--workers", "1", "--no-pictures"]
    with site(tmp_path, database, TOY) as served:
        served.start_workers(1)
        with Program(command, cwd=tmp_path, env=TOY) as running:
            running.await_line("watch it in a browser until it ends: ")
            campaign = served.submit(other)
            assert running.wait() == 0, running.output
        assert f"archive sha256 {undisturbed_digest(BALL)}" in running.output
        done = served.await_end(campaign)
        assert (done["status"], done["digest"]) == ("finished", undisturbed_digest(other))
        listed = served.get("/api/v1/campaigns").json()["campaigns"]
        assert [one["status"] for one in listed] == ["finished", "finished"]
    checked = brink("doctor", "--thorough", "--database", database, cwd=tmp_path, env=TOY)
    assert checked.returncode == 0, checked.stdout


@pytest.mark.long("stops a campaign twice")
def test_a_stopped_run_reaches_the_same_end(
    databases: Databases, tmp_path: Path, small_problems: None
) -> None:
    file = written(tmp_path, BALL)
    with databases.database() as url:
        options = ["--database", url, "--workers", "2", "--no-pictures"]
        for stop, begun, more in (
            (signal.SIGINT, r"generation=1 ", ()),
            (signal.SIGTERM, r"generation=\d+ ", ("--resume",)),
        ):
            with Program([BRINK, "-v", "run", file, *options, *more], cwd=tmp_path, env=TOY) as running:
                running.await_line(begun)
                running.signal(stop)
                assert running.wait() == 1
            assert "nothing is lost" in running.output
            assert re.search(rf"continue with: .*brink( --plugin \S+)+ run '{file}' --resume", running.output)
            assert "Traceback" not in running.output
        refused = brink("run", file, *options, cwd=tmp_path, env=TOY)
        assert refused.returncode == 1
        assert "--resume" in refused.stderr
        resumed = brink("run", file, *options, "--resume", "--json", cwd=tmp_path, env=TOY)
        assert resumed.returncode == 0, resumed.stderr
    assert "continuing at" in resumed.stderr
    assert json.loads(resumed.stdout)["digest"] == undisturbed_digest(BALL)
