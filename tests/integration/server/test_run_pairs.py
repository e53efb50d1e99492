"""The pairs in the summary of `brink run`: first after a search for pairs, in one line after other searches."""

import asyncio
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

import brink.cli.pair_findings
from brink.api.client import Api
from brink.api.live import CampaignDisplay
from brink.api.results import NoTrace, fetch_archive
from brink.cli.commands import app
from brink.cli.options import with_api
from brink.cli.pair_findings import PairFindings, fetch_pair_findings
from brink.cli.pair_tables import pairs_table
from brink.cli.pairs import fetch_pairs
from brink.report.figures import Drawing
from brink.report.pair_words import legend
from brink.search import surrogate
from brink.server.api.schemas import Progress


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


pytestmark = pytest.mark.usefixtures("few_trees")

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
    count = next(line for line in lines if "distinct pairs across the boundary" in line)
    pairs = int(count.split()[0])
    assert pairs > 0
    assert "checked" not in shown
    assert "simulated again yet" not in shown, "computed verdicts are the same each time"
    assert shown.index(count) < shown.find("distinct boundary solution"), "what it looks for comes first"
    assert "DBS (strict DBS)" not in shown
    assert "2 of 2 parameters" in shown or "1 of 2 parameters" in shown
    assert len((folder / "pairs.jsonl").read_text().splitlines()) == pairs
    assert len((folder / "pairs.csv").read_text().splitlines()) == pairs + 1
    assert (folder / "pair-1.png").read_bytes().startswith(b"\x89PNG")
    assert {"pairs.jsonl", "pairs.csv", "pair-1.png", "map.png"} <= set(lines)
    assert {path.stem for path in folder.glob("*.png")} == {"pair-1", "map"}, "others are about the boundary"
    assert "--confirm" not in shown, "other seeds give the same verdicts"


def test_the_table_says_what_both_sides_share_and_explains_its_terms(searched: Searched) -> None:
    campaign, database = searched.campaign, searched.database
    results = CliRunner().invoke(app, ["results", campaign, "--database", database]).stdout
    assert f"brink pairs {campaign}" in results, "boundary solutions are not what it looked for"
    found = with_api(None, database, lambda api: fetch_pairs(api, campaign))
    pair = found.pairs[0]
    scenario = "Long left bend (road 0), night; task: take the first exit"
    told = pair.model_copy(update={"common": scenario})
    view = found.model_copy(update={"pairs": [told], "terms": "reported: true or not", "computed": False})
    screen = Console(record=True, width=200)
    screen.print(pairs_table(view))
    text = screen.export_text()
    assert f"in both: {scenario} " in text
    assert "detected" not in text
    assert legend(view)[0] == "reported: true or not"
    assert "by the requirement of the campaign alone" in legend(view)[1]
    assert legend(found.model_copy(update={"pairs": []})) == [], "nothing to explain"
    assert not [words for words in legend(view) if words.startswith("confirmed 0/15")]
    pending = legend(view.model_copy(update={"pending": 1}))
    assert [words for words in pending if words.startswith("confirmed 0/15")], (
        "the counts stand there already"
    )


def test_another_search_reports_its_pairs_in_one_line(database: str, tmp_path: Path) -> None:
    shown = run(tmp_path, database, {"id": "random@1"}, "--no-pictures", simulations=100)
    [line] = [line for line in shown.splitlines() if line.startswith("pairs across the boundary: ")]
    assert (
        "no pair within eps 0.02: the nearest solutions with opposite verdicts" in line or "distinct" in line
    )
    assert "DBS (strict DBS)" in shown


def test_without_a_pair_nothing_is_written_and_the_summary_says_why(database: str, tmp_path: Path) -> None:
    shown = run(tmp_path, database, {"id": "edge@1"}, "--no-pictures", simulations=60)
    assert "distinct boundary solution" in shown or "boundary.csv" not in shown, "an empty table says nothing"
    assert "no pair within eps 0.002: the nearest solutions with opposite verdicts" in shown
    assert "pairs.csv" not in shown
    again = ("--json", "--resume", "--no-pictures")
    told = json.loads(run(tmp_path, database, {"id": "edge@1"}, *again, simulations=60))
    assert told["pairs"]["distinct"] == 0
    assert not [file for file in told["files"] if "pair" in Path(file).name]
    [wider] = [line.split()[4] for line in shown.splitlines() if " --eps " in line]
    assert told["pairs"]["nearest"]["distance"] <= float(wider) <= 1.1 * told["pairs"]["nearest"]["distance"]


def test_too_many_pairs_cost_one_line_and_nothing_else(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_DISTINCT", 0)
    close = {"id": "edge@1", "params": {"eps": 0.1, "d_th": 0.0}}
    shown = run(tmp_path, database, close, simulations=80)
    told = "more than 0 distinct pairs at d_th 0: choose a larger d_th or a smaller eps"
    assert shown.count(told) == 1
    assert "/query" not in shown
    assert "--d-th 0.2" in shown, "what to try next"
    [folder] = tmp_path.glob("disc-*")
    names = {path.name for path in folder.iterdir()}
    assert {"map.png", "archive.npz"} <= names
    assert not names & {"pairs.jsonl", "pairs.csv", "pair-1.png", "dbs.png", "parameters.png"}
    again = json.loads(run(tmp_path, database, close, "--json", "--resume", "--no-pictures", simulations=80))
    assert again["pairs"]["searched"]
    assert told in again["pairs"]["too_many"]
    out = tmp_path / "plots"
    drawn = CliRunner().invoke(app, ["plot", again["campaign"], "--out", str(out), "--database", database])
    assert drawn.exit_code == 0, drawn.output
    assert told in " ".join(drawn.stderr.split())
    assert (out / "map.png").is_file()


def test_another_search_with_too_many_pairs_says_so_and_keeps_its_boundary(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_TIGHT", 0)
    shown = run(tmp_path, database, {"id": "random@1"}, "--no-pictures")
    assert "within eps 0.02: choose a smaller eps" in shown
    assert "--eps 0.01" in shown
    assert "DBS (strict DBS)" in shown


def test_a_picture_that_cannot_be_drawn_is_left_out_with_a_word(
    searched: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = searched.campaign

    async def fails(*_: object, **__: object) -> None:
        raise NoTrace("the episode of solution 3 failed on this machine: no")

    monkeypatch.setattr(brink.cli.pair_findings, "write_pair", fails)

    async def draw(api: Api) -> tuple[PairFindings, list[Path]]:
        found = await fetch_pair_findings(api, await fetch_archive(api, campaign))
        assert isinstance(found, PairFindings)
        drawing = Drawing(api=api, campaign=campaign, folder=tmp_path, stop=asyncio.Event(), timeout_s=1.0)
        return found, await found.draw(drawing)

    found, files = with_api(None, searched.database, draw)
    assert files == []
    screen = Console(record=True, width=120)
    found.show(screen)
    assert "no picture of pair 1: the episode of solution 3 failed" in screen.export_text()


def test_progress_of_a_search_for_pairs_does_not_speak_of_the_boundary(searched: Searched) -> None:
    campaign, database = searched.campaign, searched.database
    shown = CliRunner().invoke(app, ["status", campaign, "--database", database]).stdout
    assert f"searched for pairs across the boundary; show them with: brink pairs {campaign}" in " ".join(
        shown.split()
    )
    assert "distinct" not in shown

    async def progress(api: Api) -> Progress:
        return await api.read(Progress, f"/campaigns/{campaign}/progress")

    found = with_api(None, database, progress)
    screen = Console(record=True, width=160)
    with CampaignDisplay(screen) as display:
        display.show(found)
    line = screen.export_text()
    assert "unsafe" in line
    assert "fitness" not in line
    assert "strict" not in line


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
    assert f"no files of a run to bring up to date in {place}; --results names" in nowhere.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before

    told = CliRunner().invoke(app, [*command, "results"]).stdout
    place = Path("results") / searched.folder.name
    assert f"brought up to date in {place}: pairs.jsonl, pairs.csv, pair-1.png, report.html" in told
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


@pytest.mark.parametrize("command", ["results", "compare", "repeats"])
def test_commands_about_the_boundary_say_where_the_pairs_are(searched: Searched, command: str) -> None:
    shown = CliRunner().invoke(app, [command, searched.campaign, "--database", searched.database])
    assert "this campaign searched for pairs across the boundary; " in shown.stdout
    assert f"brink pairs {searched.campaign}" in shown.stdout
