"""Calls as they are stored, so that a resumed campaign neither asks nor pays twice."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from brink.server.llm.budget import Budget
from brink.server.llm.wire import Mode, Usage


class Outcome(StrEnum):
    """What became of a call.

    Attributes:
        SENT: It is under way; whoever finds it so after a restart knows that its answer was lost, and maybe paid for.
        OK: Some of the reply can be used.
        TRUNCATED: The reply ran into the limit of tokens; what came of it counts.
        INVALID: Nothing of the reply can be used.
        DECLINED: The model, or a filter before it, declined to answer.
        REFUSED: The endpoint refused the request for good, or there is no key.
        UNAVAILABLE: No answer after all tries.
        OVER_BUDGET: Not sent, or not sent again: a budget does not allow it.
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
    """Which call of a campaign.

    Attributes:
        request: Number of the request for seeds.
        turn: 0 for the question, 1 for the repair turn.
    """

    request: int
    turn: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredCall:
    """A call and what became of it.

    Attributes:
        key: Which call.
        prompt_hash: Of the messages.
        mode: How the form of the reply was asked for.
        raw: The body of the reply, but for the key; None if there is none.
        outcome: What became of it.
        calls: Requests that the endpoint worked on, or may have: what counts against ``max_calls``.
        usage: Tokens of all these; None if there are none.
        cost: Of all these; None if it is unknown.
        latency_s: Of the answered request, or, without an answer, until it was given up.
        error: What was wrong, in words; None if nothing was.
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
    """Where the calls of one campaign are stored."""

    def find(self, key: CallKey) -> StoredCall | None:
        """Return a call, or None if it was never made."""
        ...

    def store(self, call: StoredCall) -> None:
        """Store a call, for good, before returning; it takes the place of one that is only sent."""
        ...

    def spent(self) -> Budget:
        """Return what all stored calls took, as `spent_on` adds it up."""
        ...


def spent_on(calls: Iterable[StoredCall]) -> Budget:
    """Return what calls took."""
    spent = Budget()
    for call in calls:
        spent = spent.plus(call.calls, call.usage, call.cost)
    return spent
