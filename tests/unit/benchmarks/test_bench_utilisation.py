"""The model of the workers' schedule under one campaign of a search."""

import random

import pytest

from benchmarks.measurement import silent
from benchmarks.utilisation import model_searches, played, utilisation
from brink.server.problems.catalogue import make_algorithm


def test_one_worker_is_always_busy() -> None:
    found = utilisation([(5, 0), (3, 1), (4, 2)], 1, random.Random(1))
    assert found.granted == pytest.approx(1.0)
    assert found.whole == pytest.approx(1.0)


def test_a_generation_waits_for_the_longest_drive_of_the_one_before() -> None:
    drawn = random.Random(1)
    durations = [drawn.lognormvariate(-0.125, 0.5) for _ in range(3)]
    found = utilisation([(2, 0), (1, 1)], 2, random.Random(1))
    first = max(durations[:2])
    assert found.granted == pytest.approx(sum(durations[:2]) / (2 * first))
    assert found.whole == pytest.approx(sum(durations) / (2 * (first + durations[2])))


def test_more_generations_in_flight_keep_more_workers_busy() -> None:
    def share(in_flight: int) -> float:
        asked = [(8, max(0, place - in_flight + 1)) for place in range(40)]
        return utilisation(asked, 16, random.Random(1)).granted

    assert share(2) < share(4) < share(16)
    assert share(40) == pytest.approx(1.0)


def test_a_search_asks_for_its_whole_budget_and_counts_its_lines() -> None:
    few = played(make_algorithm("random@1"), {"generation_size": 10, "in_flight": 4}, budget=100, seed=1)
    assert few.asked == tuple((10, max(0, place - 3)) for place in range(10))
    assert few.lines == 0
    some = played(make_algorithm("edge@2"), {}, budget=300, seed=1)
    assert sum(size for size, _ in some.asked) == 300
    assert some.lines >= 1


def test_most_workers_are_modelled_with_more_candidates_in_flight_too() -> None:
    rows = list(model_searches(silent, ids=["random@1"], workers=[1, 200], budgets=[800], seeds=1, repeats=2))
    assert [row.what for row in rows] == [
        "used, random@1, 800 simulations, 1 workers",
        "used, random@1, 800 simulations, 200 workers",
        "used, random@1, 800 simulations, 200 workers, in_flight 14",
    ]
    assert rows[0].value == pytest.approx(1.0)
