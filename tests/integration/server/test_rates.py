"""Rates count simulations alone, and nobody is told a time left that waiting makes nonsense of."""

from datetime import timedelta

import httpx
import pytest
from sqlalchemy import create_engine, select, update
from support.api import FakeWorker, ball, coordinator, eventually, expect, finish, progress, submit

from brink.server.db.models import CampaignRow, JobRow


def test_results_from_the_cache_are_counted_apart(client: httpx.Client) -> None:
    first = progress(client, finish(client, ball()))
    assert first["cached"] == 0
    assert first["rate_per_s"] > 0
    again = submit(client, ball(name="again"))
    eventually(lambda: progress(client, again)["status"] == "finished", "the cache answers")
    found = progress(client, again)
    assert found["cached"] == found["simulations"] == first["simulations"]
    assert found["rate_per_s"] is None, "nothing was simulated"


def test_results_from_the_cache_are_no_rate_of_an_experiment(client: httpx.Client) -> None:
    body = {
        "name": "small", "problems": [{"name": "ball", "id": "ball@1"}],
        "algorithms": [{"name": "GA", **ball()["algorithm"]}], "seeds": [1], "budget": {"simulations": 60},
    }  # fmt: skip
    found = []
    for name in ("first", "again"):
        experiment = expect(client.post("/api/v1/experiments", json={**body, "name": name}), 201)
        worker, path = FakeWorker(client), f"/api/v1/experiments/{experiment['id']}/progress"
        [member] = experiment["members"]
        worker.work(member["campaign"])
        found.append(expect(client.get(path)))
    assert found[0]["cached"] == 0
    assert found[0]["rate_per_s"] > 0
    assert found[1]["cached"] == found[1]["simulations"]
    assert found[1]["rate_per_s"] is None


def test_a_paused_campaign_has_no_time_left(client: httpx.Client) -> None:
    campaign, worker = submit(client, ball()), FakeWorker(client)
    worker.report(worker.lease(max_jobs=8))
    assert progress(client, campaign)["remaining_s"] > 0
    expect(client.post(f"/api/v1/campaigns/{campaign}/pause"))
    assert progress(client, campaign)["remaining_s"] is None


@pytest.mark.parametrize("unit", ["campaign", "experiment"])
def test_waiting_for_a_worker_has_no_time_left(database_url: str, small_problems: None, unit: str) -> None:
    with coordinator(database_url, worker_seen_s=0.2) as client:
        if unit == "campaign":
            path = f"/api/v1/campaigns/{submit(client, ball())}/progress"
        else:
            body = {
                "name": "e", "problems": [{"name": "ball", "id": "ball@1"}],
                "algorithms": [{"name": "GA", **ball()["algorithm"]}], "seeds": [1], "budget": {"simulations": 60},
            }  # fmt: skip
            path = f"/api/v1/experiments/{expect(client.post('/api/v1/experiments', json=body), 201)['id']}/progress"
        worker = FakeWorker(client)
        worker.report(worker.lease(max_jobs=8))
        eventually(lambda: expect(client.get(path))["workers"] == 0, "the worker counts as gone")
        found = expect(client.get(path))
        assert (found["leased"], found["remaining_s"]) == (0, None)
        assert found["queued"] > 0


def test_time_before_the_first_worker_is_no_part_of_the_rate(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    waited = progress(client, campaign)["elapsed_s"]
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=1))
    worker.report(worker.lease(max_jobs=8))
    found = progress(client, campaign)
    assert waited > 0
    assert found["rate_per_s"] > (found["simulations"] - 1) / (found["elapsed_s"] - waited)


def test_a_break_is_no_part_of_the_rate(client: httpx.Client, database_url: str) -> None:
    campaign, worker = submit(client, ball()), FakeWorker(client)
    worker.report(worker.lease(max_jobs=8))
    a_day = timedelta(days=1)
    engine = create_engine(database_url)
    with engine.begin() as connection:
        for row in connection.execute(
            select(JobRow.id, JobRow.finished_at).where(JobRow.finished_at.is_not(None))
        ):
            earlier = row.finished_at - a_day
            connection.execute(update(JobRow).where(JobRow.id == row.id).values(finished_at=earlier))
        created_at = connection.execute(select(CampaignRow.created_at)).scalar_one() - a_day
        connection.execute(update(CampaignRow).values(created_at=created_at))
    engine.dispose()
    assert progress(client, campaign)["rate_per_s"] < 1
    for _ in range(3):
        worker.report(worker.lease(max_jobs=1))
    found = progress(client, campaign)
    assert found["simulations"] == 11
    assert found["rate_per_s"] > 1
    assert found["cached"] == 0
