"""`brink tolerance` holds a detector against a search for tolerances: by recordings, and by drives with a camera."""

import base64
import csv
import html
import io
import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from support.api import coordinator
from support.databases import Databases
from support.tolerance import body, camera, finished
from typer.testing import CliRunner, Result

from brink.cli.commands import app

pytestmark = pytest.mark.long("runs a search for tolerances; the checks have unit tests")
RECORDINGS = Path(__file__).parents[2] / "data" / "recordings"
WIDE = ("--camera", "1920", "1080", "60", "1.4")
"""The camera of `blind.csv`."""
HEADER = "drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px,score,condition"


class Checked:
    """Runs `brink tolerance` against a finished search for tolerances.

    Attributes:
        campaign: The search: misses and delays of the lead and of pedestrians, by day and by night.
        camera: A campaign with a detector in the loop, which misses the lead at night.
    """

    def __init__(self, database: str, campaign: str, camera: str) -> None:
        self.database, self.campaign, self.camera = database, campaign, camera

    def __call__(self, *options: object, status: int = 0) -> Result:
        given = ["tolerance", self.campaign, "--database", self.database, *map(str, options)]
        done = CliRunner().invoke(app, given)
        assert done.exit_code == status, done.output
        return done

    def view(self, *options: object) -> Any:
        return json.loads(self(*options, "--json").stdout)

    def cells(self, *options: object) -> dict[tuple[str, ...], Any]:
        """Return the cells of a check by type, target and condition."""
        return {(*cell["choices"].values(), cell["condition"]): cell for cell in self.view(*options)["cells"]}

    def refused(self, *options: object) -> str:
        done = CliRunner().invoke(
            app, ["tolerance", self.campaign, "--database", self.database, *map(str, options)]
        )
        assert done.exit_code != 0, done.output
        return str(done.exception) + done.output


@pytest.fixture(scope="module")
def check(module_databases: Databases, smaller_library: None) -> Iterator[Checked]:
    cells = {"type": ["miss", "late"], "target": ["lead", "pedestrian"]}
    with module_databases.database() as url, coordinator(url) as client:
        search = finished(
            client, body(1, 900, cells=cells, generation_size=120, in_flight=1, without_error=10)
        )
        yield Checked(url, search, finished(client, camera()))


def recording(folder: Path, *, drives: int = 20, missed: range = range(30, 70), score: float = 0.9) -> Path:
    """Write drives of 8 s at night with a lead 15 m ahead, which is not reported for a while."""
    rows = [HEADER]
    for drive in range(drives):
        for step in range(81):
            box = "380,420,310,345,{},by night"
            rows.append(f"d{drive},{step / 10},truth,7,car,{box.format('')}")
            if step not in missed:
                rows.append(f"d{drive},{step / 10},detection,,car,{box.format(score)}")
    file = folder / "mine.csv"
    file.write_text("\n".join(rows) + "\n")
    return file


# The small files, with what is right for each.


def test_a_blind_detector_meets_nothing_and_pedestrians_have_no_evidence(
    check: Checked, tmp_path: Path
) -> None:
    file = tmp_path / "blind.csv"
    file.write_text((RECORDINGS / "blind.csv").read_text().replace("night, wet", "by night"))
    cells = check.cells("--detections", file, *WIDE)
    lead = {key: cell for key, cell in cells.items() if "lead" in key}
    assert not {cell["result"] for cell in lead.values()} & {"met"}
    assert cells["miss", "lead", "by night"]["result"] == "not met"
    assert cells["miss", "lead", "by night"]["at_least"] == 12
    assert {cell["result"] for key, cell in cells.items() if "pedestrian" in key} == {"no data"}
    assert {cell["result"] for key, cell in cells.items() if "by day" in key} == {"no data"}


@pytest.mark.parametrize(
    ("name", "missed_s", "late_s", "at_least"),
    [("cutin", 4.0, None, 0), ("always", 4.0, None, 0), ("late", 3.0, 0.2, 0), ("gap", 3.0, 5.0, 1)],
)
def test_errors_are_measured_while_the_road_user_matters_and_is_in_sight(
    check: Checked, name: str, missed_s: float, late_s: float | None, at_least: int
) -> None:
    cells = check.cells("--detections", RECORDINGS / f"{name}.csv")
    missed, late = (cells[kind, "lead", "all drives"] for kind in ("miss", "late"))
    assert missed["typical"] == pytest.approx(missed_s)
    assert missed["at_least"] == at_least
    assert late["typical"] == (None if late_s is None else pytest.approx(late_s))
    # Drives that say nothing of their condition count under no condition.
    assert {cell["drives"] for key, cell in cells.items() if "all drives" not in key} == {0}


# What is printed, written and drawn.


def test_the_table_says_what_is_met_what_is_not_and_what_to_record(check: Checked, tmp_path: Path) -> None:
    done = check("--detections", recording(tmp_path))
    lines = done.stdout.splitlines()
    assert lines[0] == (
        "mine does not meet the requirement: not met in 1 of 8 cells, unknown in 7 (7 without any data), met in 0; "
        "from 20 drives."
    )
    assert "make at most 5% of drives violate the front gap or collide" in lines[1]
    assert lines[2].split()[:3] == ["result", "error", "condition"]
    assert lines[3].startswith("not met  ")
    folded = [line for line in lines if "without data. " in line.lower()]
    assert len(folded) == 1
    assert "By day: everything." in folded[0]
    assert any(re.search(r"^- By day.*59 drives or more", line) for line in lines)
    assert "20 drives, 1,620 images, 1,620 true boxes, 820 detections" in done.stderr
    assert "should be reported while it is visible: at least 25% of it in sight" in done.stderr


def test_each_cell_is_a_sentence(check: Checked, tmp_path: Path) -> None:
    lines = check("--detections", recording(tmp_path), "--format", "sentences").stdout.splitlines()
    assert re.match(
        r"By night: not reporting the lead for …: not met: in 20 drives the worst such error has a median of 4\.0 s; "
        r"\d+\.\d% \[\d+\.\d, \d+\.\d\] "
        r"of drives with such errors violate the front gap or collide, 5% are allowed\.$",
        lines[0],
    )
    assert lines[-1].startswith("Without data. By night: not reporting the nearest pedestrian")
    assert lines[-1].endswith(" By day: everything.")


def test_lower_bounds_are_marked(check: Checked) -> None:
    done = check("--detections", RECORDINGS / "gap.csv")
    assert "≥ 3.0 s" in done.stdout
    assert "≥ 5.0 s" in done.stdout
    assert "the recording cut the error off" in done.stdout


@pytest.mark.parametrize("by", ["recording", "episodes"])
def test_a_check_is_written_in_each_format_and_drawn(check: Checked, tmp_path: Path, by: str) -> None:
    given = ("--detections", recording(tmp_path)) if by == "recording" else ("--episodes", check.camera)
    table, page, text, document, picture = (
        tmp_path / name for name in ("check.csv", "check.html", "check.md", "check.json", "check.png")
    )
    check(*given, "--out", table, "--picture", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 15_000
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert len(rows) == 8
    assert (rows[0]["type"], rows[0]["target"], rows[0]["condition"]) == ("miss", "lead", "by night")
    assert rows[0]["sentence"].startswith("By night: not reporting the lead")
    check(*given, "--out", text, "--picture", picture)
    assert (
        "![Shares of drives that violate, with intervals, against the limit](check.png)" in text.read_text()
    )
    assert "## What to record next" in text.read_text()
    check(*given, "--out", document)
    assert len(json.loads(document.read_text())["cells"]) == 8
    check(*given, "--out", page)
    assert "not reporting the lead for …" in page.read_text()
    assert check(*given, "--format", "csv").stdout == table.read_text()
    assert check(*given, "--format", "html").stdout == page.read_text()


class Page(HTMLParser):
    """Collects what a page loads, and counts its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.external: list[str] = []
        self.classes: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.external += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]
        self.classes += [value or "" for name, value in attrs if name == "class"]


def test_the_page_shows_the_worst_episodes_as_strips_of_frames(check: Checked, tmp_path: Path) -> None:
    page = tmp_path / "check.html"
    check("--detections", recording(tmp_path), "--out", page)
    text = page.read_text()
    found = Page(text)
    assert found.external == []
    assert found.classes.count("strip") == 5  # the worst drives that a cell names
    assert text.count("<figcaption>") == 5 * 8
    assert "Drive d0: not reporting the lead for 4.0 s" in text
    assert "from 3.0 to 7.0 s, road user 7" in text
    assert "15 m, missed" in text
    assert "15 m, reported" in text
    # The key, then the true box of each frame; reported boxes in those before and after the miss.
    assert found.classes.count("true subject") == 1 + 5 * 8
    assert 1 < found.classes.count("reported") < 5 * 8


def test_the_worst_episodes_are_shown_on_pictures_of_the_recording(check: Checked, tmp_path: Path) -> None:
    given = ("--detections", recording(tmp_path, drives=2), "--images", tmp_path, "--format", "html")
    for drive in ("d0", "d1"):
        (tmp_path / drive).mkdir()
        for step in range(81):
            Image.new("RGB", (80, 60), (step, 0, 0)).save(tmp_path / drive / f"{step:06}.png")
    found = Page(check(*given).stdout)
    assert len(found.external) == found.tags.count("image") == 2 * 8
    assert all(one.startswith("data:image/jpeg;base64,") for one in found.external)
    reds = []
    for one in found.external[:8]:
        with Image.open(io.BytesIO(base64.b64decode(one.partition(",")[2]))) as picture:
            reds.append(picture.getpixel((2, 2))[0])  # type: ignore[index]
    assert reds == pytest.approx([24, 32, 39, 46, 54, 61, 69, 76], abs=3)  # the steps of the frames
    (tmp_path / "d1" / "000080.png").unlink()
    assert (
        "d1: expected a picture (.png, .jpg, .jpeg) for each of the 81 images of drive d1"
        in check.refused(*given)
    )
    for step in (24, 80):
        (tmp_path / "d1" / f"{step:06}.png").write_text("no picture")
    assert "d1/000024.png: expected a picture: " in check.refused(*given)


def test_names_are_text_on_the_page(check: Checked, tmp_path: Path) -> None:
    file = recording(tmp_path)
    hostile = tmp_path / "<img src=x onerror=alert(1)>.csv"
    hostile.write_text(file.read_text().replace("d0,", "<script>\x1b0,"))
    page = tmp_path / "check.html"
    check("--detections", hostile, "--out", page)
    found = Page(page.read_text())
    assert not {"img", "script"} & set(found.tags)
    assert r"&lt;script&gt;\u001b0" in page.read_text()
    text = check("--detections", hostile, "--format", "md").stdout
    assert r"\<script>\u001b0" in text
    table = check("--detections", hostile, "--format", "csv").stdout
    assert r"<script>\u001b0" in table
    assert "\x1b" not in page.read_text() + text + table


def test_the_report_of_the_search_checks_the_detector_of_a_campaign(check: Checked, tmp_path: Path) -> None:
    view, page = check.view("--episodes", check.camera), tmp_path / "report.html"
    given = [
        "report",
        check.campaign,
        "--episodes",
        check.camera,
        "--database",
        check.database,
        "--out",
        str(page),
    ]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    text = html.unescape(page.read_text())
    assert "<h2>Does brink-det@2 meet the requirement?</h2>" in text
    assert view["note"] in text
    assert all(words in text for words in view["next"])
    assert 'alt="Shares of drives that errors of this size make violate, against the limit"' in text


# The exit status.


@pytest.mark.parametrize(("missed", "status"), [(range(30, 70), 1), (range(30, 32), 0)])
def test_the_gate_fails_where_a_cell_is_not_met(
    check: Checked, tmp_path: Path, missed: range, status: int
) -> None:
    file = recording(tmp_path, missed=missed)
    check("--detections", file, "--gate", "--format", "csv", status=status)
    check("--detections", file)


def test_the_gate_holds_for_the_detector_of_a_campaign(check: Checked) -> None:
    is_met = all(cell["result"] != "not met" for cell in check.view("--episodes", check.camera)["cells"])
    check("--episodes", check.camera, "--gate", status=0 if is_met else 1)


# What a recording is.


def test_a_threshold_decides_what_counts(check: Checked, tmp_path: Path) -> None:
    file = recording(tmp_path, missed=range(0), score=0.4)
    key = ("miss", "lead", "by night")
    assert check.cells("--detections", file)[key]["typical"] == pytest.approx(8.1)
    assert check.cells("--detections", file, "--threshold", "0.3")[key]["typical"] == 0.0
    assert "820 detections, of which 0" not in check("--detections", file, "--threshold", "0.3").stderr
    assert "1,620 detections, of which 0 have a score of at least 0.5" in check("--detections", file).stderr


def test_thresholds_are_compared(check: Checked, tmp_path: Path) -> None:
    file = recording(tmp_path, missed=range(30, 32), score=0.4)
    shown = check("--detections", file, "--thresholds", "0.5,0.3").stdout
    lines = [line.split() for line in shown.splitlines()]
    assert lines[0] == ["threshold", "not", "met", "unknown", "met"]
    assert [line[0] for line in lines[1:3]] == ["0.3", "0.5"]
    assert int(lines[1][1]) < int(lines[2][1])
    assert "cells:" in shown
    assert "must be checked by others" in shown
    rows = list(
        csv.DictReader(
            io.StringIO(check("--detections", file, "--thresholds", "0.5,0.3", "--format", "csv").stdout)
        )
    )
    assert len(rows) == 16
    assert {row["threshold"] for row in rows} == {"0.3", "0.5"}
    both = json.loads(check("--detections", file, "--thresholds", "0.5,0.3", "--json").stdout)
    assert [one["threshold"] for one in both] == [0.3, 0.5]
    assert "expected detections with scores, got none that differ" in check.refused(
        "--detections", file, "--thresholds", "auto"
    )


def test_conditions_classes_and_visibility_are_said_on_the_command_line(
    check: Checked, tmp_path: Path
) -> None:
    rows = ["drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px,visible_share"]
    rows += [f"a,{step / 10},truth,7,tram,380,420,310,345,{0.3 if step < 40 else 1.0}" for step in range(81)]
    file = tmp_path / "tram.csv"
    file.write_text("\n".join(rows) + "\n")
    assert "--classes tram=vehicle" in check.refused("--detections", file)
    given = ("--detections", file, "--classes", "tram=vehicle", "--condition", "by day")
    assert check.cells(*given)["miss", "lead", "by day"]["typical"] == pytest.approx(8.1)
    assert check.cells(*given, "--min-visible", "0.5")["miss", "lead", "by day"]["typical"] == pytest.approx(
        4.1
    )
    assert "expected one of the conditions by day; by night; got 'fog'" in check.refused(
        *given, "--condition", "fog"
    )


def test_coco_is_short_for_truth_and_detections(check: Checked, tmp_path: Path) -> None:
    truth, results = tmp_path / "truth.json", tmp_path / "results.json"
    images = [
        {"id": step, "width": 800, "height": 600, "video_id": 1, "frame_id": step} for step in range(81)
    ]
    boxes = [
        {"id": step, "image_id": step, "category_id": 1, "bbox": [380, 310, 40, 35], "track_id": 7}
        for step in range(81)
    ]
    truth.write_text(
        json.dumps({"images": images, "annotations": boxes, "categories": [{"id": 1, "name": "car"}]})
    )
    results.write_text(json.dumps([{**box, "score": 0.9} for box in boxes if box["id"] not in range(30, 45)]))
    by_coco = check.cells("--coco", truth, results, "--frames-per-s", "10", "--condition", "by night")
    assert by_coco["miss", "lead", "by night"]["typical"] == pytest.approx(1.5)
    files = ("--detections", results, "--truth", truth, "--frames-per-s", "10", "--condition", "by night")
    assert check.cells(*files, "--format", "coco") == by_coco


# Refusals.


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--out", "check.txt"], "ends in .csv, .json, .md or .html"),
        (["--out", "nowhere/check.csv"], "nowhere: no such folder"),
        (["--picture", "check.gif"], "ends in .png, .svg or .pdf"),
        (["--json", "--format", "csv"], "cannot be combined with --format"),
        (["--format", "csv", "--format", "csv"], "csv: expected it once"),
        (["--format", "xml"], "expected one of table, sentences, csv, json, md, html, or of a recording"),
        (["--episodes", "9c01"], "cannot be combined with --episodes"),
        (["--coco", "a.json", "b.json"], "cannot be combined with --detections"),
        (["--gate", "--thresholds", "0.5"], "cannot be combined with --thresholds"),
        (["--thresholds", "low"], "expected 1 to 50 numbers such as 0.3,0.5,0.7, or auto; got 'low'"),
        (["--thresholds", "0.5", "--out", "check.html"], "expected a table, .csv or .json, and no picture"),
        (["--classes", "tram"], "expected CLASS=MEANING"),
        (["--format", "kitti"], "cutin.csv"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(check: Checked, options: list[str], words: str) -> None:
    assert words in check.refused("--detections", RECORDINGS / "cutin.csv", *options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--threshold", "0.3"], "--threshold: requires --detections"),
        (["--truth", "labels"], "--truth: requires --detections"),
        (["--clip", "--episodes", "9c01"], "--clip: requires --detections"),
        (["--images", "pictures"], "--images: requires --detections and a page"),
        (["--gate"], "--gate: requires --detections or --episodes"),
        (["--format", "kitti"], "expected the format of a recording with --detections"),
        (["--format", "html"], "html: requires --detections or --episodes"),
        (["--against", "9c01", "--out", "check.csv"], "--out: cannot be combined with --against"),
        (["--against", "9c01", "--picture", "check.png"], "--picture: cannot be combined with --against"),
    ],
)
def test_options_that_would_do_nothing_are_refused(check: Checked, options: list[str], words: str) -> None:
    assert words in check.refused(*options)
