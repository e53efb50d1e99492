"""Operational design domains: whatever draws or repairs stays within them, and distances stay the same."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.analysis.coverage import Coverage
from brink.search.errors import OddError
from brink.search.features import equivalent_orders
from brink.search.metric import Metric
from brink.search.odd import limited, odd_of
from brink.search.operators import mutated, offspring
from brink.search.shorthand import space_from
from brink.search.slots import Slots
from brink.search.space import Categorical, Component, Dormant, Extent, Integer, Real, SearchSpace
from brink.search.testing import example_spaces
from brink.search.traffic.participants import MAX_SPEEDS_MPS, Kind
from brink.search.traffic.variation import TrafficGenome, hostile_solution, mutated_randomly

MIXED = example_spaces()["mixed"]
ODD = {
    "scenario.weather": ["fog", "wet"],
    "scenario.cars": {"min": 1, "max": 2},
    "behaviour.start": {"min": 20},
    "behaviour.left": {"min": 100.0, "max": 130.0},
    "behaviour.right": {"max": 170.0},
    "behaviour.delay": 0.5,
}
WITHIN = limited(MIXED, ODD)
TRAFFIC = example_spaces()["traffic"]
FLOATS = st.floats(-1e4, 1e4) | st.just(float("nan"))


def parts(count: int, odd: dict[str, object]) -> SearchSpace:
    """Return a space of interchangeable boxes within an ODD."""
    parameters = tuple(
        p
        for i in range(1, count + 1)
        for p in (Real(f"box_{i}.x", 0, 10), Categorical(f"box_{i}.c", ("r", "g")))
    )
    names = tuple((f"box_{i}.x", f"box_{i}.c") for i in range(1, count + 1))
    return limited(SearchSpace((Component("scene", parameters, interchangeable=names),)), odd)


def test_an_odd_is_written_with_its_full_names_in_one_form() -> None:
    assert odd_of(WITHIN) == {
        "scenario.weather": ["wet", "fog"],
        "scenario.cars": {"min": 1, "max": 2},
        "behaviour.start": {"min": 20, "max": 90},
        "behaviour.left": {"min": 100.0, "max": 130.0},
        "behaviour.right": {"min": 0.0, "max": 170.0},
        "behaviour.delay": 0.5,
    }
    assert odd_of(limited(MIXED, odd_of(WITHIN))) == odd_of(WITHIN)
    assert limited(MIXED, {}) is MIXED
    assert (
        odd_of(limited(MIXED, {"scenario.weather": ["dry", "wet", "fog"], "behaviour.delay": {"min": 0}}))
        == {}
    )


@given(st.lists(FLOATS, min_size=8, max_size=8), st.integers(0, 99))
def test_repair_leads_into_the_odd_and_leaves_valid_solutions_unchanged(
    values: list[float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    repaired = WITHIN.repair(WITHIN.split(np.array(values)), rng)
    WITHIN.check(repaired)
    MIXED.check(repaired)
    again = WITHIN.repair(repaired, rng)
    assert WITHIN.join(again).tobytes() == WITHIN.join(repaired).tobytes()


@pytest.mark.parametrize("seed", range(5))
def test_draws_and_offspring_are_within_the_odd(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parents = [WITHIN.sample(rng) for _ in range(20)]
    for mother, father in zip(parents, reversed(parents), strict=True):
        WITHIN.check(mother)
        for index, component in enumerate(WITHIN.components):
            for child in offspring(
                component, mother[index], father[index], crossover=0.5, mutation=0.9, rng=rng
            ):
                assert not list(component.problems(child))
    rows = WITHIN.draw_unrepaired(200, rng)
    assert set(rows[:, 0]) == {1.0, 2.0}
    assert rows[:, 5].min() >= 100.0
    assert rows[:, 5].max() <= 130.0
    assert set(rows[:, 7]) == {0.5}


def test_without_an_odd_the_same_numbers_are_drawn_as_ever() -> None:
    drawn = MIXED.draw_unrepaired(3, np.random.default_rng(4))
    shares = np.random.default_rng(4).random((3, 8))
    choices = np.where(MIXED.categorical, np.floor(shares * [3, 1, 3, 1, 1, 1, 1, 1]), shares * MIXED.ranges)
    assert drawn.tobytes() == choices.tobytes()


def test_mutation_steps_shrink_with_the_odd_and_never_move_a_fixed_number() -> None:
    whole, part = Real("x", 0.0, 10.0, sigma=2.0), Real("x", 0.0, 10.0, sigma=2.0).limited({"max": 5})
    assert (whole.mutation_sigma, part.mutation_sigma, whole.limited(3).mutation_sigma) == (2.0, 1.0, 0.0)
    assert Integer("n", 0, 100).limited({"max": 2}).mutation_sigma == 0.5, "rounding must not undo every step"
    rng = np.random.default_rng(1)
    row = WITHIN.components[1].sample(rng)
    assert mutated(WITHIN.components[1], row, 1.0, rng)[5] == row[5]


def test_distances_are_those_without_the_odd_and_fixed_parameters_add_nothing() -> None:
    rng = np.random.default_rng(2)
    rows = np.array([WITHIN.join(WITHIN.sample(rng)) for _ in range(30)])
    within = Metric.of_space(WITHIN).between(rows, rows)
    assert within.tobytes() == Metric.of_space(MIXED).between(rows, rows).tobytes()
    other = rows.copy()
    other[:, 7] = 1.5  # delay, which is fixed
    assert (Metric.of_space(MIXED).between(other, other) == within).all()


def test_size_counts_what_is_within_the_odd() -> None:
    space = example_spaces()["categorical"]
    assert limited(space, {"scenario.*": ["a", "b"], "behaviour.fault-0": "on"}).size == 2**6 * 2**7
    only = SearchSpace((Component("x", (Real("a", 0, 1), Integer("b", 0, 9))),))
    assert limited(only, {"x.a": 0.25, "x.b": {"max": 4}}).size == 5


@pytest.mark.parametrize(
    ("odd", "name", "message"),
    [
        (
            {"scenario.wether": "dry"},
            "scenario.wether",
            "did you mean 'scenario.weather'?; known: scenario.weather",
        ),
        ({"weather": "dry"}, "weather", "known: scenario.weather"),
        ({"weather.*": "dry"}, "weather.*", "unknown parameter 'weather.*'"),
        ({"scenario.weather": []}, "scenario.weather", "expected some of dry, wet, fog, got []"),
        ({"scenario.weather": ["hail"]}, "scenario.weather", "expected one of dry, wet, fog, got 'hail'"),
        ({"scenario.weather": {"min": 1}}, "scenario.weather", "expected some of dry, wet, fog"),
        ({"scenario.cars": {"min": 3, "max": 1}}, "scenario.cars", "expected min <= max, got 3 and 1"),
        ({"scenario.cars": 5}, "scenario.cars", "expected a whole number in [0, 4], got 5.0"),
        ({"scenario.cars": 1.5}, "scenario.cars", "expected a whole number in [0, 4], got 1.5"),
        ({"behaviour.left": {"max": 900}}, "behaviour.left", "expected a number in [0, 800], got 900.0"),
        ({"behaviour.left": {"most": 9}}, "behaviour.left", "expected min, max or both, got ['most']"),
        ({"behaviour.left": {}}, "behaviour.left", "expected min, max or both"),
        ({"behaviour.left": [1, 2]}, "behaviour.left", "expected a number or {min: …, max: …}"),
        ({"behaviour.left": "5"}, "behaviour.left", "expected a number or {min: …, max: …}"),
        ({"behaviour.left": None}, "behaviour.left", "expected a number, got None"),
        ({"behaviour.left": 1, "behaviour.l*": 1}, "behaviour.l*", "behaviour.left is limited twice"),
        ({"behaviour.right": {"max": 40}}, None, "right can be 50 above left"),
    ],
)
def test_a_wrong_odd_is_refused_with_what_was_expected(
    odd: dict[str, object], name: str | None, message: str
) -> None:
    with pytest.raises(OddError) as refused:
        limited(MIXED, odd)
    assert refused.value.name == name
    assert message in str(refused.value)


def test_an_odd_has_at_least_two_solutions() -> None:
    space = SearchSpace((Component("x", (Real("a", 0, 1), Categorical("b", ("u", "v")))),))
    with pytest.raises(OddError, match="fixes every parameter"):
        limited(space, {"x.a": 0.5, "x.b": "u"})


def test_a_block_is_switched_off_by_its_label_not_by_zeros() -> None:
    members = ("x", "y")
    space = SearchSpace(
        (
            Component(
                "b",
                (Categorical("label", ("none", "car")), Real("x", 0, 1), Real("y", 0, 1)),
                (Dormant("label", "none", members),),
            ),
        )
    )
    with pytest.raises(OddError, match="to have none of them, fix label to none"):
        limited(space, {"b.x": 0, "b.y": 0})
    rng = np.random.default_rng(1)
    awake = limited(space, {"b.label": "car", "b.x": {"min": 0.5}, "b.y": 0})
    assert all(awake.sample(rng)[0].tolist()[1] >= 0.5 for _ in range(20))
    asleep = limited(space, {"b.x": {"min": 0.5}})
    drawn = [asleep.sample(rng)[0].tolist() for _ in range(40)]
    assert {row[1] for row in drawn if row[0] == 0} == {0.0}, "dormant numbers are 0, whatever the ODD"
    assert all(row[1] >= 0.5 for row in drawn if row[0] == 1)


def test_parts_with_different_limits_are_no_longer_interchangeable() -> None:
    assert len(equivalent_orders(parts(3, {"scene.box_*.x": {"max": 5}}))) == 6
    assert len(equivalent_orders(parts(3, {"scene.box_2.x": {"max": 5}}))) == 2
    assert len(equivalent_orders(parts(2, {"scene.box_2.x": {"max": 5}}))) == 1


def test_a_description_of_a_space_keeps_its_odd() -> None:
    space = limited(example_spaces()["numeric"], {"scenario.gap": {"min": 10}, "behaviour.lag": 3})
    again = space_from(space.describe())
    assert odd_of(again) == odd_of(space)
    assert again.ranges.tolist() == space.ranges.tolist()
    assert odd_of(again.unlimited()) == {}
    assert "odd" not in str(example_spaces()["mixed"].describe())


def test_a_constraint_that_knows_nothing_of_limits_has_none() -> None:
    space = example_spaces()["slots"]
    assert any(isinstance(rule, Slots) for rule in space.components[1].constraints)
    with pytest.raises(OddError, match="gene_1 cannot be limited"):
        limited(space, {"perturbation.gene_1": "noise"})
    assert odd_of(limited(space, {"scenario.weather": "dry"})) == {"scenario.weather": "dry"}


@pytest.mark.parametrize(
    "odd",
    [
        {"participants.p*.kind": ["none", "pedestrian"]},
        {
            "participants.p*.kind": ["none", "car"],
            "participants.p*.speed_mps": {"min": 5, "max": 8},
            "participants.p*.a*.action": ["none", "keep", "brake"],
            "participants.p*.a*.magnitude": {"max": 0.5},
            "participants.p*.a*.duration_s": {"max": 1.5},
        },
    ],
)
def test_road_users_stay_within_the_odd_through_patterns_and_changes(odd: dict[str, object]) -> None:
    genome, rng = TrafficGenome.of(limited(TRAFFIC, odd)), np.random.default_rng(1)
    allowed = set(odd["participants.p*.kind"])  # type: ignore[call-overload]
    for _ in range(40):
        drawn = hostile_solution(genome.road, 4, rng)
        rows = [genome.row(drawn, None, rng), genome.row(genome.sample(rng), None, rng)]
        newcomer = hostile_solution(genome.road, 1, rng)[0]
        changed = mutated_randomly(genome.solution(rows[0]), newcomer, 4, rng)
        rows.append(genome.row(changed, rows[0], rng))
        for row in rows:
            genome.space.check(genome.space.split(row))
            assert {one.kind.value for one in genome.solution(row)} <= allowed
            speeds = [one.speed_mps for one in genome.solution(row) if "participants.p*.speed_mps" in odd]
            assert all(5 <= speed <= 8 for speed in speeds)


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        ({"p1.kind": ["none", "car"]}, r"limit p\*\.kind"),
        ({"p*.a1.action": ["none", "keep"]}, r"limit p\*\.a\*\.action"),
        ({"p*.kind": ["car"]}, "expected none and at least one other choice"),
        ({"p*.kind": ["none"]}, "expected none and at least one other choice"),
        ({"p*.a*.action": ["none", "brake"]}, "expected none and keep"),
        ({"p*.speed_mps": {"min": 5}}, f"at least {MAX_SPEEDS_MPS[Kind.PEDESTRIAN]:g} m/s or less"),
        ({"p*.a*.duration_s": {"max": 0.2}}, "up to 0.5 s or more"),
        ({"p*.ds_m": {"min": 5}}, r"p1\.ds_m cannot be limited"),
    ],
)
def test_limits_that_road_users_cannot_keep_are_refused(odd: dict[str, object], message: str) -> None:
    with pytest.raises(OddError, match=message):
        limited(TRAFFIC, {f"participants.{name}": limit for name, limit in odd.items()})


def test_a_monitor_says_what_is_outside_the_odd_that_it_learned() -> None:
    rng = np.random.default_rng(3)
    rows = np.array([WITHIN.join(WITHIN.sample(rng)) for _ in range(60)])
    coverage = Coverage.of(WITHIN, rows, equivalent_orders(WITHIN))
    assert not any("ODD" in one for one in coverage.reasons(rows, coverage.nearest(rows)))
    outside = rows[:1].copy()
    outside[0, [0, 1, 7]] = 0.0, 4.0, 1.5
    (reason,) = coverage.reasons(outside, coverage.nearest(outside))
    assert "scenario.weather dry is outside the ODD (wet or fog)" in reason
    assert "scenario.cars is outside the ODD (1 to 2)" in reason
    assert "behaviour.delay is outside the ODD (0.5 s)" in reason


def test_a_box_can_be_held_in_a_part_of_the_image() -> None:
    space = SearchSpace(
        (Component("b", (Integer("l", 0, 100), Integer("r", 0, 100)), (Extent("l", "r", 10.0, 100.0),)),)
    )
    right = limited(space, {"b.l": {"min": 60, "max": 95}, "b.r": {"min": 70}})
    rng = np.random.default_rng(1)
    for _ in range(200):
        low, high = right.repair([rng.normal(50, 60, size=2)], rng)[0].tolist()
        assert 60 <= low <= 95
        assert high >= max(70, low + 10)
