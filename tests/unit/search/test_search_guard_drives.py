"""What a guard is worth: counts, shares and intervals over drives, on drives made by hand."""

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


def test_prevented_and_caused_violations_are_counted_apart() -> None:
    worth = guard_worth(drives([1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 0, 0, 0]))

    assert (worth.violations_without, worth.violations_with, worth.prevented, worth.caused) == (4, 2, 3, 1)
    assert worth.reduction.value == pytest.approx(0.5)
    assert worth.prevented_share.value == pytest.approx(0.75)
    assert worth.caused_share.value == pytest.approx(0.25)
    assert worth.distance_lost.value == pytest.approx(0.05)
    assert worth.false_alarms_per_h.value == pytest.approx(100.0)
    assert worth.intervention_share.value == pytest.approx(0.25)


def test_plain_shares_have_an_interval_where_nothing_was_found() -> None:
    worth = guard_worth(drives([1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], seed=[1, 2, 1, 2, 1, 2]))

    assert worth.caused_share.value == 0.0
    assert worth.caused_share.low == 0.0
    assert worth.caused_share.high == pytest.approx(0.49, abs=0.01), "Wilson's interval of none of four"
    assert worth.prevented_share.low == pytest.approx(0.34, abs=0.01)


def test_prevented_violations_with_another_one_instead_are_told_apart() -> None:
    worth = guard_worth(drives([1, 1, 1, 0], [0, 0, 1, 0], held=[1, 0, 0, 1]))

    assert (worth.prevented, worth.prevented_entirely) == (2, 1)


def test_a_figure_without_anything_to_divide_by_is_unknown() -> None:
    worth = guard_worth(drives([0, 0], [0, 1]))

    assert worth.reduction == Estimate(value=None, low=None, high=None)
    assert worth.caused_share.value == 0.5


def test_the_unit_is_the_drive_whatever_seed_it_was_drawn_with() -> None:
    before, after = [1] * 60 + [0] * 140, [0] * 30 + [1] * 30 + [0] * 140
    worths = [guard_worth(drives(before, after, seed=seed)) for seed in ([0] * 200, [*range(10)] * 20)]

    assert worths[0].reduction == worths[1].reduction
    assert [one.seeds for one in worths] == [1, 10]


def test_intervals_of_ratios_cover_what_is_drawn() -> None:
    """Ten seeds of 200 drives: a bootstrap over the seeds covers .9 of what it should."""
    draws = np.random.default_rng(3)
    covered = []
    for _ in range(400):
        before = draws.random(2_000) < 0.3
        after = np.where(before, draws.random(2_000) < 0.4, draws.random(2_000) < 0.01)
        found = guard_worth(
            drives(before.astype(int).tolist(), after.astype(int).tolist(), seed=[*range(10)] * 200)
        ).reduction
        assert found.low is not None
        assert found.high is not None
        covered.append(found.low <= 1 - (0.3 * 0.4 + 0.7 * 0.01) / 0.3 <= found.high)
    assert np.mean(covered) >= 0.93


def test_where_nothing_happened_a_ratio_may_still_be_positive() -> None:
    worth = guard_worth(drives([1] * 50 + [0] * 50, [0] * 100, alarms=0))

    assert worth.reduction.value == worth.reduction.high == 1.0
    assert worth.reduction.low == pytest.approx(1 - 3.69 / 50, abs=0.001), "the Poisson limit of none of 50"
    assert worth.false_alarms_per_h.low == 0.0
    assert worth.false_alarms_per_h.high == pytest.approx(3.69 / (50 * 36 / 3600), rel=0.001)


def test_figures_of_a_part_are_those_of_its_drives_alone() -> None:
    every = drives([1, 1, 0, 0], [0, 1, 0, 1])

    part = every.of(np.array([True, False, True, False]))

    assert len(part) == 2
    assert guard_worth(part).reduction.value == 1.0


def test_no_drives_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one drive"):
        guard_worth(drives([], []))


def test_a_single_drive_has_no_interval() -> None:
    worth = guard_worth(drives([1, 0], [0, 0]))

    assert (worth.reduction.low, worth.reduction.high) == (None, None), "one violation"
    assert worth.distance_lost.low is not None
