"""The SQL of calls of language models, and of who is asking now."""

import logging
import threading
import time
from datetime import timedelta
from typing import Final

from sqlalchemy import Connection, delete, insert, select

from brink.server.db.engine import Engines
from brink.server.db.models import LlmCallRow, SeedClaimRow
from brink.server.db.sql import database_now, lock_campaign
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.llm.budget import Budget
from brink.server.llm.calls import CallKey, Outcome, StoredCall, spent_on
from brink.server.llm.wire import Mode, Usage

STORES_AGAIN_S: Final = 2.0
GIVES_UP_S: Final = 600.0
"""For how long a paid answer waits for a database that takes no writes."""

log = logging.getLogger(__name__)


def list_calls(connection: Connection, campaign_id: str, key: CallKey | None = None) -> list[StoredCall]:
    """Return the calls of a campaign in the order of asking, or the one with a key."""
    query = (
        select(LlmCallRow.__table__)
        .where(LlmCallRow.campaign_id == campaign_id)
        .order_by(LlmCallRow.request, LlmCallRow.turn)
    )
    if key is not None:
        query = query.where(LlmCallRow.request == key.request, LlmCallRow.turn == key.turn)
    return [
        StoredCall(
            key=CallKey(row.request, row.turn), prompt_hash=row.prompt_hash, mode=Mode(row.mode), raw=row.reply,
            outcome=Outcome(row.outcome), calls=row.calls,
            usage=None
            if row.prompt_tokens is None
            else Usage(
                prompt_tokens=row.prompt_tokens, completion_tokens=row.completion_tokens,
                estimated=row.estimated,
            ),
            cost=row.cost, latency_s=row.latency_s, error=row.error,
        )
        for row in connection.execute(query)
    ]  # fmt: skip


def insert_call(connection: Connection, campaign_id: str, call: StoredCall) -> None:
    """Store a call, in the place of what was stored while it was under way."""
    usage = call.usage
    connection.execute(
        delete(LlmCallRow).where(
            LlmCallRow.campaign_id == campaign_id,
            LlmCallRow.request == call.key.request,
            LlmCallRow.turn == call.key.turn,
            LlmCallRow.outcome == Outcome.SENT,
        )
    )
    connection.execute(
        insert(LlmCallRow).values(
            campaign_id=campaign_id, request=call.key.request, turn=call.key.turn,
            prompt_hash=call.prompt_hash, mode=call.mode, reply=call.raw, outcome=call.outcome,
            calls=call.calls, prompt_tokens=None if usage is None else usage.prompt_tokens,
            completion_tokens=None if usage is None else usage.completion_tokens,
            estimated=usage is not None and usage.estimated, cost=call.cost, latency_s=call.latency_s,
            error=call.error, called_at=database_now(connection),
        )
    )  # fmt: skip


def claim(connection: Connection, campaign_id: str, owner: str, hold_s: float) -> bool:
    """Take or keep the right to ask for a campaign's seeds; return whether it was free, expired or held already."""
    # The campaign's row, since a claim that is not there yet cannot be locked: two could find none and both take it.
    if not lock_campaign(connection, campaign_id):
        return False
    now = database_now(connection)
    mine = SeedClaimRow.campaign_id == campaign_id
    held = connection.execute(select(SeedClaimRow.__table__).where(mine)).one_or_none()
    if held is not None and held.owner != owner and held.expires_at > now:
        return False
    connection.execute(delete(SeedClaimRow).where(mine))
    connection.execute(
        insert(SeedClaimRow).values(
            campaign_id=campaign_id, owner=owner, expires_at=now + timedelta(seconds=hold_s)
        )
    )
    return True


def release(connection: Connection, owner: str, campaign_id: str | None = None) -> None:
    """Give the right up, for one campaign or for all."""
    claims = delete(SeedClaimRow).where(SeedClaimRow.owner == owner)
    connection.execute(
        claims if campaign_id is None else claims.where(SeedClaimRow.campaign_id == campaign_id)
    )


class CampaignCalls:
    """The calls of one campaign in the database; implements `brink.server.llm.calls.CallLog`.

    Args:
        engines: To read with.
        writer: To write with.
        campaign_id: Whose calls.
        stopping: Set when the coordinator stops: nothing waits for the database any more.
    """

    def __init__(self, engines: Engines, writer: Writer, campaign_id: str, stopping: threading.Event) -> None:
        self._engines = engines
        self._writer = writer
        self._campaign_id = campaign_id
        self._stopping = stopping

    def every(self) -> list[StoredCall]:
        """Return all calls, in the order of asking."""
        with self._engines.reader.connect() as connection:
            return list_calls(connection, self._campaign_id)

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        with self._engines.reader.connect() as connection:
            found = list_calls(connection, self._campaign_id, key)
        return found[0] if found else None

    def store(self, call: StoredCall) -> None:
        """Store a call, for good, before returning; what was paid for waits while nothing can be written.

        Raises:
            Unavailable: Nothing could be written for a long time, or until the coordinator stopped.
        """
        until = time.monotonic() + GIVES_UP_S
        while True:
            try:
                self._writer.submit(
                    lambda connection: insert_call(connection, self._campaign_id, call)
                ).result()
            except Unavailable as error:
                about = {"campaign": self._campaign_id}
                log.warning("a model's answer cannot be stored yet: %s", error, extra=about)
                if time.monotonic() > until or self._stopping.wait(STORES_AGAIN_S):
                    raise
            else:
                return

    def spent(self) -> Budget:
        """Return what all stored calls took."""
        return spent_on(self.every())
