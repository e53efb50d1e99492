"""The report of a campaign: one page that is complete in itself and says what was found, whatever was looked for."""

import base64
import io
import json
import re
import shutil
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Final

import pytest
import yaml
from PIL import Image
from support.api import FakeWorker, ball, coordinator, expect, progress, submit
from support.tolerance import body as tolerance_body
from support.tolerance import finished as tolerance_finished
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.cli.options import with_api
from brink.report import campaign_facts
from brink.report.campaign import campaign_report
from brink.search import surrogate
from brink.server.campaigns.body import parse_body

API = "/api/v1/campaigns"
VOID: Final = {"meta", "img", "br", "link", "input"}
NO_PICTURES: Mapping[str, Path] = {}
MTQ: dict[str, Any] = {
    "name": "disc",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "edge@1", "params": {"eps": 0.02}},
    "budget": {"simulations": 150},
    "seed": 1,
    "tags": ["disc", "demo"],
    "notes": "First line.\nSecond line.",
}

pytestmark = pytest.mark.usefixtures("few_trees")


class Page(HTMLParser):
    """A page that was parsed: every element is closed in order, and nothing refers to anything outside.

    Attributes:
        text: What a reader sees.
        headings: Texts of the headings of the second level.
        pictures: Sources and descriptions of the pictures.
    """

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self._open: list[str] = []
        self._words: list[str] = []
        self.headings: list[str] = []
        self.pictures: list[tuple[str, str]] = []
        self.tags: set[str] = set()
        self.feed(page)
        self.close()
        assert self._open == []
        self.text = " ".join(" ".join(self._words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        given = dict(attrs)
        assert not [name for name in given if name.startswith("on")]
        for name in ("src", "href", "srcset", "action", "data"):
            assert (given.get(name) or "data:").startswith("data:")
        if tag == "img":
            self.pictures.append((given["src"] or "", given["alt"] or ""))
        if tag == "h2":
            self.headings.append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" in self._open:
            assert not re.search(r"url\(|@import", data)
            return
        self._words.append(data)
        if self._open and self._open[-1] == "h2":
            self.headings[-1] += data


def written(database: str, campaign: str, **options: Any) -> str:
    """Return the report of a campaign; without pictures, unless other options are given."""
    given = options or {"pictures": NO_PICTURES}
    return with_api(None, database, lambda api: campaign_report(api, campaign, **given))


def read(database: str, campaign: str, **options: Any) -> Page:
    page = written(database, campaign, **options)
    assert page.startswith("<!DOCTYPE html>")
    found = Page(page)
    assert "script" not in found.tags
    return found


def computed(database: str, document: Mapping[str, Any]) -> str:
    """Run a campaign whose verdicts are computed, and return its id."""
    with coordinator(database) as client:
        campaign = submit(client, document)
        assert FakeWorker(client).work(campaign)["status"] == "finished"
    return campaign


@pytest.fixture(scope="module")
def searched(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A database with a finished search for pairs, to be copied, and the campaign's id."""
    file = Path(shutil.copy(sqlite_file, tmp_path_factory.mktemp("searched") / "brink.db"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surrogate, "TREES", 6)
        return file, computed(f"sqlite:///{file}", MTQ)


@pytest.fixture
def disc(searched: tuple[Path, str], tmp_path: Path) -> tuple[str, str]:
    """The URL of the test's own database with a finished search for pairs, and the campaign's id."""
    file, campaign = searched
    return f"sqlite:///{shutil.copy(file, tmp_path / 'disc.db')}", campaign


def test_a_search_for_pairs_shows_the_best_with_pictures_and_lists_the_others(disc: tuple[str, str]) -> None:
    database_url, campaign = disc
    told: list[tuple[str, int, int]] = []
    page = written(database_url, campaign, most_pairs=2, show=lambda *step: told.append(step))
    found = Page(page)
    assert found.headings == [
        "What was found",
        "Pairs",
        "Where it was unsafe",
        "Requirements held and violated",
        "How far to trust it",
        "How it was computed",
        "Tags and notes",
    ]
    assert "Brink searched for pairs of solutions that are neighbours" in found.text
    count = re.search(r"The result: (\d+) distinct pairs across the boundary", found.text)
    assert count
    assert [words.partition(":")[0] for _, words in found.pictures] == [
        "Pair 1",
        "Pair 2",
        "Map of the campaign",
    ]
    for source, _ in found.pictures:
        with Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))) as picture:
            assert picture.width > 1000
    assert page.count("<article>") == 2
    listed = re.search(r"<caption>Distinct pairs, confirmed ones first</caption>.*?</table>", page, re.DOTALL)
    assert listed
    assert listed[0].count("<tr>") - 1 == min(int(count[1]), 20)
    assert "they are deterministic" in found.text
    assert "is a random search on the same problem" in found.text
    assert "disc" in found.text
    assert "First line. Second line." in found.text
    assert told[0] == ("reading the campaign", 0, 0)
    assert ("drawing pairs", 2, 2) in told
    assert written(database_url, campaign) == written(database_url, campaign), (
        "the same campaign, the same page"
    )


def test_the_printed_file_and_digest_describe_the_campaign(disc: tuple[str, str]) -> None:
    database_url, campaign = disc
    page = written(database_url, campaign)
    printed = re.search(r"<pre[^>]*>(.*?)</pre>", page, re.DOTALL)
    assert printed
    file = yaml.safe_load(printed[1])
    with coordinator(database_url) as client:
        again = submit(client, file)
        assert FakeWorker(client).work(again)["digest"] == progress(client, campaign)["digest"]
        assert str(progress(client, campaign)["digest"]) in page
    assert parse_body(file).tags == []


def test_names_tags_and_notes_are_text_and_never_markup(database_url: str) -> None:
    hostile = "</title><script>alert(1)</script><img src=x onerror=alert(2)>\"'&"
    campaign = computed(
        database_url, {**MTQ, "name": hostile, "notes": hostile, "budget": {"simulations": 60}}
    )
    page = written(database_url, campaign)
    assert "<script" not in page
    assert "<img" not in page
    found = Page(page)
    assert found.text.count(hostile) >= 3, "title, heading and notes"


@pytest.mark.long("runs campaigns")
@pytest.mark.usefixtures("small_problems")
def test_an_unfinished_campaign_says_so(database_url: str) -> None:
    with coordinator(database_url) as client:
        empty = submit(client, ball(problem={"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}))
        half = submit(client, ball(seed=2))
        FakeWorker(client).work(half, until=lambda stands: stands["generation"] >= 1)
        expect(client.post(f"{API}/{half}/pause"))
        cancelled = submit(client, ball(seed=3))
        expect(client.post(f"{API}/{cancelled}/cancel"))
    found = read(database_url, empty)
    assert "Unfinished: the campaign is still running, after 0 of 60 simulations." in found.text
    assert "No drive has a verdict yet, so there is nothing to report." in found.text
    assert found.headings == [
        "What was found",
        "How far to trust it",
        "How it was computed",
        "Tags and notes",
    ]
    found = read(database_url, half)
    assert "Unfinished: the campaign is paused" in found.text
    assert "The campaign has not ended, so all of this may change." in found.text
    assert "Archive" not in found.text
    found = read(database_url, half)
    assert "the same file gives the same archive" in found.text
    assert "its digest must be" not in found.text
    found = read(database_url, cancelled)
    assert "The campaign was cancelled after 0 of 60 simulations" in found.text
    assert "No drive has a verdict, so" in found.text


@pytest.mark.long("runs campaigns")
@pytest.mark.usefixtures("smaller_library")
def test_a_search_for_tolerances_shows_sentences_and_curves_instead_of_pairs(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with coordinator(database_url) as client:
        campaign = tolerance_finished(
            client, tolerance_body(simulations=400, conditions=[{"name": "always"}])
        )
        cells = expect(client.get(f"{API}/{campaign}/tolerance"))["cells"]
    monkeypatch.setattr(campaign_facts, "MOST_ROWS", 3)
    found = read(database_url, campaign, most_pairs=6)
    assert "Tolerances" in found.headings
    assert not {"Pairs", "Where it was unsafe", "The boundary"} & set(found.headings)
    [(_, words)] = found.pictures
    assert words.startswith("Share of drives that violate because of an error")
    limited = [cell["sentence"] for cell in cells if cell["tolerated"]["finding"] == "limit"]
    assert limited
    assert all(sentence in found.text for sentence in limited)
    assert all(cell["tolerated_words"] in found.text for cell in cells)
    assert "No pair has been simulated again" not in found.text


@pytest.mark.long("runs campaigns")
def test_the_command_writes_the_file_whole_or_says_what_is_wrong(
    disc: tuple[str, str], tmp_path: Path
) -> None:
    database_url, campaign = disc

    def run(*arguments: str) -> Any:
        return CliRunner().invoke(app, ["report", *arguments, "--database", database_url])

    file = tmp_path / "found.html"
    done = run(campaign[:4], "--out", str(file), "--pairs", "1")
    assert done.exit_code == 0, done.output
    assert f"{file}: 0." in done.stdout
    assert Page(file.read_text()).headings[0] == "What was found"
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".part")]
    for arguments, message in (
        ((campaign, "--out", "report.pdf"), "ends in .html"),
        ((campaign, "--out", str(tmp_path / "none" / "report.html")), "no such folder"),
        (("none", "--out", str(file)), "no such campaign"),
    ):
        failed = run(*arguments)
        assert failed.exit_code != 0
        assert message in str(failed.exception)


@pytest.mark.long("runs campaigns")
def test_a_run_writes_the_report_with_the_pictures_that_it_drew(sqlite_file: Path, tmp_path: Path) -> None:
    database = f"sqlite:///{tmp_path / 'runs.db'}"
    (tmp_path / "runs.db").write_bytes(sqlite_file.read_bytes())
    (tmp_path / "disc.json").write_text(json.dumps(MTQ))
    command = ["run", str(tmp_path / "disc.json"), "--database", database, "--out", str(tmp_path)]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    [file] = tmp_path.glob("disc-*/report.html")
    assert "  report.html" in ran.stdout.splitlines()
    found = Page(file.read_text())
    drawn = {path.name: base64.b64encode(path.read_bytes()).decode() for path in file.parent.glob("*.png")}
    shown = [source.partition(",")[2] for source, _ in found.pictures]
    assert shown == [drawn["pair-1.png"], drawn["map.png"]]
