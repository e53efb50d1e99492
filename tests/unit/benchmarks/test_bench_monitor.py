from pathlib import Path

import numpy as np
import pytest

from benchmarks import monitor_accuracy
from benchmarks.monitor_accuracy import MonitorAccuracy, mean_rows
from benchmarks.trials import Record, Records
from brink.search.analysis.choices import Model
from brink.search.analysis.monitor import Answer
from brink.sim.episode import EpisodeSpec


def test_both_models_are_judged_on_the_same_fresh_drives(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[str] = []

    def run(self: Records, specs: list[EpisodeSpec], part: str, progress: object) -> list[Record]:
        asked.extend(spec.digest() for spec in specs)
        curved = [spec.scenario["road_curve"] != "straight" for spec in specs]
        assert len({spec.seed for spec in specs}) == len(specs)
        return [
            Record(
                robustness={"front-gap@1": -1.0 if one else 1.0},
                objectives={},
                features={},
                cpu_s=0,
                wall_s=0,
            )
            for one in curved
        ]

    monkeypatch.setattr(Records, "run", run)
    monkeypatch.setattr(monitor_accuracy, "FRESH_SEED", 77)
    found, evaluation = MonitorAccuracy(tmp_path, drives=120, fresh=150, seeds=(1, 2)).measure()
    assert len(set(asked)) == 150 + 2 * 120
    assert [(one.model, one.seed) for one in found] == [(model, seed) for model in Model for seed in (1, 2)]
    for one in found:
        assert one.metrics.solutions == 150
        assert sum(count for count, _ in one.answers.values()) == 150
        assert list(one.answers) == list(Answer)
        assert one.agreement is not None
        assert 0 <= one.agreement <= 1
    assert found[0].metrics.auroc > 0.95
    rows = {row.what: row for row in mean_rows(found)}
    assert rows["trees: AUROC"].value == pytest.approx(np.mean([one.metrics.auroc for one in found[:2]]))
    assert rows["trees: AUROC"].met
    assert rows["neighbours: AUROC"].met is None
    assert evaluation.model is Model.TREES
