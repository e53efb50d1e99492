"""`brink perturbations`: the catalogue as text and JSON, and contact sheets."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from brink.cli import perturbations
from brink.cli.main import main

cv2 = pytest.importorskip("cv2", reason="contact sheets need the vision extra")

Brink = Callable[..., tuple[int, str, str]]


@pytest.fixture
def brink(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Brink:
    """Run `brink perturbations` in a folder of its own; returns status, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["brink", "perturbations", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return run


def test_the_list_names_every_gene_and_counts_the_levels(brink: Brink) -> None:
    status, out, _ = brink("list")
    assert status == 0
    assert "15 genes, 175 levels" in out
    assert "shifted_pixels" in out
    assert "0.5, 0.45 … 0.05" in out


def test_the_list_as_json_has_all_values(brink: Brink) -> None:
    status, out, _ = brink("list", "--json")
    genes = {item["gene"]: item for item in json.loads(out)}
    assert status == 0
    assert sum(item["levels"] for item in genes.values()) == 175
    assert genes["snow"]["values"] == [None, 1.5, 2, 3, 4, 5]
    assert all(len(item["values"]) == item["levels"] and item["effect"] for item in genes.values())


def test_a_sheet_of_ones_own_picture(brink: Brink, tmp_path: Path) -> None:
    cv2.imwrite("mine.jpg", np.full((200, 320, 3), (90, 120, 150), dtype=np.uint8))
    genes = ("--gene", "smoke", "--gene", "rain")
    status, out, _ = brink("show", "--image", "mine.jpg", "--out", "sheet.png", "--tile-width", "80", *genes)
    assert (status, out) == (0, "sheet.png\n")
    sheet = cv2.imread("sheet.png")
    assert 240 < sheet.shape[1] < 300
    assert sheet.shape[0] > 2 * 50


def test_without_a_picture_a_street_is_drawn_and_the_seed_decides(brink: Brink) -> None:
    shown = []
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert brink("show", "--out", f"{name}.png", "--gene", "dirty", "--seed", seed)[0] == 0
        shown.append(Path(f"{name}.png").read_bytes())
    assert shown[0] == shown[1] != shown[2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "sheet.gif"], "--out: sheet.gif: expected a file name that ends in .png or .jpg"),
        (["--out", "gone/sheet.png"], "--out: gone: no such folder"),
        (["--out", "s.png", "--image", "gone.png"], "--image: gone.png: no such file"),
        (["--out", "s.png", "--image", "."], "--image: .: not a file"),
        (["--out", "s.png", "--image", "text.png"], "text.png: expected a picture (PNG, JPEG"),
        (["--out", "s.png", "--gene", "smog"], "--gene: unknown perturbation 'smog'; "),
    ],
)
def test_bad_files_and_names_are_one_line_before_work_begins(
    brink: Brink, arguments: list[str], words: str
) -> None:
    Path("text.png").write_text("no picture")
    status, out, err = brink("show", *arguments)
    assert (status, out) == (1, "")
    (line,) = err.splitlines()
    assert line.startswith(f"brink: {words}")
    assert not Path("s.png").exists()


def test_a_wrong_name_hints_at_the_right_one(brink: Brink) -> None:
    assert "did you mean 'smoke'?" in brink("show", "--out", "s.png", "--gene", "smog")[2]


def test_without_opencv_the_command_says_what_to_install(
    brink: Brink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(perturbations, "find_spec", lambda name: None)
    status, _, err = brink("show", "--out", "s.png")
    assert status == 1
    assert err == (
        "brink: drawing pictures needs OpenCV; install it with: "
        ".venv/bin/pip install -c constraints.txt -e '.[vision]'\n"
    )
    assert brink("list")[0] == 0
