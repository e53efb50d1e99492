"""Brink from Python as people use it: the examples of docstrings, the how-to page, the notebook."""

import doctest
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
FENCED = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("module", ["local", "client", "function", "study"])
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
    assert len(names["result"].to_pandas()) >= 60
    assert len(names["found"].pairs()) >= 3
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
    assert sum("image/png" in data for data in shown) >= 2, "the map and a pair"
    assert any("simulations" in data.get("text/html", "") for data in shown), "the progress"
