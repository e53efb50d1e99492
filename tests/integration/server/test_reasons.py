"""Why something failed is stored, whatever the exception of a plug-in says."""

import pytest
from sqlalchemy import select
from support.databases import sqlite_then_postgres
from support.queue import Queue

from brink.server.campaigns.store import set_status
from brink.server.db.engine import open_engines
from brink.server.db.models import CampaignRow
from brink.server.db.types import LONGEST_REASON
from brink.server.states import CampaignStatus


@sqlite_then_postgres
@pytest.mark.parametrize(
    ("said", "stored"),
    [
        ("a file named \udcff", r"a file named \udcff"),
        ("a\0b", r"a\u0000b"),
        ("x" * 1_000_000, "x" * (LONGEST_REASON - 1) + "…"),
        ("line\n\x1b[2J\u202e", "line\n\x1b[2J\u202e"),
    ],
)
def test_a_reason_is_stored_whatever_it_says(database_url: str, said: str, stored: str) -> None:
    queue = Queue(engines=open_engines(database_url))
    try:
        campaign = queue.campaign(1)
        with queue.engines.writer.begin() as connection:
            set_status(connection, campaign, CampaignStatus.PAUSED, said)
        with queue.engines.reader.connect() as connection:
            assert connection.execute(select(CampaignRow.status_reason)).scalar_one() == stored
    finally:
        queue.engines.dispose()
