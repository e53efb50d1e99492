"""What the dashboard asks for: columnar, tagged, and news that nobody can miss."""

import json

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, ball, coordinator, eventually, expect, progress, submit
from support.databases import Databases

API = "/api/v1"
FILE = "name: checked\nproblem: {id: ball@1}\nalgorithm: {id: random@1}\nbudget: {simulations: 20}\n"


def finished(client: httpx.Client, **changes: object) -> str:
    campaign = submit(client, ball(**changes))  # type: ignore[arg-type]
    FakeWorker(client).work(campaign)
    return campaign


def tagged(client: httpx.Client, path: str) -> tuple[object, str]:
    answer = client.get(f"{API}/{path}")
    return expect(answer), answer.headers["etag"]


def again(client: httpx.Client, path: str, etag: str) -> httpx.Response:
    return client.get(f"{API}/{path}", headers={"If-None-Match": etag})


def test_an_idle_campaign_costs_an_answer_without_a_body(client: httpx.Client) -> None:
    campaign = finished(client)
    for part in ("progress", "map", "course?t_b=0.2&d_th=0.1", "dependence"):
        path = f"campaigns/{campaign}/{part}"
        _, etag = tagged(client, path)
        answer = again(client, path, etag)
        assert answer.status_code == 304, part
        assert answer.content == b""
        assert sum(len(name) + len(value) + 4 for name, value in answer.headers.raw) < 500


def test_the_sequence_grows_with_every_change_and_the_tag_with_it(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=40))
    path = f"campaigns/{campaign}/progress"
    seen = []
    for steer in (None, "pause", "resume", "cancel"):
        if steer:
            expect(client.post(f"{API}/campaigns/{campaign}/{steer}"))
        told, etag = tagged(client, path)
        assert isinstance(told, dict)
        seen.append((told["sequence"], etag))
        assert again(client, path, etag).status_code == 304
    assert len({etag for _, etag in seen}) == len(seen)
    assert [sequence for sequence, _ in seen] == sorted({sequence for sequence, _ in seen})


def test_what_workers_do_within_a_generation_is_news_though_nothing_is_told(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=40))
    path = f"campaigns/{campaign}/progress"
    told, etag = tagged(client, path)
    worker = FakeWorker(client)
    worker.lease(3)
    leased, later = tagged(client, path)
    assert again(client, path, etag).status_code == 200
    assert isinstance(told, dict)
    assert isinstance(leased, dict)
    assert (told["leased"], leased["leased"]) == (0, 3)
    assert later != etag


def test_the_overview_says_in_columns_where_each_campaign_stands(client: httpx.Client) -> None:
    done = finished(client, name="first one")
    waiting = submit(client, ball(seed=2, name="second_100%"))
    told, etag = tagged(client, "overview")
    assert isinstance(told, dict)
    assert told["id"] == [waiting, done]
    assert told["status"] == ["running", "finished"]
    assert told["simulations"] == [0, progress(client, done)["simulations"]]
    assert told["dbs"][1][-1] == progress(client, done)["generations"][-1]["dbs"]
    assert told["problem"] == ["ball@1", "ball@1"]
    assert again(client, "overview", etag).status_code == 304
    expect(client.post(f"{API}/campaigns/{waiting}/pause"))
    assert again(client, "overview", etag).status_code == 200


def test_campaigns_are_found_by_name_and_state(client: httpx.Client) -> None:
    finished(client, name="first one")
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


def test_pages_of_the_overview_follow_each_other(client: httpx.Client) -> None:
    made = [submit(client, ball(seed=seed)) for seed in range(5)]
    seen: list[str] = []
    cursor = None
    while True:
        page = expect(
            client.get(f"{API}/overview", params={"limit": 2, **({"cursor": cursor} if cursor else {})})
        )
        seen += page["id"]
        if (cursor := page["next"]) is None:
            break
    assert seen == made[::-1]


def test_the_map_brings_what_is_new_and_the_fitness_of_all(client: httpx.Client) -> None:
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


def test_the_map_tells_the_values_of_a_parameter(client: httpx.Client) -> None:
    campaign = finished(client)
    solutions = expect(client.get(f"{API}/campaigns/{campaign}/solutions", params={"limit": 5}))["solutions"]
    component, values = next(iter(solutions[0]["parameters"].items()))
    name = next(iter(values))
    by = expect(client.get(f"{API}/campaigns/{campaign}/map", params={"parameter": f"{component}.{name}"}))[
        "by"
    ]
    told = [one["parameters"][component][name] for one in solutions]
    assert by["values"][:5] == pytest.approx(told, abs=1e-3)
    wrong = client.get(f"{API}/campaigns/{campaign}/map", params={"parameter": f"{component}.nme"})
    assert expect(wrong, 422)["errors"][0]["pointer"] == "/query/parameter"


def test_the_course_ends_where_the_boundary_stands(client: httpx.Client) -> None:
    campaign = finished(client)
    asked = {"t_b": 0.9, "d_th": 0.05}
    course = expect(client.get(f"{API}/campaigns/{campaign}/course", params=asked))
    boundary = expect(client.get(f"{API}/campaigns/{campaign}/boundary", params=asked))
    assert (course["dbs"][-1], course["strict_dbs"][-1]) == (boundary["dbs"], boundary["strict_dbs"])
    assert (np.diff(course["simulations"]) > 0).all()


def test_a_campaign_without_a_verdict_has_an_empty_map_and_no_course(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    assert expect(client.get(f"{API}/campaigns/{campaign}/map"))["number"] == []
    assert expect(client.get(f"{API}/campaigns/{campaign}/course"))["simulations"] == []
    assert expect(client.get(f"{API}/campaigns/{campaign}/dependence"))["evaluated"] == 0


def test_a_campaign_file_is_checked_and_nothing_is_stored(client: httpx.Client) -> None:
    headers = {"Content-Type": "application/yaml"}
    body = expect(client.post(f"{API}/campaigns/check", content=FILE, headers=headers))
    assert (body["name"], body["budget"], body["seed"]) == ("checked", {"simulations": 20}, 1)
    assert (
        expect(client.post(f"{API}/campaigns/check", content=json.dumps(ball()), headers=headers))["seed"]
        == 1
    )
    assert expect(client.get(f"{API}/overview"))["id"] == []


def test_a_wrong_campaign_file_is_answered_with_where_and_what(client: httpx.Client) -> None:
    for text, pointer, words in (
        ("name: [", "", "line 1"),
        ("name: x\nname: y", "", "given twice"),
        ("a: 2024-13-45", "", "not YAML"),
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


def test_two_coordinators_tell_the_same_news(databases: Databases, small_problems: None) -> None:
    with databases.database() as url, coordinator(url) as one, coordinator(url) as other:
        campaign = submit(one, ball(simulations=20))
        path = f"campaigns/{campaign}/progress"
        _, etag = tagged(one, path)
        assert again(other, path, etag).status_code == 304
        expect(other.post(f"{API}/campaigns/{campaign}/pause"))
        eventually(lambda: again(one, path, etag).status_code == 200, "the other's change is seen")
