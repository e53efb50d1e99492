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


def test_steps_and_log_scales_are_written_as_values_or_by_name() -> None:
    parameters = (
        Real("gap", 0.0, 10.0, step=0.1),
        Integer("cars", 0, 9, step=3),
        Real("rate", 1e-6, 1.0, "1/s", log=True, resolution=1.1),
        Categorical("lanes", ("2", "3")),
    )
    by_name = {
        "gap": {"min": 0, "max": 10, "step": 0.1},
        "cars": {"min": 0, "max": 9, "step": 3},
        "rate": {"min": 1e-6, "max": 1, "log": True, "unit": "1/s", "resolution": 1.1},
        "lanes": {"values": [2, 3]},
    }
    as_values = {**by_name, "gap": (0, 10, 0.1), "cars": range(0, 11, 3)}
    for written in (by_name, as_values, {"cars": (0, 9, 3), **by_name}):
        space = space_of({name: written[name] for name in by_name})
        assert space.components[0].parameters == parameters
        assert space_from(space.describe()) == space
    assert space_of({"scenario": by_name}).components[0].parameters == parameters


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"x": "wide"}, "x: expected a range such as"),
        ({"x": (True, False)}, "x: expected a range such as"),
        ({"x": (0.0, 1.0, 2.0)}, "x: expected a step > 0 within the range, got 2.0"),
        ({"x": (0, 10, 0.3)}, "whole number of steps of 0.3 from 0 to the largest value, such as 9.6 or 9.9"),
        (
            {"x": {"min": 0, "max": 10, "log": True}},
            "x: expected a real number > 0 for a log scale, got real from 0",
        ),
        (
            {"x": {"min": 1, "max": 10, "step": 1, "log": True}},
            "x: expected a real number > 0|expected a step or",
        ),
        (
            {"x": {"min": 0.1, "max": 1.1, "step": 0.1, "log": True}},
            "expected a step or a log scale, got both",
        ),
        (
            {"x": {"min": 1, "max": 2, "log": True, "resolution": 0.1}},
            "factor > 1 as resolution on a log scale",
        ),
        ({"x": {"min": 0, "max": 1, "scale": "log"}}, "expected values, or min and max and any of log"),
        ({"x": {"min": 0}}, "expected values, or min and max"),
        ({"x": {"min": 0, "max": "1"}}, "expected numbers as min, max"),
        ({"x": {"min": 0, "max": 1, "unit": 2}}, "unit and title as texts"),
        ({"x": []}, "x: expected a range such as"),
        ({"x": (0.0, 1.0, "m", 0.0)}, "x: expected a resolution > 0"),
        ({"x": range(9, 0, -2)}, "ascending"),
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
