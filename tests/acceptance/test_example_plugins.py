"""The plug-ins of the README run as they are, through coordinator and workers."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import mostly_long

from brink.search.testing import check_algorithm, example_spaces

PLUGINS = Path(__file__).parents[2] / "examples" / "plugins"


@pytest.mark.parametrize(
    ("plugin", "simulations"),
    mostly_long([("brake_assist", 120), ("gentle", 60), ("edge_walk", 40)], [], "runs a campaign"),
)
def test_example_plugin_runs_as_a_campaign(plugin: str, simulations: int, tmp_path: Path) -> None:
    text = (PLUGINS / f"{plugin}.yaml").read_text(encoding="utf-8")
    file = tmp_path / "campaign.yaml"
    lines = [line for line in text.splitlines() if not line.startswith("budget:")]
    file.write_text("\n".join([*lines, f"budget: {{simulations: {simulations}}}"]), encoding="utf-8")
    command = [
        sys.executable, "-c", "from brink.cli.main import main; main()", "--plugin", plugin, "run", str(file),
        "--database", f"sqlite:///{tmp_path}/brink.db", "--out", str(tmp_path / "out"), "--no-pictures", "--json",
    ]  # fmt: skip
    run = subprocess.run(command, cwd=PLUGINS, capture_output=True, text=True, timeout=240, check=False)
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert summary["evaluated"] >= simulations
    assert summary["failed"] == 0


def test_example_algorithm_keeps_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PLUGINS))
    plugin = __import__("edge_walk")
    for space in example_spaces().values():
        check_algorithm(plugin.EdgeWalk(), space, budget=130)
