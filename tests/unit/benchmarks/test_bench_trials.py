"""Measurements that resume after an interruption."""

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import mumoea, simood, trials
from benchmarks.trials import Record, Records, code_fingerprint
from brink.sim.episode import EpisodeSpec

SPEC = EpisodeSpec(
    simulator="brink-aeb@3",
    scenario={
        "time_of_day": "noon",
        "weather": "clear",
        "occluder": "car",
        "crossing_m": 50.0,
        "arrival_s": 0.0,
        "oncoming_m": 60.0,
        "obstacle": "none",
    },
    behaviour={"mode": "oracle"},
    requirements=("no-collision@1", "no-dangerous-stop@1"),
    seed=1,
    duration_s=1.0,
    options={},
)
SPECS = [replace(SPEC, seed=seed) for seed in range(4)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "records.jsonl"


def test_known_outcomes_are_not_rerun_and_keep_order(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    progress: list[tuple[str, int, int]] = []
    with closing(Records(file, processes=2)) as records:
        first = records.run(SPECS[:3], "drives", lambda *done: progress.append(done))
    assert progress == [("drives", 1, 3), ("drives", 2, 3), ("drives", 3, 3)]
    file.write_text(file.read_text() + '{"spec": "cut off')
    with closing(Records(file, processes=1)) as records:
        again = records.run([*SPECS[::-1], SPECS[0]])
    assert [one.features for one in again[1:4]] == [one.features for one in first[::-1]]
    assert again[-1] is again[3]
    kept = [json.loads(line)["spec"] for line in file.read_text().splitlines() if line.endswith("}")]
    assert sorted(kept) == sorted(spec.digest() for spec in SPECS)

    def never(spec: EpisodeSpec) -> Record:
        raise AssertionError(spec)

    monkeypatch.setattr(trials, "run_record", never)
    with closing(Records(file)) as records:
        assert records.run(SPECS[:3]) == first


def test_the_fingerprint_depends_on_the_code() -> None:
    assert code_fingerprint(["sim/aeb"]) == code_fingerprint(["sim/aeb"])
    assert code_fingerprint(["sim/aeb"]) != code_fingerprint(["sim/aeb", "sim/world"])
    assert code_fingerprint(["sim/aeb"]) != code_fingerprint(["sim/aeb", "sim/requirements.py"])
    assert len(code_fingerprint(["sim/perception"])) == 12


@pytest.mark.parametrize("code", [mumoea.CODE, simood.CODE], ids=["mumoea", "simood"])
def test_code_that_identifies_stored_outcomes_exists(code: tuple[str, ...]) -> None:
    assert len(code_fingerprint(code)) == 12
