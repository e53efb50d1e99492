"""Slots: distinct techniques, intensities on levels, whatever comes in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from brink.search.errors import SpaceError
from brink.search.levels import Slots
from brink.search.space import Categorical, Component, Integer, Real

CHOICES = ("noise", "blur", "rain")
SLOTS = Slots((("gene_1", "intensity_1"), ("gene_2", "intensity_2")), (3, 6, 11))
COMPONENT = Component(
    "perturbation",
    (
        Categorical("gene_1", CHOICES), Real("intensity_1", 0.0, 1.0),
        Categorical("gene_2", CHOICES), Real("intensity_2", 0.0, 1.0),
    ),
    (SLOTS,),
)  # fmt: skip


@given(
    arrays(np.float64, 4, elements=st.floats(allow_nan=True, allow_infinity=True, width=64)),
    st.integers(0, 2**32 - 1),
)
def test_whatever_is_repaired_complies_and_then_stays(vector: NDArray[np.float64], seed: int) -> None:
    rng = np.random.default_rng(seed)
    mended = COMPONENT.repair(vector, rng)
    assert list(COMPONENT.problems(mended)) == []
    assert np.array_equal(COMPONENT.repair(mended, rng), mended)


def test_intensities_go_to_the_nearest_level() -> None:
    rng = np.random.default_rng(0)
    mended = COMPONENT.repair(np.array([1.0, 0.29, 2.0, 0.04]), rng)
    assert mended.tolist() == [1.0, 1 / 5, 2.0, 0.0]
    assert COMPONENT.repair(np.array([0.0, 7.0, 1.0, -3.0]), rng).tolist() == [0.0, 1.0, 1.0, 0.0]


def test_a_technique_that_comes_twice_gives_way_in_the_later_slot() -> None:
    mended = COMPONENT.repair(np.array([2.0, 1.0, 2.0, 1.0]), np.random.default_rng(0))
    assert mended.tolist() == [2.0, 1.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("vector", "problem"),
    [
        ([1.0, 0.2, 1.0, 0.4], "different techniques"),
        ([1.0, 0.25, 2.0, 0.4], "intensity_1 on a level, the nearest is 0.2"),
        ([1.0, 0.2, 2.0, 0.01], "intensity_2 on a level, the nearest is 0.0"),
    ],
)
def test_what_does_not_comply_is_named(vector: list[float], problem: str) -> None:
    assert problem in next(iter(COMPONENT.problems(np.array(vector))))


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        (Slots((), (3, 6, 11)), "1 to 3 slots"),
        (Slots((("gene_1", "intensity_1"),), (3, 6)), "category of 2 choices"),
        (Slots((("gene_1", "intensity_1"),), (3, 6, 1)), "at least 2 levels"),
        (Slots((("gene_1", "count"),), (3, 6, 11)), "real number in"),
        (Slots((("gene_1", "intensity_1"), ("other", "intensity_2")), (3, 6, 11)), "same choices"),
    ],
)
def test_slots_that_do_not_fit_their_component_are_refused(slots: Slots, message: str) -> None:
    parameters = (
        *COMPONENT.parameters, Integer("count", 0, 1), Categorical("other", ("a", "b", "c")),
    )  # fmt: skip
    with pytest.raises(SpaceError, match=message):
        Component("perturbation", parameters, (slots,))
