"""Measurements that go on where they were interrupted."""

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from brink.sim import trials
from brink.sim.episode import EpisodeSpec
from brink.sim.trials import Record, Records, code_fingerprint, run_record

SPEC = EpisodeSpec(
    simulator="brink-aeb@1",
    scenario={
        "time_of_day": "noon", "weather": "clear", "occluder": "car", "crossing_m": 50.0, "arrival_s": 0.0,
        "oncoming_m": 60.0, "obstacle": "none",
    },
    behaviour={"mode": "oracle"}, requirements=("no-collision@1", "no-dangerous-stop@1"), seed=1, duration_s=1.0,
    options={},
)  # fmt: skip
SPECS = [replace(SPEC, seed=seed) for seed in range(4)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "records.jsonl"


def test_a_record_says_what_came_out() -> None:
    record = run_record(SPEC)
    assert set(record.robustness) == set(SPEC.requirements)
    assert not record.unsafe
    assert record.features["frames"] == 20
    assert 0 < record.cpu_s < 5


def test_nothing_is_run_twice_and_order_is_kept(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[int, int]] = []
    with closing(Records(file, processes=2)) as records:
        first = records.run(SPECS[:3], lambda *done: told.append(done))
    assert told == [(1, 3), (2, 3), (3, 3)]
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


def test_a_cut_line_does_not_spoil_what_is_written_after_it(file: Path) -> None:
    file.parent.mkdir()
    file.write_text('{"spec": "cut off')
    with closing(Records(file, processes=1)) as records:
        records.run(SPECS[:1])
    good = [line for line in file.read_text().splitlines() if line.endswith("}")]
    assert json.loads(good[-1])["spec"] == SPECS[0].digest()


def test_other_code_has_another_fingerprint() -> None:
    assert code_fingerprint(["sim/aeb"]) == code_fingerprint(["sim/aeb"])
    assert code_fingerprint(["sim/aeb"]) != code_fingerprint(["sim/aeb", "sim/world"])
    assert len(code_fingerprint(["sim/perception"])) == 12
