"""Seeds from language models: prompts, repair turns, and background threads that make the calls.

`ask` makes one call and at most one repair turn, within a bounded time. It always returns: with fewer proposals, or
none, and the reason.

A campaign waits for its seeds without blocking anything else. One coordinator at a time asks for them. A reply is
stored before it is used, so a repeated request gives the same seeds: a coordinator that takes over reads the stored
replies.
"""

import asyncio
import contextlib
import logging
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError

from brink.search.algorithm import Origin, Proposal, SeedRequest
from brink.search.traffic.participants import Solution
from brink.server.db.engine import Engines
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.llm.access import LlmAccess
from brink.server.llm.calls import (
    Breaker,
    CallLog,
    CampaignCalls,
    breaker_after,
    check_budget,
    claim,
    list_calls,
    release,
    using,
    worst_usage,
)
from brink.server.llm.client import Call, LlmClient
from brink.server.llm.prompts import question, repair
from brink.server.llm.protocol import (
    CallLogMismatch,
    LlmError,
    Messages,
    OverBudget,
    UnusableReply,
    Usage,
    prompt_hash,
    read_reply,
)
from brink.server.llm.replies import SCHEMA, Parsed, RoadChecker, parse, pointed
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import Problem, SupportsSeeds
from brink.server.seeding import LlmCall, Mode, Outcome, spent_on

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
    """

    proposals: tuple[Proposal, ...]
    words: str


@dataclass(frozen=True, slots=True)
class _Turn:
    """A call and its parsed reply."""

    call: LlmCall
    parsed: Parsed


async def ask(request: SeedRequest, problem: SupportsSeeds, log: CallLog, client: LlmClient) -> Answer:
    """Ask a language model for solutions; a stored call is not made again.

    Args:
        request: Number of solutions, and the known ones.
        problem: The road, and the system under test.
        log: The calls of the campaign.
        client: The endpoint.

    Raises:
        CallLogMismatch: A stored call of this request was made with a different prompt.
    """
    turns = _Turns(request.number, RoadChecker(problem.road, problem.max_participants), log, client)
    asked = question(request, problem.road, problem.max_participants, problem.system)
    first = await turns.take(asked, request.count)
    usable = first.parsed.solutions
    proposals = [Proposal(solution=solution, origin=Origin.LLM) for solution in usable]
    missing = request.count - len(usable)
    second = None
    if missing and first.parsed.errors and first.call.outcome is not Outcome.DECLINED:
        second = await turns.take(repair(asked, usable, first.parsed.errors, missing), missing, usable)
        proposals += [Proposal(solution=s, origin=Origin.LLM_REPAIR) for s in second.parsed.solutions]
    return Answer(proposals=tuple(proposals), words=_summary(request.count, first, second))


@dataclass(slots=True, kw_only=True)
class _Sending(Call):
    """A call that is being made.

    Attributes:
        sent: The call, with the requests of a coordinator that stopped before the reply.
        others: The other calls of the campaign.
        messages: The prompt.
        settings: The limits and prices.
        log: Where the call is stored.
    """

    sent: LlmCall
    others: Sequence[LlmCall]
    messages: Messages
    settings: LlmSettings
    log: CallLog

    def before_request(self) -> None:
        """Check the budget, and store the next request with its worst-case usage, in case the process stops.

        Raises:
            OverBudget: The budget does not allow it.
        """
        check_budget(spent_on([*self.others, self.after()]), self.settings, self.messages)
        self.log.store(using(self.after(), self.settings, 1, self.worst))

    @property
    def worst(self) -> Usage:
        """The most that one request may use."""
        return worst_usage(self.settings, self.messages)

    def after(self, *replies: Usage) -> LlmCall:
        """Return the call after the requests so far, of which each lost one counts as the worst case."""
        lost = [self.worst * self.lost] if self.lost else []
        return using(self.sent, self.settings, self.requests, *lost, *replies)


class _Turns:
    """Makes the calls of one request, or finds them in the log.

    Args:
        number: Number of the request.
        road: Checks that solutions are possible.
        log: The calls of the campaign.
        client: The endpoint.
    """

    def __init__(self, number: int, road: RoadChecker, log: CallLog, client: LlmClient) -> None:
        self._number = number
        self._road = road
        self._log = log
        self._client = client
        self._deadline_s = client.clock() + client.settings.delay_limit_s
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
        new = LlmCall(
            request=self._number,
            turn=self._turn,
            prompt_hash=prompt_hash(messages),
            mode=self._client.mode,
            error="in progress, or lost when a coordinator stopped",
        )
        self._turn += 1
        stored, now = self._log.read()
        others = [call for call in stored if (call.request, call.turn) != (new.request, new.turn)]
        call = next((call for call in stored if call not in others), new)
        if call.prompt_hash != new.prompt_hash:
            raise CallLogMismatch(
                f"request {call.request}, turn {call.turn}: expected the stored call to have the prompt "
                f"{new.prompt_hash[:12]}; it has {call.prompt_hash[:12]}. It was made by another version of "
                "Brink or for another campaign: continue with that version, or start the campaign again"
            )
        if call.outcome is Outcome.SENT:
            breaker, settings = breaker_after(stored, now), self._client.settings
            sending = _Sending(
                tries=1 if breaker.on_trial else max(1, settings.retries + 1 - call.calls),
                deadline_s=self._deadline_s,
                sent=call,
                others=others,
                messages=messages,
                settings=settings,
                log=self._log,
            )
            call = await self._made(sending, breaker, wanted, known)
            self._log.store(call)
        return _Turn(call, self._parse(call.reply, wanted, known)[0])

    async def _made(
        self, sending: _Sending, breaker: Breaker, wanted: int, known: Sequence[Solution]
    ) -> LlmCall:
        """Make a call.

        Args:
            sending: The call.
            breaker: The circuit breaker.
            wanted: Number of solutions.
            known: Solutions that were accepted already.
        """
        sent, client = sending.sent, self._client
        if breaker.cools_s > 0:
            return _ended(sent, Outcome.CIRCUIT_OPEN, breaker.words)
        noun = "request" if sent.calls == 1 else "requests"
        stopped = f"{sent.calls} {noun} lost when a coordinator stopped" if sent.calls else ""
        began = client.clock()
        try:
            reply = await client.complete(sending.messages, SCHEMA, sending)
        except LlmError as error:
            given = {"mode": client.mode, "reply": error.raw, "latency_s": client.clock() - began}
            again = breaker.failed and isinstance(error, OverBudget)
            before = f"the last call failed: {breaker.error}" if again else ""
            return _ended(sending.after(), error.outcome, stopped, str(error), before, **given)
        given = {"mode": client.mode, "reply": reply.raw, "latency_s": sending.latency_s}
        failures = f"before the reply: {sending.words}" if sending.failures else ""
        _, outcome, trouble = self._parse(reply.raw, wanted, known)
        call = sending.after(reply.usage or sending.worst)
        return _ended(call, outcome, stopped, failures, trouble, **given)

    def _parse(self, raw: str | None, wanted: int, known: Sequence[Solution]) -> tuple[Parsed, Outcome, str]:
        """Return the content of a new or stored reply, its outcome, and its errors."""
        try:
            reply = read_reply(raw or "")
        except UnusableReply as error:
            return Parsed(), Outcome.INVALID, str(error)
        parsed = parse(reply.text, self._road, wanted, known)
        if reply.refusal and not parsed.solutions:
            return parsed, Outcome.DECLINED, "the model or a content filter declined to answer"
        more = len(parsed.errors) - _ERRORS_SHOWN
        trouble = "; ".join(map(pointed, parsed.errors[:_ERRORS_SHOWN]))
        trouble += f"; and {more} more" if more > 0 else ""
        outcome = Outcome.OK if parsed.solutions else Outcome.INVALID
        if reply.truncated:
            limit = f"the reply reached max_tokens ({self._client.settings.max_tokens})"
            trouble = f"{limit}; {trouble}" if trouble else limit
            outcome = Outcome.TRUNCATED if parsed.solutions else outcome
        return parsed, outcome, trouble


def _ended(call: LlmCall, outcome: Outcome, *words: str, **changes: object) -> LlmCall:
    """Return a call with its outcome.

    Args:
        call: The call.
        outcome: The outcome.
        words: What went wrong; empty parts are left out.
        changes: Other fields that change.
    """
    error = "; ".join(filter(None, words))[:_ERROR_CHARS] or None
    return call.model_copy(update={"outcome": outcome, "error": error, **changes})


def _summary(count: int, first: _Turn, second: _Turn | None) -> str:
    """Summarise a request on one line."""
    outcome, error = first.call.outcome, first.call.error
    if outcome in (Outcome.UNAVAILABLE, Outcome.REFUSED):
        return f"language model unavailable: {error}"
    if outcome in (Outcome.OVER_BUDGET, Outcome.CIRCUIT_OPEN):
        return f"language model not asked: {error}"
    usable = len(first.parsed.solutions)
    notes = ["reply truncated"] if outcome is Outcome.TRUNCATED else []
    if second is None:
        words = f"language model: {usable} of {count} usable"
        notes += [error] if error and not usable else []
    else:
        repaired = len(second.parsed.solutions)
        words = f"language model: {usable + repaired} of {count} usable, {repaired} after repair"
        notes += [] if repaired else [f"repair {second.call.outcome}: {second.call.error}"]
    return f"{words} ({'; '.join(notes)})" if notes else words


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
        self._pending: dict[str, threading.Thread] = {}
        self._answers: dict[tuple[str, int], Sequence[Proposal]] = {}
        self._stopping = threading.Event()

    def close(self) -> None:
        """Start no more requests, wait a few seconds for pending answers, and release all claims."""
        with self._lock:
            self._stopping.set()
            pending = dict(self._pending)
        deadline = time.monotonic() + LAST_ANSWERS_S
        for campaign_id, thread in pending.items():
            about = {"campaign": campaign_id}
            log.info("%s; waiting up to %g s for the answer", thread.name, LAST_ANSWERS_S, extra=about)
            thread.join(max(0.0, deadline - time.monotonic()))
            if thread.is_alive():
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
        thread = threading.Thread(
            target=self._ask,
            args=(campaign_id, settings, problem, request),
            name=f"asking {settings.model} for {request.count} solutions",
            daemon=True,  # a model that never answers must not prevent the coordinator from stopping
        )
        with self._lock:
            stopping = self._stopping.is_set()
            if not stopping:
                self._pending[campaign_id] = thread
                thread.start()
        if stopping:
            self._release(campaign_id)
        return None

    def calls(self, connection: Connection, campaign_id: str) -> list[LlmCall]:
        """Return the stored calls of a campaign in order."""
        return list_calls(connection, campaign_id)

    def doing(self, campaign_id: str) -> str | None:
        """Describe the request that a campaign waits for; None if this coordinator has none in progress."""
        with self._lock:
            pending = self._pending.get(campaign_id)
        return None if pending is None else pending.name

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
    ) -> Sequence[Proposal] | None:
        """Return the seeds; None if another coordinator holds the claim, which is renewed even during a pause."""
        answering = asyncio.create_task(self._answer(campaign_id, settings, problem, request))
        while not (await asyncio.wait({answering}, timeout=HOLD_S / 3))[0]:
            try:
                held = await asyncio.wrap_future(self._claim(campaign_id))
            except (Unavailable, DBAPIError):
                continue  # no other coordinator can claim it either
            if not held:
                log.warning("another coordinator now asks for its seeds", extra={"campaign": campaign_id})
                answering.cancel()
                return None
        return answering.result()

    async def _answer(
        self, campaign_id: str, settings: LlmSettings, problem: SupportsSeeds, request: SeedRequest
    ) -> Sequence[Proposal]:
        calls = CampaignCalls(self._engines, self._writer, campaign_id, self._stopping)
        known, _ = calls.read()
        mode = known[-1].mode if known else Mode.JSON_SCHEMA
        async with LlmClient(settings, access=self._access, mode=mode) as client:
            answer = await ask(request, problem, calls, client)
        level = logging.INFO if answer.proposals else logging.WARNING
        patterns = "" if answer.proposals else "; hand-written patterns take their place"
        log.log(level, "%s%s", answer.words, patterns, extra={"campaign": campaign_id})
        return answer.proposals
