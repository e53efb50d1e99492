"""Intervals of shares that were simulated with replicates of an uncertain model."""

import numpy as np
import pytest

from brink.search.analysis.intervals import replicated_interval
from brink.search.fitness import wilson_interval


@pytest.mark.parametrize(("counts", "of"), [([37], [1000]), ([0] * 20, [100] * 20), ([0, 5], [0, 40])])
def test_with_one_replicate_or_nothing_counted_the_interval_is_wilsons(
    counts: list[int], of: list[int]
) -> None:
    low, high = wilson_interval([sum(counts)], [sum(of)])
    found = replicated_interval(np.array(counts), np.array(of))
    assert found == pytest.approx((low[0], high[0]), rel=1e-3)


def test_more_drives_of_the_same_replicates_do_not_make_the_model_more_certain() -> None:
    shares = np.array([0.02, 0.05, 0.08, 0.11])
    few, many = (
        replicated_interval((shares * drives).round().astype(int), np.full(4, drives))
        for drives in (200, 20_000)
    )
    assert many[1] - many[0] > 0.6 * (few[1] - few[0])
    assert many[0] < 0.03 < 0.10 < many[1]


@pytest.mark.parametrize("spread", [0.0, 0.01, 0.03])
def test_the_interval_covers_the_share_of_which_the_fit_is_an_estimate(spread: float) -> None:
    rng = np.random.default_rng(4)
    true, covered, repetitions = 0.1, 0, 600
    for _ in range(repetitions):
        fit = true + spread * rng.normal()
        replicates = np.clip(fit + spread * rng.normal(size=20), 0.0, 1.0)
        low, high = replicated_interval(rng.binomial(100, replicates), np.full(20, 100))
        covered += low <= true <= high
    assert covered / repetitions >= 0.93
