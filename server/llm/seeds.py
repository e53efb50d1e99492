"""Seeds from language models for campaigns: asked for on threads of their own, known again after a restart.

A campaign waits for its seeds and nothing else does. One coordinator at a time asks for them. What a model answered
is stored before it counts, so the same request of a campaign gives the same seeds whenever it is asked: a coordinator
that takes over reads the stored replies.
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

from sqlalchemy.exc import DBAPIError

from brink.search.algorithm import Proposal, SeedRequest
from brink.server.db.engine import Engines
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.llm.client import LlmClient
from brink.server.llm.errors import CallLogMismatch
from brink.server.llm.seeder import ask
from brink.server.llm.settings import LlmSettings
from brink.server.llm.store import CampaignCalls, claim, release
from brink.server.llm.wire import Mode
from brink.server.problems.base import Describes, Problem

HOLD_S: Final = 60.0
"""How long a coordinator that has died keeps others from asking in its place."""

LAST_ANSWERS_S: Final = 8.0
"""How long a coordinator that stops waits for answers that are under way: less than containers are given to stop."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Asking:
    """A request that is being asked. Changes in place."""

    words: str
    thread: threading.Thread


class _ClaimLost(Exception):
    """Another coordinator asks now."""


class LlmSeeds:
    """Asks language models on behalf of campaigns.

    Args:
        engines: To read stored calls with.
        writer: To store calls with.
        came: Told the id of a campaign whose seeds have come, from another thread.
    """

    def __init__(self, engines: Engines, writer: Writer, came: Callable[[str], None]) -> None:
        self._engines = engines
        self._writer = writer
        self._came = came
        self._owner = secrets.token_hex(8)
        self._lock = threading.Lock()
        self._asking: dict[str, _Asking] = {}
        self._answers: dict[tuple[str, int], Sequence[Proposal]] = {}
        self._stopping = threading.Event()

    def close(self) -> None:
        """Ask nothing more; an answer that comes soon is stored yet, and other coordinators may ask then."""
        with self._lock:
            self._stopping.set()
            asking = dict(self._asking)
        until = time.monotonic() + LAST_ANSWERS_S
        for campaign_id, one in asking.items():
            about = {"campaign": campaign_id}
            log.info("%s; waiting up to %g s for the answer", one.words, LAST_ANSWERS_S, extra=about)
            one.thread.join(max(0.0, until - time.monotonic()))
            if one.thread.is_alive():
                log.warning("no answer came; it will be asked for again, and counts twice", extra=about)
        self._release(None)

    def proposals(
        self, campaign_id: str, settings: LlmSettings | None, problem: Problem, request: SeedRequest
    ) -> Sequence[Proposal] | None:
        """Return the proposals that came, perhaps none; None while this or another coordinator is still asking.

        Args:
            campaign_id: The campaign that waits.
            settings: The language model; None if the campaign names none.
            problem: The campaign's problem.
            request: What the algorithm asks for.
        """
        if settings is None or not isinstance(problem, Describes):
            return ()
        with self._lock:
            if (campaign_id, request.number) in self._answers:
                return self._answers.pop((campaign_id, request.number))
            asking = self._asking.get(campaign_id)
            if self._stopping.is_set():
                return None
        if asking is not None or not self._claim(campaign_id).result():
            return None
        words = f"asking {settings.model} for {request.count} solutions"
        # A daemon: a model that never answers must not keep a coordinator from stopping.
        thread = threading.Thread(
            target=self._ask, args=(campaign_id, settings, problem, request), name="seeds", daemon=True
        )
        with self._lock:
            stopping = self._stopping.is_set()
            if not stopping:
                self._asking[campaign_id] = _Asking(words, thread)
                thread.start()
        if stopping:
            self._release(campaign_id)
        return None

    def doing(self, campaign_id: str) -> str | None:
        """Return what a campaign waits for, in words; None if this coordinator asks nothing for it."""
        with self._lock:
            asking = self._asking.get(campaign_id)
        return None if asking is None else asking.words

    def _claim(self, campaign_id: str) -> Future[bool]:
        return self._writer.submit(lambda connection: claim(connection, campaign_id, self._owner, HOLD_S))

    def _ask(self, campaign_id: str, settings: LlmSettings, problem: Describes, request: SeedRequest) -> None:
        """Ask, on a thread of its own; without an answer the sweeper has it asked again."""
        answer: Sequence[Proposal] | None = None
        about = {"campaign": campaign_id}
        try:
            answer = asyncio.run(self._answer_while_claimed(campaign_id, settings, problem, request))
        except _ClaimLost:
            log.warning("another coordinator asks for its seeds now", extra=about)
        except (Unavailable, DBAPIError) as error:
            log.warning("%s; its seeds will be asked for again", error, extra=about)
        except CallLogMismatch as error:
            log.warning("%s; it goes on without these seeds", error, extra=about)
            answer = ()
        except Exception:
            log.exception("seeds cannot be had; it goes on without them", extra=about)
            answer = ()
        # Released before it is forgotten: who stops waits for all that are not forgotten, and then the writer closes.
        self._release(campaign_id)
        with self._lock:
            self._asking.pop(campaign_id, None)
            if answer is not None:
                self._answers[campaign_id, request.number] = answer
            stopping = self._stopping.is_set()
        if answer is not None and not stopping:
            self._came(campaign_id)

    def _release(self, campaign_id: str | None) -> None:
        with contextlib.suppress(Unavailable, DBAPIError):  # it expires
            self._writer.submit(lambda connection: release(connection, self._owner, campaign_id)).result()

    async def _answer_while_claimed(
        self, campaign_id: str, settings: LlmSettings, problem: Describes, request: SeedRequest
    ) -> Sequence[Proposal]:
        """Answer, and keep the claim meanwhile, be the campaign paused or not; without it ask nothing more."""
        answering = asyncio.create_task(self._answer(campaign_id, settings, problem, request))
        while not (await asyncio.wait({answering}, timeout=HOLD_S / 3))[0]:
            try:
                held = await asyncio.wrap_future(self._claim(campaign_id))
            except (Unavailable, DBAPIError):
                continue  # nobody else can claim it either
            if not held:
                answering.cancel()
                raise _ClaimLost
        return answering.result()

    async def _answer(
        self, campaign_id: str, settings: LlmSettings, problem: Describes, request: SeedRequest
    ) -> Sequence[Proposal]:
        calls = CampaignCalls(self._engines, self._writer, campaign_id, self._stopping)
        known = calls.every()
        mode = known[-1].mode if known else Mode.JSON_SCHEMA
        async with LlmClient(settings, mode=mode) as client:
            answer = await ask(
                request, road=problem.road, most=problem.most, system=problem.system, log=calls, client=client
            )
        level = logging.INFO if answer.proposals else logging.WARNING
        log.log(level, "%s", answer.words, extra={"campaign": campaign_id})
        return answer.proposals
