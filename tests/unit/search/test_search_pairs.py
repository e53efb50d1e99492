"""Steps between the sides of a pair, and the pairs of an archive."""

import numpy as np
import pytest

from brink.search.analysis import pairs as analysis
from brink.search.analysis.pairs import find_pairs
from brink.search.archive import Archive, Neighbourhood
from brink.search.errors import TooManyPairs
from brink.search.pairs import Steps, midpoints
from brink.search.space import (
    BoolArray,
    Categorical,
    Component,
    Extent,
    FloatArray,
    IntArray,
    Integer,
    Real,
    SearchSpace,
)
from brink.search.testing import example_spaces

SPACE = SearchSpace(
    (
        Component(
            "scenario", (Real("gap", 0.0, 100.0, "m"), Integer("cars", 0, 4), Categorical("road", ("a", "b")))
        ),
        Component(
            "behaviour",
            (Real("left", 0.0, 10.0), Real("right", 0.0, 10.0)),
            (Extent(low="left", high="right", minimum=1.0, size=10.0),),
        ),
    )
)
BASE = (50.0, 2.0, 0.0, 3.0, 6.0)


def archive_of(*solutions: tuple[tuple[float, ...], bool]) -> Archive:
    """Return an archive of rows with their verdicts, numbered from 10."""
    rows = np.array([row for row, _ in solutions])
    unsafe = np.array([verdict for _, verdict in solutions])
    empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1, z=1.96))
    return empty.grown(np.arange(10, 10 + len(rows)), rows, unsafe, np.where(unsafe, -1.0, 1.0))


def changed(**values: float) -> tuple[float, ...]:
    names = ("gap", "cars", "road", "left", "right")
    return tuple(values.get(name, value) for name, value in zip(names, BASE, strict=True))


def numbers(archive: Archive, *, eps: float = 0.02, d_th: float = 0.0) -> list[tuple[int, int]]:
    return [(p.safe.number, p.unsafe.number) for p in find_pairs(archive, SPACE, eps=eps, d_th=d_th).pairs]


@pytest.mark.parametrize(
    ("unsafe", "is_pair"),
    [
        (changed(gap=54.0), True),  # 4 m of 100 m, one of four numbers, half the distance: .005
        (changed(gap=90.0), False),
        (changed(road=1.0), True),
        (changed(road=1.0, gap=51.0), False),
        (changed(cars=3.0), True),
        (changed(cars=4.0), False),
        (changed(cars=3.0, gap=51.0), False),
        (changed(left=3.1, right=6.1), True),
        (BASE, False),
    ],
)
def test_a_pair_is_near_or_one_step_apart(unsafe: tuple[float, ...], is_pair: bool) -> None:
    archive = archive_of((BASE, False), (unsafe, True))
    assert numbers(archive) == ([(10, 11)] if is_pair else [])


@pytest.mark.parametrize(
    ("unsafe", "is_categorical"),
    [
        (changed(road=1.0), True),
        (changed(cars=3.0), True),
        (changed(gap=51.0), False),
        (changed(road=1.0, gap=50.1), False),
    ],
)
def test_a_categorical_pair_differs_in_a_category_or_a_step_alone(
    unsafe: tuple[float, ...], is_categorical: bool
) -> None:
    (pair,) = find_pairs(archive_of((BASE, False), (unsafe, True)), SPACE, eps=0.9, d_th=0.0).pairs
    assert pair.is_categorical == is_categorical


def test_the_sides_of_a_box_are_one_unit() -> None:
    archive = archive_of((BASE, False), (changed(left=3.1, right=6.1), True))
    (pair,) = find_pairs(archive, SPACE, eps=0.02, d_th=0.0).pairs
    assert pair.units == ((3, 4),)
    assert pair.distance == pytest.approx(0.5 * 0.02 / 4)


def test_checked_pairs_come_first_and_then_the_tightest() -> None:
    other = changed(road=1.0)
    archive = archive_of(
        (BASE, False),
        (changed(gap=52.0), True),
        (changed(gap=51.0), True),
        (other, False),
        (changed(road=1.0, gap=53.0), True),
        (other, False),
        (changed(road=1.0, gap=53.0), True),
    )
    assert numbers(archive)[:3] == [(13, 14), (10, 12), (10, 11)]
    found = find_pairs(archive, SPACE, eps=0.02, d_th=0.1)
    assert [(p.safe.number, p.checked) for p in found.pairs] == [(13, True), (10, False)]
    assert (found.tight, found.checked, found.safe, found.unsafe) == (3, 1, 2, 3)


def test_a_solution_with_both_verdicts_is_on_neither_side() -> None:
    archive = archive_of((BASE, False), (BASE, True), (changed(gap=51.0), True), (changed(gap=49.0), False))
    found = find_pairs(archive, SPACE, eps=0.02, d_th=0.0)
    assert (found.chancy, [(p.safe.number, p.unsafe.number) for p in found.pairs]) == (1, [(13, 12)])


def test_solutions_that_differ_in_nothing_that_had_a_part_are_no_pair() -> None:
    archive = archive_of((BASE, False), (changed(gap=52.0), True), (changed(cars=3.0), True))
    cars_alone = np.array([False, True, False, False, False])

    def had_part(places: IntArray) -> BoolArray:
        return np.tile(cars_alone, (len(places), 1))

    found = find_pairs(archive, SPACE, eps=0.02, d_th=0.0, had_part=had_part)
    assert [(pair.safe.number, pair.unsafe.number) for pair in found.pairs] == [(10, 12)]
    assert (found.tight, found.without_part) == (1, 1)


def test_a_difference_may_have_had_a_part_in_one_drive_alone() -> None:
    archive = archive_of((BASE, False), (changed(gap=52.0), True))
    part = {0: False, 1: True}
    found = find_pairs(
        archive,
        SPACE,
        eps=0.02,
        d_th=0.0,
        had_part=lambda places: np.array([[part[int(at)]] * 5 for at in places]),
    )
    assert (found.tight, found.without_part) == (1, 0)


def test_the_pairs_are_those_of_a_plain_search() -> None:
    rng, steps = np.random.default_rng(3), Steps(SPACE)
    rows: list[FloatArray] = [SPACE.join(SPACE.sample(rng)) for _ in range(40)]
    rows += [
        SPACE.join(SPACE.repair(SPACE.split(row + rng.normal(0, 0.3, 5)), rng))
        for row in rows
        for _ in range(3)
    ]
    archive = archive_of(*((tuple(row), bool(rng.random() < 0.5)) for row in rows))
    expected = {
        (10 + a, 10 + b)
        for a in np.flatnonzero(~archive.unsafe).tolist()
        for b in np.flatnonzero(archive.unsafe).tolist()
        if steps.is_tight(archive.vectors[a], archive.vectors[b], 0.02)
    }
    assert expected
    assert set(numbers(archive)) == expected

    tight = find_pairs(archive, SPACE, eps=0.02, d_th=0.0).pairs
    by_number = {10 + place: row[None] for place, row in enumerate(archive.vectors)}
    taken: list[tuple[int, int]] = []
    centres: list[FloatArray] = []
    for pair in tight:
        centre = midpoints(by_number[pair.safe.number], by_number[pair.unsafe.number], SPACE)[0]
        if all(steps.distance(centre, other) >= 0.05 for other in centres):
            taken.append((pair.safe.number, pair.unsafe.number))
            centres.append(centre)
    assert 1 < len(taken) < len(tight)
    assert numbers(archive, d_th=0.05) == taken


def test_a_pair_is_checked_by_other_seeds_only() -> None:
    one, other = changed(gap=50.0), changed(gap=51.0)
    archive = archive_of((one, False), (one, False), (other, True), (other, True))

    def found(seeds: list[int] | None) -> analysis.Pair:
        given = None if seeds is None else np.array(seeds)
        (pair,) = find_pairs(archive, SPACE, eps=0.02, d_th=0.0, seeds=given).pairs
        return pair

    same = found([1, 1, 1, 2])
    assert (same.checked, same.safe.evaluated, same.safe.seeds, same.same_seed) == (False, 2, 1, True)
    assert found([1, 2, 3, 3]).checked is False
    different = found([1, 2, 3, 4])
    assert (different.checked, different.same_seed, different.unsafe.seed) == (True, False, 3)
    unknown = found(None)
    assert (unknown.checked, unknown.same_seed, unknown.safe.seed) == (True, False, None)


def test_too_many_pairs_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "MOST_TIGHT", 3)
    archive = archive_of(*((changed(gap=50.0 + place), place % 2 == 0) for place in range(4)))
    with pytest.raises(
        TooManyPairs, match=r"more than 3 pairs of solutions are within eps 0\.02: choose a smaller"
    ) as refused:
        find_pairs(archive, SPACE, eps=0.02, d_th=0.0)
    assert refused.value.setting == "eps"
    assert len(find_pairs(archive, SPACE, eps=0.002, d_th=0.0).pairs) == 3
    monkeypatch.setattr(analysis, "MOST_DISTINCT", 2)
    for d_th in (0.0, 1e-6):
        with pytest.raises(
            TooManyPairs, match=r"more than 2 distinct pairs at d_th .*: choose a larger d_th"
        ) as refused:
            find_pairs(archive, SPACE, eps=0.002, d_th=d_th)
        assert refused.value.setting == "d_th"


@pytest.mark.parametrize("name", ["mixed", "numeric", "categorical", "slots", "traffic"])
def test_a_pair_is_narrowed_in_valid_steps_until_it_is_tight(name: str) -> None:
    space, rng = example_spaces()[name], np.random.default_rng(5)
    steps = Steps(space)
    for _ in range(5):
        safe = space.join(space.sample(rng))
        drawn = space.join(space.sample(rng))
        unsafe = np.where(space.categorical, safe, drawn) if not space.categorical.all() else drawn
        unsafe = space.join(space.repair(space.split(unsafe), rng))
        for _ in range(200):
            middle = steps.between(safe, unsafe, rng)
            if middle is None or steps.is_tight(safe, unsafe, 0.01):
                break
            space.check(space.split(middle))
            assert not np.array_equal(middle, safe)
            assert not np.array_equal(middle, unsafe)
            safe, unsafe = (middle, unsafe) if rng.random() < 0.5 else (safe, middle)
        else:
            pytest.fail("not narrowed in 200 steps")
