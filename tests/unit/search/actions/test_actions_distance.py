"""Distances of solutions of participants: known answers and what a distance must keep."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from brink.search.actions.distance import (
    UNMATCHED_M,
    RolledOut,
    encounter_distances,
    matched_distance,
    matched_distances,
    participant_distances,
    trajectory_distances,
)

MOST = 3


def rolled(*solutions: list[list[tuple[float, float]]]) -> RolledOut:
    """Make roll-outs from lists of waypoints."""
    points = np.full((len(solutions), MOST, 4, 2), np.nan)
    actions = np.zeros((len(solutions), MOST))
    for row, participants in enumerate(solutions):
        for column, ends in enumerate(participants):
            points[row, column, : len(ends)] = ends
            actions[row, column] = len(ends)
    return RolledOut(points=points, actions=actions)


AHEAD = [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0)]
BESIDE = [(3.0, 4.0), (13.0, 4.0)]


def test_td_sums_over_the_actions_that_both_have() -> None:
    sums, shared = trajectory_distances(rolled([AHEAD]), rolled([BESIDE]))
    assert sums[0, 0, 0, 0] == 10.0
    assert shared[0, 0, 0, 0] == 2.0
    assert shared[0, 0, 1:].sum() == 0.0


def test_ed_is_the_mean_over_all_pairs_and_not_0_to_itself() -> None:
    both = rolled([AHEAD, BESIDE])
    # Pairs: 0 and 10, 10 and 0.
    assert encounter_distances(both, both).tolist() == [[5.0]]
    assert encounter_distances(both, rolled([AHEAD])).tolist() == [[5.0]]
    assert encounter_distances(rolled([AHEAD]), rolled([AHEAD])).tolist() == [[0.0]]


def test_a_participants_distance_is_its_mean_to_all_participants() -> None:
    found = participant_distances(rolled([AHEAD, BESIDE]), rolled([AHEAD], [BESIDE, BESIDE]))
    assert found[0, :2] == pytest.approx([20.0 / 3.0, 10.0 / 3.0])
    assert np.isnan(found[0, 2])


def test_matching_sees_through_the_order_and_counts_who_is_left_over() -> None:
    assert matched_distance(rolled([AHEAD, BESIDE]), rolled([BESIDE, AHEAD])) == 0.0
    assert matched_distance(rolled([AHEAD]), rolled([BESIDE])) == 5.0
    assert matched_distance(rolled([AHEAD, BESIDE]), rolled([BESIDE])) == pytest.approx(UNMATCHED_M / 2)


def random_solution(rng: np.random.Generator) -> list[list[tuple[float, float]]]:
    return [
        [tuple(point) for point in rng.uniform(-50, 50, (rng.integers(2, 5), 2)).tolist()]
        for _ in range(rng.integers(1, MOST + 1))
    ]


@given(st.integers(0, 2**32 - 1))
def test_distances_are_symmetric_and_matching_is_the_best_of_all_orders(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solutions = rolled(*(random_solution(rng) for _ in range(3)))
    apart = encounter_distances(solutions, solutions)
    assert apart == pytest.approx(apart.T)
    matched = matched_distances(solutions, solutions)
    assert matched == pytest.approx(matched.T)
    assert np.diag(matched).tolist() == [0.0] * 3
    assert matched[0, 1] == pytest.approx(_by_hand(solutions.take([0]), solutions.take([1])))


def _by_hand(first: RolledOut, second: RolledOut) -> float:
    def present(one: RolledOut) -> list[NDArray[np.float64]]:
        return [one.points[0, p, : int(count)] for p, count in enumerate(one.actions[0]) if count]

    few, many = sorted((present(first), present(second)), key=len)
    totals = []
    for chosen in permutations(many, len(few)):
        costs = []
        for a, b in zip(few, chosen, strict=True):
            shared = min(len(a), len(b))
            costs.append(float(np.linalg.norm(a[:shared] - b[:shared], axis=1).mean()))
        totals.append(sum(costs) + UNMATCHED_M * (len(many) - len(few)))
    return min(totals) / len(many)


def test_of_no_solutions_there_are_no_distances() -> None:
    none = rolled()
    assert encounter_distances(none, rolled([AHEAD])).shape == (0, 1)
    assert participant_distances(none, rolled([AHEAD])).shape == (0, MOST)
    assert matched_distances(none, rolled([AHEAD])).shape == (0, 1)
