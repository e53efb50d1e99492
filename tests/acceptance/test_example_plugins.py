"""The plug-ins of the README run as they are, through coordinator and workers."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from support.marks import mostly_long

from brink.search.testing import check_algorithm, example_spaces

PLUGINS = Path(__file__).parents[2] / "examples" / "plugins"


@pytest.mark.parametrize(
    ("plugin", "simulations"),
    mostly_long(
        [("brake_assist", 120), ("gentle", 60), ("wide_gap", 60), ("edge_walk", 40)], [], "runs a campaign"
    ),
)
def test_example_plugin_runs_as_a_campaign(plugin: str, simulations: int, tmp_path: Path) -> None:
    text = (PLUGINS / f"{plugin}.yaml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("budget:")]
    summary = run_campaign(plugin, [*lines, f"budget: {{simulations: {simulations}}}"], tmp_path)
    assert summary["evaluated"] >= simulations
    assert summary["failed"] == 0


def run_campaign(plugin: str, lines: Sequence[str], folder: Path) -> dict[str, Any]:
    """Run a campaign file with a plug-in, in a process of its own; return the summary."""
    file = folder / "campaign.yaml"
    file.write_text("\n".join(lines), encoding="utf-8")
    command = [
        sys.executable, "-c", "from brink.cli.main import main; main()", "--plugin", plugin, "run", str(file),
        "--database", f"sqlite:///{folder}/brink.db", "--out", str(folder / "out"), "--no-pictures", "--json",
    ]  # fmt: skip
    run = subprocess.run(command, cwd=PLUGINS, capture_output=True, text=True, timeout=240, check=False)
    assert run.returncode == 0, run.stderr
    summary: dict[str, Any] = json.loads(run.stdout)
    return summary


@pytest.mark.long("runs two campaigns, each in a process of its own")
def test_a_campaign_starts_from_an_earlier_one_with_real_workers(tmp_path: Path) -> None:
    lines = [
        "name: brakes", "problem: {id: brake-assist@1}", "algorithm: {id: edge@1}", "budget: {simulations: 60}",
    ]  # fmt: skip
    earlier = run_campaign("brake_assist", [*lines, "seed: 1"], tmp_path)
    start = f"start_from: {{campaign: '{earlier['campaign']}'}}"
    warm = run_campaign("brake_assist", [*lines, "seed: 2", start], tmp_path)
    assert (warm["evaluated"], warm["failed"]) == (60, 0)
    assert warm["digest"] != earlier["digest"]


def test_example_algorithm_keeps_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PLUGINS))
    plugin = __import__("edge_walk")
    for space in example_spaces().values():
        check_algorithm(plugin.EdgeWalk(), space, budget=130)
