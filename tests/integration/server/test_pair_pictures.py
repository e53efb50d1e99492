"""`brink pairs --picture` and `--film`: of drives, of problems without drives, and what is refused."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from support.traces import make_trace
from typer.testing import CliRunner

import brink.report.pair_pictures
from brink.api.live import Steps
from brink.cli.commands import app
from brink.pictures.pair_view import STILL_WIDTH_PX
from brink.plots.style import WIDTH_PX
from brink.server.findings.pairs.views import PairsView
from brink.sim.trace import Trace

pytestmark = pytest.mark.long("runs a campaign and draws")

CAMPAIGN = {
    "name": "disc",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 300},
    "seed": 1,
}
WIDE = ["--eps", "0.05", "--d-th", "0.1"]


@pytest.fixture(scope="module")
def disc(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[str]]:
    """A finished campaign on a problem without drives: its id, and the options that name its database."""
    folder = tmp_path_factory.mktemp("disc")
    (folder / "disc.json").write_text(json.dumps(CAMPAIGN))
    database = f"sqlite:///{shutil.copyfile(sqlite_file, folder / 'disc.db')}"
    command = [
        "run",
        str(folder / "disc.json"),
        "--database",
        database,
        "--no-pictures",
        "--out",
        str(folder),
        "--json",
    ]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    return str(json.loads(ran.stdout)["campaign"]), ["--database", database]


def pairs(disc: tuple[str, list[str]], *options: str) -> Any:
    campaign, database = disc
    return CliRunner().invoke(app, ["pairs", campaign, *WIDE, *options, *database])


def view_of(disc: tuple[str, list[str]]) -> PairsView:
    return PairsView.model_validate_json(pairs(disc, "--json").stdout)


def test_a_problem_without_drives_is_drawn_in_its_plane(disc: tuple[str, list[str]], tmp_path: Path) -> None:
    picture = tmp_path / "pair.png"
    said = pairs(disc, "--picture", "1", str(picture))
    assert said.exit_code == 0, said.output
    assert said.stdout.strip() == str(picture)
    with Image.open(picture) as image:
        assert image.width == WIDTH_PX


def test_a_problem_without_drives_cannot_be_filmed(disc: tuple[str, list[str]], tmp_path: Path) -> None:
    said = pairs(disc, "--film", "1", str(tmp_path / "pair.mp4"))
    assert said.exit_code != 0
    assert "verdicts are computed, so there is no drive to film: ask for --picture" in str(said.exception)
    assert list(tmp_path.iterdir()) == []


def test_drives_are_drawn_with_the_words_of_the_pair(
    disc: tuple[str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = view_of(disc)
    safe = view.pairs[0].safe.number

    async def trace_of(_api: object, _campaign: str, number: int) -> Trace:
        return make_trace(samples=150, violated=number != safe)

    async def simulated(api: Any, campaign: str, **_: object) -> PairsView:
        return view.model_copy(update={"computed": False})

    async def front_gap(_api: object, _campaign: str) -> tuple[str, ...]:
        return ("front-gap@1",)

    monkeypatch.setattr(brink.report.pair_pictures, "run_episode", trace_of)
    monkeypatch.setattr(brink.report.pair_pictures, "fetch_requirements", front_gap)
    monkeypatch.setattr("brink.cli.pairs.fetch_pairs", simulated)
    picture = tmp_path / "pair.png"
    steps: list[tuple[str, int, int]] = []
    show = Steps.show

    def record(self: Steps, what: str, done: int = 0, total: int = 0) -> None:
        steps.append((what, done, total))
        show(self, what, done, total)

    monkeypatch.setattr(Steps, "show", record)
    said = pairs(disc, "--picture", "1", str(picture))
    assert said.exit_code == 0, said.output
    with Image.open(picture) as image:
        assert image.width == STILL_WIDTH_PX
    simulating = "simulating both drives of pair 1 again"
    assert steps[:3] == [(simulating, 0, 2), (simulating, 1, 2), (f"drawing {picture}", 0, 0)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--picture", "999", "pair.png"], "expected the number of a pair from 1 to "),
        (["--picture", "0", "pair.png"], "got 0"),
        (["--picture", "1", "pair.mp4"], "pair.mp4: expected a file name that ends in .png"),
        (["--film", "1", "pair.png"], "pair.png: expected a file name that ends in .mp4 or .gif"),
        (["--film", "1", "nowhere/pair.gif"], "nowhere: no such folder"),
        (["--eps", "0", "--picture", "1", "pair.png"], "but there is none: no pair within eps 0"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_can(
    disc: tuple[str, list[str]],
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    said = pairs(disc, *options)
    assert said.exit_code != 0
    assert message in str(said.exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--picture", "--film"])
def test_an_option_that_is_given_twice_is_refused_before_anything_is_drawn(
    option: str, tmp_path: Path
) -> None:
    once = [option, "1", str(tmp_path / "a.gif")]
    said = CliRunner().invoke(app, ["pairs", "3f2a", *once, *once])
    assert said.exit_code == 2
    assert f"'{option}': may be given only once; use one call for each" in said.stderr
    assert list(tmp_path.iterdir()) == []
