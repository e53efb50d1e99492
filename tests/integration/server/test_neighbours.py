"""The neighbours of a solution over the API: what its fitness is made of."""

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, expect, submit

from brink.search.analysis.similarity import nearest_solutions
from brink.search.archive import Archive, Neighbourhood
from brink.search.fitness import wilson_interval
from brink.search.metric import Metric

API = "/api/v1/campaigns"


@pytest.fixture
def campaign(client: httpx.Client) -> str:
    submitted = submit(client, ball(simulations=60))
    assert FakeWorker(client).work(submitted)["status"] == "finished"
    return submitted


def test_the_nearest_are_those_of_the_distance_matrix(client: httpx.Client, campaign: str) -> None:
    solutions = expect(client.get(f"{API}/{campaign}/solutions", params={"limit": 1000}))["solutions"]
    numbers = [solution["number"] for solution in solutions if solution["fitness"] is not None]
    asked = ",".join(map(str, numbers))
    block = expect(client.get(f"{API}/{campaign}/distances", params={"numbers": asked}))
    by_number = {solution["number"]: solution for solution in solutions}
    for place in (0, 7, len(numbers) - 1):
        number = numbers[place]
        told = expect(client.get(f"{API}/{campaign}/solutions/{number}/neighbours", params={"most": 5}))
        row = block["distances"][place]
        order = sorted((d, n) for d, n in zip(row, numbers, strict=True) if n != number)[:5]
        assert [(one["distance"], one["number"]) for one in told["nearest"]] == [
            (pytest.approx(distance, abs=1e-6), other) for distance, other in order
        ]
        for one in told["nearest"]:
            other = by_number[one["number"]]
            assert one["unsafe"] == (other["verdict"] == "unsafe")
            assert (one["robustness"], one["fitness"]) == (other["robustness"], other["fitness"])
            assert one["within"] == (one["distance"] <= told["radius"])
        itself = by_number[number]
        assert (told["neighbours"], told["unsafe_neighbours"]) == (
            itself["neighbours"], itself["unsafe_neighbours"],
        )  # fmt: skip
        low, high = wilson_interval(told["unsafe_neighbours"], told["neighbours"], 1.96)
        assert told["interval"] == pytest.approx((float(low), float(high)))
        assert (told["evaluated"], told["p_th"]) == (len(numbers), 0.1)
        assert told["confidence"] == pytest.approx(0.95, abs=1e-4)
        assert told["looks_for_boundary"]


def test_all_within_the_radius_can_be_asked_for(client: httpx.Client, campaign: str) -> None:
    told = expect(client.get(f"{API}/{campaign}/solutions/0/neighbours", params={"most": 1000}))
    within = [one for one in told["nearest"] if one["within"]]
    assert len(within) + 1 == told["neighbours"]
    assert len(told["nearest"]) == told["evaluated"] - 1
    assert expect(client.get(f"{API}/{campaign}/solutions/0/neighbours", params={"most": 0}))["nearest"] == []


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_a_solution_that_was_not_evaluated_has_none(client: httpx.Client) -> None:
    running = submit(client, ball())
    assert (
        "no evaluated solution 0"
        in expect(client.get(f"{API}/{running}/solutions/0/neighbours"), 404)["detail"]
    )
    expect(client.get(f"{API}/{running}/solutions/0/neighbours", params={"most": -1}), 422)


def test_of_those_equally_near_the_lower_number_comes_first() -> None:
    metric = Metric(np.ones(1), np.zeros(1, bool))
    rows = np.array([[0.5], [0.75], [0.25], [0.75], [0.25], [0.5]])
    numbers = np.array([4, 9, 8, 2, 1, 0])
    archive = Archive.empty(metric, Neighbourhood(radius=0.1, p_th=0.1)).grown(
        numbers, rows, np.zeros(6, bool), np.ones(6)
    )
    found = nearest_solutions(archive, 0, 3)
    assert archive.numbers[found.positions].tolist() == [0, 1, 2]
    assert found.distances == pytest.approx([0.0, 0.25, 0.25])
    assert archive.numbers[nearest_solutions(archive, 0, 10).positions].tolist() == [0, 1, 2, 8, 9]
