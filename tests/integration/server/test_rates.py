"""A rate all the way: a stated distribution, a claim that ends the search, exposure, strata, terminal and picture."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, submit
from support.databases import sqlite_then_postgres
from support.problems import Ball, simulated

from brink.search.algorithms.subset import Subset
from brink.server.campaigns.body import read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.findings.words import percent, rounded
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
from brink.sim import catalogue
from brink.worker.wire import Completed, LeasedJob

API = "/api/v1/campaigns"
DISTRIBUTION = {"where.x": {"normal": {"mean": 0, "deviation": 0.5}}}


class Driven(Ball):
    """The ball, with drives that record distance and time."""

    id = "driven@1"
    requirements = ("distance@1",)
    evaluation = SimulatedProblem.evaluation


def driven(job: LeasedJob) -> Completed:
    features = {"way_m": 250.0, "ended_at_s": 36.0, "replicate": float(int(job.spec["seed"]) % 5)}
    return simulated(job.spec).model_copy(update={"features": features})


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setitem(catalogue._registered[PROBLEMS], Driven.id, Driven)
    return {"id": Driven.id, "params": {"distribution": DISTRIBUTION}}


@sqlite_then_postgres
@pytest.mark.parametrize("algorithm", ["rate@1", "random@1"])
def test_a_rate_has_intervals_exposure_and_its_distribution(
    client: httpx.Client, problem: dict[str, Any], algorithm: str
) -> None:
    params = {"generation_size": 20, "in_flight": 2}
    campaign = submit(
        client, ball(simulations=100, problem=problem, algorithm={"id": algorithm, "params": params})
    )
    stands = FakeWorker(client, judge=driven).work(campaign)
    assert (stands["status"], stands["evaluated"]) == ("finished", 100)
    path = f"{API}/{campaign}/findings/rate"
    found = expect(client.get(path))
    view = found["view"]
    assert view["simulations"] == 100
    assert 0 <= view["rate"]["low"] <= view["fixed"]["low"] <= view["rate"]["value"]
    assert view["rate"]["value"] <= view["fixed"]["high"] <= view["rate"]["high"] <= 1
    # The uncertainty of a fit is added to that of chance; verdicts do not depend on the replicate.
    assert view["replicates"] == 5
    assert view["fitted"]["value"] == view["rate"]["value"]
    assert view["fitted"]["low"] < view["rate"]["value"] < view["fitted"]["high"]
    # Every drive is 250 m and 36 s long: 4,000 drives for 1,000 km, and 100 an hour.
    assert view["per_hour"]["value"] / view["per_1000_km"]["value"] == pytest.approx(100 / 4000)
    if algorithm == "random@1":
        assert view["per_1000_km"]["value"] == pytest.approx(4000 * view["rate"]["value"])
    assert "normal with mean 0" in " ".join(found["caveats"])
    assert "simulat" in found["sentence"]
    assert expect(client.get(path, params={"at_most": 0.999}))["view"]["claim"]["decision"] == "shown"
    assert client.get(path, params={"at_most": 2}).status_code == 422
    assert client.get(path, params={"by": "where.x"}).status_code == 422
    table = client.get(path, params={"format": "csv", "table": "looks"}).text.splitlines()
    assert table[0] == "simulations,rate,low,high"
    assert table[-1].startswith("100,")


@sqlite_then_postgres
def test_a_claim_ends_the_search_and_a_search_for_the_boundary_says_that_it_ignored_the_distribution(
    client: httpx.Client, problem: dict[str, Any]
) -> None:
    algorithm = {"id": "rate@1", "params": {"claim": {"at_most": 0.9}, "generation_size": 10, "in_flight": 2}}
    campaign = submit(client, ball(simulations=2000, problem=problem, algorithm=algorithm))
    stands = FakeWorker(client, judge=driven).work(campaign)
    assert stands["status"] == "finished"
    assert stands["evaluated"] < 200
    assert expect(client.get(f"{API}/{campaign}/findings/rate"))["view"]["claim"]["decision"] == "shown"

    other = submit(
        client,
        ball(simulations=30, problem=problem, algorithm={"id": "ga@1", "params": {"population_size": 10}}),
    )
    FakeWorker(client, judge=driven).work(other)
    said = " ".join(expect(client.get(f"{API}/{other}/findings"))["more"]).lower()
    assert "the search (ga@1) ignored the operational distribution" in said


def test_subset_simulation_says_what_each_level_gave(
    client: httpx.Client, problem: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {Subset.id: Subset})
    algorithm = {"id": Subset.id, "params": {"chains": 20, "length": 5, "in_flight": 2}}
    params = {"distribution": {"where.x": {"normal": {"mean": -1.5, "deviation": 0.5}}}}
    campaign = submit(
        client, ball(simulations=1000, problem={**problem, "params": params}, algorithm=algorithm)
    )
    stands = FakeWorker(client, judge=driven).work(campaign)
    assert stands["status"] == "finished"
    found = expect(client.get(f"{API}/{campaign}/findings"))["findings"][0]
    view = found["view"]
    assert (found["kind"], view["ended"]) == ("levels", "reached")
    assert view["rate"]["low"] < view["rate"]["value"] < view["rate"]["high"]
    assert len(found["tables"][0]["rows"]) == len(view["levels"]) >= 2
    assert "approximate" in " ".join(found["caveats"])
    assert "normal with mean -1.5" in " ".join(found["caveats"])
    assert client.get(f"{API}/{campaign}/findings/rate").status_code == 404


@sqlite_then_postgres
def test_wrong_input_is_refused_by_field(client: httpx.Client, problem: dict[str, Any]) -> None:
    for params, pointer in (
        ({"distribution": {"where.q": "uniform"}}, "/problem/params/distribution/where.q"),
        ({"distribution": []}, ""),
        ({"distribution": [1]}, "/problem/params/distribution"),
    ):
        answer = client.post(API, json=ball(problem={"id": Driven.id, "params": params}))
        if pointer:
            assert answer.status_code == 422, answer.text
            assert pointer in answer.text
    algorithm = {"id": "rate@1", "params": {"claim": {"at_most": 3}}}
    answer = client.post(API, json=ball(problem=problem, algorithm=algorithm))
    assert answer.status_code == 422
    assert "/algorithm/params/claim" in answer.text


def test_a_campaign_file_names_a_table_of_observations(tmp_path: Path) -> None:
    (tmp_path / "drives.csv").write_text("scenario.x, scenario.y\n0.5,1\n\n-1,0.25\n")
    content: dict[str, Any] = {
        "name": "rows",
        "problem": {"id": "ball@1", "params": {"distribution": {"from": "drives.csv"}}},
        "algorithm": {"id": "rate@1"},
        "budget": {"simulations": 10},
    }
    file = tmp_path / "campaign.yaml"
    file.write_text(json.dumps(content))
    assert read_campaign_file(file).problem.params["distribution"] == {
        "rows": {"columns": ["scenario.x", "scenario.y"], "values": [[0.5, 1.0], [-1.0, 0.25]]}
    }
    for name in ("nothing.csv", 3):
        content["problem"]["params"]["distribution"]["from"] = name
        file.write_text(json.dumps(content))
        with pytest.raises(InvalidInput) as caught:
            read_campaign_file(file)
        assert caught.value.errors[0].pointer == "/problem/params/distribution/from"


def test_intervals_are_rounded_outward() -> None:
    assert (percent(0.01234, outward=-1), percent(0.01234), percent(0.01234, outward=1)) == (
        "1.2%",
        "1.2%",
        "1.3%",
    )
    assert (percent(0.0), percent(1.0, outward=1), percent(0.000123, outward=1)) == ("0%", "100%", "0.013%")
    assert (rounded(1234), rounded(1234, outward=1)) == ("1,200", "1,300")
