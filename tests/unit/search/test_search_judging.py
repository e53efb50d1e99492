import numpy as np
import pytest

from brink.search.judging import alarms, false_alarms_at, judge


def test_known_answers() -> None:
    probability = np.array([0.1, 0.4, 0.35, 0.8])
    unsafe = np.array([False, False, True, True])
    found = judge(probability, unsafe)
    assert found.auroc == 0.75  # the textbook example of scikit-learn
    assert found.brier == pytest.approx((0.01 + 0.16 + 0.65**2 + 0.04) / 4)
    assert (found.solutions, found.unsafe) == (4, 2)


def test_honest_probabilities_lie_within_their_bins() -> None:
    rng = np.random.default_rng(2)
    probability = rng.random(20_000)
    unsafe = rng.random(20_000) < probability
    found = judge(probability, unsafe, probability - 0.02, probability + 0.02)
    assert sum(one.solutions for one in found.bins) == 20_000
    assert [one.foretold for one in found.bins] == sorted(one.foretold for one in found.bins)
    assert all(one.observed_low <= one.observed <= one.observed_high for one in found.bins)
    assert sum(one.within for one in found.bins) >= 9
    liar = judge(probability**3, unsafe, probability**3, probability**3)
    assert sum(one.within for one in liar.bins) <= 2
    assert liar.auroc == pytest.approx(found.auroc)
    assert liar.brier > found.brier


def test_alarms_trade_missed_hazards_for_false_ones() -> None:
    probability = np.array([0.1, 0.2, 0.2, 0.6, 0.9])
    unsafe = np.array([False, False, True, True, True])
    found = {alarm.probability: (alarm.missed, alarm.false) for alarm in alarms(probability, unsafe)}
    assert found == {
        0.9: (pytest.approx(2 / 3), 0.0), 0.6: (pytest.approx(1 / 3), 0.0), 0.2: (0.0, 0.5), 0.1: (0.0, 1.0),
    }  # fmt: skip
    assert false_alarms_at(alarms(probability, unsafe), 0.0).probability == 0.2
    assert false_alarms_at(alarms(probability, unsafe), 0.4).false == 0.0
    with pytest.raises(ValueError, match="no alarm misses"):
        false_alarms_at(alarms(probability, unsafe, at=[1.0]), 0.1)


def test_one_verdict_alone_judges_nothing() -> None:
    with pytest.raises(ValueError, match="safe and unsafe"):
        judge(np.array([0.2, 0.3]), np.array([True, True]))
    with pytest.raises(ValueError, match="a verdict for each"):
        judge(np.array([0.2, 0.3]), np.array([True]))
