"""Campaigns of scripted traffic that an older version began: shown as they were, not continued."""

from typing import Any

import httpx
import pytest
from sqlalchemy import select, update
from support.api import coordinator, eventually, expect, progress, submit
from support.traffic import traffic_worker

from brink.search.algorithms.mumoea import Mumoea
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow

API = "/api/v1/campaigns"


def traffic(**problem: Any) -> dict[str, Any]:
    return {
        "name": "traffic",
        "problem": {"id": "npc-actions@1", "params": {"participants": 2, "duration_s": 5.0, **problem}},
        "algorithm": {"id": "mumoea@1", "params": {"population_size": 8, "seeds": 3}},
        "budget": {"simulations": 24},
        "seed": 1,
    }


def make_older(engines: Engines, campaign: str) -> None:
    """Store a campaign as older versions did: without the parameter `distance`, and with any criticality."""
    table = CampaignRow.__table__
    with engines.writer.begin() as connection:
        document = connection.execute(select(table.c.document).where(table.c.id == campaign)).scalar_one()
        del document["algorithm"]["params"]["distance"]
        document["problem"]["params"] |= {"violation": "speed-limit@1", "criticality": "gap"}
        connection.execute(update(CampaignRow).where(table.c.id == campaign).values(document=document))


def test_a_finished_campaign_keeps_the_distance_and_the_criticality_that_it_had(
    client: httpx.Client, engines: Engines
) -> None:
    campaign = submit(client, traffic())
    assert traffic_worker(client).work(campaign)["status"] == "finished"
    body = expect(client.get(f"{API}/{campaign}"))["body"]
    assert body["algorithm"]["params"]["distance"] == "time"
    assert body["problem"]["params"]["criticality"] == "auto"
    make_older(engines, campaign)
    body = expect(client.get(f"{API}/{campaign}"))["body"]
    assert body["algorithm"]["params"]["distance"] == "paper"
    assert body["problem"]["params"]["criticality"] == "gap"
    assert expect(client.get(f"{API}/{campaign}/violations"))["types"]
    # Its solutions can be simulated again, although no search may be led by that gap any more.
    expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 2, "t_b": 1.0, "d_th": 0.05}), 201)


def test_an_unfinished_campaign_is_paused_and_says_why(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as older, coordinator(database_url) as client:
        older.setattr(Mumoea, "layout", 2)
        campaign = submit(client, traffic())
        stands = traffic_worker(client).work(campaign, until=lambda stands: bool(stands["generations"]))
        assert (stands["status"], len(stands["generations"])) == ("running", 1)
    with coordinator(database_url) as client:
        traffic_worker(client).report_all()
        eventually(lambda: bool(progress(client, campaign)["status"] == "paused"), "it is paused")
        reason = progress(client, campaign)["status_reason"]
    assert "mumoea@1 has changed since this campaign began" in reason
    assert "continue with the version of Brink that began it, or submit it again" in reason


@pytest.mark.parametrize("violation", ["lane-keeping@1", "red-light@1", "speed-limit@1", "progress@1"])
def test_a_search_by_a_gap_that_says_nothing_about_the_requirement_is_refused(
    client: httpx.Client, violation: str
) -> None:
    answer = expect(client.post(API, json=traffic(violation=violation, criticality="gap")), 422)
    (error,) = answer["errors"]
    assert error["pointer"] == "/problem/params/criticality"
    assert (
        error["message"]
        == f"expected auto or robustness: the gap to road users is not meaningful for {violation}"
    )
    by_elites = {**traffic(violation=violation, criticality="gap"), "algorithm": {"id": "qd@1"}}
    expect(client.post(API, json=by_elites), 422)
    submit(client, traffic(violation=violation))
    # Random search does not minimise anything.
    at_random = {**traffic(violation=violation, criticality="gap"), "algorithm": {"id": "random@1"}}
    submit(client, at_random)
