"""The SQL of calls of language models."""

from sqlalchemy import Connection, insert, select

from server.db.clock import database_now
from server.db.engine import Engines
from server.db.models import LlmCallRow
from server.db.writer import Writer
from server.llm.budget import Budget
from server.llm.calls import CallKey, Outcome, StoredCall, spent_on
from server.llm.wire import Mode, Usage


def list_calls(connection: Connection, campaign_id: str) -> list[StoredCall]:
    """Return the calls of a campaign in the order of asking."""
    query = (
        select(LlmCallRow.__table__)
        .where(LlmCallRow.campaign_id == campaign_id)
        .order_by(LlmCallRow.request, LlmCallRow.turn)
    )
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
    """Store a call."""
    usage = call.usage
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


class CampaignCalls:
    """The calls of one campaign in the database; implements `server.llm.calls.CallLog`.

    Args:
        engines: To read with.
        writer: To write with.
        campaign_id: Whose calls.
    """

    def __init__(self, engines: Engines, writer: Writer, campaign_id: str) -> None:
        self._engines = engines
        self._writer = writer
        self._campaign_id = campaign_id

    def every(self) -> list[StoredCall]:
        """Return all calls, in the order of asking."""
        with self._engines.reader.connect() as connection:
            return list_calls(connection, self._campaign_id)

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        return next((call for call in self.every() if call.key == key), None)

    def store(self, call: StoredCall) -> None:
        """Store a call, for good, before returning."""
        self._writer.submit(lambda connection: insert_call(connection, self._campaign_id, call)).result()

    def spent(self) -> Budget:
        """Return what all stored calls took."""
        return spent_on(self.every())
