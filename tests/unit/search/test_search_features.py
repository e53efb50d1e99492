import itertools

import numpy as np
import pytest

from brink.search.errors import SpaceError
from brink.search.features import Features, equivalent_orders, units_of
from brink.search.space import Categorical, Component, Extent, Integer, Real, SearchSpace
from brink.search.testing import example_spaces
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams

URBAN = UrbanInjected(UrbanInjectedParams()).space
MIXED = example_spaces()["mixed"]


def parts(count: int) -> SearchSpace:
    """Return a space of a gap and interchangeable boxes with a colour each."""
    parameters: list[Real | Integer | Categorical] = [Real("gap", 1.0, 5.0)]
    for i in range(count):
        box = (Real(f"{side}_{i}", 0.0, 10.0, "px") for side in ("left", "right"))
        parameters += [Categorical(f"colour_{i}", ("red", "blue")), *box]
    names = tuple((f"colour_{i}", f"left_{i}", f"right_{i}") for i in range(count))
    rules = tuple(Extent(f"left_{i}", f"right_{i}", 1.0, 10.0) for i in range(count))
    return SearchSpace((Component("scene", tuple(parameters), rules, interchangeable=names),))


def test_every_column_belongs_to_one_unit() -> None:
    for space in (URBAN, *example_spaces().values()):
        columns = sorted(itertools.chain.from_iterable(units_of(space)))
        assert columns == list(range(space.dimension))
    names = MIXED.column_names()
    pairs = [tuple(names[column] for column in unit) for unit in units_of(MIXED) if len(unit) == 2]
    assert pairs == [("behaviour.start", "behaviour.end"), ("behaviour.left", "behaviour.right")]


def test_features_are_scaled_numbers_categories_middles_and_lengths() -> None:
    features = Features.of_space(parts(2))
    row = parts(2).encode(
        {
            "scene": {
                "gap": 3.0,
                "colour_0": "blue",
                "left_0": 2.0,
                "right_0": 6.0,
                "colour_1": "red",
                "left_1": 0.0,
                "right_1": 1.0,
            }
        }
    )
    found = dict(zip(features.names(), features.of_rows(np.array(row))[0].tolist(), strict=True))
    assert found == pytest.approx(
        {
            "scene.gap": 0.75,
            "scene.left_0": 0.2,
            "scene.right_0": 0.6,
            "scene.left_1": 0.0,
            "scene.right_1": 0.1,
            "scene.colour_0=red": 0.0,
            "scene.colour_0=blue": 1.0,
            "scene.colour_1=red": 1.0,
            "scene.colour_1=blue": 0.0,
            "middle of scene.left_0..scene.right_0": 0.4,
            "length of scene.left_0..scene.right_0": 0.4,
            "middle of scene.left_1..scene.right_1": 0.05,
            "length of scene.left_1..scene.right_1": 0.1,
        }
    )


@pytest.mark.parametrize(("count", "orders"), [(2, 2), (3, 6), (4, 4)])
def test_equivalent_orders_swap_whole_parts(count: int, orders: int) -> None:
    space = parts(count)
    found = equivalent_orders(space)
    assert found.shape == (orders, space.dimension)
    assert len({tuple(order) for order in found.tolist()}) == orders
    row = space.join(space.sample(np.random.default_rng(1)))
    whole = {tuple(row[1 + 3 * i : 4 + 3 * i]) for i in range(count)}
    for order in found:
        swapped = row[order]
        assert swapped[0] == row[0]
        assert {tuple(swapped[1 + 3 * i : 4 + 3 * i]) for i in range(count)} == whole
    closed = {tuple(a[b]) for a in found for b in found}
    assert closed == {tuple(order) for order in found}, (
        "an average over the orders is the same for all of them"
    )


@pytest.mark.parametrize(("count", "orders"), [(1, 1), (2, 2), (3, 6), (4, 4), (6, 6)])
def test_more_trajectories_are_shown_in_few_orders(count: int, orders: int) -> None:
    space = UrbanInjected(UrbanInjectedParams(trajectories=count)).space
    found = equivalent_orders(space)
    assert found.shape == (orders, 7 + 11 * count), (
        "six trajectories have 720 orders, which nobody can afford"
    )
    row = space.join(space.sample(np.random.default_rng(2)))
    for order in found:
        space.check(space.split(row[order]))


def test_stored_layout_gives_the_same_features() -> None:
    features = Features.of_space(URBAN)
    bare = SearchSpace(tuple(Component(c.name, c.parameters) for c in URBAN.components))
    again = Features.of(bare, features.ties, features.orders.tolist())
    rows = np.array([URBAN.join(URBAN.sample(np.random.default_rng(i))) for i in range(5)])
    assert (again.in_every_order(rows) == features.in_every_order(rows)).all()
    assert again.names() == features.names()


@pytest.mark.parametrize(
    ("ties", "orders"),
    [
        ([[0, 1]], [[0, 1, 2, 3, 4, 5, 6]]),  # column 1 is a category
        ([[2, 2]], [[0, 1, 2, 3, 4, 5, 6]]),
        ([[2, 3, 5]], [[0, 1, 2, 3, 4, 5, 6]]),
        ([[2, 9]], [[0, 1, 2, 3, 4, 5, 6]]),
        ([], []),
        ([], [[0, 1, 2]]),
        ([], [[0, 1, 2, 3, 4, 5, 5]]),
        ([], [[0, 4, 5, 6, 1, 2, 3]]),  # the given order must come first
        ([], [[0, 1, 2, 3, 4, 5, 6], [1, 0, 2, 3, 4, 5, 6]]),  # swaps a number and a category
        ([], [[0.0, 1, 2, 3, 4, 5, 6]]),
    ],
)
def test_wrong_layouts_are_rejected(ties: list[list[int]], orders: list[list[int]]) -> None:
    with pytest.raises(SpaceError):
        Features.of(parts(2), ties, orders)


def test_rows_of_the_wrong_shape_are_rejected() -> None:
    with pytest.raises(SpaceError, match="rows of 7 numbers"):
        Features.of_space(parts(2)).of_rows(np.zeros((3, 5)))


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ((("a", "b"),), "two or more parts"),
        ((("a",), ("b", "c")), "two or more parts"),
        ((("a",), ("z",)), "unknown parameter 'z'"),
        ((("a",), ("a",)), "each parameter once"),
        ((("a",), ("c",)), "same type, range and choices"),
        ((("a",), ("d",)), "same type, range and choices"),
    ],
)
def test_parts_that_cannot_be_swapped_are_rejected(named: tuple[tuple[str, ...], ...], said: str) -> None:
    numbers = (Real("a", 0, 1), Real("b", 0, 1), Real("c", 0, 2), Integer("d", 0, 1))
    with pytest.raises(SpaceError, match=said):
        Component("scene", numbers, interchangeable=named)
