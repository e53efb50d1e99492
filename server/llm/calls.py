"""The stored language-model calls of a campaign, and its budget: a resumed campaign neither asks nor pays twice.

The budget is checked before each request with the most that the request may use. Unless both prices are set, a cost
is unknown, not 0. Usage that the endpoint does not report counts as the worst case and is marked as an estimate.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
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
        calls: Requests that the endpoint processed or may have processed.
        tokens: Tokens of prompts and replies.
        estimated_tokens: Those of them that the endpoint did not report.
        priced: Total cost of the calls whose cost is known.
        unpriced_calls: Number of calls whose cost is unknown.
    """

    calls: int = 0
    tokens: int = 0
    estimated_tokens: int = 0
    priced: float = 0.0
    unpriced_calls: int = 0

    @property
    def cost(self) -> float | None:
        """The total cost, or None if it is unknown."""
        return None if self.unpriced_calls else self.priced

    def plus(self, calls: int, usage: Usage | None, cost: float | None) -> "Spent":
        """Return the total after some more requests.

        Args:
            calls: Number of requests.
            usage: Their tokens; None if there are none.
            cost: Their cost; None if it is unknown.
        """
        tokens = usage.total if usage is not None else 0
        estimated = usage is not None and usage.estimated
        return Spent(
            calls=self.calls + calls,
            tokens=self.tokens + tokens,
            estimated_tokens=self.estimated_tokens + (tokens if estimated else 0),
            priced=self.priced + (cost or 0.0),
            unpriced_calls=self.unpriced_calls + (calls if cost is None else 0),
        )

    def check_budget(self, settings: LlmSettings, messages: Messages) -> None:
        """Check that the budget allows another request, even in the worst case.

        Args:
            settings: The limits and prices.
            messages: The prompt of the request.

        Raises:
            OverBudget: It does not; the message names the limit.
        """
        if self.calls >= settings.max_calls:
            raise OverBudget(f"all {settings.max_calls} calls of max_calls are used up")
        worst = worst_usage(settings, messages)
        allowed = settings.max_total_tokens
        if allowed is not None and self.tokens + worst.total > allowed:
            raise OverBudget(
                f"the next call may take {worst.total} tokens, and {self.tokens} of {allowed} (max_total_tokens) "
                "are spent"
            )
        if settings.max_cost is None:
            return
        cost, next_cost = self.cost, cost_of(worst, settings)
        if cost is None or next_cost is None:
            raise OverBudget(
                f"the cost of {self.unpriced_calls} calls is unknown, so max_cost cannot be enforced"
            )
        if cost + next_cost > settings.max_cost:
            raise OverBudget(
                f"the next call may cost {next_cost:.4g}, and {cost:.4g} of {settings.max_cost:g} (max_cost) is spent"
            )


class Outcome(StrEnum):
    """The outcome of a call.

    Attributes:
        SENT: In progress. After a restart, this means that the reply was lost, although it may be billed.
        OK: Some of the reply is usable.
        TRUNCATED: The reply reached the token limit; its complete solutions are used.
        INVALID: None of the reply is usable.
        DECLINED: The model or a content filter declined to answer.
        REFUSED: The endpoint rejected the request permanently, or there is no key.
        UNAVAILABLE: No attempt got a reply.
        OVER_BUDGET: Not sent, or not sent again, because a budget does not allow it.
    """

    SENT = "sent"
    OK = "ok"
    TRUNCATED = "truncated"
    INVALID = "invalid"
    DECLINED = "declined"
    REFUSED = "refused"
    UNAVAILABLE = "unavailable"
    OVER_BUDGET = "over_budget"


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
        calls: Requests that the endpoint processed or may have processed; they count against ``max_calls``.
        usage: Tokens of these requests; None if there are none.
        cost: Cost of these requests; None if it is unknown.
        latency_s: Duration of the successful request; without a reply, time until the call was given up.
        error: What went wrong; None if nothing did.
    """

    key: CallKey
    prompt_hash: str
    mode: Mode
    raw: str | None = field(repr=False)
    outcome: Outcome
    calls: int
    usage: Usage | None
    cost: float | None
    latency_s: float
    error: str | None


class CallLog(Protocol):
    """Stores the calls of one campaign."""

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        ...

    def store(self, call: StoredCall) -> None:
        """Store a call durably, replacing the same call with the outcome SENT."""
        ...

    def spent(self) -> Spent:
        """Return the totals of all stored calls."""
        ...


def spent_on(calls: Iterable[StoredCall]) -> Spent:
    """Return the totals of calls."""
    spent = Spent()
    for call in calls:
        spent = spent.plus(call.calls, call.usage, call.cost)
    return spent
