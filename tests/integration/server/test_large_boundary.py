"""Boundaries with very many solutions: the best ones are listed and called that, and nothing takes too long."""

import csv
import io
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support.api import ball, eventually, expect, listening_coordinator, progress, submit
from support.databases import Databases
from support.problems import small_problems

from brink.search.analysis import boundary
from brink.server.campaigns import plan

pytestmark = pytest.mark.long("a campaign with thousands of simulations")
API = "/api/v1/campaigns"
SOLUTIONS = 1_200
EVERY: dict[str, Any] = {"t_b": 1.0, "d_th": 0.0}
BEST = "the best 1,000 of 1,200 distinct boundary solutions"


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), listening_coordinator(url) as opened:
        yield opened


@pytest.fixture(scope="module")
def large(client: httpx.Client) -> str:
    """A finished campaign with more solutions than are listed."""
    campaign = submit(
        client,
        ball(
            problem={"id": "mtq@1"},
            algorithm={"id": "random@1", "params": {"generation_size": 400}},
            simulations=SOLUTIONS,
        ),
    )
    eventually(lambda: progress(client, campaign)["status"] == "finished", "the campaign ends")
    return campaign


def read(client: httpx.Client, campaign: str, status: int = 200, **params: Any) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/boundary", params=params), status)
    return found


def test_the_best_thousand_are_listed_and_all_are_counted(client: httpx.Client, large: str) -> None:
    whole = read(client, large, **EVERY)
    assert (whole["dbs"], len(whole["solutions"]), whole["words"]) == (SOLUTIONS, 1_000, BEST)
    listed = [one["number"] for one in whole["solutions"]]
    fitness = [one["fitness"] for one in whole["solutions"]]
    assert fitness == sorted(fitness)
    assert set(whole["strict"]) <= set(listed)
    assert len(whole["strict"]) <= whole["strict_dbs"]
    few = read(client, large, **EVERY, limit=3)
    assert few["words"] == "the best 3 of 1,200 distinct boundary solutions"
    assert [one["number"] for one in few["solutions"]] == listed[:3]
    assert (few["dbs"], few["strict_dbs"]) == (whole["dbs"], whole["strict_dbs"])
    table = client.get(f"{API}/{large}/boundary", params={**EVERY, "limit": 5, "format": "csv"}).text
    assert [int(row["number"]) for row in csv.DictReader(io.StringIO(table))] == listed[:5]
    assert read(client, large, 422, limit=1_001)["errors"][0]["pointer"] == "/query/limit"


def test_thresholds_that_take_too_long_are_refused_with_a_hint(
    client: httpx.Client, large: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(boundary, "_BLOCK", 50)
    monkeypatch.setattr(plan, "MOST_COST", 1_000)
    [error] = read(client, large, 422, t_b=1.0, d_th=0.001)["errors"]
    assert error["pointer"] == "/query/d_th"
    assert (
        f"campaign {large}: 1,200 solutions have a fitness of at most t_b 1, and too many" in error["message"]
    )
    assert error["message"].endswith("choose a larger d_th or a smaller t_b")
    assert read(client, large, t_b=1.0, d_th=0.0, limit=1)["dbs"] == SOLUTIONS, "nothing is compared"
    assert "dbs" in read(client, large, t_b=0.1, d_th=0.2), "it is counted with each generation anyway"
