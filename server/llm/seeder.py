"""Asks a language model for the solutions that a search wants: one question, at most one repair turn.

Whatever the endpoint does, `ask` returns: with fewer proposals, or none, and a line that says why. Every call is
stored with its outcome; a call that is stored is not made again, so that a resumed campaign takes the same path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from brink.search.algorithm import Origin, Proposal, SeedRequest
from brink.search.traffic.participants import RoadLimits, Solution
from brink.server.errors import FieldError
from brink.server.llm.budget import cost_of, times, together, worst_usage
from brink.server.llm.calls import CallKey, CallLog, Outcome, StoredCall
from brink.server.llm.client import LlmClient
from brink.server.llm.drivable import Drivable
from brink.server.llm.errors import CallLogMismatch, EndpointAway, LlmError, OverBudget, UnusableReply
from brink.server.llm.form import SCHEMA
from brink.server.llm.prompts import question, repair
from brink.server.llm.replies import Parsed, parse
from brink.server.llm.wire import Messages, prompt_hash, read_reply

_WORDS_CHARS: Final = 500
_ERRORS_NAMED: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What came of a request.

    Attributes:
        proposals: Valid solutions, each with where it comes from.
        words: What happened, on one line.
        calls: The calls that it took, stored ones included.
    """

    proposals: tuple[Proposal, ...]
    words: str
    calls: tuple[StoredCall, ...]


async def ask(
    request: SeedRequest, *, road: RoadLimits, most: int, system: str, log: CallLog, client: LlmClient
) -> Answer:
    """Return what a language model proposes.

    Args:
        request: What is wanted.
        road: Where participants are.
        most: Most participants of a solution.
        system: The system under test, in a few words.
        log: The calls of the campaign.
        client: Speaks to the endpoint.

    Raises:
        CallLogMismatch: A stored call of this request was made with another prompt.
    """
    drivable = Drivable(road, most)
    turns = _Turns(request.number, drivable, log, client)
    asked = question(request, road, most, system)
    first = await turns.take(asked, request.count)
    found = first.parsed.solutions
    proposals = [Proposal(solution=solution, origin=Origin.LLM) for solution in found]
    missing = request.count - len(found)
    second = None
    if missing and first.parsed.errors and first.call.outcome is not Outcome.DECLINED:
        second = await turns.take(repair(asked, found, first.parsed.errors, missing), missing, found)
        proposals += [Proposal(solution=s, origin=Origin.LLM_REPAIR) for s in second.parsed.solutions]
    return Answer(
        proposals=tuple(proposals),
        words=_words(request.count, first, second),
        calls=(first.call,) if second is None else (first.call, second.call),
    )


@dataclass(frozen=True, slots=True)
class _Turn:
    """A call and what its reply says."""

    call: StoredCall
    parsed: Parsed


class _Turns:
    """Makes the calls of one request, or finds them in the log."""

    def __init__(self, number: int, drivable: Drivable, log: CallLog, client: LlmClient) -> None:
        self._number = number
        self._drivable = drivable
        self._log = log
        self._client = client
        self._turn = 0

    async def take(self, messages: Messages, wanted: int, known: Sequence[Solution] = ()) -> _Turn:
        """Return the next turn."""
        key = CallKey(self._number, self._turn)
        self._turn += 1
        call = self._log.find(key)
        if call is not None and call.prompt_hash != prompt_hash(messages):
            raise CallLogMismatch(
                f"request {key.request}, turn {key.turn}: expected the stored call to have the prompt "
                f"{prompt_hash(messages)[:12]}, it has {call.prompt_hash[:12]}. Another version of Brink, or another "
                "campaign, made it: go on with that version, or begin the campaign anew"
            )
        if call is None or call.outcome is Outcome.SENT:
            call = await self._made(key, messages, wanted, known, earlier=call.calls if call else 0)
            self._log.store(call)
        return _Turn(call, self._heard(call.raw, wanted, known)[0])

    async def _made(
        self, key: CallKey, messages: Messages, wanted: int, known: Sequence[Solution], *, earlier: int
    ) -> StoredCall:
        """Make a call, and return it with what became of it.

        Each request is stored before it is sent: whoever stops meanwhile leaves behind that it was, and what it may
        have taken.

        Args:
            key: Which call.
            messages: What is asked.
            wanted: How many solutions.
            known: Solutions that were accepted already.
            earlier: Requests of this call whose answers were lost when a coordinator stopped.
        """
        settings, spent = self._client.settings, self._log.spent()
        worst, mode = worst_usage(settings, messages), self._client.mode

        def may_send(lost: int) -> None:
            used = times(worst, lost)
            spent.plus(lost, used, cost_of(used, settings)).may_send(settings, messages)
            maybe = times(worst, earlier + lost + 1)
            self._log.store(
                StoredCall(
                    key=key, prompt_hash=prompt_hash(messages), mode=mode, raw=None, outcome=Outcome.SENT,
                    calls=earlier + lost + 1, usage=maybe, cost=cost_of(maybe, settings), latency_s=0.0,
                    error="under way, or lost when a coordinator stopped",
                )
            )  # fmt: skip

        try:
            completion = await self._client.complete(messages, SCHEMA, may_send=may_send)
        except LlmError as error:
            lost = earlier + error.effort.lost
            used = times(worst, lost)
            return StoredCall(
                key=key, prompt_hash=prompt_hash(messages), mode=mode,
                raw=error.raw if isinstance(error, UnusableReply) else None,
                outcome=_outcome_of(error), calls=lost, usage=used if lost else None,
                cost=cost_of(used, settings) if lost else 0.0, latency_s=error.effort.elapsed_s,
                error=str(error)[:_WORDS_CHARS],
            )  # fmt: skip
        lost = earlier + completion.lost
        usage = completion.usage or worst
        if lost:
            usage = together(usage, times(worst, lost))
        _, outcome, trouble = self._heard(completion.raw, wanted, known)
        return StoredCall(
            key=key, prompt_hash=prompt_hash(messages), mode=completion.mode, raw=completion.raw,
            outcome=outcome, calls=lost + 1, usage=usage, cost=cost_of(usage, settings),
            latency_s=completion.latency_s, error=trouble,
        )  # fmt: skip

    def _heard(
        self, raw: str | None, wanted: int, known: Sequence[Solution]
    ) -> tuple[Parsed, Outcome, str | None]:
        """Return what a reply says: the same for a fresh one and for a stored one."""
        if raw is None:
            return Parsed(), Outcome.INVALID, None
        try:
            reply = read_reply(raw)
        except UnusableReply as error:
            return Parsed(), Outcome.INVALID, str(error)
        parsed = parse(reply.text, self._drivable, wanted, known)
        if reply.refusal and not parsed.solutions:
            return parsed, Outcome.DECLINED, "the model, or a filter before it, declined to answer"
        trouble = _named(parsed.errors)
        if reply.cut_short:
            return parsed, Outcome.TRUNCATED, trouble
        return parsed, Outcome.OK if parsed.solutions else Outcome.INVALID, trouble


def _outcome_of(error: LlmError) -> Outcome:
    match error:
        case EndpointAway():
            return Outcome.UNAVAILABLE
        case OverBudget():
            return Outcome.OVER_BUDGET
        case UnusableReply():
            return Outcome.INVALID
        case _:
            return Outcome.REFUSED


def _named(errors: Sequence[FieldError]) -> str | None:
    if not errors:
        return None
    more = len(errors) - _ERRORS_NAMED
    named = "; ".join(map(str, errors[:_ERRORS_NAMED])) + (f"; and {more} more" if more > 0 else "")
    return named[:_WORDS_CHARS]


def _words(count: int, first: _Turn, second: _Turn | None) -> str:
    """Return what happened, on one line."""
    call = first.call
    match call.outcome:
        case Outcome.UNAVAILABLE | Outcome.REFUSED:
            return f"language model away: {call.error}"
        case Outcome.OVER_BUDGET:
            return f"language model not asked: {call.error}"
        case Outcome.DECLINED:
            return f"language model: 0 of {count} usable ({call.error})"
        case _:
            pass
    usable = len(first.parsed.solutions)
    mended = len(second.parsed.solutions) if second is not None else 0
    words = f"language model: {usable + mended} of {count} usable"
    if second is not None:
        words += f", {mended} after repair"
    notes = ["reply cut short"] if call.outcome is Outcome.TRUNCATED else []
    last = second.call if second is not None else call
    if second is not None and not second.parsed.solutions:
        notes.append(f"repair {last.outcome}: {last.error}")
    elif usable + mended == 0 and call.error:
        notes.append(call.error)
    return f"{words} ({'; '.join(notes)})" if notes else words
