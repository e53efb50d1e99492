"""Pairs of any campaign are brought to thresholds."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, listening_coordinator
from support.databases import Databases
from support.problems import small_problems
from support.sweep import by_seed
from typer.testing import CliRunner

from brink.cli.commands import app

API = "/api/v1/campaigns"
PAIRS = {"eps": 0.1, "d_th": 0.1}
LIMIT = 6


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), listening_coordinator(url) as opened:
        yield opened


def submit(client: httpx.Client, **changes: Any) -> str:
    algorithm = {"id": "random@1", "params": {"generation_size": 20}}
    campaign: str = expect(client.post(API, json=ball(simulations=120, algorithm=algorithm, **changes)), 201)[
        "id"
    ]
    assert FakeWorker(client, judge=by_seed).work(campaign)["status"] == "finished"
    return campaign


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    return submit(client)


@pytest.fixture(scope="module")
def offer(client: httpx.Client, campaign: str) -> dict[str, Any]:
    offers = expect(client.get(f"{API}/{campaign}/pairs", params=PAIRS | {"limit": LIMIT}))["offers"]
    (found,) = [one for one in offers if one["kind"] == "sharpen"]
    return dict(found)


@pytest.fixture(scope="module")
def sharpened(client: httpx.Client, campaign: str, offer: dict[str, Any]) -> dict[str, Any]:
    """Return the follow-up that sharpened the first pairs."""
    asked = {"kind": "sharpen", "limit": LIMIT, **PAIRS}
    found = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json=asked), 201)
    assert FakeWorker(client, judge=by_seed).work(found["campaign"])["status"] == "finished"
    return dict(found)


def test_the_thresholds_lie_where_the_radius_is(client: httpx.Client, sharpened: dict[str, Any]) -> None:
    finding = expect(client.get(f"{API}/{sharpened['campaign']}/findings/thresholds"))
    found = [one for one in finding["view"]["thresholds"] if one["outcome"] == "threshold"]
    assert len(found) >= 2
    for one in found:
        held = float(one["held"].split()[1])
        truth = (1.0 - held**2) ** 0.5
        assert one["middle"] is not None
        assert abs(abs(one["middle"]) - truth) < 0.15, one
        assert one["drives"] >= 12


def test_a_follow_up_is_introduced_by_its_own_finding(
    client: httpx.Client, campaign: str, sharpened: dict[str, Any]
) -> None:
    found = expect(client.get(f"{API}/{sharpened['campaign']}/findings"))
    assert " threshold" in found["words"]
    assert found["of"] == {"campaign": campaign, "name": "ball", "kind": "sharpen"}
    assert found["findings"][0]["kind"] == "thresholds"


def test_it_costs_no_more_than_was_offered(
    client: httpx.Client, offer: dict[str, Any], sharpened: dict[str, Any]
) -> None:
    state = expect(client.get(f"{API}/{sharpened['campaign']}"))
    assert (offer["exact"], offer["reason"], offer["repeats"]) == (False, "", None)
    assert state["simulations"] <= sharpened["budget"] <= offer["simulations"]


def test_the_same_question_is_asked_once(
    client: httpx.Client, campaign: str, sharpened: dict[str, Any]
) -> None:
    asked = {"kind": "sharpen", "limit": LIMIT, **PAIRS}
    again = expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json=asked))
    assert again["campaign"] == sharpened["campaign"]


def test_the_command_shows_the_thresholds_below_the_pairs(
    client: httpx.Client, campaign: str, sharpened: dict[str, Any]
) -> None:
    words = ["pairs", campaign, "--sharpen", "--limit", str(LIMIT), "--eps", "0.1", "--d-th", "0.1"]
    ran = CliRunner().invoke(app, [*words, "--server", str(client.base_url)])
    assert ran.exit_code == 0, ran.output
    text = " ".join(ran.output.split())
    assert "Thresholds: " in text
    assert f"findings {sharpened['campaign']} thresholds --picture thresholds.png" in text
