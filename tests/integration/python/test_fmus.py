"""Campaigns on FMUs, with real workers."""

import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from support import fmus

import brink
from brink.server.errors import InvalidInput

EXAMPLE = Path(__file__).parents[3] / "examples" / "fmu"

pytest.importorskip("fmpy")
if not (fmus.can_build() and shutil.which("make")):
    pytest.skip("no C compiler, or no make", allow_module_level=True)


@pytest.mark.long("starts a coordinator and workers; the parts are tested alone")
def test_the_example_is_searched_once_it_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXAMPLE, "fmu", ignore=shutil.ignore_patterns("*.fmu", "binaries"))
    path = tmp_path / "fmu" / "campaign.yaml"
    document = yaml.safe_load((EXAMPLE / "follow.yaml").read_text())
    document |= {"algorithm": {"id": "random@1"}, "budget": {"simulations": 24}}
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InvalidInput, match=r"problem.params.fmu: .*follow.fmu cannot be read"):
        brink.run(path, progress=False)
    subprocess.run(["make", "-C", "fmu"], check=True, timeout=300, stdout=subprocess.DEVNULL)
    result = brink.run(path, progress=False, workers=2)
    assert (result.evaluated, result.failed) == (24, 0)
    assert 0 < result.unsafe < 24
