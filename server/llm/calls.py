"""The stored language-model calls of a campaign, and its budget and circuit breaker, which are derived from them.

A call is one prompt, with all HTTP requests that it takes; a stored call is neither made nor paid again. The budget
is checked before each request, with the most that the request may use. Unless both prices are set, a cost is unknown,
not 0. Usage that the endpoint does not report counts as the worst case and is marked as an estimate.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Final, Protocol

from brink.server.llm.protocol import Messages, Mode, OverBudget, Usage, canonical
from brink.server.llm.settings import LlmSettings

CHARS_PER_TOKEN: Final = 3.5
"""For JSON and English; low for the tokenizers in use, so that token counts are overestimated."""

_MILLION: Final = 1_000_000


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
    return (
        usage.prompt_tokens * settings.input_price + usage.completion_tokens * settings.output_price
    ) / _MILLION


@dataclass(frozen=True, slots=True, kw_only=True)
class Spent:
    """What a campaign's calls have used so far.

    Attributes:
        requests: HTTP requests sent, whatever became of them.
        tokens: Tokens of prompts and replies.
        estimated_tokens: Those of them that the endpoint did not report.
        priced: Total cost of the requests whose cost is known.
        unpriced: Number of requests whose cost is unknown.
    """

    requests: int = 0
    tokens: int = 0
    estimated_tokens: int = 0
    priced: float = 0.0
    unpriced: int = 0

    @property
    def cost(self) -> float | None:
        """The total cost, or None if it is unknown."""
        return None if self.unpriced else self.priced

    def plus(self, requests: int, usage: Usage | None, cost: float | None) -> "Spent":
        """Return the total after some more requests.

        Args:
            requests: Number of requests.
            usage: Their tokens; None if there are none.
            cost: Their cost; None if it is unknown.
        """
        tokens = usage.total if usage is not None else 0
        estimated = usage is not None and usage.estimated
        return Spent(
            requests=self.requests + requests,
            tokens=self.tokens + tokens,
            estimated_tokens=self.estimated_tokens + (tokens if estimated else 0),
            priced=self.priced + (cost or 0.0),
            unpriced=self.unpriced + (requests if cost is None else 0),
        )

    def check_budget(self, settings: LlmSettings, messages: Messages) -> None:
        """Check that the budget allows another request, even in the worst case.

        Args:
            settings: The limits and prices.
            messages: The prompt of the request.

        Raises:
            OverBudget: It does not; the message names the limit.
        """
        if self.requests >= settings.max_calls:
            raise OverBudget(f"all {settings.max_calls} requests of max_calls are used up")
        worst = worst_usage(settings, messages)
        allowed = settings.max_total_tokens
        if allowed is not None and self.tokens + worst.total > allowed:
            raise OverBudget(
                f"the next request may take {worst.total} tokens, and {self.tokens} of {allowed} (max_total_tokens) "
                "are spent"
            )
        if settings.max_cost is None:
            return
        cost, next_cost = self.cost, cost_of(worst, settings)
        if cost is None or next_cost is None:
            raise OverBudget(
                f"the cost of {self.unpriced} requests is unknown, so max_cost cannot be enforced"
            )
        if cost + next_cost > settings.max_cost:
            raise OverBudget(
                f"the next request may cost {next_cost:.4g}, and {cost:.4g} of {settings.max_cost:g} (max_cost) is "
                "spent"
            )


class Outcome(StrEnum):
    """The outcome of a call.

    Attributes:
        SENT: In progress. After a restart, this means that the reply was lost, although it may be billed.
        OK: Some of the reply is usable.
        TRUNCATED: The reply reached the token limit; its complete solutions are used, and there are some.
        INVALID: None of the reply is usable.
        DECLINED: The model or a content filter declined to answer.
        REFUSED: The endpoint rejected the request permanently, or there is no key.
        UNAVAILABLE: No try got a reply.
        OVER_BUDGET: Not sent, or not sent again after a coordinator stopped, because a budget does not allow it.
        CIRCUIT_OPEN: Not sent, because the last calls failed (`Breaker`).
    """

    SENT = "sent"
    OK = "ok"
    TRUNCATED = "truncated"
    INVALID = "invalid"
    DECLINED = "declined"
    REFUSED = "refused"
    UNAVAILABLE = "unavailable"
    OVER_BUDGET = "over_budget"
    CIRCUIT_OPEN = "circuit_open"


@dataclass(frozen=True, slots=True, order=True)
class CallKey:
    """Identifies a call of a campaign.

    Attributes:
        request: Number of the request for seeds.
        turn: 0 for the question, 1 for the repair turn.
    """

    request: int
    turn: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredCall:
    """A call and its outcome.

    Attributes:
        key: Identifies the call.
        prompt_hash: Hash of its messages.
        mode: How the form of the reply was specified.
        raw: Body of the reply, without the API key; None if there is none.
        outcome: The outcome.
        requests: HTTP requests sent, whatever became of them; they count against ``max_calls``.
        usage: Tokens of those that the endpoint processed or may have processed; None if there are none.
        cost: Cost of these tokens; None if it is unknown.
        latency_s: Duration of the successful request; without a reply, time until the call was given up.
        error: What went wrong, in words; None if nothing did.
        stored_at: When it was stored, by the clock of the database; None until then.
    """

    key: CallKey
    prompt_hash: str
    mode: Mode
    raw: str | None = field(repr=False)
    outcome: Outcome
    requests: int
    usage: Usage | None
    cost: float | None
    latency_s: float
    error: str | None
    stored_at: datetime | None = field(default=None, compare=False)


class CallLog(Protocol):
    """Stores the calls of one campaign."""

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        ...

    def store(self, call: StoredCall) -> None:
        """Store a call durably, replacing the same call if its outcome was SENT."""
        ...

    def spent(self) -> Spent:
        """Return the totals of all stored calls."""
        ...

    def breaker(self) -> "Breaker":
        """Return the circuit breaker after all stored calls."""
        ...


def spent_on(calls: Iterable[StoredCall]) -> Spent:
    """Return the totals of calls."""
    spent = Spent()
    for call in calls:
        spent = spent.plus(call.requests, call.usage, call.cost)
    return spent


FAILED_CALLS: Final = 2
"""The circuit breaker opens after this many failed calls in a row."""
FIRST_COOL_DOWN_S: Final = 60.0
LONGEST_COOL_DOWN_S: Final = 3600.0
"""How long it stays open: doubled after each failed trial, from the first to the longest."""
_FAILED: Final = frozenset({Outcome.INVALID, Outcome.DECLINED, Outcome.REFUSED, Outcome.UNAVAILABLE})
_USABLE: Final = frozenset({Outcome.OK, Outcome.TRUNCATED})


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


def breaker_after(calls: Sequence[StoredCall], now: datetime) -> Breaker:
    """Return the circuit breaker of a campaign.

    Args:
        calls: Its stored calls, in order.
        now: The time by the clock that dated the calls.
    """
    failed: list[StoredCall] = []
    for call in calls:  # those that were not made, or are in progress, say nothing about the endpoint
        if call.outcome in _USABLE:
            failed = []
        elif call.outcome in _FAILED:
            failed.append(call)
    if not failed:
        return Breaker()
    last, beyond = failed[-1], len(failed) - FAILED_CALLS
    cools_s = 0.0
    if beyond >= 0 and last.stored_at is not None:
        cool_down_s = min(LONGEST_COOL_DOWN_S, FIRST_COOL_DOWN_S * 2.0 ** min(beyond, 32))
        cools_s = min(cool_down_s, max(0.0, cool_down_s - (now - last.stored_at).total_seconds()))
    return Breaker(failed=len(failed), error=last.error or last.outcome, cools_s=cools_s)
