"""Searches that are dropped from memory between their steps, and restored."""

import logging

import pytest
from support.api import FakeWorker, ball, coordinator, submit, undisturbed_digest

BODIES = [ball(seed=seed) for seed in (1, 2)]


@pytest.mark.parametrize(("limit_mib", "restored"), [(0, True), (1024, False)])
def test_campaigns_that_alternate_reach_the_same_archives_whether_or_not_they_fit_into_memory(
    database_url: str, small_problems: None, caplog: pytest.LogCaptureFixture, limit_mib: int, restored: bool
) -> None:
    caplog.set_level(logging.INFO, logger="brink.server.campaigns.advance")
    with coordinator(database_url, live_searches_mib=limit_mib) as client:
        campaigns = [submit(client, body) for body in BODIES]
        worker = FakeWorker(client)
        digests = [worker.work(campaign)["digest"] for campaign in campaigns]
        metrics = client.get("/metrics").text
    assert digests == [undisturbed_digest(body) for body in BODIES]
    messages = [record.getMessage() for record in caplog.records]
    assert ("campaign restored" in messages) is restored
    assert ("search dropped from memory" in messages) is restored
    assert "brink_live_searches 0.0" in metrics
