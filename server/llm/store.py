"""The SQL of language model calls, and of the claims that let one coordinator at a time make them."""

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
from brink.server.llm.calls import Breaker, CallKey, Outcome, Spent, StoredCall, breaker_after, spent_on
from brink.server.llm.protocol import Mode, Usage

RETRY_S: Final = 2.0
GIVE_UP_S: Final = 600.0
"""How long to keep trying to store a reply that was paid for while the database is not writable."""

log = logging.getLogger(__name__)


def list_calls(connection: Connection, campaign_id: str, key: CallKey | None = None) -> list[StoredCall]:
    """Return the calls of a campaign in order.

    Args:
        connection: For reading.
        campaign_id: The campaign.
        key: Return only the call with this key.
    """
    query = (
        select(LlmCallRow.__table__)
        .where(LlmCallRow.campaign_id == campaign_id)
        .order_by(LlmCallRow.request, LlmCallRow.turn)
    )
    if key is not None:
        query = query.where(LlmCallRow.request == key.request, LlmCallRow.turn == key.turn)
    return [
        StoredCall(
            key=CallKey(row.request, row.turn),
            prompt_hash=row.prompt_hash,
            mode=Mode(row.mode),
            raw=row.reply,
            outcome=Outcome(row.outcome),
            requests=row.calls,
            usage=None
            if row.prompt_tokens is None
            else Usage(
                prompt_tokens=row.prompt_tokens,
                completion_tokens=row.completion_tokens,
                estimated=row.estimated,
            ),
            cost=row.cost,
            latency_s=row.latency_s,
            error=row.error,
            stored_at=row.called_at,
        )
        for row in connection.execute(query)
    ]


def insert_call(connection: Connection, campaign_id: str, call: StoredCall) -> None:
    """Store a call, replacing the row that was stored while it was in progress.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        call: The call.
    """
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
            campaign_id=campaign_id,
            request=call.key.request,
            turn=call.key.turn,
            prompt_hash=call.prompt_hash,
            mode=call.mode,
            reply=call.raw,
            outcome=call.outcome,
            calls=call.requests,
            prompt_tokens=None if usage is None else usage.prompt_tokens,
            completion_tokens=None if usage is None else usage.completion_tokens,
            estimated=usage is not None and usage.estimated,
            cost=call.cost,
            latency_s=call.latency_s,
            error=call.error,
            called_at=database_now(connection),
        )
    )


def claim(connection: Connection, campaign_id: str, owner: str, hold_s: float) -> bool:
    """Claim or keep the exclusive right to request a campaign's seeds.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        owner: Random id of the coordinator.
        hold_s: Time until the claim expires.

    Returns:
        Whether the owner holds the claim.
    """
    # Lock the campaign's row: a claim that does not exist yet cannot be locked, and two could be inserted.
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
    """Release claims.

    Args:
        connection: In a write transaction.
        owner: Random id of the coordinator.
        campaign_id: The campaign; None for all claims of the owner.
    """
    claims = delete(SeedClaimRow).where(SeedClaimRow.owner == owner)
    connection.execute(
        claims if campaign_id is None else claims.where(SeedClaimRow.campaign_id == campaign_id)
    )


class CampaignCalls:
    """The calls of one campaign in the database; implements `CallLog`.

    Args:
        engines: For reading.
        writer: For writing.
        campaign_id: The campaign.
        stopping: Set when the coordinator stops; writes are then no longer retried.
    """

    def __init__(self, engines: Engines, writer: Writer, campaign_id: str, stopping: threading.Event) -> None:
        self._engines = engines
        self._writer = writer
        self._campaign_id = campaign_id
        self._stopping = stopping

    def every(self) -> list[StoredCall]:
        """Return all calls in order."""
        with self._engines.reader.connect() as connection:
            return list_calls(connection, self._campaign_id)

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        with self._engines.reader.connect() as connection:
            stored = list_calls(connection, self._campaign_id, key)
        return stored[0] if stored else None

    def store(self, call: StoredCall) -> None:
        """Store a call durably, retrying while the database is not writable, because it has been paid for.

        Raises:
            Unavailable: The database was not writable for `GIVE_UP_S`, or until the coordinator stopped.
        """
        deadline = time.monotonic() + GIVE_UP_S
        while True:
            try:
                self._writer.submit(
                    lambda connection: insert_call(connection, self._campaign_id, call)
                ).result()
            except Unavailable as error:
                about = {"campaign": self._campaign_id}
                log.warning("a model's answer cannot be stored yet: %s", error, extra=about)
                if time.monotonic() > deadline or self._stopping.wait(RETRY_S):
                    raise
            else:
                return

    def spent(self) -> Spent:
        """Return the totals of all stored calls."""
        return spent_on(self.every())

    def breaker(self) -> Breaker:
        """Return the circuit breaker after all stored calls."""
        with self._engines.reader.connect() as connection:
            return breaker_after(list_calls(connection, self._campaign_id), database_now(connection))
