"""Seeds from language models: prompts, repair turns, and background threads that make the calls.

`ask` makes one call and at most one repair turn, within a bounded time. It always returns: with fewer proposals, or
none, and the reason.

A campaign waits for its seeds without blocking anything else. One coordinator at a time asks for them. A reply is
stored before it is used, so a repeated request gives the same seeds: a coordinator that takes over reads the stored
replies.
"""

import asyncio
import contextlib
import functools
import logging
import operator
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final, TypedDict

from sqlalchemy.exc import DBAPIError

from brink.search.algorithm import Origin, Proposal, SeedRequest
from brink.search.traffic.participants import RoadLimits, Solution
from brink.server.db.engine import Engines
from brink.server.db.writer import Writer
from brink.server.errors import FieldError, Unavailable
from brink.server.llm.access import LlmAccess
from brink.server.llm.calls import Breaker, CallKey, CallLog, Outcome, StoredCall, cost_of, worst_usage
from brink.server.llm.client import LlmClient
from brink.server.llm.prompts import question, repair
from brink.server.llm.protocol import (
    CallLogMismatch,
    Effort,
    EndpointUnavailable,
    LlmError,
    Messages,
    Mode,
    OverBudget,
    UnusableReply,
    Usage,
    prompt_hash,
    read_reply,
)
from brink.server.llm.replies import SCHEMA, Parsed, RoadChecker, parse, pointed
from brink.server.llm.settings import LlmSettings
from brink.server.llm.store import CampaignCalls, claim, release
from brink.server.problems.base import Problem, SupportsSeeds

HOLD_S: Final = 60.0
"""How long the claim of a coordinator that died prevents others from asking."""

LAST_ANSWERS_S: Final = 8.0
"""How long a stopping coordinator waits for pending replies: less than the grace period of containers."""

_ERROR_CHARS: Final = 500
_ERRORS_SHOWN: Final = 3

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The answer to a request for seeds.

    Attributes:
        proposals: Valid solutions, each with its origin.
        words: Summary on one line.
        calls: The calls that it took, including stored ones.
    """

    proposals: tuple[Proposal, ...]
    words: str
    calls: tuple[StoredCall, ...]


async def ask(
    request: SeedRequest,
    *,
    road: RoadLimits,
    max_participants: int,
    system: str,
    log: CallLog,
    client: LlmClient,
) -> Answer:
    """Ask a language model for solutions; a stored call is not made again.

    Args:
        request: Number of solutions, and the known ones.
        road: The road.
        max_participants: Maximum number of participants in a solution.
        system: Short description of the system under test.
        log: The calls of the campaign.
        client: The endpoint.

    Raises:
        CallLogMismatch: A stored call of this request was made with a different prompt.
    """
    deadline_s = client.clock() + client.settings.delay_limit_s
    turns = _Turns(request.number, RoadChecker(road, max_participants), log, client, deadline_s)
    asked = question(request, road, max_participants, system)
    first = await turns.take(asked, request.count)
    usable = first.parsed.solutions
    proposals = [Proposal(solution=solution, origin=Origin.LLM) for solution in usable]
    missing = request.count - len(usable)
    second = None
    if missing and first.parsed.errors and first.call.outcome is not Outcome.DECLINED:
        second = await turns.take(repair(asked, usable, first.parsed.errors, missing), missing, usable)
        proposals += [Proposal(solution=s, origin=Origin.LLM_REPAIR) for s in second.parsed.solutions]
    return Answer(
        proposals=tuple(proposals),
        words=_summary(request.count, first, second),
        calls=(first.call,) if second is None else (first.call, second.call),
    )


class _Used(TypedDict):
    """Usage and cost of a call."""

    usage: Usage | None
    cost: float | None


class _Bill:
    """What a call uses and costs.

    Args:
        settings: The prices, and the longest reply.
        messages: The prompt.
        earlier: Tokens of requests that were lost when a coordinator stopped.

    Attributes:
        messages: The prompt.
        worst: The most that one request may use.
    """

    def __init__(self, settings: LlmSettings, messages: Messages, earlier: Usage | None) -> None:
        self.messages = messages
        self.worst = worst_usage(settings, messages)
        self._settings = settings
        self._earlier = earlier

    def of(self, *, lost: int, reply: Usage | None = None) -> _Used:
        """Return the usage and the cost of a call.

        Args:
            lost: Requests that the endpoint may have processed without delivering a usable reply.
            reply: Tokens of the reply; None without one.
        """
        parts = [
            part for part in (reply, self.worst * lost if lost else None, self._earlier) if part is not None
        ]
        usage = functools.reduce(operator.add, parts) if parts else None
        return _Used(usage=usage, cost=cost_of(usage, self._settings) if usage is not None else 0.0)


@dataclass(frozen=True, slots=True)
class _Turn:
    """A call and its parsed reply."""

    call: StoredCall
    parsed: Parsed


class _Turns:
    """Makes the calls of one request, or finds them in the log.

    Args:
        number: Number of the request.
        road: Checks that solutions are possible.
        log: The calls of the campaign.
        client: The endpoint.
        deadline_s: Time on the client's clock until which calls may take.
    """

    def __init__(
        self, number: int, road: RoadChecker, log: CallLog, client: LlmClient, deadline_s: float
    ) -> None:
        self._number = number
        self._road = road
        self._log = log
        self._client = client
        self._deadline_s = deadline_s
        self._turn = 0

    async def take(self, messages: Messages, wanted: int, known: Sequence[Solution] = ()) -> _Turn:
        """Return the next turn.

        Args:
            messages: The prompt.
            wanted: Number of solutions.
            known: Solutions that were accepted already.

        Raises:
            CallLogMismatch: The turn is stored with a different prompt.
        """
        key = CallKey(self._number, self._turn)
        self._turn += 1
        call = self._log.find(key)
        if call is not None and call.prompt_hash != prompt_hash(messages):
            raise CallLogMismatch(
                f"request {key.request}, turn {key.turn}: expected the stored call to have the prompt "
                f"{prompt_hash(messages)[:12]}; it has {call.prompt_hash[:12]}. It was made by another version of "
                "Brink or for another campaign: continue with that version, or start the campaign again"
            )
        if call is None or call.outcome is Outcome.SENT:
            call = await self._make_call(key, messages, wanted, known, call)
            self._log.store(call)
        return _Turn(call, self._parse(call.raw, wanted, known)[0])

    async def _make_call(
        self,
        key: CallKey,
        messages: Messages,
        wanted: int,
        known: Sequence[Solution],
        stopped: StoredCall | None,
    ) -> StoredCall:
        """Make a call, storing each request with its worst-case usage before it is sent, in case the process stops.

        Args:
            key: Identifies the call.
            messages: The prompt.
            wanted: Number of solutions.
            known: Solutions that were accepted already.
            stopped: The same call as a coordinator stored it that stopped before the reply; None if there was none.
        """
        settings, breaker = self._client.settings, self._log.breaker()
        earlier = stopped.requests if stopped is not None else 0
        bill = _Bill(settings, messages, None if stopped is None else stopped.usage)
        stored = functools.partial(StoredCall, key=key, prompt_hash=prompt_hash(messages))
        if breaker.cools_s > 0:
            return stored(
                mode=self._client.mode,
                raw=None,
                outcome=Outcome.CIRCUIT_OPEN,
                requests=earlier,
                **bill.of(lost=0),
                latency_s=0.0,
                error=breaker.words[:_ERROR_CHARS],
            )
        before_request = self._store_before(stored, bill, earlier)
        try:
            completion = await self._client.complete(
                messages,
                SCHEMA,
                tries=1 if breaker.on_trial else max(1, settings.retries + 1 - earlier),
                deadline_s=self._deadline_s,
                before_request=before_request,
            )
        except LlmError as error:
            effort = error.effort
            return stored(
                mode=self._client.mode,
                raw=error.raw if isinstance(error, UnusableReply) else None,
                outcome=_outcome_of(error),
                requests=earlier + effort.requests,
                **bill.of(lost=effort.lost),
                latency_s=effort.elapsed_s,
                error=_failure_words(error, breaker, earlier),
            )
        effort = completion.effort
        _, outcome, trouble = self._parse(completion.raw, wanted, known)
        return stored(
            mode=completion.mode,
            raw=completion.raw,
            outcome=outcome,
            requests=earlier + effort.requests,
            **bill.of(lost=effort.lost, reply=completion.usage or bill.worst),
            latency_s=completion.latency_s,
            error=_join(
                _stopped_words(earlier), effort.words and f"before the reply: {effort.words}", trouble
            ),
        )

    def _store_before(
        self, stored: Callable[..., StoredCall], bill: _Bill, earlier: int
    ) -> Callable[[Effort], None]:
        """Return a callback that checks the budget and stores a call before each of its requests.

        Args:
            stored: Makes the call as it is stored.
            bill: What the call costs.
            earlier: Requests of this call that were lost when a coordinator stopped.
        """
        settings, mode, spent = self._client.settings, self._client.mode, self._log.spent()

        def before_request(effort: Effort) -> None:
            used = bill.worst * effort.lost
            sent = spent.plus(effort.requests, used, cost_of(used, settings))
            sent.check_budget(settings, bill.messages)
            self._log.store(
                stored(
                    mode=mode,
                    raw=None,
                    outcome=Outcome.SENT,
                    requests=earlier + effort.requests + 1,
                    **bill.of(lost=effort.lost + 1),
                    latency_s=0.0,
                    error="in progress, or lost when a coordinator stopped",
                )
            )

        return before_request

    def _parse(
        self, raw: str | None, wanted: int, known: Sequence[Solution]
    ) -> tuple[Parsed, Outcome, str | None]:
        """Return the content of a new or stored reply, its outcome, and its errors."""
        if raw is None:
            return Parsed(), Outcome.INVALID, None
        try:
            reply = read_reply(raw)
        except UnusableReply as error:
            return Parsed(), Outcome.INVALID, str(error)
        parsed = parse(reply.text, self._road, wanted, known)
        if reply.refusal and not parsed.solutions:
            return parsed, Outcome.DECLINED, "the model or a content filter declined to answer"
        trouble = _join_errors(parsed.errors)
        if reply.truncated:
            limit = f"the reply reached max_tokens ({self._client.settings.max_tokens})"
            outcome = Outcome.TRUNCATED if parsed.solutions else Outcome.INVALID
            return parsed, outcome, _join(limit, trouble)
        return parsed, Outcome.OK if parsed.solutions else Outcome.INVALID, trouble


def _outcome_of(error: LlmError) -> Outcome:
    match error:
        case EndpointUnavailable():
            return Outcome.UNAVAILABLE
        case OverBudget():
            return Outcome.OVER_BUDGET
        case UnusableReply():
            return Outcome.INVALID
        case _:
            return Outcome.REFUSED


def _failure_words(error: LlmError, breaker: Breaker, earlier: int) -> str | None:
    """Describe what happened to a call without a reply and, if it was not made, to the last call before it."""
    before = (
        f"the last call failed: {breaker.error}" if breaker.failed and isinstance(error, OverBudget) else None
    )
    return _join(_stopped_words(earlier), str(error), before)


def _join_errors(errors: Sequence[FieldError]) -> str | None:
    if not errors:
        return None
    more = len(errors) - _ERRORS_SHOWN
    text = "; ".join(map(pointed, errors[:_ERRORS_SHOWN])) + (f"; and {more} more" if more > 0 else "")
    return text[:_ERROR_CHARS]


def _join(*parts: str | None) -> str | None:
    """Join the available parts into one text of bounded length; None if there are none."""
    return "; ".join(part for part in parts if part)[:_ERROR_CHARS] or None


def _stopped_words(lost: int) -> str | None:
    if not lost:
        return None
    return f"{lost} {'request' if lost == 1 else 'requests'} lost when a coordinator stopped"


def _summary(count: int, first: _Turn, second: _Turn | None) -> str:
    """Summarise a request on one line."""
    call = first.call
    match call.outcome:
        case Outcome.UNAVAILABLE | Outcome.REFUSED:
            return f"language model unavailable: {call.error}"
        case Outcome.OVER_BUDGET | Outcome.CIRCUIT_OPEN:
            return f"language model not asked: {call.error}"
        case Outcome.DECLINED:
            return f"language model: 0 of {count} usable ({call.error})"
        case _:
            pass
    usable = len(first.parsed.solutions)
    repaired = len(second.parsed.solutions) if second is not None else 0
    words = f"language model: {usable + repaired} of {count} usable"
    if second is not None:
        words += f", {repaired} after repair"
    notes = ["reply truncated"] if call.outcome is Outcome.TRUNCATED else []
    if second is not None and not second.parsed.solutions:
        notes.append(f"repair {second.call.outcome}: {second.call.error}")
    elif usable + repaired == 0 and call.error:
        notes.append(call.error)
    return f"{words} ({'; '.join(notes)})" if notes else words


@dataclass(slots=True)
class _Pending:
    """A request in progress."""

    words: str
    thread: threading.Thread


class _ClaimLost(Exception):
    """Another coordinator holds the claim now."""


class LlmSeeds:
    """Asks language models on behalf of campaigns, on background threads.

    Args:
        engines: For reading stored calls.
        writer: For storing calls.
        on_seeds: Called from another thread with the id of a campaign whose seeds are available.
        access: The language models and keys that campaigns may use.
    """

    def __init__(
        self, engines: Engines, writer: Writer, on_seeds: Callable[[str], None], access: LlmAccess
    ) -> None:
        self._engines = engines
        self._writer = writer
        self._on_seeds = on_seeds
        self._access = access
        self._owner = secrets.token_hex(8)
        self._lock = threading.Lock()
        self._pending: dict[str, _Pending] = {}
        self._answers: dict[tuple[str, int], Sequence[Proposal]] = {}
        self._stopping = threading.Event()

    def close(self) -> None:
        """Start no more requests, wait a few seconds for pending answers, and release all claims."""
        with self._lock:
            self._stopping.set()
            pending = dict(self._pending)
        deadline = time.monotonic() + LAST_ANSWERS_S
        for campaign_id, one in pending.items():
            about = {"campaign": campaign_id}
            log.info("%s; waiting up to %g s for the answer", one.words, LAST_ANSWERS_S, extra=about)
            one.thread.join(max(0.0, deadline - time.monotonic()))
            if one.thread.is_alive():
                log.warning("no answer; the request will be repeated, and counted twice", extra=about)
        self._release(None)

    def proposals(
        self, campaign_id: str, settings: LlmSettings | None, problem: Problem, request: SeedRequest
    ) -> Sequence[Proposal] | None:
        """Return the proposals, possibly none; None while this or another coordinator is still asking.

        Args:
            campaign_id: The campaign that waits.
            settings: The language model; None if the campaign has none.
            problem: The campaign's problem.
            request: The request of the algorithm.
        """
        if settings is None or not isinstance(problem, SupportsSeeds):
            return ()
        with self._lock:
            if (campaign_id, request.number) in self._answers:
                return self._answers.pop((campaign_id, request.number))
            pending = self._pending.get(campaign_id)
            if self._stopping.is_set():
                return None
        if pending is not None or not self._claim(campaign_id).result():
            return None
        words = f"asking {settings.model} for {request.count} solutions"
        # A daemon thread: a model that never answers must not prevent the coordinator from stopping.
        thread = threading.Thread(
            target=self._ask, args=(campaign_id, settings, problem, request), name="seeds", daemon=True
        )
        with self._lock:
            stopping = self._stopping.is_set()
            if not stopping:
                self._pending[campaign_id] = _Pending(words, thread)
                thread.start()
        if stopping:
            self._release(campaign_id)
        return None

    def doing(self, campaign_id: str) -> str | None:
        """Describe the request that a campaign waits for; None if this coordinator has none in progress."""
        with self._lock:
            pending = self._pending.get(campaign_id)
        return None if pending is None else pending.words

    def _claim(self, campaign_id: str) -> Future[bool]:
        return self._writer.submit(lambda connection: claim(connection, campaign_id, self._owner, HOLD_S))

    def _ask(
        self, campaign_id: str, settings: LlmSettings, problem: SupportsSeeds, request: SeedRequest
    ) -> None:
        """Ask for seeds, on a separate thread; if that yields no result, the sweeper repeats the request."""
        answer: Sequence[Proposal] | None = None
        about = {"campaign": campaign_id}
        try:
            answer = asyncio.run(self._answer_while_claimed(campaign_id, settings, problem, request))
        except _ClaimLost:
            log.warning("another coordinator now asks for its seeds", extra=about)
        except (Unavailable, DBAPIError) as error:
            log.warning("%s; its seeds will be requested again", error, extra=about)
        except CallLogMismatch as error:
            log.warning("%s; the campaign continues without these seeds", error, extra=about)
            answer = ()
        except Exception:
            log.exception("seeds not available; the campaign continues without them", extra=about)
            answer = ()
        # Release the claim before removing the entry: close() waits for all entries, and then the writer is closed.
        self._release(campaign_id)
        with self._lock:
            self._pending.pop(campaign_id, None)
            if answer is not None:
                self._answers[campaign_id, request.number] = answer
            stopping = self._stopping.is_set()
        if answer is not None and not stopping:
            self._on_seeds(campaign_id)

    def _release(self, campaign_id: str | None) -> None:
        with contextlib.suppress(Unavailable, DBAPIError):  # the claim expires anyway
            self._writer.submit(lambda connection: release(connection, self._owner, campaign_id)).result()

    async def _answer_while_claimed(
        self, campaign_id: str, settings: LlmSettings, problem: SupportsSeeds, request: SeedRequest
    ) -> Sequence[Proposal]:
        """Obtain the seeds while renewing the claim, even if the campaign is paused.

        Raises:
            _ClaimLost: Another coordinator holds the claim.
        """
        answering = asyncio.create_task(self._answer(campaign_id, settings, problem, request))
        while not (await asyncio.wait({answering}, timeout=HOLD_S / 3))[0]:
            try:
                held = await asyncio.wrap_future(self._claim(campaign_id))
            except (Unavailable, DBAPIError):
                continue  # no other coordinator can claim it either
            if not held:
                answering.cancel()
                raise _ClaimLost
        return answering.result()

    async def _answer(
        self, campaign_id: str, settings: LlmSettings, problem: SupportsSeeds, request: SeedRequest
    ) -> Sequence[Proposal]:
        calls = CampaignCalls(self._engines, self._writer, campaign_id, self._stopping)
        known = calls.every()
        mode = known[-1].mode if known else Mode.JSON_SCHEMA
        async with LlmClient(settings, access=self._access, mode=mode) as client:
            answer = await ask(
                request,
                road=problem.road,
                max_participants=problem.max_participants,
                system=problem.system,
                log=calls,
                client=client,
            )
        level = logging.INFO if answer.proposals else logging.WARNING
        patterns = "" if answer.proposals else "; hand-written patterns take their place"
        log.log(level, "%s%s", answer.words, patterns, extra={"campaign": campaign_id})
        return answer.proposals
