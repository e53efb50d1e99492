"""A campaign through the REST API, from its submission to its archive."""

import httpx
from support.api import FakeWorker, ball, submit


def test_a_campaign_finishes_and_shows_what_it_found(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    done = FakeWorker(client).work(campaign)
    assert done["status"] == "finished"
    assert done["evaluated"] >= 60
    print(done)
