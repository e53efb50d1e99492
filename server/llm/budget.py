"""What calls cost, and whether another is allowed: checked before each request, with its worst case.

A price that is not known makes a cost unknown, never 0; usage that the endpoint does not state counts as the worst
case and is marked as an estimate.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

from brink.server.llm.errors import OverBudget
from brink.server.llm.settings import LlmSettings
from brink.server.llm.wire import Messages, Usage, canonical

CHARS_PER_TOKEN: Final = 3.5
"""Of JSON and English, on the low side for the tokenizers in use."""

_MILLION: Final = 1_000_000


def tokens_of(chars: int) -> int:
    """Return the estimated tokens of so many characters."""
    return math.ceil(chars / CHARS_PER_TOKEN)


def worst_usage(settings: LlmSettings, messages: Messages) -> Usage:
    """Return what one request may use at most, by estimate."""
    return Usage(
        prompt_tokens=tokens_of(len(canonical(messages))),
        completion_tokens=settings.max_tokens,
        estimated=True,
    )


def times(usage: Usage, count: int) -> Usage:
    """Return the usage of so many requests alike."""
    return replace(
        usage,
        prompt_tokens=usage.prompt_tokens * count,
        completion_tokens=usage.completion_tokens * count,
    )


def together(first: Usage, second: Usage) -> Usage:
    """Return the usage of both."""
    return Usage(
        prompt_tokens=first.prompt_tokens + second.prompt_tokens,
        completion_tokens=first.completion_tokens + second.completion_tokens,
        estimated=first.estimated or second.estimated,
    )


def cost_of(usage: Usage, settings: LlmSettings) -> float | None:
    """Return what tokens cost, or None if a price is unknown."""
    if settings.input_price is None or settings.output_price is None:
        return None
    return (
        usage.prompt_tokens * settings.input_price + usage.completion_tokens * settings.output_price
    ) / _MILLION


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """What a campaign's calls took so far.

    Attributes:
        calls: Requests that the endpoint worked on, or may have.
        tokens: Of prompts and replies.
        estimated_tokens: Those of them that the endpoint did not state.
        priced: Cost of the calls whose cost is known.
        unpriced_calls: How many calls have an unknown cost.
    """

    calls: int = 0
    tokens: int = 0
    estimated_tokens: int = 0
    priced: float = 0.0
    unpriced_calls: int = 0

    @property
    def cost(self) -> float | None:
        """What was spent, or None if that is unknown."""
        return None if self.unpriced_calls else self.priced

    def plus(self, calls: int, usage: Usage | None, cost: float | None) -> "Budget":
        """Return the budget after some more requests.

        Args:
            calls: How many.
            usage: Their tokens; None for none.
            cost: Their cost, or None if it is unknown.
        """
        tokens = usage.total if usage is not None else 0
        estimated = usage is not None and usage.estimated
        return Budget(
            calls=self.calls + calls,
            tokens=self.tokens + tokens,
            estimated_tokens=self.estimated_tokens + (tokens if estimated else 0),
            priced=self.priced + (cost or 0.0),
            unpriced_calls=self.unpriced_calls + (calls if cost is None else 0),
        )

    def may_send(self, settings: LlmSettings, messages: Messages) -> None:
        """Return if another request with these messages is allowed, even if it takes all that it may.

        Raises:
            OverBudget: It is not; the message says which budget does not allow it.
        """
        if self.calls >= settings.max_calls:
            raise OverBudget(f"all {settings.max_calls} calls of max_calls are made")
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
                f"the cost of {self.unpriced_calls} calls is unknown, so max_cost cannot be kept"
            )
        if cost + next_cost > settings.max_cost:
            raise OverBudget(
                f"the next call may cost {next_cost:.4g}, and {cost:.4g} of {settings.max_cost:g} (max_cost) is spent"
            )
