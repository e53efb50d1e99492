"""Bad input: the answer points at the field, says what was expected and names the nearest valid name."""

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support.api import ball, coordinator, row_counts
from support.databases import Databases
from support.problems import small_problems

from brink.server.db.engine import Engines, open_engines
from brink.server.errors import field_name


@pytest.fixture(scope="module")
def database_url(module_databases: Databases) -> Iterator[str]:
    """The URL of one database for the whole file, since bad input stores nothing."""
    with module_databases.database() as url:
        yield url


@pytest.fixture(scope="module")
def engines(database_url: str) -> Iterator[Engines]:
    """The engines of the shared database."""
    opened = open_engines(database_url)
    yield opened
    opened.dispose()


@pytest.fixture(scope="module")
def client(database_url: str) -> Iterator[httpx.Client]:
    """A client of one coordinator for the whole file."""
    with small_problems(), coordinator(database_url) as opened:
        yield opened


def changed(path: str, value: object) -> dict[str, Any]:
    """Return the body of a campaign on the ball with one field changed."""
    body = json.loads(json.dumps(ball()))
    *parents, last = path.strip("/").split("/")
    place = body
    for name in parents:
        place = place.setdefault(name, {})
    place[last] = value
    return dict(body)


BAD = [
    pytest.param("/problem/id", "bal@1", "/problem/id", "unknown problem 'bal@1'", "ball@1", id="problem"),
    pytest.param("/problem/id", "xyzzy", "/problem/id", "expected one of", None, id="nothing-near"),
    pytest.param(
        "/algorithm/id", "mlcsh@1", "/algorithm/id", "unknown algorithm", "mlcshe@1", id="algorithm"
    ),
    pytest.param("/bugdet", {}, "/bugdet", "unknown field; expected one of", "budget", id="field"),
    pytest.param(
        "/budget/simulation", 1, "/budget/simulation", "unknown field", "simulations", id="nested-field"
    ),
    pytest.param(
        "/llm",
        {"modell": "x", "model": "x", "endpoint": "http://127.0.0.1:9/v1"},
        "/llm/modell",
        "unknown field",
        "model",
        id="field-of-an-optional-object",
    ),
    pytest.param(
        "/problem/params/limt", 1.0, "/problem/params/limt", "unknown field", "limit", id="parameter"
    ),
    pytest.param(
        "/algorithm/params/populaton_size",
        9,
        "/algorithm/params/populaton_size",
        "unknown field",
        "population_size",
        id="setting",
    ),
    pytest.param(
        "/budget/simulations", "60", "/budget/simulations", "valid integer, got '60'", None, id="text"
    ),
    pytest.param("/budget/simulations", 60.5, "/budget/simulations", "valid integer", None, id="fraction"),
    pytest.param("/budget/simulations", True, "/budget/simulations", "valid integer", None, id="boolean"),
    pytest.param("/seed", -1, "/seed", "greater than or equal to 0, got -1", None, id="negative"),
    pytest.param("/seed", 2**53, "/seed", "less than 9007199254740992", None, id="too-large"),
    pytest.param("/priority", 101, "/priority", "less than or equal to 100", None, id="priority"),
    pytest.param("/name", "", "/name", "at least 1 character", None, id="empty"),
    pytest.param("/name", "a\0b", "/name", "", None, id="nul"),
    pytest.param(
        "/problem/params/limit", 0, "/problem/params/limit", "greater than 0, got 0", None, id="bound"
    ),
    pytest.param(
        "/problem/params/limit", "1", "/problem/params/limit", "valid number", None, id="number-as-text"
    ),
    pytest.param(
        "/problem/params/needs", "faulty", "/problem/params/needs", "'faulty@1' or", "faulty@1", id="choice"
    ),
    pytest.param(
        "/execution/max_failed_share",
        1.5,
        "/execution/max_failed_share",
        "less than or equal to 1",
        None,
        id="share",
    ),
    pytest.param(
        "/budget/simulations", 19, "/budget/simulations", "at least the 20", None, id="small-budget"
    ),
    pytest.param("/budget", None, "/budget", "got None", None, id="null"),
]


@pytest.mark.parametrize(("path", "value", "pointer", "message", "nearest"), BAD)
def test_answer_points_at_the_wrong_field(
    client: httpx.Client,
    engines: Engines,
    path: str,
    value: object,
    pointer: str,
    message: str,
    nearest: str | None,
) -> None:
    before = row_counts(engines)
    answer = client.post("/api/v1/campaigns", json=changed(path, value))
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    (error,) = answer.json()["errors"]
    assert error["pointer"] == pointer
    assert message in error["message"]
    assert error["nearest"] == nearest
    assert answer.json()["detail"].startswith(f"{field_name(pointer)}: "), "as in the file"
    assert row_counts(engines) == before


@pytest.mark.parametrize(
    "params",
    [r'{"fault": "\ud800"}', r'{"\ud800": 1}', '{"limit": NaN}', '{"limit": 1e999}', '{"limit": [[[' * 40],
)
def test_parameters_beyond_json_are_rejected(client: httpx.Client, engines: Engines, params: str) -> None:
    before = row_counts(engines)
    content = json.dumps(ball()).replace('{"id": "ball@1"}', f'{{"id": "ball@1", "params": {params}}}')
    answer = client.post("/api/v1/campaigns", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert row_counts(engines) == before
    assert client.get("/api/v1/campaigns").status_code == 200, "such a parameter once broke every list"


def test_all_wrong_fields_are_reported_together(client: httpx.Client) -> None:
    body = {**ball(), "seed": "one", "extra": 1}
    del body["name"]
    errors = client.post("/api/v1/campaigns", json=body).json()["errors"]
    assert {error["pointer"] for error in errors} == {"/seed", "/extra", "/name"}


def test_mlcshe_on_one_component_is_refused_with_alternative(client: httpx.Client, engines: Engines) -> None:
    body = {**ball(), "problem": {"id": "line@1"}, "algorithm": {"id": "mlcshe@1"}}
    answer = client.post("/api/v1/campaigns", json=body)
    (error,) = answer.json()["errors"]
    assert (answer.status_code, error["pointer"]) == (422, "/algorithm/id")
    assert "two components" in error["message"]
    assert "ga@1" in error["message"]
    assert row_counts(engines)["campaigns"] == 0


@pytest.mark.parametrize(
    "scalar",
    ["0x" + "f" * 5_000, "0b" + "1" * 20_000, ":".join(["1"] * 3_000), "!!bool abc", "!!timestamp abc"],
)
@pytest.mark.parametrize("field", ["seed", "name", "budget", "odd"])
def test_odd_scalars_of_yaml_are_rejected(client: httpx.Client, field: str, scalar: str) -> None:
    text = json.dumps({**ball(), field: "HERE"}).replace('"HERE"', scalar)
    answer = client.post(
        "/api/v1/campaigns/check", content=text, headers={"Content-Type": "application/yaml"}
    )
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert "line 1" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("path", "pointer"),
    [
        ("/api/v1/campaigns?limit=0", "/query/limit"),
        ("/api/v1/campaigns?cursor=%21%21", "/query/cursor"),
        ("/api/v1/campaigns?status=runing", "/query/status/0"),
        ("/api/v1/jobs?limit=x", "/query/limit"),
        ("/api/v1/jobs?after=99999999999999999999", "/query/after"),
        ("/api/v1/campaigns/x/boundary?t_b=2", "/query/t_b"),
        ("/api/v1/campaigns/x/solutions?after=99999999999999999999", "/query/after"),
        ("/api/v1/campaigns/x/solutions/99999999999999999999", "/path/number"),
    ],
)
def test_answer_points_at_the_wrong_query_parameter(client: httpx.Client, path: str, pointer: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 422, answer.text
    assert [error["pointer"] for error in answer.json()["errors"]] == [pointer]


IDENTITY = {"id": "w", "host": "", "pid": 1, "version": ""}
HUGE = 10**25


@pytest.mark.parametrize(
    ("path", "body", "pointer"),
    [
        ("lease", {"worker": {**IDENTITY, "id": ""}, "capabilities": []}, "/worker/id"),
        ("lease", {"worker": {**IDENTITY, "pid": HUGE}, "capabilities": []}, "/worker/pid"),
        ("lease", {"worker": IDENTITY, "capabilities": [], "max_jobs": 0}, "/max_jobs"),
        ("lease", {"worker": IDENTITY, "capabilities": ["x"] * 300}, "/capabilities"),
        ("lease", {"worker": IDENTITY, "capabilites": []}, "/capabilites"),
        ("heartbeat", {"worker": IDENTITY, "leases": [{"job": HUGE, "token": "t"}]}, "/leases/0/job"),
        (
            "results",
            {"worker": IDENTITY, "results": [{"job": 1, "token": "t", "outcome": {"kind": "other"}}]},
            "/results/0/outcome",
        ),
        (
            "results",
            {
                "worker": IDENTITY,
                "results": [
                    {
                        "job": HUGE,
                        "token": "t",
                        "outcome": {"kind": "failed", "reason": "error", "message": ""},
                    }
                ],
            },
            "/results/0/job",
        ),
    ],
)
def test_answer_points_at_the_wrong_worker_field(
    client: httpx.Client, path: str, body: dict[str, Any], pointer: str
) -> None:
    answer = client.post(f"/api/v1/jobs/{path}", json=body)
    assert answer.status_code == 422, answer.text
    assert pointer in [error["pointer"] for error in answer.json()["errors"]]
