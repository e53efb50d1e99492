"""The stored language-model calls of a campaign, and its budget and circuit breaker, which are derived from them.

A call is one prompt, with all HTTP requests that it takes; a stored call is neither made nor paid again. The budget
is checked before each request, with the most that the request may use. Unless both prices are set, a cost is unknown,
not 0. Usage that the endpoint does not report counts as the worst case and is marked as an estimate.
"""

import itertools
import logging
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any, Final, Protocol

from sqlalchemy import Connection, delete, insert, select

from brink.server.db.engine import Engines
from brink.server.db.models import LlmCallRow, SeedClaimRow
from brink.server.db.sql import database_now, lock_campaign
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.llm.protocol import Messages, OverBudget, Usage, canonical
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import LlmCall, Outcome, Spent

CHARS_PER_TOKEN: Final = 3.5
"""For JSON and English; low for the tokenizers in use, so that token counts are overestimated."""
FAILED_CALLS: Final = 2
"""The circuit breaker opens after this many failed calls in a row."""
FIRST_COOL_DOWN_S: Final = 60.0
LONGEST_COOL_DOWN_S: Final = 3600.0
"""How long it stays open: doubled after each failed trial, from the first to the longest."""
RETRY_S: Final = 2.0
GIVE_UP_S: Final = 600.0
"""How long to keep trying to store a reply that was paid for while the database is not writable."""
_FAILED: Final = frozenset({Outcome.INVALID, Outcome.DECLINED, Outcome.REFUSED, Outcome.UNAVAILABLE})
_USABLE: Final = frozenset({Outcome.OK, Outcome.TRUNCATED})

log = logging.getLogger(__name__)


def tokens_of(chars: int) -> int:
    """Estimate the number of tokens of a text from its number of characters."""
    return math.ceil(chars / CHARS_PER_TOKEN)


def worst_usage(settings: LlmSettings, messages: Messages) -> Usage:
    """Estimate the maximum usage of one request."""
    prompt_tokens = tokens_of(len(canonical(messages)))
    return Usage(prompt_tokens=prompt_tokens, completion_tokens=settings.max_tokens, estimated=True)


def cost_of(usage: Usage, settings: LlmSettings) -> float | None:
    """Return the cost of tokens, or None if a price is unknown."""
    if settings.input_price is None or settings.output_price is None:
        return None
    cost = usage.prompt_tokens * settings.input_price + usage.completion_tokens * settings.output_price
    return cost / 1_000_000


def using(call: LlmCall, settings: LlmSettings, requests: int, *usages: Usage) -> LlmCall:
    """Return a call after some more requests.

    Args:
        call: The call.
        settings: The prices.
        requests: Number of requests.
        usages: Tokens that some of them used.
    """
    if call.prompt_tokens is not None and call.completion_tokens is not None:
        usages += (Usage(call.prompt_tokens, call.completion_tokens, call.estimated),)
    used: dict[str, Any] = {"calls": call.calls + requests}
    if usages:
        usage = sum(usages[1:], usages[0])
        used |= {**asdict(usage), "cost": cost_of(usage, settings)}
    return call.model_copy(update=used)


def check_budget(spent: Spent, settings: LlmSettings, messages: Messages) -> None:
    """Check that the budget allows another request, even in the worst case.

    Args:
        spent: What the campaign's calls have used.
        settings: The limits and prices.
        messages: The prompt of the request.

    Raises:
        OverBudget: It does not; the message names the limit.
    """
    if spent.total_calls >= settings.max_calls:
        raise OverBudget(f"all {settings.max_calls} requests of max_calls are used up")
    worst = worst_usage(settings, messages)
    allowed, tokens = settings.max_total_tokens, spent.total_tokens
    if allowed is not None and tokens + worst.total > allowed:
        raise OverBudget(
            f"the next request may take {worst.total} tokens, and {tokens} of {allowed} (max_total_tokens) are spent"
        )
    most, cost, next_cost = settings.max_cost, spent.cost, cost_of(worst, settings)
    if most is None:
        return
    if cost is None or next_cost is None:
        raise OverBudget("the cost of earlier requests is unknown, so max_cost cannot be enforced")
    if cost + next_cost > most:
        raise OverBudget(
            f"the next request may cost {next_cost:.4g}, and {cost:.4g} of {most:g} (max_cost) is spent"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Breaker:
    """The circuit breaker of a campaign, derived from its stored calls so that restarts do not reset it.

    Attributes:
        failed: Failed calls in a row, up to the last call.
        error: What happened to the last of them.
        cools_s: Time until the next call is allowed; 0 if it is allowed now.
    """

    failed: int = 0
    error: str = ""
    cools_s: float = 0.0

    @property
    def on_trial(self) -> bool:
        """Whether the breaker is open, so that the next call is a trial with a single attempt."""
        return self.failed >= FAILED_CALLS

    @property
    def words(self) -> str:
        """Why calls are suspended, and until when."""
        return (
            f"the circuit breaker is open: {self.failed} failed calls in a row; no call for "
            f"{math.ceil(self.cools_s)} s; the last one: {self.error}"
        )


def _has_failed(call: LlmCall) -> bool:
    return call.outcome in _FAILED


def breaker_after(calls: Sequence[LlmCall], now: datetime) -> Breaker:
    """Return the circuit breaker of a campaign.

    Args:
        calls: Its stored calls, in order.
        now: The time by the clock that dated the calls.
    """
    # Calls that were not made, or are in progress, say nothing about the endpoint.
    telling = [call for call in reversed(calls) if call.outcome in _FAILED | _USABLE]
    failed = list(itertools.takewhile(_has_failed, telling))
    if not failed:
        return Breaker()
    last, beyond = failed[0], len(failed) - FAILED_CALLS
    cools_s = 0.0
    if beyond >= 0 and last.called_at is not None:
        cool_down_s = min(LONGEST_COOL_DOWN_S, FIRST_COOL_DOWN_S * 2.0 ** min(beyond, 32))
        cools_s = min(cool_down_s, max(0.0, cool_down_s - (now - last.called_at).total_seconds()))
    return Breaker(failed=len(failed), error=last.error or last.outcome, cools_s=cools_s)


class CallLog(Protocol):
    """Stores the calls of one campaign."""

    def read(self) -> tuple[list[LlmCall], datetime]:
        """Return all calls in order, and the current time by the clock that dates them."""

    def store(self, call: LlmCall) -> None:
        """Store a call durably, replacing the same call if its outcome was SENT."""


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

    def read(self) -> tuple[list[LlmCall], datetime]:
        """Return all calls in order, and the current time by the clock of the database."""
        with self._engines.reader.connect() as connection:
            return list_calls(connection, self._campaign_id), database_now(connection)

    def store(self, call: LlmCall) -> None:
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


def list_calls(connection: Connection, campaign_id: str) -> list[LlmCall]:
    """Return the calls of a campaign in order."""
    query = (
        select(LlmCallRow.__table__)
        .where(LlmCallRow.campaign_id == campaign_id)
        .order_by(LlmCallRow.request, LlmCallRow.turn)
    )
    return [LlmCall.model_validate(dict(row)) for row in connection.execute(query).mappings()]


def insert_call(connection: Connection, campaign_id: str, call: LlmCall) -> None:
    """Store a call, replacing the row that was stored while it was in progress.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        call: The call.
    """
    connection.execute(
        delete(LlmCallRow).where(
            LlmCallRow.campaign_id == campaign_id,
            LlmCallRow.request == call.request,
            LlmCallRow.turn == call.turn,
            LlmCallRow.outcome == Outcome.SENT,
        )
    )
    row = {**call.model_dump(), "campaign_id": campaign_id, "called_at": database_now(connection)}
    connection.execute(insert(LlmCallRow).values(row))


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
