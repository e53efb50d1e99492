"""What each campaign found, in a few words in the list of campaigns."""

import time
from threading import Event
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, eventually, expect, finish, listening_coordinator, perturbed, submit
from support.databases import Databases, sqlite_then_postgres
from support.problems import small_problems
from support.tolerance import body as tolerance
from support.tolerance import judge
from support.traffic import traffic_worker

from brink.search.deadline import check_time
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.store import Campaign
from brink.server.dashboard import found
from brink.server.findings.kind import Listed
from brink.server.findings.pairs.kind import PairsKind

pytestmark = [
    pytest.mark.long("the words of the list of campaigns"),
    pytest.mark.usefixtures("few_trees", "smaller_library"),
]

API = "/api/v1"
EDGE = {"id": "edge@1", "params": {"eps": 0.3, "d_th": 0.1}}


def column(client: httpx.Client, name: str = "found", **params: Any) -> dict[str, Any]:
    """Return a column of the overview by campaign, once everything has been worked out."""
    read: dict[str, Any] = {}

    def known() -> bool:
        read.update(expect(client.get(f"{API}/overview", params=params)))
        return None not in read["found"]

    eventually(known, "the words are worked out")
    return dict(zip(read["id"], read[name], strict=True))


def test_pairs_are_counted_and_then_how_many_of_them_hold(client: httpx.Client) -> None:
    campaign = finish(client, ball(name="edge", algorithm=EDGE))
    pairs = expect(client.get(f"{API}/campaigns/{campaign}/pairs"))["distinct"]
    assert pairs > 1
    assert column(client) == {campaign: f"{pairs} pairs"}
    again = expect(client.post(f"{API}/campaigns/{campaign}/pairs/follow-ups", json={"kind": "confirm"}), 201)
    FakeWorker(client).work(again["campaign"])
    held = expect(client.get(f"{API}/campaigns/{campaign}/pairs"))["confirmed"]
    eventually(
        lambda: column(client)[campaign] == f"{held} of {pairs} pairs hold",
        "the follow-up is taken into account",
    )
    assert column(client)[again["campaign"]] == ""


@sqlite_then_postgres
def test_tolerances_violations_and_combinations_are_counted(client: httpx.Client) -> None:
    tolerances = submit(client, tolerance(simulations=400))
    FakeWorker(client, capabilities=("brink-drive-errors@2",), judge=judge).work(tolerances)
    traffic = {
        "name": "traffic",
        "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 12.0}},
        "algorithm": {"id": "mumoea@1", "params": {"population_size": 20}},
        "budget": {"simulations": 40},
    }
    violations = submit(client, traffic)
    traffic_worker(client).work(violations)
    types = expect(client.get(f"{API}/campaigns/{violations}/violations"))["types"]
    chains = finish(
        client, ball(simulations=40, problem={"id": "slotted@1"}, algorithm={"id": "random@1"}), perturbed
    )
    found = column(client)
    assert found[tolerances] == "8 tolerances"
    avoidable = sum(kind["avoidable"] == "careful" for kind in types)
    assert found[violations] == f"{avoidable} of {len(types)} types of violations avoidable"
    assert "hazardous chain" in found[chains]


def test_a_list_that_polls_works_nothing_out_twice_and_waits_for_nothing(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = finish(client, ball(name="edge", algorithm=EDGE))
    restored: list[str] = []
    listed = Event()
    stored = Archives.stored

    def counted(self: Archives, campaign: Campaign) -> Any:
        assert listed.wait(30.0)
        restored.append(campaign.id)
        return stored(self, campaign)

    monkeypatch.setattr(Archives, "stored", counted)
    first = client.get(f"{API}/overview")
    assert expect(first)["found"] == [None]
    listed.set()
    column(client)
    etag = client.get(f"{API}/overview").headers["etag"]
    assert etag != first.headers["etag"]
    for _ in range(3):
        assert client.get(f"{API}/overview", headers={"If-None-Match": etag}).status_code == 304
    expect(client.patch(f"{API}/campaigns/{campaign}", json={"tags": ["night"]}))
    assert expect(client.get(f"{API}/overview"))["found"][0].endswith("pairs"), "earlier words stay meanwhile"
    eventually(lambda: column(client)[campaign].endswith("pairs"), "they are worked out again")
    assert restored == [campaign]


def test_what_cannot_be_told_is_left_out(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    campaign = finish(client, ball(name="edge", algorithm=EDGE))

    def fails(self: PairsKind, listed: Listed) -> str:
        raise OSError("the disk is gone")

    monkeypatch.setattr(PairsKind, "brief", fails)
    assert column(client) == {campaign: ""}
    assert "its finding cannot be computed" in caplog.text


def test_what_takes_too_long_to_tell_is_ended_and_left_out(
    databases: Databases, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def endless(self: PairsKind, listed: Listed) -> str:
        while True:
            check_time()
            time.sleep(0.01)

    monkeypatch.setattr(PairsKind, "brief", endless)
    monkeypatch.setattr(found, "LIMIT_S", 0.2)
    with databases.database() as url, small_problems(), listening_coordinator(url) as client:
        campaign = finish(client, ball(name="edge", algorithm=EDGE))
        assert column(client) == {campaign: ""}
    assert "takes too long to compute" in caplog.text
