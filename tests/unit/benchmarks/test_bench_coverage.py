"""`python -m benchmarks coverage`: nominal rates against rates found on synthetic data."""

import numpy as np
import pytest

from benchmarks.coverage import Claim, Coverage, Study, measure, studies

FAST = {
    "tolerance: 100 drives a cell": 24,
    "tolerance: 20,000 drives a cell": 12,
    "tolerance, screened: 10% of the drives that hold leak": 24,
    "dependence: chi-squared test of random solutions": 60,
    "rules: leaf counted elsewhere": 60,
    "guard drive: violations fall, 200 drives": 100,
    "guard judge: 200 random drives": 200,
}
"""Studies that every run of the tests repeats, and how often."""


def rate(claim: Claim, nominal: float, hits: int) -> Coverage:
    return Coverage(name="a study", claim=claim, nominal=nominal, hits=hits, repetitions=1_000)


def test_rates_miss_their_target_only_on_the_wrong_side_and_beyond_chance() -> None:
    assert [rate(Claim.AT_LEAST, 0.9, hits).met for hits in (860, 885, 990)] == [False, True, True]
    assert [rate(Claim.AT_MOST, 0.05, hits).met for hits in (0, 60, 90)] == [True, True, False]
    assert rate(Claim.NONE, 0.0, 500).met is None


def test_what_a_study_finds_depends_on_seed_and_name_alone() -> None:
    def coin(name: str) -> Study:
        return Study(
            name=name,
            claim=Claim.NONE,
            nominal=0.0,
            simulate=lambda rng, repetitions: rng.random(repetitions) < 0.5,
        )

    one, other = coin("one"), coin("other")
    together = {found.name: found.hits for found in measure([one, other], 1_000, 1)}
    (alone,) = measure([other], 1_000, 1)
    assert together == {"one": together["one"], "other": alone.hits}
    assert together["one"] != together["other"]
    assert next(measure([other], 1_000, 2)).hits != alone.hits


def test_a_study_that_loses_repetitions_is_refused() -> None:
    lossy = Study(name="lossy", claim=Claim.NONE, nominal=0.0, simulate=lambda *_: np.ones(3, np.bool_))
    with pytest.raises(ValueError, match="lossy: expected 5 repetitions"):
        list(measure([lossy], 5, 1))


@pytest.mark.parametrize("name", FAST)
def test_a_short_run_agrees_with_the_nominal_rate(name: str) -> None:
    (study,) = [one for one in studies() if one.name == name]
    (found,) = measure([study], FAST[name], 1)
    assert found.met is not False
