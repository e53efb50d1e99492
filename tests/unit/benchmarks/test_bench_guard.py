"""The benchmark of guards: training sets, drives that are kept, and what was never seen. Drives are made up here."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.guards import REQUIREMENT, drive_with

from benchmarks import guard as bench_guard
from benchmarks.guard import RANDOM, SETS, GuardBench, baseline_rows
from brink.guard import drives as guard_drives
from brink.guard.choices import Sensor
from brink.guard.drives import Drive, Recorders
from brink.guard.features import ALL_FEATURES
from brink.search.analysis import guard_training
from brink.sim.episode import EpisodeSpec

TRAINING, FRESH = 120, 80


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch, few_trees: None, small_pools: None) -> list[str]:
    """Make drives up: a third is violated, after a second of high speed. Returns the digests of those that ran."""
    ran: list[str] = []

    def record_one(spec: EpisodeSpec) -> Drive:
        ran.append(spec.digest())
        rng = np.random.default_rng(spec.seed)
        violated = rng.random() < 1 / 3
        values = np.where(np.arange(60) >= 30 if violated else np.zeros(60, np.bool_), 8.0, 2.0)
        found = drive_with(
            (values + rng.normal(0.0, 0.5, 60)).tolist(), violated_at_s=5.95 if violated else None, spec=spec
        )
        found.features[:, ALL_FEATURES.index("persons")] = rng.integers(2)
        return found

    monkeypatch.setattr(guard_drives, "record_one", record_one)
    monkeypatch.setattr(guard_training, "TREES", 3)
    monkeypatch.setattr(guard_training, "LEAST_STEPS_OF_A_LEAF", 10)
    monkeypatch.setattr(bench_guard, "TIMED_DRIVES", 1)
    return ran


def measured(folder: Path, *sets: str) -> bench_guard.Measured:
    return GuardBench(
        folder, training=TRAINING, fresh=FRESH, requirement=REQUIREMENT, sets=sets or SETS, processes=1
    ).measure()


@pytest.mark.long("searches with every method of the comparison")
def test_every_training_set_and_sensor_is_judged_on_the_same_fresh_drives(
    made_up: list[str], tmp_path: Path
) -> None:
    found = measured(tmp_path)
    assert [(one.trained_on, one.sensor) for one in found.judged] == [
        (s, sensor) for s in SETS for sensor in Sensor
    ]
    assert len({(one.evaluation.drives, one.evaluation.violations) for one in found.judged}) == 1
    assert {one.drives for one in found.judged} == {TRAINING}
    assert all(one.evaluation.guard.compared.recall > 0.9 for one in found.judged)
    assert [(one.trained_on, one.judged_on) for one in found.unseen] == [
        ("random without them", "unseen roads"),
        (RANDOM, "unseen roads"),
        ("random without them", "unseen behaviours"),
        (RANDOM, "unseen behaviours"),
    ] * 2
    for without, known in zip(found.unseen[::2], found.unseen[1::2], strict=True):
        assert without.drives == known.drives < TRAINING, "both are fitted to equally many drives"
        assert without.evaluation.drives == known.evaluation.drives < FRESH
    rows = {row.what: row for row in found.rows()}
    assert rows["predicted 1.5 s ahead: random, boxes"].met is True
    assert rows["predicted 1.5 s ahead: edge, range"].met is None
    assert rows["ms a step: range"].value > 0.0
    assert json.loads(json.dumps(found.to_json()))["judged"][0]["trained_on"] == RANDOM
    names = [row[0] for row in baseline_rows(found.judged[-1].evaluation)]
    assert names == ["time to collision on boxes", "time to collision on ranges", "always", "never"]
    assert 0 < found.bytes_per_drive < 20_000

    ran = len(made_up)
    again = measured(tmp_path, RANDOM)
    assert len(made_up) == ran, "recorded drives are kept"
    assert again.judged[0].evaluation == found.judged[0].evaluation


def test_an_interrupted_search_goes_on_and_a_changed_one_runs_again(
    made_up: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_guard, "CHUNK", 25)

    def searched() -> list[Drive]:
        bench = GuardBench(tmp_path, training=TRAINING, fresh=0, requirement=REQUIREMENT, processes=1)
        bench._folder.mkdir(parents=True, exist_ok=True)
        with Recorders(1) as recorders:
            return bench._searched(recorders, "MLCSHE")

    whole = [one.digest for one in searched()]
    ran = len(made_up)
    files = sorted(tmp_path.glob("*/mlcshe-*.npz"))
    assert len(files) > 4
    files[-1].unlink()
    assert [one.digest for one in searched()] == whole
    assert 0 < len(made_up) - ran <= 25, "only the missing chunk runs"

    params = {"radius": 0.3, "p_th": 0.1, "mutation_probability": 0.9}
    monkeypatch.setattr(bench_guard, "SEARCHES", {"MLCSHE": ("mlcshe@1", params)})
    other = [one.digest for one in searched()]
    assert other != whole
    assert len(set(other) - set(whole)) <= len(made_up) - ran
