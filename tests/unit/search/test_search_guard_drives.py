"""What a guard is worth: counts, shares and intervals over seeds, on drives made by hand."""

import numpy as np
import pytest

from brink.search.analysis.guard_drives import Estimate, GuardedDrives, guard_worth


def drives(
    without: list[int],
    after: list[int],
    *,
    seed: list[int] | None = None,
    way_without_m: float = 100.0,
    way_with_m: float = 95.0,
    alarms: int = 1,
    held: list[int] | None = None,
) -> GuardedDrives:
    count = len(without)
    return GuardedDrives(
        seed=np.array([0] * count if seed is None else seed, np.int64),
        violated_without=np.array(without, bool),
        violated_with=np.array(after, bool),
        other_with=np.zeros(count, bool),
        held_with=~np.array(after, bool) if held is None else np.array(held, bool),
        way_without_m=np.full(count, way_without_m),
        way_with_m=np.full(count, way_with_m),
        time_with_s=np.full(count, 36.0),
        alarms=np.full(count, alarms, np.int64),
        intervention_s=np.full(count, 9.0),
    )


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_prevented_and_caused_violations_are_counted_apart() -> None:
    worth = guard_worth(drives([1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 0, 0, 0]), rng())

    assert (worth.violations_without, worth.violations_with, worth.prevented, worth.caused) == (4, 2, 3, 1)
    assert worth.reduction.value == pytest.approx(0.5)
    assert worth.prevented_share.value == pytest.approx(0.75)
    assert worth.caused_share.value == pytest.approx(0.25)
    assert worth.distance_lost.value == pytest.approx(0.05)
    assert worth.false_alarms_per_h.value == pytest.approx(100.0)
    assert worth.intervention_share.value == pytest.approx(0.25)


def test_plain_shares_have_an_interval_where_nothing_was_found() -> None:
    worth = guard_worth(drives([1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], seed=[1, 2, 1, 2, 1, 2]), rng())

    assert worth.caused_share.value == 0.0
    assert worth.caused_share.low == 0.0
    assert worth.caused_share.high == pytest.approx(0.49, abs=0.01), "Wilson's interval of none of four"
    assert worth.prevented_share.low == pytest.approx(0.34, abs=0.01)


def test_prevented_violations_with_another_one_instead_are_told_apart() -> None:
    worth = guard_worth(drives([1, 1, 1, 0], [0, 0, 1, 0], held=[1, 0, 0, 1]), rng())

    assert (worth.prevented, worth.prevented_entirely) == (2, 1)


def test_more_violations_with_the_guard_are_a_negative_reduction() -> None:
    assert guard_worth(drives([1, 0, 0], [1, 1, 1]), rng()).reduction.value == pytest.approx(-2.0)


def test_a_figure_without_anything_to_divide_by_is_unknown() -> None:
    worth = guard_worth(drives([0, 0], [0, 1]), rng())

    assert worth.reduction == Estimate(value=None, low=None, high=None)
    assert worth.caused_share.value == 0.5


def test_one_seed_has_no_interval() -> None:
    worth = guard_worth(drives([1, 0], [0, 0]), rng())

    assert worth.seeds == 1
    assert (worth.reduction.low, worth.reduction.high) == (None, None)


def test_intervals_contain_the_value_and_are_those_of_whole_seeds() -> None:
    seeds = np.repeat(np.arange(10), 20)
    # Half of the seeds prevent everything, the others nothing: between drives of a seed there is no variation.
    after = np.where(seeds % 2 == 0, 0, 1)
    worth = guard_worth(drives([1] * 200, after.tolist(), seed=seeds.tolist()), rng())

    assert worth.reduction.value == pytest.approx(0.5)
    assert worth.reduction.low is not None
    assert worth.reduction.high is not None
    # The share of even seeds among ten draws: a binomial with 95% between 2 and 8.
    assert (worth.reduction.low, worth.reduction.high) == pytest.approx((0.2, 0.8))


def test_figures_of_a_part_are_those_of_its_drives_alone() -> None:
    every = drives([1, 1, 0, 0], [0, 1, 0, 1])

    part = every.of(np.array([True, False, True, False]))

    assert len(part) == 2
    assert guard_worth(part, rng()).reduction.value == 1.0


def test_no_drives_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one drive"):
        guard_worth(drives([], []), rng())
