"""Constraints written as formulas: what violates them is never drawn, repaired to, or taken."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink import Study
from brink.search.errors import SpaceError
from brink.search.odd import limited, odd_sentence
from brink.search.pairs import Steps
from brink.search.shorthand import space_from, space_of
from brink.search.testing import example_spaces

DECLARED = {
    "scenario": {"gap": (0.0, 60.0, "m"), "speed": (0.0, 90.0, "km/h"), "weather": ["dry", "wet"]},
    "behaviour": {"delay": (0.0, 2.0, "s")},
}
GAP = "gap > 2 * speed / 3.6"
SPACE = space_of(DECLARED, [GAP, "weather == 'dry' or behaviour.delay < 0.5"])
SEEDS = st.integers(0, 10_000)


def meets(row: np.ndarray) -> bool:
    gap, speed, weather, delay = row
    return bool(gap > 2 * speed / 3.6 and (weather == 0 or delay < 0.5))


@given(SEEDS, st.lists(st.floats(-100, 200), min_size=4, max_size=4))
@settings(deadline=None)
def test_draws_and_repairs_meet_all_constraints_and_a_repair_leaves_what_does(
    seed: int, wild: list[float]
) -> None:
    rng = np.random.default_rng(seed)
    for vectors in (SPACE.sample(rng), SPACE.repair(SPACE.split(np.array(wild)), rng)):
        row = SPACE.join(vectors)
        assert meets(row)
        assert SPACE.contains(vectors)
        assert np.array_equal(SPACE.join(SPACE.repair(vectors, rng)), row)


@given(SEEDS)
@settings(deadline=None)
def test_a_repair_moves_no_further_than_to_the_border(seed: int) -> None:
    rng = np.random.default_rng(seed)
    space = space_of({"gap": (0.0, 60.0), "speed": (0.0, 90.0)}, [GAP])
    row = np.array([rng.uniform(0.0, 20.0), rng.uniform(60.0, 90.0)])
    (repaired,) = space.repair((row,), rng)
    gap, speed = repaired
    assert 0 < gap - 2 * speed / 3.6 < 0.1


def test_draws_stay_uniform_among_the_feasible_ones() -> None:
    space = space_of({"x": (0.0, 1.0), "y": (0.0, 1.0)}, ["x + y < 1"])
    rng = np.random.default_rng(1)
    rows = np.array([space.join(space.sample(rng)) for _ in range(3000)])
    assert abs(float((rows.sum(axis=1) < 0.5).mean()) - 0.25) < 0.03


def test_a_description_an_odd_and_a_whole_space_keep_or_drop_them() -> None:
    assert space_from(SPACE.describe()) == SPACE
    within = limited(SPACE, {"scenario.speed": {"min": 60}})
    assert within.constraints == SPACE.constraints
    assert meets(within.join(within.sample(np.random.default_rng(1))))
    assert "meet the constraints were simulated: gap > 2 * speed / 3.6; weather" in odd_sentence(within)
    assert within.unlimited() == space_of(DECLARED)


def test_what_violates_a_constraint_is_refused_by_name() -> None:
    values: dict[str, dict[str, object]] = {
        "scenario": {"gap": 5.0, "speed": 50.0, "weather": "wet"},
        "behaviour": {"delay": 0.1},
    }
    with pytest.raises(SpaceError, match=r"scenario: expected values that meet the constraint gap > 2"):
        SPACE.encode(values)
    values = {"scenario": {"gap": 55.0, "speed": 5.0, "weather": "wet"}, "behaviour": {"delay": 1.0}}
    with pytest.raises(SpaceError, match=r"expected values that meet the constraint weather == 'dry'"):
        SPACE.encode(values)
    assert not SPACE.contains(space_of(DECLARED).encode(values))


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        ("gap >", "cannot be read"),
        ("gap + speed", "expected a comparison, such as"),
        ("gpa > 1", "unknown parameter 'gpa'; did you mean 'gap'"),
        ("weather > 1", "weather is one of dry, wet; compare it with one of these, such as weather == 'dry'"),
        ("weather == 'rain'", "weather is never 'rain'; known: dry, wet"),
        ("gap == 'wide'", "gap is never 'wide'"),
        ("gap > 100", r"none of that many random ones did\. Check the units"),
        ("delay > 3 * gap + 10", "expected at least one solution"),
        (7, "expected a formula"),
        ("__import__('os').system('true') > 1", "not allowed"),
    ],
)
def test_wrong_constraints_are_refused_with_what_to_do(constraint: str, words: str) -> None:
    with pytest.raises(SpaceError, match=words):
        space_of(DECLARED, [constraint])


def test_categories_that_are_numbers_are_calculated_with() -> None:
    space = space_of({"lanes": ["2", "3"], "cars": range(0, 9)}, ["cars <= 2 * lanes"])
    rng = np.random.default_rng(1)
    drawn = [space.decode(space.sample(rng))["parameters"] for _ in range(200)]
    assert max(int(one["cars"]) for one in drawn if one["lanes"] == "2") == 4
    assert max(int(one["cars"]) for one in drawn if one["lanes"] == "3") == 6


def test_two_sides_of_a_hole_are_not_one_step_apart_if_something_lies_between() -> None:
    steps = Steps(space_of({"x": (0.0, 1.0)}, ["x < 0.45 or x > 0.55"]))
    assert not steps.are_one_step_apart(np.array([0.0]), np.array([1.0]))
    assert steps.are_one_step_apart(np.array([0.45]), np.array([0.55]))


def test_a_space_of_which_a_quarter_is_infeasible_is_searched_without_a_failure() -> None:
    sharp = {"checks": 0, "margin": 0.0, "eps": 0.01, "d_th": 0.05}
    space = {"x": (0.0, 1.0), "y": (0.0, 1.0)}
    study = Study(space, simulations=120, params=sharp, constraints=["x < 0.5 or y < 0.5"])
    while trials := study.ask():
        for trial in trials:
            x, y = trial.values["x"], trial.values["y"]
            assert x < 0.5 or y < 0.5
            study.tell(trial, float(x - y + 0.2))
    frame = study.to_pandas()
    assert len(frame) == 120
    assert len(study.pairs(eps=0.02, d_th=0.05)) >= 3


def test_the_example_space_has_constraints_within_and_across_components() -> None:
    space = example_spaces()["declared"]
    assert [len(one.formulas) for one in space.components] == [1, 0]
    assert len(space.formulas) == 1
