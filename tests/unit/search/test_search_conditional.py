"""Parameters that are present only with some choices of another one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink import Study
from brink.python.function import check_call
from brink.search.analysis.dependence import parameter_columns
from brink.search.errors import SpaceError
from brink.search.metric import Metric
from brink.search.operators import offspring
from brink.search.pairs import Steps
from brink.search.shorthand import space_from, space_of
from brink.search.space import FloatArray

DECLARED = {
    "kind": ["cut-in", "brake", "none"],
    "how": {"values": ["late", "early"], "when": {"kind": "cut-in"}},
    "depth": {"min": 1, "max": 5, "when": {"how": ["late"]}},
    "force": {"min": 0.1, "max": 10, "log": True, "when": {"kind": ["cut-in", "brake"]}},
    "gap": (0.0, 40.0, "m"),
}
SPACE = space_of(DECLARED)
COMPONENT = SPACE.components[0]


def drawn(seed: int, count: int = 100) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)])


@given(st.integers(0, 10_000))
@settings(deadline=None)
def test_only_what_is_present_is_drawn_bred_and_written(seed: int) -> None:
    mother, father = drawn(seed, 2)
    rng = np.random.default_rng(seed)
    children = offspring(COMPONENT, mother, father, crossover=0.5, mutation=0.5, rng=rng)
    for row in (mother, father, *children):
        assert SPACE.contains((row,))
        values = COMPONENT.decode(row)
        expected = {"kind", "gap"}
        expected |= {"force"} if values["kind"] != "none" else set()
        expected |= {"how"} if values["kind"] == "cut-in" else set()
        expected |= {"depth"} if values.get("how") == "late" else set()
        assert set(values) == expected
        assert np.array_equal(COMPONENT.encode(values), row)


def test_a_parameter_that_becomes_present_is_drawn_and_one_that_becomes_absent_is_dropped() -> None:
    row = np.array(COMPONENT.encode({"kind": "none", "gap": 1.0}))
    row[0] = 0.0
    assert "force" in COMPONENT.decode(COMPONENT.repair(row, np.random.default_rng(1)))
    row[0] = 2.0
    assert set(COMPONENT.decode(COMPONENT.repair(row, np.random.default_rng(1)))) == {"kind", "gap"}


def test_absence_is_a_category_of_its_own() -> None:
    space = space_of({"kind": ["a", "b"], "x": {"min": 0, "max": 4, "when": {"kind": "b"}}, "y": (0.0, 1.0)})
    (absent,) = space.encode({"parameters": {"kind": "a", "y": 0.5}})
    rows = np.array(
        [absent, *(space.encode({"parameters": {"kind": "b", "x": x, "y": 0.5}})[0] for x in (0.0, 1.0, 4.0))]
    )
    # Half of the distance is the share of differing categories, half the mean difference of the two numbers.
    expected = np.array([[0, 3, 3, 3], [3, 0, 0.25, 1], [3, 0.25, 0, 0.75], [3, 1, 0.75, 0]]) / 4
    assert Metric.of_space(space).between(rows, rows) == pytest.approx(expected)
    assert Steps(space).apart(rows[[0, 0, 1]], rows[[1, 3, 2]]) == pytest.approx(
        expected[[0, 0, 1], [1, 3, 2]]
    )


def test_descriptions_and_tables_know_what_is_absent() -> None:
    assert space_from(SPACE.describe()) == SPACE
    rows = drawn(1)
    active = {column.parameter.name: column.active for column in parameter_columns(SPACE, rows)}
    assert (active["force"] == (rows[:, 0] != 2)).all()
    assert active["gap"].all()
    assert not active["depth"].all()


def test_a_constraint_does_not_apply_where_a_parameter_of_it_is_absent() -> None:
    space = space_of(DECLARED, ["depth < 2"])
    rng = np.random.default_rng(1)
    values = [space.components[0].decode(space.sample(rng)[0]) for _ in range(300)]
    assert max(float(one["depth"]) for one in values if "depth" in one) < 2
    assert sum("depth" not in one for one in values) > 100


@pytest.mark.parametrize("algorithm", ["edge@1", "edge@2", "random@1"])
def test_a_study_gives_only_the_present_parameters(algorithm: str) -> None:
    study = Study(DECLARED, algorithm, simulations=60)
    while trials := study.ask():
        for trial in trials:
            study.tell(trial, trial.values["gap"] - 2.0 * trial.values.get("force", 0.0))
    frame = study.to_pandas()
    assert frame["force"].isna().equals(frame["kind"] == "none")
    assert frame["how"].isna().equals(frame["kind"] != "cut-in")
    study.pairs()


def test_a_function_needs_a_default_for_what_may_be_absent() -> None:
    check_call(lambda kind, gap, how=None, depth=None, force=None: 0.0, SPACE)
    with pytest.raises(SpaceError, match="how"):
        check_call(lambda kind, gap, how, depth, force: 0.0, SPACE)


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        (
            {"min": 0, "max": 1, "when": {"later": "a"}},
            "expected a categorical parameter of the component that comes",
        ),
        ({"min": 0, "max": 1, "when": {"kind": "c"}}, "no such choice; known: a, b"),
        ({"min": 0, "max": 1, "when": "kind"}, "expected when as a parameter with its choices"),
    ],
)
def test_wrong_conditions_are_refused(parameter: object, words: str) -> None:
    with pytest.raises(SpaceError, match=words):
        space_of({"kind": ["a", "b"], "x": parameter, "later": ["a", "b"]})


def test_a_value_of_an_absent_parameter_is_refused() -> None:
    with pytest.raises(
        SpaceError, match=r"force: expected no value unless kind is cut-in or brake, got 1\.0"
    ):
        COMPONENT.encode({"kind": "none", "gap": 1.0, "force": 1.0})
