"""Seeds from language models for campaigns: asked for on threads of their own, known again after a restart.

A campaign waits for its seeds and nothing else does. What a model answered is stored before it counts, so the same
request of a campaign gives the same seeds whenever it is asked: after a restart the stored replies are read again.
"""

import asyncio
import logging
import threading
from collections.abc import Callable, Sequence

from search.seeding import Proposal, SeedRequest
from server.campaigns.values import Campaign
from server.db.engine import Engines
from server.db.writer import Writer
from server.errors import Unavailable
from server.llm.client import LlmClient
from server.llm.errors import CallLogMismatch
from server.llm.seeder import ask
from server.llm.settings import LlmSettings
from server.llm.store import CampaignCalls
from server.llm.wire import Mode
from server.problems.base import Describes, Problem

log = logging.getLogger(__name__)


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
        self._lock = threading.Lock()
        self._asking: dict[tuple[str, int], str] = {}
        self._answers: dict[tuple[str, int], Sequence[Proposal]] = {}

    def proposals(
        self, campaign: Campaign, problem: Problem, request: SeedRequest
    ) -> Sequence[Proposal] | None:
        """Return what came, perhaps nothing; None while it is not known yet."""
        settings = campaign.body.llm
        if settings is None or not isinstance(problem, Describes):
            return ()
        key = campaign.id, request.number
        with self._lock:
            if key in self._answers:
                return self._answers.pop(key)
            if key in self._asking:
                return None
            self._asking[key] = f"asking {settings.model} for {request.count} solutions"
        # A daemon: a model that never answers must not keep a coordinator from stopping.
        asking = threading.Thread(
            target=self._ask, args=(campaign.id, settings, problem, request), name="seeds", daemon=True
        )
        asking.start()
        return None

    def doing(self, campaign_id: str) -> str | None:
        """Return what a campaign waits for, in words; None if it waits for no seeds."""
        with self._lock:
            return next((words for (asks, _), words in self._asking.items() if asks == campaign_id), None)

    def _ask(self, campaign_id: str, settings: LlmSettings, problem: Describes, request: SeedRequest) -> None:
        key = campaign_id, request.number
        answer: Sequence[Proposal] | None = None
        try:
            answer = asyncio.run(self._answer(campaign_id, settings, problem, request))
        except Unavailable as error:
            log.warning("campaign=%s: %s; its seeds will be asked for again", campaign_id, error)
        except CallLogMismatch as error:
            log.warning("campaign=%s: %s; it goes on without these seeds", campaign_id, error)
            answer = ()
        except Exception:
            log.exception("campaign=%s: seeds cannot be had; it goes on without them", campaign_id)
            answer = ()
        with self._lock:
            self._asking.pop(key, None)
            if answer is not None:
                self._answers[key] = answer
        if answer is not None:
            self._came(campaign_id)

    async def _answer(
        self, campaign_id: str, settings: LlmSettings, problem: Describes, request: SeedRequest
    ) -> Sequence[Proposal]:
        calls = CampaignCalls(self._engines, self._writer, campaign_id)
        known = calls.every()
        mode = known[-1].mode if known else Mode.JSON_SCHEMA
        async with LlmClient(settings, mode=mode) as client:
            answer = await ask(
                request, road=problem.road, most=problem.most, system=problem.system, log=calls, client=client
            )
        log.info("campaign=%s request=%d %s", campaign_id, request.number, answer.words)
        return answer.proposals
