"""Rates count simulations alone, and nobody is told a time left that waiting makes nonsense of."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

import httpx
import pytest
from sqlalchemy import create_engine, select, update
from support.api import FakeWorker, ball, coordinator, eventually, expect, finish, progress, submit

from brink.server.campaigns.view_store import first_after_break
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
                "name": "e",
                "problems": [{"name": "ball", "id": "ball@1"}],
                "algorithms": [{"name": "GA", **ball()["algorithm"]}],
                "seeds": [1],
                "budget": {"simulations": 60},
            }
            path = f"/api/v1/experiments/{expect(client.post('/api/v1/experiments', json=body), 201)['id']}/progress"
        worker = FakeWorker(client)
        worker.report(worker.lease(max_jobs=8))
        eventually(lambda: expect(client.get(path))["workers"] == 0, "the worker counts as gone")
        found = expect(client.get(path))
        assert (found["leased"], found["remaining_s"]) == (0, None)
        assert found["queued"] > 0


@pytest.mark.parametrize(("since_s", "rate"), [([], None), ([60.0], None), ([60.0, 40.0, 20.0, 0.0], 0.05)])
def test_a_break_is_no_part_of_the_rate(
    client: httpx.Client, database_url: str, since_s: list[float], rate: float | None
) -> None:
    campaign, worker = submit(client, ball()), FakeWorker(client)
    worker.report(worker.lease(max_jobs=4 + len(since_s)))
    a_day_s = 24 * 3600.0
    ago_s = [a_day_s + 60.0, a_day_s + 40.0, a_day_s + 20.0, a_day_s, *since_s]
    engine, now = create_engine(database_url), datetime.now(UTC)
    with engine.begin() as connection:
        jobs = connection.execute(
            select(JobRow.id).where(JobRow.finished_at.is_not(None)).order_by(JobRow.id)
        )
        for job, ago in zip(jobs.scalars().all(), ago_s, strict=True):
            ended = now - timedelta(seconds=ago)
            connection.execute(update(JobRow).where(JobRow.id == job).values(finished_at=ended))
        connection.execute(update(CampaignRow).values(created_at=now - timedelta(seconds=2 * a_day_s)))
    engine.dispose()
    found = progress(client, campaign)
    assert found["simulations"] == len(ago_s)
    assert found["rate_per_s"] == (None if rate is None else pytest.approx(rate, rel=0.3))


def test_a_break_is_by_far_the_longest_time_without_results() -> None:
    begin = datetime(2026, 1, 1, tzinfo=UTC)

    def place(seconds: Iterable[float], end_s: float) -> int | None:
        times = [begin + timedelta(seconds=second) for second in seconds]
        return first_after_break(times, begin + timedelta(seconds=end_s))

    night_s = 36_000.0
    assert place([*range(50), *(night_s + second for second in range(1_000))], night_s + 1_001) == 50
    assert place(range(50), night_s) == 50, "nothing has come since"
    assert place(range(50), 60.0) is None
    bursts = [400.0 * burst + 0.1 * job for burst in range(4) for job in range(32)]
    assert place(bursts, 1_500.0) is None, "long episodes that end together"
    assert place([0.0, 1_000.0, 2_000.0], 2_100.0) is None, "long episodes"
    assert place([], night_s) is None
