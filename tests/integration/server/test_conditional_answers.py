"""Answers with tags: who has one already is told so, and is sent the next as soon as something changes."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, submit


def small_experiment(client: httpx.Client) -> str:
    body: dict[str, Any] = {
        "name": "small", "problems": [{"id": "ball@1"}], "algorithms": [{"id": "random@1"}], "seeds": [1],
        "budget": {"simulations": 20},
    }  # fmt: skip
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
def test_an_answer_is_sent_again_only_when_something_changed(
    client: httpx.Client, path: str, change: Callable[[httpx.Client, str], None]
) -> None:
    experiment = small_experiment(client)
    FakeWorker(client).lease(max_jobs=1)
    url = f"/api/v1{path.format(experiment=experiment)}"
    first = client.get(url)
    expect(first)
    known = {"If-None-Match": first.headers["ETag"]}
    again = client.get(url, headers=known)
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["ETag"] == first.headers["ETag"]
    change(client, experiment)
    later = client.get(url, headers=known)
    expect(later)
    assert later.headers["ETag"] != first.headers["ETag"]
    assert later.json() != first.json()


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    ("known", "status"),
    [("{tag}", 304), ("W/{tag}", 304), ('"other", W/{tag}', 304), ("*", 304), ('"other"', 200), ("", 200)],
)
def test_tags_are_known_as_proxies_pass_them_on(client: httpx.Client, known: str, status: int) -> None:
    submit(client, ball())
    tag = client.get("/api/v1/jobs").headers["ETag"]
    answer = client.get("/api/v1/jobs", headers={"If-None-Match": known.format(tag=tag)})
    assert answer.status_code == status
    assert bool(answer.content) == (status == 200)


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_another_question_has_another_tag(client: httpx.Client) -> None:
    submit(client, ball())
    tag = client.get("/api/v1/jobs", params={"limit": 3}).headers["ETag"]
    assert client.get("/api/v1/jobs", params={"limit": 4}, headers={"If-None-Match": tag}).status_code == 200
