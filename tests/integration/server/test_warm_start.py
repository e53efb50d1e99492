"""Campaigns that start from known solutions, over HTTP: what counts as theirs, and what is refused."""

import io
import json
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, coordinator, expect, finish, progress, row_counts, submit
from support.databases import Databases, module_sqlite_then_postgres
from support.marks import mostly_long
from support.problems import small_problems

from brink.search import surrogate
from brink.search.algorithm import Known, Scored, ask_all
from brink.search.archive import archive_digest
from brink.search.pairs import Steps
from brink.search.streams import episode_seed
from brink.search.testing import started
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.db.engine import Engines, open_engines

Body = dict[str, Any]
RANDOM = {"id": "random@1", "params": {"generation_size": 20}}
EDGE = {"id": "edge@1", "params": {"d_th": 0.05, "generation_size": 10}}


@pytest.fixture(scope="module")
def database_url(module_databases: Databases) -> Iterator[str]:
    """The URL of one database for the whole file: campaigns start from each other."""
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
    with pytest.MonkeyPatch.context() as patched, small_problems(), coordinator(database_url) as opened:
        patched.setattr(surrogate, "TREES", 15)
        yield opened


@pytest.fixture(scope="module")
def earlier(client: httpx.Client) -> str:
    """A finished random search of the ball with 60 simulations."""
    return finish(client, ball(seed=7, algorithm=RANDOM))


def archive(client: httpx.Client, campaign: str) -> Any:
    answer = client.get(f"/api/v1/campaigns/{campaign}/archive.npz")
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content))


def error_of(client: httpx.Client, body: Body) -> dict[str, Any]:
    """Return the only error of a submission."""
    answer = client.post("/api/v1/campaigns", json=body)
    assert answer.status_code == 422, answer.text
    (error,) = answer.json()["errors"]
    return dict(error)


def point(x: float, y: float, robustness: float | None = None) -> dict[str, Any]:
    return {"values": {"where.x": x, "what.y": y}} | (
        {} if robustness is None else {"robustness": robustness}
    )


@module_sqlite_then_postgres
@pytest.mark.parametrize(
    "algorithm",
    mostly_long(
        [
            RANDOM,
            ball()["algorithm"],
            {"id": "mlcshe@1", "params": {"population_size": 5, "archive_size": 2}},
            EDGE,
        ],
        [RANDOM, EDGE],
        "another algorithm",
    ),
    ids=lambda algorithm: str(algorithm["id"]),
)
def test_results_of_an_earlier_campaign_guide_the_search_and_are_not_its_own(
    client: httpx.Client, earlier: str, algorithm: dict[str, Any]
) -> None:
    body = ball(algorithm=algorithm, start_from={"campaign": earlier[:6]}, simulations=50)
    campaign = finish(client, body)
    stands, own = progress(client, campaign), archive(client, campaign)
    known = archive(client, earlier)
    assert stands["known"] == {
        "campaign": earlier,
        "results": 60,
        "unsafe": int(known["unsafe"].sum()),
        "points": 0,
        "outside_odd": 0,
    }
    assert stands["simulations"] == stands["evaluated"] == len(own["numbers"])
    assert stands["generations"][0]["evaluated"] <= 25
    assert own["numbers"].tolist() == list(range(len(own["numbers"])))
    assert stands["digest"] == warm_digest(body, known)
    page = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 1000}))
    assert len(page["solutions"]) == len(own["numbers"])
    assert all(
        one["spec"]
        for one in [
            expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/{number}")) for number in (0, 10)
        ]
    )


def warm_digest(document: Body, arrays: Any) -> str:
    """Return the archive digest of a warm campaign on the ball, from its algorithm alone, without a coordinator."""
    body = parse_body(document)
    plan = make_plan(body)
    algorithm = plan.algorithm
    known = Known(
        rows=arrays["vectors"],
        unsafe=arrays["unsafe"],
        robustness=arrays["robustness"],
        points=arrays["vectors"][:0],
    )
    state = started(
        algorithm,
        plan.problem.space,
        plan.config,
        seed=body.seed,
        budget=body.budget.simulations,
        known=known,
    )
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        distances = {c.number: float(np.hypot(c.vectors[0][0], c.vectors[1][0])) for c in state.pending}
        state = algorithm.tell(
            state, {n: Scored(unsafe=d < 1, robustness=d - 1) for n, d in distances.items()}
        )
    return archive_digest(state.archive)


@pytest.mark.long("runs campaigns")
def test_known_solutions_are_listed_with_where_they_come_from(client: httpx.Client, earlier: str) -> None:
    campaign = finish(client, ball(algorithm=RANDOM, start_from={"campaign": earlier}, simulations=20))
    found: list[dict[str, Any]] = []
    after: int | None = -1
    while after is not None:
        page = expect(client.get(f"/api/v1/campaigns/{campaign}/known", params={"after": after, "limit": 25}))
        found += page["solutions"]
        after = page["next"]
    assert [one["place"] for one in found] == list(range(60))
    for one in found[:5]:
        there = expect(client.get(f"/api/v1/campaigns/{earlier}/solutions/{one['number']}"))
        assert one["campaign"] == earlier
        assert (one["parameters"], one["robustness"]) == (there["parameters"], there["robustness"])
        assert (one["verdict"], one["words"]) == (there["verdict"], there["words"])
    assert expect(client.get(f"/api/v1/campaigns/{earlier}/known")) == {"solutions": [], "next": None}
    assert progress(client, earlier)["known"] is None


@module_sqlite_then_postgres
def test_given_points_are_simulated_first_and_given_results_not_at_all(client: httpx.Client) -> None:
    points = [point(0.25, 0.5), point(-1.5, 1.25)]
    start = {"solutions": [point(0.5, 0.5, -0.3), *points, point(1.9, 1.9, 1.7)]}
    campaign = finish(client, ball(algorithm=RANDOM, start_from=start, simulations=20))
    own = archive(client, campaign)
    assert own["vectors"][:2].tolist() == [[0.25, 0.5], [-1.5, 1.25]]
    assert own["unsafe"][:2].tolist() == [True, False]
    assert len(own["numbers"]) == 20
    stands = progress(client, campaign)
    assert stands["known"] == {"campaign": None, "results": 2, "unsafe": 1, "points": 2, "outside_odd": 0}
    listed = expect(client.get(f"/api/v1/campaigns/{campaign}/known"))["solutions"]
    assert [one["verdict"] for one in listed] == ["unsafe", None, None, "safe"]
    assert {(one["campaign"], one["number"]) for one in listed} == {(None, None)}


@pytest.mark.long("runs two searches; the other test of warm starts runs always")
def test_pairs_of_a_warm_campaign_are_two_drives_of_its_own_under_one_seed(
    client: httpx.Client, earlier: str
) -> None:
    campaign = finish(client, ball(algorithm=EDGE, start_from={"campaign": earlier}, simulations=80))
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/pairs"))
    assert found["pairs"]
    space = make_plan(parse_body(ball())).problem.space
    for pair in found["pairs"]:
        sides = [
            expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/{pair[side]['number']}"))
            for side in ("safe", "unsafe")
        ]
        assert sides[0]["seed"] == sides[1]["seed"]
        assert sides[0]["seed"] in {episode_seed(1, number) for number in range(80)}
        assert all(one["spec"] is not None for one in sides)
        rows = [space.join(space.encode(one["parameters"])) for one in sides]
        assert Steps(space).is_tight(rows[0], rows[1], 0.02)


@pytest.mark.long("runs campaigns")
def test_another_problem_is_refused_and_its_solutions_alone_are_simulated_first(
    client: httpx.Client, earlier: str
) -> None:
    other = {"id": "ball@1", "params": {"limit": 0.5}}
    body = ball(problem=other, algorithm=RANDOM, start_from={"campaign": earlier}, simulations=20)
    error = error_of(client, body)
    assert error["pointer"] == "/start_from/campaign"
    assert "problem.params.limit is 1.0 there and 0.5 here" in error["message"]
    assert "start_from.results: false" in error["message"]
    points = {"campaign": earlier, "results": False, "limit": 12}
    campaign = finish(client, body | {"start_from": points})
    own, known = archive(client, campaign), archive(client, earlier)
    given = {row.tobytes() for row in known["vectors"]}
    assert all(row.tobytes() in given for row in own["vectors"][:12])
    assert len(own["numbers"]) == 20
    assert progress(client, campaign)["known"] == {
        "campaign": earlier,
        "results": 0,
        "unsafe": 0,
        "points": 12,
        "outside_odd": 0,
    }
    sizes = np.abs(np.hypot(*own["vectors"][:12].T) - 1.0)
    assert (np.diff(sizes[::2]) >= 0).all()
    assert (np.diff(sizes[1::2]) >= 0).all()


def test_more_points_than_the_budget_are_refused(client: httpx.Client, earlier: str) -> None:
    start = {"campaign": earlier, "results": False}
    error = error_of(client, ball(algorithm=RANDOM, start_from=start, simulations=59))
    assert error["pointer"] == "/budget/simulations"
    assert "at least the 60 simulations of the known points" in error["message"]
    assert "start_from.limit" in error["message"]


@module_sqlite_then_postgres
def test_a_campaign_that_runs_is_no_source(client: httpx.Client) -> None:
    running = submit(client, ball(algorithm=RANDOM, execution={"cache": False}))
    error = error_of(client, ball(start_from={"campaign": running}))
    assert error["pointer"] == "/start_from/campaign"
    assert f"campaign {running} is running: wait until it has ended" in error["message"]
    expect(client.post(f"/api/v1/campaigns/{running}/cancel"))
    assert "no evaluated solutions" in error_of(client, ball(start_from={"campaign": running}))["message"]


BAD = [
    pytest.param({}, "/start_from", "expected either campaign or solutions", None, id="nothing"),
    pytest.param(
        {"campaign": "abcd", "solutions": [point(0, 0)]},
        "/start_from",
        "either campaign or solutions",
        None,
        id="both",
    ),
    pytest.param({"solutions": []}, "/start_from/solutions", "at least 1 item", None, id="no-solutions"),
    pytest.param(
        {"solutions": [point(0, 0)], "limit": 3},
        "/start_from",
        "limit and results only with campaign",
        None,
        id="limit-of-given-solutions",
    ),
    pytest.param({"campaing": "abcd"}, "/start_from/campaing", "unknown field", "campaign", id="field"),
    pytest.param(
        {"campaign": "nosuchid"}, "/start_from/campaign", "no such campaign", None, id="unknown-campaign"
    ),
    pytest.param({"campaign": "a"}, "/start_from/campaign", "at least 2 characters", None, id="short-id"),
    pytest.param(
        {"campaign": "abcd", "limit": 0}, "/start_from/limit", "or equal to 1, got 0", None, id="zero"
    ),
    pytest.param(
        {"campaign": "abcd", "limit": 5001},
        "/start_from/limit",
        "less than or equal to 5000",
        None,
        id="too-many",
    ),
    pytest.param(
        {"solutions": [{"values": {"where.x": 0.0, "what.z": 0.0, "what.y": 0}}]},
        "/start_from/solutions/0/values/what.z",
        "unknown parameter",
        "what.y",
        id="unknown-parameter",
    ),
    pytest.param(
        {"solutions": [point(0, 0), {"values": {"where.x": 0.0}}]},
        "/start_from/solutions/1/values/what.y",
        "missing",
        None,
        id="missing-parameter",
    ),
    pytest.param(
        {"solutions": [point(0, 3.0)]},
        "/start_from/solutions/0/values/what.y",
        "got 3",
        None,
        id="out-of-range",
    ),
    pytest.param(
        {"solutions": [{"values": {"where.x": "left", "what.y": 0.0}}]},
        "/start_from/solutions/0/values/where.x",
        "'left'",
        None,
        id="text-for-a-number",
    ),
    pytest.param(
        {"solutions": [point(0, 1), point(1, 1), point(0, 1, 0.5)]},
        "/start_from/solutions/2",
        "the same as solution 0",
        None,
        id="twice",
    ),
    pytest.param(
        {"solutions": [{**point(0, 0), "robustness": "low"}]},
        "/start_from/solutions/0/robustness",
        "valid number",
        None,
        id="robustness",
    ),
]


@pytest.mark.parametrize(("start", "pointer", "message", "nearest"), BAD)
def test_answer_points_at_what_is_wrong(
    client: httpx.Client, engines: Engines, start: Body, pointer: str, message: str, nearest: str | None
) -> None:
    before = row_counts(engines)
    error = error_of(client, ball(start_from=start))
    assert error["pointer"] == pointer
    assert message in error["message"]
    assert error["nearest"] == nearest
    assert row_counts(engines) == before
    checked = client.post("/api/v1/campaigns/check", content=json.dumps(ball(start_from=start)))
    assert checked.status_code == 422


@pytest.mark.parametrize(
    "algorithm", ["nsga2@1", "mosat@1", "mumoea@1", "simood-ga@1", "repeat@1", "minimise@1"]
)
def test_algorithms_that_cannot_start_from_anything_say_which_can(
    client: httpx.Client, earlier: str, algorithm: str
) -> None:
    error = error_of(client, ball(algorithm={"id": algorithm}, start_from={"campaign": earlier}))
    assert error["pointer"] == "/start_from"
    assert f"{algorithm} cannot start from known solutions" in error["message"]
    assert all(able in error["message"] for able in ("edge@1", "ga@1", "mlcshe@1", "random@1"))


def test_a_file_that_starts_from_nothing_keeps_its_hash_and_one_that_does_has_its_own() -> None:
    body = {
        "name": "ball",
        "problem": {"id": "ball@1"},
        "budget": {"simulations": 60},
        "algorithm": {"id": "ga@1", "params": {"population_size": 20}},
    }
    cold = parse_body(body).document_hash()
    assert cold == "4e962fa28735de31773fe90b47af8a75ac51ec5b418acc0bc5a191c0daf00a0b"
    starts = [{"campaign": "abcd"}, {"campaign": "abcd", "limit": 5}, {"solutions": [point(0, 0)]}]
    hashes = {parse_body(body | {"start_from": start}).document_hash() for start in starts}
    assert len(hashes | {cold}) == 4


@pytest.mark.long("runs campaigns")
def test_a_campaign_outlives_the_one_that_it_started_from(client: httpx.Client) -> None:
    source = finish(client, ball(seed=9, algorithm=RANDOM))
    campaign = submit(client, ball(start_from={"campaign": source}, seed=3))
    expect(client.delete(f"/api/v1/campaigns/{source}"), 204)
    done = FakeWorker(client).work(campaign)
    assert (done["status"], done["known"]["results"]) == ("finished", 60)
    assert len(expect(client.get(f"/api/v1/campaigns/{campaign}/known"))["solutions"]) == 60


@module_sqlite_then_postgres
def test_known_results_count_towards_the_boundary_only_where_the_answer_says_so(
    client: httpx.Client, earlier: str
) -> None:
    campaign = finish(client, ball(start_from={"campaign": earlier}))
    boundary = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))
    assert boundary["with_known"]["results"] == 60
    assert "Together with the 60 known results that the campaign started from" in boundary["note"]
    own = archive(client, campaign)
    assert int(own["neighbours"].max()) <= len(own["numbers"])
    cold = expect(client.get(f"/api/v1/campaigns/{earlier}/boundary"))
    assert cold["with_known"] is None
    assert "known results" not in cold["note"]


@module_sqlite_then_postgres
def test_another_space_is_refused_with_what_differs(client: httpx.Client, earlier: str) -> None:
    body = ball(problem={"id": "line@1"}, algorithm=RANDOM, start_from={"campaign": earlier})
    error = error_of(client, body)
    assert error["pointer"] == "/start_from/campaign"
    assert "searches another space: it has what.y, this one none" in error["message"]


def test_robustness_that_is_no_number_is_refused(client: httpx.Client) -> None:
    content = json.dumps(ball(start_from={"solutions": [point(0, 0, 9.0)]})).replace("9.0", "NaN")
    answer = client.post("/api/v1/campaigns", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
