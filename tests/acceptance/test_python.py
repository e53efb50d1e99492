"""Brink from Python as people use it: the examples of docstrings, the how-to page, the notebook."""

import doctest
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import pytest
from nbclient import NotebookClient
from support.marks import mostly_long

import brink
from brink.server.errors import ServerError

ROOT = Path(__file__).parents[2]
FENCED = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(
    "module", mostly_long(["local", "client", "function", "study"], ["local"], "runs campaigns")
)
def test_examples_of_docstrings_run(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(import_module(f"brink.python.{module}"), optionflags=doctest.ELLIPSIS)
    assert tried > 0
    assert failed == 0


@pytest.mark.long("runs a campaign")
def test_the_how_to_page_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    page = (ROOT / "docs" / "how-to" / "use-brink-from-python.md").read_text(encoding="utf-8")
    blocks = FENCED.findall(page)
    assert len(blocks) == 5
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, "use-brink-from-python.md", "exec"), names)
    assert len(names["result"].pairs()) == 8, "as the page says"
    thresholds = names["found"].findings("thresholds")
    assert len(thresholds) == 18, "as the page says"
    assert thresholds["held"][0] == "held: distance 21.31 m, road wet"
    assert names["study"].finished


@pytest.mark.long("runs a notebook with a campaign")
def test_the_notebook_goes_from_nothing_to_a_pair_on_film(tmp_path: Path) -> None:
    notebook = nbformat.read(ROOT / "examples" / "first-campaign.ipynb", as_version=4)  # type: ignore[no-untyped-call]
    client = NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    shown = [output.data for output in outputs if "data" in output]
    assert not [output for output in outputs if output.output_type == "error"]
    assert any("data:video/mp4" in data.get("text/html", "") for data in shown), "the film of a pair"
    assert any("image/png" in data for data in shown), "a pair"
    assert any("data:image/png" in data.get("text/html", "") for data in shown), "the map"
    assert any("simulations" in data.get("text/html", "") for data in shown), "the progress"


SLOW = """
import signal
import time
import brink

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored if the tests run in the background of a shell

def slow(x):
    with open("calls", "a") as calls:
        calls.write("x")
    time.sleep(0.05)
    return x - 0.5

result = brink.search(slow, {"x": (0.0, 1.0)}, algorithm="random@1", simulations=120, workers=1)
print(result.id, result.evaluated)
"""


@pytest.mark.long("starts processes")
def test_an_interrupted_search_goes_on_where_it_was(tmp_path: Path) -> None:
    script = tmp_path / "slow.py"
    script.write_text(SLOW, encoding="utf-8")
    command = [sys.executable, str(script)]
    first = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    calls = tmp_path / "calls"
    try:
        wait_until(lambda: calls.exists() and calls.stat().st_size >= 20, first)
        wait_until(lambda: counts(tmp_path)[1] >= 20, first)
        first.send_signal(signal.SIGINT)
        _, errors = first.communicate(timeout=60)
    finally:
        first.kill()
    assert "KeyboardInterrupt" in errors
    status, stored, campaign = *counts(tmp_path), names(tmp_path)[0]
    assert status == "paused"
    assert 20 <= stored < 120
    again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=True)
    assert again.stdout.split() == [campaign, "120"]
    assert names(tmp_path) == [campaign]


def counts(folder: Path) -> tuple[str, int]:
    """Return the status of the latest campaign of a folder and its number of simulations; 0 before it exists."""
    if not (folder / "brink.db").exists():
        return "", 0
    try:
        (latest, *_) = brink.connect(database=f"{folder}/brink.db").campaigns()
        progress = latest.progress()
    except (ServerError, ValueError):
        return "", 0
    return progress.status.value, progress.simulations


def names(folder: Path) -> list[str]:
    return [campaign.id for campaign in brink.connect(database=f"{folder}/brink.db").campaigns()]


def wait_until(holds: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait for something that a process brings about."""
    deadline = time.monotonic() + 60
    while not holds():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.2)
