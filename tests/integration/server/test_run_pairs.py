"""The pairs that `brink run` found: in its summary, in its files, and as evidence."""

import asyncio
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import brink.cli.kind_files
from brink.api.client import Api
from brink.api.results import NoTrace, fetch_archive
from brink.cli.commands import app
from brink.cli.kind_files import PairFiles
from brink.cli.options import with_api
from brink.report.figures import Drawing
from brink.search import surrogate
from brink.server.findings.finding import Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """A campaign that searched for pairs.

    Attributes:
        database: Where it is stored.
        campaign: Its id.
        shown: What `brink run` printed.
        folder: The only folder with its results.
    """

    database: str
    campaign: str
    shown: str
    folder: Path


@pytest.fixture(scope="module")
def searched(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    """A search for pairs that ran to its end with pictures, for the tests that only read it."""
    folder = tmp_path_factory.mktemp("searched")
    database = f"sqlite:///{shutil.copyfile(sqlite_file, folder / 'runs.db')}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surrogate, "TREES", 6)
        shown = run(folder, database, SEARCH)
    [results] = folder.glob("disc-*")
    listed = CliRunner().invoke(app, ["status", "--json", "--database", database])
    [campaign] = json.loads(listed.stdout)["campaigns"]
    return Searched(database=database, campaign=campaign["id"], shown=shown, folder=results)


@pytest.fixture
def database(sqlite_file: Path, tmp_path: Path) -> str:
    return f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path / 'runs.db')}"


pytestmark = [pytest.mark.long("runs campaigns"), pytest.mark.usefixtures("few_trees")]

SEARCH = {"id": "edge@1", "params": {"eps": 0.01}}


def run(folder: Path, database: str, algorithm: dict[str, Any], *options: str, simulations: int = 300) -> str:
    """Run a campaign on a problem without drives; return what was printed."""
    body = {
        "name": "disc",
        "problem": {"id": "mtq@1"},
        "algorithm": algorithm,
        "budget": {"simulations": simulations},
        "seed": 1,
    }
    (folder / "disc.json").write_text(json.dumps(body))
    command = ["run", str(folder / "disc.json"), "--database", database, "--out", str(folder), *options]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    return ran.stdout


def test_a_search_for_pairs_reports_them_first_with_files_and_a_picture(searched: Searched) -> None:
    shown, folder = searched.shown, searched.folder
    lines = [line.strip() for line in shown.splitlines()]
    count = next(line for line in lines if line.startswith("Pairs: "))
    pairs = int(count.split()[1])
    assert pairs > 0
    assert "checked" not in shown
    assert "simulated again yet" not in shown, "computed verdicts are the same each time"
    assert shown.index(count) < shown.find("distinct boundary solution"), "what it looks for comes first"
    assert "DBS (strict DBS)" not in shown
    assert "numbers move by up to" in shown
    assert len((folder / "pairs.jsonl").read_text().splitlines()) == pairs
    assert len((folder / "pairs.csv").read_text().splitlines()) == pairs + 1
    assert (folder / "pair-1.png").read_bytes().startswith(b"\x89PNG")
    assert {"pairs.jsonl", "pairs.csv", "pair-1.png", "map.png"} <= set(lines)
    assert {path.stem for path in folder.glob("*.png")} == {"pair-1", "map"}, "others are about the boundary"
    assert "--confirm" not in shown, "other seeds give the same verdicts"


def test_without_a_pair_nothing_is_written_and_the_summary_says_why(database: str, tmp_path: Path) -> None:
    shown = run(tmp_path, database, {"id": "edge@1"}, "--no-pictures", simulations=60)
    assert "distinct boundary solution" in shown or "boundary.csv" not in shown, "an empty table says nothing"
    assert "no pair within eps 0.002: the nearest solutions with opposite verdicts" in shown
    assert "pairs.csv" not in shown
    again = ("--json", "--resume", "--no-pictures")
    told = json.loads(run(tmp_path, database, {"id": "edge@1"}, *again, simulations=60))
    assert told["pairs"]["distinct"] == 0
    assert not [file for file in told["files"] if "pair" in Path(file).name]
    [wider] = [line.partition(" --eps ")[2].split()[0] for line in shown.splitlines() if " --eps " in line]
    assert told["pairs"]["nearest"]["distance"] <= float(wider) <= 1.1 * told["pairs"]["nearest"]["distance"]


def test_a_picture_that_cannot_be_drawn_is_left_out_with_a_word(
    searched: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = searched.campaign

    async def fails(*_: object, **__: object) -> None:
        raise NoTrace("the episode of solution 3 failed on this machine: no")

    monkeypatch.setattr(brink.cli.kind_files, "write_pair", fails)

    async def draw(api: Api) -> tuple[PairFiles, list[Path]]:
        finding = await api.read(Finding, f"/campaigns/{campaign}/findings/pairs")
        pairs = PairFiles(await fetch_archive(api, campaign), finding)
        await pairs.read(api)
        drawing = Drawing(api=api, campaign=campaign, folder=tmp_path, stop=asyncio.Event(), timeout_s=1.0)
        return pairs, await pairs.draw(drawing)

    pairs, files = with_api(None, searched.database, draw)
    assert files == []
    assert "no picture of pair 1: the episode of solution 3 failed" in pairs.warning


def test_a_follow_up_brings_the_files_of_the_run_up_to_date(
    searched: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    database = f"sqlite:///{shutil.copyfile(searched.database.removeprefix('sqlite:///'), tmp_path / 'd.db')}"
    folder = shutil.copytree(searched.folder, tmp_path / "results" / searched.folder.name)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    command = ["pairs", searched.campaign, "--minimise", "--database", database, "--results"]

    nowhere = CliRunner().invoke(app, [*command, "elsewhere"])
    assert nowhere.exit_code == 0, nowhere.output
    place = Path("elsewhere") / searched.folder.name
    assert f"no files of a run to update in {place}; --results names" in nowhere.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before

    told = CliRunner().invoke(app, [*command, "results"]).stdout
    place = Path("results") / searched.folder.name
    assert f"updated in {place}: pairs.jsonl, pairs.csv, pair-1.png, report.html" in told
    assert {path.name for path in folder.iterdir()} == before.keys()
    tables = (folder / "pairs.jsonl").read_text(encoding="utf-8").splitlines()
    assert any(json.loads(line)["minimality"]["tried"] for line in tables)
    assert (folder / "map.png").read_bytes() == before["map.png"], "pairs keep their numbers"
    for name in ("pairs.csv", "report.html"):
        assert (folder / name).read_bytes() != before[name]
    assert "up to date" not in CliRunner().invoke(app, [*command, "results"]).stdout, "nothing new is known"


def test_the_evidence_of_a_search_for_pairs_is_its_pairs(searched: Searched, tmp_path: Path) -> None:
    out = tmp_path / "evidence"
    command = ["evidence", searched.campaign, "--out", str(out), "--pairs", "2", "--replays", "0"]
    told = CliRunner().invoke(app, [*command, "--database", searched.database])
    assert told.exit_code == 0, told.output
    tables = (searched.folder / "pairs.csv").read_bytes()
    pairs = len(tables.splitlines()) - 1
    assert f"{out}: {pairs} pairs, 2 with pictures; " in told.stdout
    assert (out / "pairs.csv").read_bytes() == tables
    assert {path.name for path in (out / "pairs").iterdir()} == {"pair-1.png", "pair-2.png"}
    readme = (out / "README.md").read_text()
    assert readme.startswith("# Pairs of disc\n")
    assert f"`brink pairs {searched.campaign}`" in readme
    assert [f"| {number} | " in readme for number in range(1, pairs + 2)] == [True] * pairs + [False]
    assert "![Pair 2](pairs/pair-2.png)" in readme
    assert "![Pair 3]" not in readme
    assert "## The unsafe region" in readme
