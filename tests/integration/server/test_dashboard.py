"""The dashboard's page, and the requests that it polls: conditional, columnar, with counts of jobs."""

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    expect,
    finish,
    listening_coordinator,
    progress,
    submit,
)
from support.databases import Databases, sqlite_then_postgres
from support.problems import SIMULATOR

from brink.server.access.tokens import create_token
from brink.server.dashboard.page import STATIC
from brink.server.db.engine import Engines
from brink.server.states import Scope
from brink.worker.wire import JobFailed, LeasedJob

SECRET = "correct-horse"
IMPORTS = re.compile(r"""(?:from|import\()\s*["'](\.[^"']+)["']""")


@pytest.fixture
def guarded(database_url: str) -> Iterator[httpx.Client]:
    with listening_coordinator(database_url, token=SECRET) as client:
        yield client


def test_page_and_its_files_need_neither_token_nor_internet(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url, verify=False) as stranger:
        page = stranger.get("/")
        assert page.status_code == 200
        assert "default-src 'self'" in page.headers["content-security-policy"]
        named = re.findall(r'(?:src|href)="([^"#]+)"', page.text)
        assert len(named) >= 10
        for file in named:
            assert file.startswith("dashboard/"), "every file comes from this coordinator"
            answer = stranger.get(f"/{file}")
            assert answer.status_code == 200, file
            assert answer.headers["cache-control"] == "no-cache"
            get_again = stranger.get(f"/{file}", headers={"If-None-Match": answer.headers["etag"]})
            assert get_again.status_code == 304


def test_every_imported_module_exists() -> None:
    modules = sorted((STATIC / "js").rglob("*.js"))
    assert len(modules) >= 10
    for module in modules:
        for named in IMPORTS.findall(module.read_text()):
            assert (module.parent / named).resolve().is_file(), f"{module.relative_to(STATIC)}: {named}"


def test_other_files_of_the_package_are_not_served(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url, verify=False) as stranger:
        for path in ("/dashboard/../page.py", "/dashboard/%2e%2e/page.py", "/dashboard/js", "/dashboard"):
            assert stranger.get(path).status_code in (401, 404), path


@pytest.mark.parametrize(("scope", "status"), [("read", 200), ("user", 200), ("admin", 200), ("worker", 403)])
def test_access_answers_with_the_scope_of_the_token(
    guarded: httpx.Client, engines: Engines, scope: str, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("brink.server.access.authentication.TOKEN_CACHE_S", 0.0)
    with engines.writer.begin() as connection:
        token = create_token(connection, Scope(scope), "somebody")
    body = expect(guarded.get("/api/v1/access", headers={"Authorization": f"Bearer {token}"}), status)
    if status == 200:
        assert body == {"tokens": True, "scope": scope}


def test_access_without_tokens_is_admin(client: httpx.Client) -> None:
    assert expect(client.get("/api/v1/access")) == {"tokens": False, "scope": "admin"}


API = "/api/v1"
FILE = "name: checked\nproblem: {id: ball@1}\nalgorithm: {id: random@1}\nbudget: {simulations: 20}\n"


def get_tagged(client: httpx.Client, path: str) -> tuple[dict[str, Any], str]:
    answer = client.get(f"{API}/{path}")
    return expect(answer), answer.headers["etag"]


def get_again(client: httpx.Client, path: str, etag: str) -> httpx.Response:
    return client.get(f"{API}/{path}", headers={"If-None-Match": etag})


def test_every_change_raises_the_sequence_number_and_changes_the_etag(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=40))
    path = f"campaigns/{campaign}/progress"
    seen = []
    for steer in (None, "pause", "resume", "cancel"):
        if steer:
            expect(client.post(f"{API}/campaigns/{campaign}/{steer}"))
        body, etag = get_tagged(client, path)
        seen.append((body["sequence"], etag))
        assert get_again(client, path, etag).status_code == 304
    assert len({etag for _, etag in seen}) == len(seen)
    assert [sequence for sequence, _ in seen] == sorted({sequence for sequence, _ in seen})


def test_overview_lists_the_progress_of_every_campaign_in_columns(client: httpx.Client) -> None:
    done = finish(client, ball(name="first one"))
    waiting = submit(client, ball(seed=2, name="second_100%"))
    eventually(lambda: None not in get_tagged(client, "overview")[0]["found"], "what it found is worked out")
    body, etag = get_tagged(client, "overview")
    assert body["id"] == [waiting, done]
    assert body["status"] == ["running", "finished"]
    assert body["simulations"] == [0, progress(client, done)["simulations"]]
    assert body["dbs"][1][-1] == progress(client, done)["generations"][-1]["dbs"]
    assert body["problem"] == ["ball@1", "ball@1"]
    assert get_again(client, "overview", etag).status_code == 304
    expect(client.post(f"{API}/campaigns/{waiting}/pause"))
    assert get_again(client, "overview", etag).status_code == 200


@sqlite_then_postgres
def test_overview_filters_by_name_status_and_experiment(client: httpx.Client) -> None:
    finish(client, ball(name="first one"))
    submit(client, ball(seed=2, name="second_100%"))
    for query, found in (
        ({"name": "FIRST"}, ["first one"]),
        ({"name": "d_100%"}, ["second_100%"]),
        ({"name": "d%100"}, []),
        ({"status": "running"}, ["second_100%"]),
        ({"status": "failed"}, []),
        ({"experiment": "0000"}, []),
    ):
        assert expect(client.get(f"{API}/overview", params=query))["name"] == found, query


@sqlite_then_postgres
def test_overview_hides_follow_ups_or_nests_them_below_their_campaigns(client: httpx.Client) -> None:
    first = finish(client, ball(name="first"))
    numbers = [one["number"] for one in expect(client.get(f"{API}/campaigns/{first}/solutions"))["solutions"]]
    second = submit(client, ball(name="second", seed=2))
    once, twice = (
        expect(client.post(f"{API}/campaigns/{first}/repeats", json={"numbers": [number]}), 201)["campaign"]
        for number in numbers[:2]
    )
    FakeWorker(client).work(once)
    of_once = expect(client.post(f"{API}/campaigns/{once}/repeats", json={"numbers": [0]}), 201)["campaign"]

    def listed(**params: Any) -> list[str]:
        found: list[str] = expect(client.get(f"{API}/overview", params=params))["id"]
        return found

    assert listed() == [of_once, twice, once, second, first]
    assert listed(follow_ups="hidden") == [second, first]
    assert listed(follow_ups="hidden", unfold=[first]) == [second, first, once, twice]
    assert listed(follow_ups="hidden", unfold=[first, once]) == [second, first, once, of_once, twice]
    assert listed(follow_ups="nested") == [second, first, once, of_once, twice]
    assert listed(follow_ups="nested", limit=1) == [second]
    body, etag = get_tagged(client, "overview?follow_ups=hidden")
    assert (body["follow_ups"], body["open_follow_ups"]) == ([0, 2], [0, 0])
    assert get_again(client, "overview?follow_ups=hidden", etag).status_code == 304
    third = expect(client.post(f"{API}/campaigns/{first}/repeats", json={"numbers": numbers[2:3]}), 201)
    body, _ = get_tagged(client, "overview?follow_ups=hidden")
    assert (body["follow_ups"], body["open_follow_ups"]) == ([0, 3], [0, 1])
    FakeWorker(client).work(third["campaign"])
    assert get_tagged(client, "overview?follow_ups=hidden")[0]["open_follow_ups"] == [0, 0]


def test_map_returns_new_solutions_and_the_fitness_of_all(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=60))
    worker = FakeWorker(client)
    worker.work(campaign, until=lambda stands: stands["generation"] >= 1)
    first = expect(client.get(f"{API}/campaigns/{campaign}/map"))
    assert len(first["number"]) == first["drawn"] == progress(client, campaign)["evaluated"]
    worker.work(campaign, until=lambda stands: stands["generation"] >= 2)
    known = {"version": first["version"], "after": len(first["number"])}
    more = expect(client.get(f"{API}/campaigns/{campaign}/map", params=known))
    whole = expect(client.get(f"{API}/campaigns/{campaign}/map"))
    if more["version"] == first["version"]:
        assert more["first"] == len(first["number"])
        assert first["x"] + more["x"] == whole["x"]
    else:
        assert more["first"] == 0
    assert len(more["fitness"]) == len(whole["number"])
    assert set(whole["told_in"]) >= {0, 1}


def test_results_are_on_the_map_and_counted_before_the_search_is_told(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=40))
    path = f"campaigns/{campaign}/map"
    empty, etag = get_tagged(client, path)
    assert (empty["reported"]["number"], empty["ground"]) == ([], None)
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=5))
    found = expect(get_again(client, path, etag))
    reported = found["reported"]
    assert (len(reported["number"]), found["number"], found["generation"]) == (5, [], 0)
    assert len(set(zip(reported["x"], reported["y"], strict=True))) == 5, "they have places of their own"
    told = progress(client, campaign)
    assert (told["evaluated"], told["reported"], told["reported_unsafe"]) == (0, 5, sum(reported["unsafe"]))
    solutions = expect(client.get(f"{API}/campaigns/{campaign}/solutions"))["solutions"]
    assert all(one["verdict"] == "pending" for one in solutions)

    worker.work(campaign, until=lambda stands: stands["generation"] >= 1)
    later = expect(client.get(f"{API}/{path}"))
    verdicts = dict(zip(later["number"], later["unsafe"], strict=True))
    assert [verdicts[number] for number in reported["number"]] == reported["unsafe"]
    assert not set(later["reported"]["number"]) & set(later["number"])


def test_map_returns_the_values_of_a_parameter(client: httpx.Client) -> None:
    campaign = finish(client, ball())
    solutions = expect(client.get(f"{API}/campaigns/{campaign}/solutions", params={"limit": 5}))["solutions"]
    component, values = next(iter(solutions[0]["parameters"].items()))
    name = next(iter(values))
    by = expect(client.get(f"{API}/campaigns/{campaign}/map", params={"parameter": f"{component}.{name}"}))[
        "by"
    ]
    body = [one["parameters"][component][name] for one in solutions]
    assert by["values"][:5] == pytest.approx(body, abs=1e-3)
    wrong = client.get(f"{API}/campaigns/{campaign}/map", params={"parameter": f"{component}.nme"})
    assert expect(wrong, 422)["errors"][0]["pointer"] == "/query/parameter"


def test_convergence_curve_ends_at_the_boundary(client: httpx.Client) -> None:
    campaign = finish(client, ball())
    asked = {"t_b": 0.9, "d_th": 0.05}
    course = expect(client.get(f"{API}/campaigns/{campaign}/course", params=asked))
    boundary = expect(client.get(f"{API}/campaigns/{campaign}/boundary", params=asked))
    assert (course["dbs"][-1], course["strict_dbs"][-1]) == (boundary["dbs"], boundary["strict_dbs"])
    assert (np.diff(course["simulations"]) > 0).all()


@sqlite_then_postgres
def test_campaign_without_verdicts_has_an_empty_map_and_curve(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    assert expect(client.get(f"{API}/campaigns/{campaign}/map"))["number"] == []
    assert expect(client.get(f"{API}/campaigns/{campaign}/course"))["simulations"] == []
    assert expect(client.get(f"{API}/campaigns/{campaign}/dependence"))["evaluated"] == 0


def test_campaign_file_is_checked_without_being_stored(client: httpx.Client) -> None:
    headers = {"Content-Type": "application/yaml"}
    body = expect(client.post(f"{API}/campaigns/check", content=FILE, headers=headers))
    assert (body["name"], body["budget"], body["seed"]) == ("checked", {"simulations": 20}, 1)
    assert (
        expect(client.post(f"{API}/campaigns/check", content=json.dumps(ball()), headers=headers))["seed"]
        == 1
    )
    assert expect(client.get(f"{API}/overview"))["id"] == []


def test_check_of_a_wrong_campaign_file_points_at_the_error(client: httpx.Client) -> None:
    for text, pointer, words in (
        ("name: [", "", "line 1"),
        ("name: x\nname: y", "", "given twice"),
        ("a: 2024-13-45", "", "line 1, column 4: expected a value of type timestamp"),
        ("# nothing", "", "expected a campaign"),
        (FILE.replace("ball@1", "bal@1"), "/problem/id", "ball@1"),
        (FILE.replace("ulations", "ulation"), "/budget/simulation", "unknown"),
    ):
        answer = client.post(
            f"{API}/campaigns/check", content=text, headers={"Content-Type": "application/yaml"}
        )
        errors = expect(answer, 422)["errors"]
        assert pointer in [error["pointer"] for error in errors], text
        assert words in answer.text, text


def test_two_coordinators_give_the_same_etags(databases: Databases, small_problems: None) -> None:
    with databases.database() as url, coordinator(url) as one, coordinator(url) as other:
        campaign = submit(one, ball(simulations=20))
        path = f"campaigns/{campaign}/progress"
        _, etag = get_tagged(one, path)
        assert get_again(other, path, etag).status_code == 304
        expect(other.post(f"{API}/campaigns/{campaign}/pause"))
        eventually(
            lambda: get_again(one, path, etag).status_code == 200,
            "the change made by the other coordinator is seen",
        )


def small_experiment(client: httpx.Client) -> str:
    body: dict[str, Any] = {
        "name": "small",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "random@1"}],
        "seeds": [1],
        "budget": {"simulations": 20},
    }
    return str(expect(client.post("/api/v1/experiments", json=body), 201)["id"])


def lease_one(client: httpx.Client, experiment: str) -> None:
    assert FakeWorker(client, id="worker-2").lease(max_jobs=1)


def submit_another(client: httpx.Client, experiment: str) -> None:
    small_experiment(client)


def pause(client: httpx.Client, experiment: str) -> None:
    expect(client.post(f"/api/v1/experiments/{experiment}/pause"))


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("/workers", lease_one),
        ("/jobs", lease_one),
        ("/jobs?status=leased", lease_one),
        ("/jobs/counts", lease_one),
        ("/experiments", submit_another),
        ("/experiments/{experiment}", pause),
        ("/experiments/{experiment}/progress", lease_one),
    ],
)
def test_etag_changes_only_when_the_answer_does(
    client: httpx.Client, path: str, change: Callable[[httpx.Client, str], None]
) -> None:
    experiment = small_experiment(client)
    FakeWorker(client).lease(max_jobs=1)
    url = f"/api/v1{path.format(experiment=experiment)}"
    first = client.get(url)
    expect(first)
    known = {"If-None-Match": first.headers["ETag"]}
    get_again = client.get(url, headers=known)
    assert (get_again.status_code, get_again.content) == (304, b"")
    assert get_again.headers["ETag"] == first.headers["ETag"]
    change(client, experiment)
    later = client.get(url, headers=known)
    expect(later)
    assert later.headers["ETag"] != first.headers["ETag"]
    assert later.json() != first.json()


@pytest.mark.parametrize(
    ("known", "status"),
    [("{tag}", 304), ("W/{tag}", 304), ('"other", W/{tag}', 304), ("*", 304), ('"other"', 200), ("", 200)],
)
def test_if_none_match_is_accepted_as_proxies_send_it(client: httpx.Client, known: str, status: int) -> None:
    submit(client, ball())
    tag = client.get("/api/v1/jobs").headers["ETag"]
    answer = client.get("/api/v1/jobs", headers={"If-None-Match": known.format(tag=tag)})
    assert answer.status_code == status
    assert bool(answer.content) == (status == 200)


NOBODY: dict[str, Any] = {"problem": {"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}}


def counts(client: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get("/api/v1/jobs/counts"))
    return found


def open_jobs(client: httpx.Client) -> set[tuple[str, str, str, str, int]]:
    found = counts(client)
    columns = (found[name] for name in ("status", "campaign", "kind", "needs", "jobs"))
    return set(zip(*columns, strict=True))


def listed(client: httpx.Client, **params: Any) -> list[int]:
    return [job["id"] for job in expect(client.get("/api/v1/jobs", params=params))["jobs"]]


def crashes(job: LeasedJob) -> JobFailed:
    return JobFailed(reason="crashed", message="boom")


def test_open_jobs_are_counted_by_status_campaign_and_simulator(client: httpx.Client) -> None:
    first = submit(client, ball(name="first", simulations=20, execution={"max_attempts": 1, "cache": False}))
    second = submit(client, ball(name="second", seed=2, **NOBODY))
    assert open_jobs(client) == {
        ("queued", first, "episode", SIMULATOR, 20),
        ("queued", second, "episode", "nobody-has-it@1", 20),
    }
    worker = FakeWorker(client)
    done, held = worker.lease(max_jobs=2), worker.lease(max_jobs=3)
    worker.report(done)
    broken = FakeWorker(client, id="worker-2", judge=crashes)
    broken.report(broken.lease(max_jobs=1))
    assert len(held) == 3
    assert open_jobs(client) == {
        ("queued", first, "episode", SIMULATOR, 14),
        ("leased", first, "episode", SIMULATOR, 3),
        ("quarantined", first, "episode", SIMULATOR, 1),
        ("queued", second, "episode", "nobody-has-it@1", 20),
    }
    found = counts(client)
    assert (found["campaigns"], found["ended"]) == ({first: "first", second: "second"}, [])
    expect(client.post(f"/api/v1/campaigns/{first}/cancel"))
    assert ("quarantined", first, "episode", SIMULATOR, 1) in open_jobs(client)
    assert counts(client)["ended"] == [first]


def test_jobs_are_listed_by_status_in_order_across_campaigns(client: httpx.Client) -> None:
    first = submit(client, ball(simulations=20, execution={"cache": False}))
    second = submit(client, ball(seed=2, simulations=20, execution={"cache": False}))
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=5))
    held = sorted(job.job for job in worker.lease(max_jobs=4))
    everything = listed(client, limit=1000)
    assert len(everything) == 40
    assert listed(client, status="leased") == held
    done = listed(client, status="done")
    waiting = [job for job in everything if job not in (*held, *done)]
    assert listed(client, status="queued") == waiting
    assert listed(client, status=["leased", "queued"]) == sorted([*held, *waiting])
    assert listed(client, status=["leased", "queued", "done"]) == everything
    assert listed(client, status="quarantined") == []
    page = expect(client.get("/api/v1/jobs", params={"status": ["leased", "queued"], "limit": 7}))
    assert [job["id"] for job in page["jobs"]] == sorted([*held, *waiting])[:7]
    rest = listed(client, status=["leased", "queued"], after=page["next"])
    assert rest == sorted([*held, *waiting])[7:]
    ours = [job["id"] for job in expect(client.get("/api/v1/jobs", params={"campaign": first}))["jobs"]]
    assert listed(client, status="queued", campaign=first) == [job for job in waiting if job in ours]
    assert listed(client, status="queued", campaign=second) == [job for job in waiting if job not in ours]
