"""Evaluation of a guard, with figures counted by hand, and the storage of recorded drives."""

from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from support.guards import REQUIREMENT, drive_with, stump_guard

from brink.guard import fitting
from brink.guard.choices import Sensor
from brink.guard.drives import Drive, check_verdicts, load_drives, save_drives
from brink.guard.evaluation import (
    ALWAYS,
    BOX_TTC,
    LEADS_S,
    NEVER,
    RANGE_TTC_NAME,
    JudgedDrives,
    evaluate,
    threshold_at,
)
from brink.guard.features import ALL_FEATURES, MAX_TTC_S
from brink.guard.time_to_collision import range_times_s
from brink.search.analysis.folds import divisions
from brink.search.analysis.guard_training import FittedHorizons
from brink.search.archive import Archive
from brink.search.fitness import wilson_interval
from brink.search.space import BoolArray, FloatArray, IntArray
from brink.server.errors import Conflict

HIGH, LOW = 8.0, 0.0
"""Speeds for which the stump's probability is above and below its threshold."""


def spell(steps: int, *spans: tuple[int, int]) -> list[float]:
    """Return speeds that are high in some spans of steps."""
    return [HIGH if any(first <= step < end for first, end in spans) else LOW for step in range(steps)]


def safe_and_unsafe() -> list[Drive]:
    return [
        drive_with(spell(100, (30, 60)), violated_at_s=6.0),  # from step 31 on: 2.9 s ahead
        drive_with(spell(100, (48, 60)), violated_at_s=6.0),  # from step 49 on: 1.1 s ahead
        drive_with(spell(100, (60, 100)), violated_at_s=6.0),  # only after the violation
        drive_with(spell(100, (0, 10)), violated_at_s=1.0),  # too early for 1.5 s
        *[drive_with(spell(100, (50, 53))) for _ in range(1)],  # a false alarm
        *[drive_with(spell(100, (50, 51))) for _ in range(5)],  # one step is not confirmed
        *[drive_with(spell(100)) for _ in range(24)],
    ]


def test_warned_violations_and_false_alarms_are_counted_by_drive() -> None:
    found = evaluate(stump_guard(), safe_and_unsafe())
    assert (found.drives, found.violations, found.too_early) == (34, 4, 1)
    own = found.own
    assert own.point.false_alarms == pytest.approx(1 / 30)
    assert dict(zip(LEADS_S, own.point.warned, strict=True)) == pytest.approx(
        {0.0: 0.75, 0.5: 0.75, 1.0: 0.5, 1.5: 0.25, 2.0: 0.25, 3.0: 0.0}
    )
    assert own.recent == 0.25
    assert own.median_lead_s == pytest.approx(1.1)
    assert own.false_per_hour == pytest.approx(1 / (30 * 10 / 3600))
    compared = found.guard.compared
    assert (compared.recall, compared.warned) == (0.25, own.point.warned)
    assert compared.false_alarms == pytest.approx(1 / 30)
    assert found.guard.interval[0] < 0.25 < found.guard.interval[1]


def test_violations_are_predicted_from_when_boxes_arrived() -> None:
    later = [
        replace(
            one,
            begins_s=0.3,
            violated_at_s={name: None if at is None else at + 0.3 for name, at in one.violated_at_s.items()},
        )
        for one in safe_and_unsafe()
    ]
    found, shifted = (evaluate(stump_guard(), drives) for drives in (safe_and_unsafe(), later))
    assert shifted.own == found.own
    assert shifted.predictors == found.predictors
    assert shifted.horizons == found.horizons
    first = drive_with(spell(100, (30, 60)), violated_at_s=6.0, begins_s=0.3)
    own = evaluate(stump_guard(), [first, *safe_and_unsafe()[1:]]).own
    assert own.median_lead_s == pytest.approx(1.1)
    alone = evaluate(stump_guard(), [first, first, *safe_and_unsafe()[4:]]).own
    assert alone.median_lead_s == pytest.approx(2.9 - 0.3)


def test_the_threshold_is_set_on_the_probability_that_decides_in_the_car(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drives = safe_and_unsafe()
    stump = stump_guard()
    # The shortest horizon has the highest score: its probability is that of the longest one, too.
    fitted = FittedHorizons(
        forest=stump.forest,
        calibration=stump.calibration,
        unseen=tuple(np.tile([3.0, -2.0, -2.0], (len(one.features), 1)) for one in drives),
    )
    monkeypatch.setattr(fitting, "fit_horizons", lambda *_: fitted)
    found = fitting.fit(drives, [REQUIREMENT], false_alarms=0.0)
    assert found.alarm.threshold == pytest.approx(1 / (1 + np.exp(-3.0)))


def test_baselines_are_the_time_to_collision_always_and_never() -> None:
    def drive(values: list[float], violated_at_s: float | None = None) -> Drive:
        return drive_with(values, feature="ttc_s", violated_at_s=violated_at_s)

    found = evaluate(
        stump_guard(),
        [
            drive([10.0] * 20 + [1.0] * 20, 4.0),
            drive([10.0] * 40, 4.0),
            *[drive([5.0] * 40) for _ in range(20)],
        ],
    )
    assert [one.name for one in found.predictors[1:]] == [BOX_TTC, ALWAYS, NEVER]
    box, always, never = found.predictors[1:]
    assert (box.compared.recall, box.compared.false_alarms) == (0.5, 0.0)
    assert (always.points[-1].recall, always.points[-1].false_alarms) == (1.0, 1.0)
    assert always.compared.recall == never.compared.recall == 0.0
    assert never.points[0].false_alarms == 0.0
    ranges = evaluate(stump_guard(sensor=Sensor.RANGE), safe_and_unsafe())
    assert RANGE_TTC_NAME in [one.name for one in ranges.predictors]


def test_a_threshold_is_the_lowest_that_few_safe_drives_reach() -> None:
    peaks = np.arange(100) / 100.0
    threshold = threshold_at(peaks, 0.05)
    assert (peaks >= threshold).sum() == 5
    assert (peaks >= np.nextafter(threshold, 0.0)).sum() == 6
    assert threshold_at(peaks, 0.0) > 0.99
    assert threshold_at(np.ones(10), 0.05) > 1.0


def judged(violated: BoolArray, *kinds: IntArray) -> JudgedDrives:
    given = kinds or (np.arange(violated.size),)
    return JudgedDrives(violated=violated, kinds=given, parts=divisions(given, violated, rng(), (10, 5, 3)))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def strengths(scores: FloatArray) -> FloatArray:
    return np.tile(scores[:, None], len(LEADS_S))


def test_a_drive_is_judged_with_a_threshold_that_it_had_no_part_in_choosing() -> None:
    """Each part has one safe drive with a high score: on the same drives, none of ten would have an alarm."""
    violated = np.arange(200) >= 100
    scores = np.where(violated, 0.5, np.arange(200) / 1000.0)
    point, _ = judged(violated).warnings(strengths(scores), 0.05)
    same = float((scores[~violated] >= threshold_at(scores[~violated], 0.05)).mean())
    assert same == 0.05
    assert point.recall == 1.0
    assert 0.03 <= point.false_alarms <= 0.08
    twice = judged(np.tile(violated, 2), np.tile(np.arange(200), 2))
    for part in twice.parts:
        assert not {*(np.flatnonzero(part.fitted) % 200)} & {*(np.flatnonzero(part.scored) % 200)}


def test_the_interval_of_a_recall_includes_how_uncertain_the_threshold_is() -> None:
    """Wilson's interval at the threshold of the same drives covers .81."""
    covered = []
    truth = 1 - NormalDist(1.5).cdf(NormalDist().inv_cdf(0.95))
    for seed in range(200):
        draws = rng(seed)
        violated = draws.random(500) < 0.3
        _, (low, high) = judged(violated).warnings(strengths(draws.normal(1.5 * violated)), 0.05)
        covered.append(low <= truth <= high)
    assert np.mean(covered) >= 0.92


def test_drives_of_a_scenario_count_as_fewer() -> None:
    violated = np.arange(240) % 3 == 0
    hits = np.arange(240) // 24 % 2 == 0  # all or none of a scenario
    own, shared = judged(violated), judged(violated, np.arange(240) // 24)
    (share, (low, high)), (same, (lower, higher)) = own.share(hits, violated), shared.share(hits, violated)
    assert share == same == 0.5
    assert (low, high) == pytest.approx(tuple(float(x) for x in wilson_interval(40, 80)), abs=1e-3)
    assert (lower, higher) == pytest.approx((0.17, 0.83), abs=0.03), "ten scenarios, and Student's t"


def test_drives_of_one_verdict_or_without_the_requirement_are_refused() -> None:
    with pytest.raises(Conflict, match="got 0 of 3"):
        evaluate(stump_guard(), [drive_with([0.0] * 10) for _ in range(3)])
    model = stump_guard()
    object.__setattr__(model, "requirements", ("no-collision@1",))
    with pytest.raises(Conflict, match=r"no-collision@1 was not evaluated.*front-gap@1"):
        evaluate(model, safe_and_unsafe())


def test_a_series_ends_before_the_first_violation() -> None:
    series = drive_with([1.0] * 50, violated_at_s=2.05).series((REQUIREMENT,), 4)
    assert series.features.shape == (21, 4)
    assert series.until_s[[0, -1]] == pytest.approx([2.05, 0.05])
    assert series.violated
    late = drive_with([1.0] * 50, violated_at_s=2.05, begins_s=0.1).series((REQUIREMENT,), 4)
    assert len(late.until_s) == 20
    assert late.until_s[[0, -1]] == pytest.approx([1.95, 0.05])
    held = drive_with([1.0] * 50).series((REQUIREMENT,), 4)
    assert (len(held.until_s), held.violated) == (50, False)


def test_stored_drives_are_read_again_and_damaged_files_are_not(tmp_path: Path) -> None:
    file, given = tmp_path / "drives.npz", [replace(one, begins_s=0.1) for one in safe_and_unsafe()[:5]]
    save_drives(file, given)
    for old, new in zip(given, load_drives(file) or [], strict=True):
        assert (old.digest, old.scenario, old.ended_at_s) == (new.digest, new.scenario, new.ended_at_s)
        assert new.begins_s == 0.1
        assert (dict(old.violated_at_s), dict(old.robustness)) == (
            dict(new.violated_at_s),
            dict(new.robustness),
        )
        assert (old.features == new.features).all()
        assert new.features.dtype == np.float16
    assert load_drives(tmp_path / "missing.npz") is None
    file.write_bytes(file.read_bytes()[:200])
    assert load_drives(file) is None


def test_drives_that_end_differently_are_reported() -> None:
    drives = [drive_with([0.0], violated_at_s=None) for _ in range(100)]
    archive = SimpleNamespace(numbers=np.arange(100), unsafe=np.zeros(100, np.bool_))
    archive.unsafe[:2] = True
    check_verdicts(drives, (REQUIREMENT,), cast(Archive, archive), "campaign x")
    archive.unsafe[7] = True
    with pytest.raises(Conflict, match=r"3 of 100 drives of campaign x end differently.*solutions 0, 1, 7"):
        check_verdicts(drives, (REQUIREMENT,), cast(Archive, archive), "campaign x")


def test_baselines_confirm_alarms_as_the_guard_does() -> None:
    def drive(values: list[float], violated_at_s: float | None = None) -> Drive:
        return drive_with(values, feature="ttc_s", violated_at_s=violated_at_s)

    noisy = [10.0] * 10 + [0.5] + [10.0] * 29
    found = evaluate(
        stump_guard(), [drive([10.0] * 20 + [1.0] * 20, 4.0)] * 2 + [drive(noisy) for _ in range(10)]
    )
    box = found.predictors[1]
    assert (box.compared.recall, box.compared.false_alarms) == (1.0, 0.0)


def test_the_baseline_on_ranges_is_the_time_to_collision_of_range_ttc() -> None:
    """It is to two metres before contact: 12 m at 5 m/s are two seconds."""
    features = np.zeros((4, len(ALL_FEATURES)), np.float16)
    path, closing = (ALL_FEATURES.index(name) for name in ("range_path_m", "range_path_closing_mps"))
    features[:, path] = 12.0, 1.0, 60.0, 12.0
    features[:, closing] = 5.0, -1.0, 0.0, 0.25
    assert range_times_s(features).tolist() == [2.0, 0.0, MAX_TTC_S, MAX_TTC_S]

    def drive(distances_m: list[float], violated_at_s: float | None = None) -> Drive:
        found = drive_with(distances_m, feature="range_path_m", violated_at_s=violated_at_s)
        found.features[:, closing] = 1.0
        return found

    # Two metres are kept: 2.5 m are half a second away, and 4 m are two.
    drives = [drive([60.0] * 20 + [2.5] * 20, 4.0)] * 2 + [drive([4.0] * 40) for _ in range(30)]
    ranges = evaluate(stump_guard(sensor=Sensor.RANGE), drives).predictors[2]
    assert (ranges.name, ranges.compared.recall, ranges.compared.false_alarms) == (RANGE_TTC_NAME, 1.0, 0.0)
    assert -2.0 < ranges.compared.threshold <= -0.5
