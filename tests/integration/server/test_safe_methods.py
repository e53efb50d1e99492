"""Requests that are safe by HTTP change nothing: GET of every route, on a coordinator that has something to show."""

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from sqlalchemy import select
from support.api import FakeWorker, ball, coordinator, expect, finish, submit
from support.populated import fill

from brink.server.db.engine import Engines
from brink.server.db.models import Base
from brink.server.findings.kind import all_kinds

Known = dict[str, list[Any]]
SIMULATORS = ("faulty@1", "brink-drive@3", "brink-encounter@2", "nobody-has-it@1")
CAMPAIGN = "/api/v1/campaigns/{campaign_id}"
NO_ANSWER = {
    f"{CAMPAIGN}/pairs/{{safe}}-{{unsafe}}/{{side}}.png",
    f"{CAMPAIGN}/solutions/{{number}}/compared/{{side}}.png",
}
"""Pictures of what nothing here has."""


def few(client: httpx.Client) -> Known:
    """Fill a coordinator with the least that GET could change something of, and return its ids."""
    finished = finish(client, ball(simulations=20, execution={"keep_traces": 0}))
    running = submit(client, ball(seed=2, execution={"cache": False}))
    tiny: dict[str, Any] = {
        "name": "tiny",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "random@1"}],
        "seeds": [1],
        "budget": {"simulations": 20},
    }
    return {
        "campaigns": [finished, running],
        "tolerances": [{}],
        "experiments": [expect(client.post("/api/v1/experiments", json=tiny), 201)["id"]],
        "violations": [{"number": 2, "requirement": "distance@1"}],
        "jobs": [job.job for job in FakeWorker(client).lease(max_jobs=1)],
    }


def dump(engines: Engines) -> dict[str, list[tuple[Any, ...]]]:
    """Return all rows of all tables."""
    with engines.reader.connect() as connection:
        return {
            name: [tuple(row) for row in connection.execute(select(table).order_by(*table.primary_key))]
            for name, table in Base.metadata.tables.items()
        }


def values_of(known: Known) -> dict[str, list[str]]:
    """Return what stands for each parameter of a path."""
    violation = known["violations"][0]
    return {
        "campaign_id": [*known["campaigns"], *known["tolerances"][0].values()],
        "experiment_id": known["experiments"],
        "number": ["0", "1", str(violation["number"])],
        "safe": ["0"],
        "unsafe": ["1"],
        "side": ["safe", "unsafe", "system", "reference"],
        "extension": ["png", "mp4"],
        "index": ["0"],
        "kind": [kind.id for kind in all_kinds()],
        "requirement": [violation["requirement"]],
    }


def queries_of(known: Known) -> dict[str, dict[str, Any]]:
    """Return the queries of routes that need one."""
    tolerances = known["tolerances"][0]
    return {
        f"{CAMPAIGN}/distances": {"numbers": "0,1"},
        f"{CAMPAIGN}/tolerance/detector": {"episodes": tolerances.get("episodes")},
        f"{CAMPAIGN}/tolerance/agreement": {"fresh": tolerances.get("fresh")},
    }


def paths(route: str, values: dict[str, list[str]]) -> Iterator[str]:
    """Yield the route with each combination of values for its parameters."""
    names = [part.partition("}")[0] for part in route.split("{")[1:]]
    for chosen in itertools.product(*(values[name] for name in names)):
        yield route.format(**dict(zip(names, chosen, strict=True)))


@pytest.mark.usefixtures("small_problems")
@pytest.mark.parametrize(
    "populate",
    [few, pytest.param(fill, marks=pytest.mark.long("simulates drives, so that every route has an answer"))],
)
def test_no_get_changes_anything(
    database_url: str, engines: Engines, populate: Callable[[httpx.Client], Known]
) -> None:
    with coordinator(database_url, lease_s=3600) as client:
        known = populate(client)
        FakeWorker(client, id="able", capabilities=SIMULATORS).lease(
            max_jobs=1
        )  # so that nothing lacks a worker
    answered: dict[str, set[int]] = defaultdict(set)
    changed = []
    with coordinator(database_url, sweeping=False) as client:
        documented = expect(client.get("/openapi.json"))["paths"]
        routes = ["/", "/docs", *(path for path, methods in documented.items() if "get" in methods)]
        values, queries, before = values_of(known), queries_of(known), dump(engines)
        for route in routes:
            parameters = documented.get(route, {}).get("get", {}).get("parameters", [])
            waits = {"wait_s": 0} if "wait_s" in {one["name"] for one in parameters} else {}
            for path in paths(route, values):
                query = {**waits, **queries.get(route, {})}
                answered[route].add(client.get(path, params=query).status_code)
                if (after := dump(engines)) != before:
                    changed.append((path, [name for name in after if after[name] != before[name]]))
                    before = after
    assert len(answered) > 40
    assert changed == []
    assert all(status < 500 for statuses in answered.values() for status in statuses)
    if populate is fill:
        assert {route for route, statuses in answered.items() if not statuses & {200, 202}} <= NO_ANSWER


@pytest.mark.usefixtures("small_problems")
def test_a_link_enqueues_nothing_but_a_request_to_record_does_so_once(
    client: httpx.Client, engines: Engines
) -> None:
    campaign = finish(client, ball(simulations=20, execution={"keep_traces": 0}))
    path = f"/api/v1/campaigns/{campaign}/solutions/3"
    followed = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    before = dump(engines)["jobs"]
    picture = f"/api/v1/campaigns/{campaign}/pairs/3-4/safe.png"
    assert expect(client.get(f"{path}/trace", headers=followed), 404)["title"] == "Not recorded"
    expect(client.get(picture, headers=followed), 204)
    expect(client.post(f"{path}/trace", headers=followed), 403)
    assert dump(engines)["jobs"] == before
    for enqueued in (2, 0):
        expect(client.post(picture), 202)
        jobs = dump(engines)["jobs"]
        assert len(jobs) == len(before) + enqueued
        before = jobs
