"""Parameters, constraints, components and spaces: sampling, repair, encoding and validation."""

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from brink.search.errors import SpaceError
from brink.search.parameters import ResolutionByChoice
from brink.search.slots import Slots
from brink.search.space import (
    Categorical,
    Component,
    Constraint,
    Dormant,
    Duration,
    Extent,
    Integer,
    Parameter,
    Real,
    SearchSpace,
)
from brink.search.testing import example_spaces

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())
SPACE = example_spaces()["mixed"]
BEHAVIOUR = SPACE.components[1]
ANY_NUMBER = st.floats(allow_nan=True, allow_infinity=True, width=64) | st.floats(-900, 900)


@st.composite
def components(draw: st.DrawFn) -> Component:
    """Draw components with real or integer pairs, some dormant, and a few free parameters."""
    parameters: list[Parameter] = [
        Real("free", -3.0, 5.0),
        Integer("count", -2, 9),
        Categorical("kind", ("a", "b", "c")),
    ]
    constraints: list[Constraint | Dormant] = []
    members: list[str] = []
    for index in range(draw(st.integers(0, 3))):
        names = f"low_{index}", f"high_{index}"
        size = draw(st.integers(2, 1000))
        share = draw(st.floats(0.001, 1.0))
        whole = draw(st.booleans())
        parameters += [Integer(name, 0, size) if whole else Real(name, 0.0, float(size)) for name in names]
        constraints.append(
            Extent(*names, share * size, size)
            if draw(st.booleans())
            else Duration(*names, share * size, size)
        )
        members.extend(names)
    sleeps = draw(st.booleans())
    if members and sleeps:
        parameters.append(Categorical("label", ("null", "some", "other")))
        dormant = Dormant("label", "null", tuple(members))
        constraints.insert(draw(st.integers(0, len(constraints))), dormant)
    return Component("part", tuple(parameters), tuple(constraints))


@given(component=components(), data=st.data(), seed=st.integers(0, 1000))
@settings(max_examples=200, deadline=None)
def test_a_repaired_vector_is_valid_and_stays(component: Component, data: st.DataObject, seed: int) -> None:
    dimension = component.dimension
    vector = np.array(data.draw(st.lists(ANY_NUMBER, min_size=dimension, max_size=dimension)))
    before = vector.copy()
    repaired = component.repair(vector, np.random.default_rng(seed))
    assert np.array_equal(vector, before, equal_nan=True)
    assert list(component.problems(repaired)) == []
    assert not repaired.flags.writeable
    again = component.repair(repaired, np.random.default_rng(seed + 1))
    assert again.tobytes() == repaired.tobytes()


@given(component=components(), seed=st.integers(0, 1000))
@settings(max_examples=100, deadline=None)
def test_samples_are_valid_and_survive_encoding(component: Component, seed: int) -> None:
    vector = component.sample(np.random.default_rng(seed))
    assert list(component.problems(vector)) == []
    written = json.loads(json.dumps(component.decode(vector)))
    assert component.encode(written).tobytes() == vector.tobytes()


@pytest.mark.parametrize("row", ORACLE["box_repair"])
def test_box_repair_matches_the_known_answers(row: dict[str, list[float]]) -> None:
    box = Component(
        "box",
        (
            Real("x_min", 0.0, 800.0, "px"),
            Real("x_max", 0.0, 800.0, "px"),
            Real("y_min", 0.0, 480.0, "px"),
            Real("y_max", 0.0, 480.0, "px"),
        ),
        (Extent("x_min", "x_max", 50.0, 800.0), Extent("y_min", "y_max", 50.0, 480.0)),
    )
    repaired = box.repair(np.array(row["inp"]), np.random.default_rng(0))
    assert repaired.tolist() == pytest.approx(row["out"], rel=0, abs=1e-9)


@pytest.mark.parametrize(
    ("given_times", "expected"),
    [
        ((100.0, 400.0), (100.0, 400.0)),
        ((400.0, 100.0), (100.0, 400.0)),
        ((100.0, 120.0), (100.0, 150.0)),
        ((120.0, 100.0), (100.0, 150.0)),
        ((880.0, 890.0), (840.0, 890.0)),
        ((-50.0, 1000.0), (0.0, 900.0)),
        ((1000.0, 950.0), (850.0, 900.0)),
        ((33.4, 60.6), (33.0, 83.0)),
    ],
)
def test_repaired_times_are_in_order_inside_the_horizon_and_apart(
    given_times: tuple[float, float], expected: tuple[float, float]
) -> None:
    span = Component(
        "span",
        (Integer("start", 0, 900, "step"), Integer("end", 0, 900, "step")),
        (Duration("start", "end", 50, 900),),
    )
    assert tuple(span.repair(np.array(given_times), np.random.default_rng(0))) == expected


def test_minimum_duration_is_rounded_up_for_integer_times() -> None:
    span = Component(
        "span", (Integer("start", 0, 100), Integer("end", 0, 100)), (Duration("start", "end", 100 / 18, 100),)
    )
    assert span.repair(np.array([10.0, 10.0]), np.random.default_rng(0)).tolist() == [10.0, 16.0]


def test_minimum_extent_above_half_the_frame_still_fits() -> None:
    axis = Component(
        "axis", (Real("low", 0.0, 10.0), Real("high", 0.0, 10.0)), (Extent("low", "high", 8.0, 10.0),)
    )
    assert axis.repair(np.array([3.0, 5.0]), np.random.default_rng(0)).tolist() == [0.0, 8.0]


def test_null_label_sets_its_numbers_to_zero() -> None:
    vector = np.array([0.0, 10.0, 80.0, 100.0, 300.0, 1.5])
    assert BEHAVIOUR.repair(vector, np.random.default_rng(0)).tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 1.5]


def test_reactivated_block_gets_fresh_numbers() -> None:
    vector = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    active = [BEHAVIOUR.repair(vector, np.random.default_rng(seed)) for seed in range(50)]
    assert len({row.tobytes() for row in active}) == 50
    for row in active:
        assert list(BEHAVIOUR.problems(row)) == []
        assert row[0] == 2.0
        assert row[5] == 1.5
    # Half of the uniform ends are in the wrong order; they become boxes of the smallest width.
    widths = np.array([row[4] - row[3] for row in active])
    assert 15 < np.count_nonzero(widths <= 50.0) < 40


def test_active_block_of_integers_is_never_all_zeros() -> None:
    block = Component(
        "block",
        (Categorical("label", ("off", "on")), Integer("a", 0, 1), Integer("b", 0, 1)),
        (Dormant("label", "off", ("a", "b")),),
    )
    rows = [block.sample(np.random.default_rng(seed)) for seed in range(200)]
    assert {tuple(row) for row in rows} == {(0, 0, 0), (1, 0, 1), (1, 1, 0), (1, 1, 1)}


def test_repair_of_a_valid_vector_draws_no_random_numbers() -> None:
    vector = BEHAVIOUR.sample(np.random.default_rng(4))
    rng = np.random.default_rng(5)
    BEHAVIOUR.repair(vector, rng)
    assert rng.random() == np.random.default_rng(5).random()


def test_negative_zero_becomes_zero_so_that_equal_solutions_have_equal_bytes() -> None:
    free = Component("free", (Real("x", -1.0, 1.0),))
    assert free.repair(np.array([-0.0]), np.random.default_rng(0)).tobytes() == np.zeros(1).tobytes()
    assert free.encode({"x": -0.0}).tobytes() == np.zeros(1).tobytes()


def test_splitting_a_joined_row_gives_the_same_vectors() -> None:
    vectors = SPACE.sample(np.random.default_rng(0))
    row = SPACE.join(vectors)
    assert [part.tolist() for part in SPACE.split(row)] == [vector.tolist() for vector in vectors]
    assert SPACE.dimension == 8
    assert SPACE.slices == (slice(0, 2), slice(2, 8))
    assert SPACE.categorical.tolist() == [True, False, True, False, False, False, False, False]
    assert SPACE.ranges.tolist() == [1, 4, 1, 90, 90, 800, 800, 2]
    assert SPACE.column_names()[:3] == ("scenario.weather", "scenario.cars", "behaviour.label")


def valid() -> dict[str, dict[str, object]]:
    return {
        "scenario": {"weather": "wet", "cars": 2},
        "behaviour": {"label": "car", "start": 3, "end": 80, "left": 10.5, "right": 200, "delay": 0},
    }


def test_encoding_then_decoding_gives_the_same_values() -> None:
    assert SPACE.decode(SPACE.encode(valid())) == valid()


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (
            ("scenario", "weather"),
            "wett",
            r"scenario\.weather: expected one of dry, wet, fog, got 'wett'; did you mean 'wet'",
        ),
        (("scenario", "cars"), 5, r"scenario\.cars: expected a whole number in \[0, 4\], got 5"),
        (("scenario", "cars"), 1.5, r"scenario\.cars: expected a whole number"),
        (("scenario", "cars"), True, r"scenario\.cars: expected a number, got True"),
        (("scenario", "car"), 1, r"scenario\.car: unknown parameter; did you mean 'cars'"),
        (("behaviour", "delay"), math.nan, r"behaviour\.delay: expected a number in \[0, 2\]"),
        (("behaviour", "delay"), 10**400, r"behaviour\.delay: expected a number that a float can hold"),
        (("behaviour", "delay"), "late", r"behaviour\.delay: expected a number, got 'late'"),
        (("behaviour", "right"), 20, r"behaviour\.left: expected right at least 50 above left"),
        (("behaviour", "end"), 6, r"behaviour\.start: expected end at least 5 above start"),
        (("behaviour", "label"), "none", r"behaviour\.start: expected 0 while its block is dormant"),
    ],
)
def test_invalid_values_are_named_with_path(path: tuple[str, str], value: object, message: str) -> None:
    values = valid()
    values[path[0]][path[1]] = value
    with pytest.raises(SpaceError, match=message):
        SPACE.encode(values)


def test_missing_and_unknown_components_and_parameters_are_named() -> None:
    values = valid()
    del values["behaviour"]["delay"]
    with pytest.raises(SpaceError, match=r"behaviour\.delay: missing"):
        SPACE.encode(values)
    with pytest.raises(SpaceError, match="behaviour: missing component"):
        SPACE.encode({"scenario": valid()["scenario"]})
    with pytest.raises(SpaceError, match="behaviour: expected an object of its parameters by name, got 3"):
        SPACE.encode({**valid(), "behaviour": 3})  # type: ignore[dict-item]
    with pytest.raises(SpaceError, match="scenari: unknown component; did you mean 'scenario'"):
        SPACE.encode({**valid(), "scenari": {}})


@pytest.mark.parametrize(
    ("vectors", "message"),
    [
        ([[0.0, 0.0]], r"expected 2 vectors \(scenario, behaviour\), got 1"),
        ([[0.0], [0.0] * 6], "scenario: expected a vector of 2 numbers"),
        ([[3.0, 0.0], [0.0] * 6], r"scenario\.weather: expected the index of one of 3 choices"),
        ([[0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 9.0]], r"behaviour\.delay: expected a number"),
        (
            [[0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]],
            r"behaviour\.label: expected numbers for an active block",
        ),
        ([[0.0, math.nan], [0.0] * 6], r"scenario\.cars: expected a whole number"),
    ],
)
def test_invalid_solutions_are_rejected(vectors: Sequence[Sequence[float]], message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        SPACE.check([np.array(vector) for vector in vectors])


PAIR = (Real("a", 0.0, 10.0), Real("b", 0.0, 10.0))


@pytest.mark.parametrize(
    ("parameters", "constraints", "message"),
    [
        ((), (), "at least one parameter"),
        ((PAIR[0], PAIR[0]), (), "distinct parameter names"),
        (PAIR, (Extent("a", "c", 1.0, 10.0),), "unknown parameter 'c'"),
        (PAIR, (Extent("a", "a", 1.0, 10.0),), "two different parameters"),
        (PAIR, (Extent("a", "b", 1.0, 20.0),), r"expected a in \[0, 20\]"),
        ((PAIR[0], Integer("b", 0, 10)), (Extent("a", "b", 1.0, 10.0),), "both real or both integer"),
        (PAIR, (Extent("a", "b", 0.0, 10.0),), r"a minimum in \(0, 10\]"),
        (PAIR, (Duration("a", "b", 11.0, 10.0),), r"a minimum in \(0, 10\]"),
        (PAIR, (Extent("a", "b", 1.0, 10.0), Duration("b", "a", 1.0, 10.0)), "more than one constraint"),
        ((*PAIR, Categorical("c", ("x",))), (Extent("a", "c", 1.0, 10.0),), "got a categorical"),
        (PAIR, (Dormant("a", "x", ("b",)),), "expected the label 'a' to be a categorical"),
        ((*PAIR, Categorical("c", ("x",))), (Dormant("c", "y", ("a",)),), "no choice 'y'"),
        ((*PAIR, Categorical("c", ("x",))), (Dormant("c", "x", ()),), "distinct members"),
        (
            (Real("a", 1.0, 2.0), Categorical("c", ("x",))),
            (Dormant("c", "x", ("a",)),),
            "0 in the range of a",
        ),
        (
            (*PAIR, Categorical("c", ("x",))),
            (Dormant("c", "x", ("a",)), Dormant("c", "x", ("a", "b"))),
            "more than one dormant block",
        ),
    ],
)
def test_inconsistent_components_are_rejected(
    parameters: tuple[Parameter, ...], constraints: tuple[Constraint | Dormant, ...], message: str
) -> None:
    with pytest.raises(SpaceError, match=message):
        Component("part", parameters, constraints)


@pytest.mark.parametrize(
    ("low", "high", "sigma"), [(1.0, 1.0, None), (2.0, 1.0, None), (0.0, math.inf, None), (0.0, 1.0, 0.0)]
)
def test_numbers_without_a_valid_range_are_rejected(low: float, high: float, sigma: float | None) -> None:
    with pytest.raises(SpaceError):
        Real("x", low, high, sigma=sigma)


def test_unusable_names_and_choices_are_rejected() -> None:
    with pytest.raises(SpaceError, match="expected a name"):
        Real("two words", 0.0, 1.0)
    with pytest.raises(SpaceError, match="distinct choices"):
        Categorical("c", ("a", "a"))
    with pytest.raises(SpaceError, match="named choices"):
        Categorical("c", ())
    with pytest.raises(SpaceError, match="integer bounds"):
        Integer("i", 0, 2**60)
    part = Component("part", PAIR)
    with pytest.raises(SpaceError, match="distinct names"):
        SearchSpace((part, part))


TECHNIQUES = ("noise", "blur", "rain")
SLOTS = Slots((("gene_1", "intensity_1"), ("gene_2", "intensity_2")), (3, 6, 11))
SLOTTED = Component(
    "perturbation",
    (
        Categorical("gene_1", TECHNIQUES),
        Real("intensity_1", 0.0, 1.0),
        Categorical("gene_2", TECHNIQUES),
        Real("intensity_2", 0.0, 1.0),
    ),
    (SLOTS,),
)


@given(
    arrays(np.float64, 4, elements=st.floats(allow_nan=True, allow_infinity=True, width=64)),
    st.integers(0, 2**32 - 1),
)
def test_repaired_slots_are_valid_and_repair_is_idempotent(vector: NDArray[np.float64], seed: int) -> None:
    rng = np.random.default_rng(seed)
    repaired = SLOTTED.repair(vector, rng)
    assert list(SLOTTED.problems(repaired)) == []
    assert np.array_equal(SLOTTED.repair(repaired, rng), repaired)


def test_intensities_are_rounded_to_the_nearest_level() -> None:
    rng = np.random.default_rng(0)
    repaired = SLOTTED.repair(np.array([1.0, 0.29, 2.0, 0.04]), rng)
    assert repaired.tolist() == [1.0, 1 / 5, 2.0, 0.0]
    assert SLOTTED.repair(np.array([0.0, 7.0, 1.0, -3.0]), rng).tolist() == [0.0, 1.0, 1.0, 0.0]


def test_a_repeated_technique_is_replaced_in_the_later_slot() -> None:
    repaired = SLOTTED.repair(np.array([2.0, 1.0, 2.0, 1.0]), np.random.default_rng(0))
    assert repaired.tolist() == [2.0, 1.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("vector", "problem"),
    [
        ([1.0, 0.2, 1.0, 0.4], "different techniques"),
        ([1.0, 0.25, 2.0, 0.4], "intensity_1 on a level, the nearest is 0.2"),
        ([1.0, 0.2, 2.0, 0.01], "intensity_2 on a level, the nearest is 0.0"),
    ],
)
def test_invalid_slots_are_named(vector: list[float], problem: str) -> None:
    assert problem in next(iter(SLOTTED.problems(np.array(vector))))


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        (Slots((), (3, 6, 11)), "1 to 3 slots"),
        (Slots((("gene_1", "intensity_1"),), (3, 6)), "categorical with 2 choices"),
        (Slots((("gene_1", "intensity_1"),), (3, 6, 1)), "at least 2 levels"),
        (Slots((("gene_1", "count"),), (3, 6, 11)), "real number in"),
        (Slots((("gene_1", "intensity_1"), ("other", "intensity_2")), (3, 6, 11)), "same choices"),
    ],
)
def test_slots_that_do_not_fit_their_component_are_rejected(slots: Slots, message: str) -> None:
    parameters = (*SLOTTED.parameters, Integer("count", 0, 1), Categorical("other", ("a", "b", "c")))
    with pytest.raises(SpaceError, match=message):
        Component("perturbation", parameters, (slots,))


def errors_with(resolution: float | ResolutionByChoice | None) -> SearchSpace:
    """Return a space of an error whose severity has a resolution."""
    kind = Categorical("type", ("none", "miss", "shift"))
    severity = Real("severity", 0.0, 2.0, resolution=resolution)
    return SearchSpace((Component("behaviour", (kind, Integer("steps", 0, 900), severity)),))


def test_a_resolution_may_depend_on_a_choice() -> None:
    space = errors_with(ResolutionByChoice("type", {"miss": 0.005}))
    for choice, resolution, is_stated in ((1, 0.005, True), (2, 0.02, False)):
        resolutions, stated = space.resolutions(np.array([choice, 5.0, 0.3]))
        assert resolutions.tolist() == [1.0, 9.0, resolution]
        assert stated.tolist() == [True, False, is_stated]
        alone, _ = space.resolutions(np.array([choice, 5.0, 0.3]), [2, 0])
        assert alone.tolist() == [resolution, 1.0]


@pytest.mark.parametrize("name", sorted(example_spaces()))
def test_a_row_changed_in_one_part_is_repaired_there_as_the_whole_row_is(name: str) -> None:
    space = example_spaces()[name]
    rng = np.random.default_rng(5)
    for column in range(space.dimension):
        row, other = (space.join(space.sample(rng)).copy() for _ in range(2))
        row[column] = other[column]
        whole, part = (np.random.default_rng(column) for _ in range(2))
        repaired = space.repaired_parts(row, [column], part)
        assert repaired.tobytes() == space.join(space.repair(space.split(row), whole)).tobytes()


def test_the_resolution_of_an_integer_is_at_least_1() -> None:
    space = SearchSpace((Component("a", (Integer("x", 0, 4), Integer("y", 0, 4, resolution=0.2))),))
    assert space.resolutions(np.array([2.0, 3.0]))[0].tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("resolution", "words"),
    [
        (0.0, "severity: expected a resolution > 0"),
        (math.nan, "severity: expected a resolution > 0"),
        (ResolutionByChoice("kind", {}), "to depend on a categorical parameter of the component, got 'kind'"),
        (
            ResolutionByChoice("steps", {}),
            "to depend on a categorical parameter of the component, got 'steps'",
        ),
        (ResolutionByChoice("type", {"mis": 0.1}), "unknown choice 'mis' of type; did you mean 'miss'?"),
    ],
)
def test_a_wrong_resolution_is_refused(resolution: float | ResolutionByChoice, words: str) -> None:
    with pytest.raises(SpaceError, match=re.escape(words)):
        errors_with(resolution)


def test_a_resolution_of_a_choice_is_positive() -> None:
    with pytest.raises(SpaceError, match="type=miss: expected a resolution > 0, got -1"):
        ResolutionByChoice("type", {"miss": -1.0})
