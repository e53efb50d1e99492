"""Folds that keep together what is alike: near solutions, shared components, and what is shared by chance."""

import numpy as np

from brink.search.analysis.folds import connected, divisions, kinds_of_solutions
from brink.search.space import (
    BoolArray,
    Categorical,
    Component,
    Dormant,
    FloatArray,
    IntArray,
    Real,
    SearchSpace,
)


def driving() -> SearchSpace:
    """Return a space of a scenario and a behaviour that may be dormant."""
    scenario = Component("scenario", tuple(Real(name, 0.0, 1.0) for name in ("speed", "gap", "rain")))
    behaviour = Component(
        "behaviour",
        (Categorical("label", ("null", "car")), Real("x", 0.0, 1.0), Real("y", 0.0, 1.0)),
        (Dormant("label", "null", ("x", "y")),),
    )
    return SearchSpace((scenario, behaviour))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def groups(space: SearchSpace, rows: FloatArray) -> IntArray:
    return connected(kinds_of_solutions(space, rows, rng()))


def verdicts(count: int) -> BoolArray:
    unsafe: BoolArray = np.arange(count) % 3 == 0
    return unsafe


def test_solutions_that_share_a_scenario_are_in_one_group() -> None:
    rows = np.column_stack(
        [np.repeat(rng(7).random((30, 3)), 4, axis=0), np.ones(120), rng(8).random((120, 2))]
    )
    found = groups(driving(), rows)
    assert (found == found[np.arange(120) // 4 * 4]).all()
    assert np.unique(found).size > 20


def test_near_solutions_are_in_one_group_whatever_they_share() -> None:
    space = SearchSpace((Component("plane", (Real("x", 0, 1), Real("y", 0, 1), Real("z", 0, 1))),))
    rows = rng(7).random((100, 3))
    pairs = np.concatenate([rows, np.clip(rows + 1e-3, 0, 1), rows])
    found = groups(space, pairs)
    assert (found[:100] == found[100:200]).all()
    assert (found[:100] == found[200:]).all()
    assert np.unique(found).size > 90, "random solutions are hardly ever joined"


def test_what_independent_draws_share_by_chance_makes_no_solutions_alike() -> None:
    """Half of the random behaviours say nothing, and every scenario is one of a few."""
    weather = Component("scenario", (Categorical("weather", ("dry", "wet", "fog")),))
    space = SearchSpace((weather, driving().components[1]))
    rows = np.array([space.join(space.sample(np.random.default_rng(i))) for i in range(200)])
    assert (rows[:, 1] == 0).sum() > 60
    others = rows[rows[:, 1] > 0]
    assert np.unique(groups(space, others)).size > 0.9 * len(others)
    equal = groups(space, rows)[(rows[:, 0] == 1) & (rows[:, 1] == 0)]
    assert np.unique(equal).size == 1, "equal solutions are one"


def test_connected_solutions_are_divided_by_each_kind() -> None:
    """Every behaviour is joined with several scenarios, as in MLCSHE."""
    draws = rng(7)
    scenarios, behaviours = draws.integers(0, 30, 300), draws.integers(0, 30, 300)
    rows = np.column_stack(
        [draws.random((30, 3))[scenarios], np.ones(300), draws.random((30, 2))[behaviours]]
    )
    kinds = kinds_of_solutions(driving(), rows, rng())
    assert np.unique(connected(kinds)).size == 1
    found = divisions(kinds, verdicts(300), rng(), (10, 5, 3))
    assert len(found) == 9
    assert (np.sum([one.scored for one in found], axis=0) == 1).all(), "every solution is scored once"
    for one in found:
        assert not {*scenarios[one.fitted]} & {*scenarios[one.scored]}
        assert not {*behaviours[one.fitted]} & {*behaviours[one.scored]}


def test_fewer_folds_hold_larger_groups_and_verdicts_are_spread() -> None:
    alone, in_sevens = np.arange(210), np.minimum(np.arange(210), 180)
    assert [len(divisions([kind], verdicts(210), rng(), (10, 5, 3))) for kind in (alone, in_sevens)] == [
        10,
        5,
    ]
    hazards = [verdicts(210)[one.scored].sum() for one in divisions([alone], verdicts(210), rng(), (10,))]
    assert (min(hazards), max(hazards)) == (7, 7)


def test_no_division_leaves_a_model_without_a_verdict() -> None:
    same = np.zeros(30, np.int64)
    assert divisions([same], verdicts(30), rng(), (3,)) == []
    first = np.arange(30) // 10
    assert divisions([first], first == 0, rng(), (3,)) == [], "all that is unsafe is in one fold"
