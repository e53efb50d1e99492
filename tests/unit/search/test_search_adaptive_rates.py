"""Rates and threshold: the known answers, degenerate populations, bounds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from brink.search.adaptive_rates import (
    Crossover,
    Population,
    crossover_probability,
    mutation_probability,
    scalar_fitness,
    scaled,
)

FITNESS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
KNOWN = Population.of(FITNESS)


def test_mutation_falls_from_the_worst_to_none_for_the_best() -> None:
    assert mutation_probability(FITNESS) == pytest.approx([1.0, 0.9, 0.6, 0.3, 0.0])


@pytest.mark.parametrize(
    ("form", "rates"),
    [
        (Crossover.MIRROR, [0.0, 0.3, 0.6, 0.9, 1.0]),
        (Crossover.RECIPROCAL, [0.3, 0.4, 0.6, 1.0, 1.0]),
        # Below the mean the classical form is its cap; formula and cap together, without that branch, are the
        # mutation rate above.
        (Crossover.SRINIVAS, [1.0, 1.0, 0.6, 0.3, 0.0]),
    ],
)
def test_crossover_by_the_better_parent(form: Crossover, rates: list[float]) -> None:
    assert crossover_probability(FITNESS, KNOWN, form) == pytest.approx(rates)


def test_the_threshold_falls_as_a_population_converges() -> None:
    assert KNOWN.threshold() == pytest.approx(0.4)
    assert Population.of(0.5 + 0.1 * FITNESS).threshold() == pytest.approx(0.04)


@pytest.mark.parametrize("form", list(Crossover))
def test_where_all_are_equal_the_rates_are_at_their_caps(form: Crossover) -> None:
    equal = np.full(4, 0.4)
    assert mutation_probability(equal, k4=0.8).tolist() == [0.8] * 4
    assert crossover_probability(equal, Population.of(equal), form, k3=0.7).tolist() == [0.7] * 4
    assert Population.of(equal).threshold() == 0.0


@given(arrays(np.float64, st.integers(1, 12), elements=st.floats(0.0, 1.0)), st.sampled_from(Crossover))
def test_rates_are_probabilities_whatever_the_population(
    fitness: NDArray[np.float64], form: Crossover
) -> None:
    for rates in (
        mutation_probability(fitness),
        crossover_probability(fitness, Population.of(fitness), form),
    ):
        assert ((rates >= 0) & (rates <= 1)).all()


def test_critical_and_different_solutions_are_fit() -> None:
    criticality, diversity = np.array([0.0, 1.0, 0.5]), np.array([1.0, 0.0, 0.5])
    assert scalar_fitness(criticality, diversity).tolist() == [1.0, 0.0, 0.5]
    assert scalar_fitness(criticality, diversity, 1.0).tolist() == [1.0, 0.0, 0.5]
    assert scaled(np.array([-1.0, 2.0, 9.0]), 0.0, 4.0).tolist() == [0.0, 0.5, 1.0]
    assert scaled(np.array([3.0, 3.0]), 3.0, 3.0).tolist() == [0.0, 0.0]
