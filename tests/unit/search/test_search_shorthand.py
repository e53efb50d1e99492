"""Search spaces as plain values."""

import numpy as np
import pytest

from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Integer, Real
from brink.search.shorthand import ONLY_COMPONENT, flat_values, space_from, space_of
from brink.search.space import Component, SearchSpace

WRITTEN = {"speed": (5, 30, "m/s"), "share": (0.0, 1.0), "lanes": range(2, 5), "road": ["dry", "wet"]}
PARAMETERS = (
    Real("speed", 5.0, 30.0, "m/s"),
    Real("share", 0.0, 1.0),
    Integer("lanes", 2, 4),
    Categorical("road", ("dry", "wet")),
)


def test_plain_values_stand_for_parameters() -> None:
    expected = SearchSpace((Component(ONLY_COMPONENT, PARAMETERS),))
    assert space_of(WRITTEN) == space_of(PARAMETERS) == space_of(expected) == expected
    assert space_of({one.name: one for one in PARAMETERS}) == expected


def test_mappings_of_mappings_are_components() -> None:
    space = space_of({"scenario": {"road": ["dry", "wet"]}, "behaviour": {"bias": (-1.0, 1.0)}})
    assert [component.name for component in space.components] == ["scenario", "behaviour"]


def test_a_description_is_read_back() -> None:
    space = space_of({"scenario": WRITTEN, "behaviour": {"bias": (-1.0, 1.0)}})
    assert space_from(space.describe()) == space


def test_the_fourth_value_of_a_range_is_its_resolution() -> None:
    space = space_of({"speed": (5.0, 30.0, "m/s", 0.5), "gap": (0.0, 40.0, "m")})
    for read in (space, space_from(space.describe())):
        resolutions, stated = read.resolutions(np.array([10.0, 20.0]))
        assert resolutions.tolist() == [0.5, 0.4]
        assert stated.tolist() == [True, False]


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"x": "wide"}, "x: expected a range such as"),
        ({"x": (True, False)}, "x: expected a range such as"),
        ({"x": (0.0, 1.0, 2.0)}, "x: expected a range such as"),
        ({"x": []}, "x: expected a range such as"),
        ({"x": (0.0, 1.0, "m", 0.0)}, "x: expected a resolution > 0"),
        ({"x": range(0, 9, 2)}, "steps of 1"),
        ({"x": Real("y", 0.0, 1.0)}, "expected a parameter of the same name"),
        ({"a": {"x": (0.0, 1.0)}, "y": (0.0, 1.0)}, "got both"),
        ({"a": {}}, "a: expected at least one parameter"),
        ([1.0, 2.0], "expected a mapping of names"),
    ],
)
def test_anything_else_is_refused(written: object, words: str) -> None:
    with pytest.raises(SpaceError, match=words):
        space_of(written)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "described",
    [
        {},
        {"components": [{"name": "a", "parameters": [{"name": "x", "type": "complex"}]}]},
        {"components": [{"name": "a", "parameters": [{"name": "x", "type": "real", "low": 0}]}]},
        {"components": [{"name": "a", "parameters": [], "constraints": [{"type": "extent"}]}]},
        {"components": "a"},
    ],
)
def test_a_broken_description_is_refused(described: dict[str, object]) -> None:
    with pytest.raises(SpaceError):
        space_from(described)


def test_values_are_flat_where_names_differ() -> None:
    assert flat_values({"a": {"x": 1}, "b": {"y": 2}}) == {"x": 1, "y": 2}
    assert flat_values({"a": {"x": 1}, "b": {"x": 2}}) == {"a.x": 1, "b.x": 2}
