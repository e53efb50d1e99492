"""The services of this process, injected into the routes, and information about the client of a request."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import Depends, Request

from brink.server.access.authentication import Caller
from brink.server.campaigns.advance import Scheduler
from brink.server.campaigns.archives import Monitors
from brink.server.campaigns.deletion import Eraser
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.traces import Films
from brink.server.dashboard.figures import Figures
from brink.server.experiments.pairs import PairCache
from brink.server.experiments.service import ExperimentService, ScoreCache
from brink.server.experiments.thresholds import ThresholdCache
from brink.server.findings.sources import Sources
from brink.server.metrics import Metrics
from brink.server.queue.service import QueueService
from brink.server.read_threads import ReadThreads
from brink.server.seeding import SeedSource
from brink.server.settings import Settings
from brink.server.single_flight import SingleFlightCache

CALLER = "brink.caller"
"""Key of the caller in the ASGI scope of a request."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Context(Sources):
    """The services of this process."""

    settings: Settings
    campaigns: CampaignService
    experiments: ExperimentService
    eraser: Eraser
    scorebook: ScoreCache
    monitors: Monitors
    queue: QueueService
    scheduler: Scheduler
    pair_pictures: SingleFlightCache[tuple[bytes, bytes]]
    """Pictures of both sides of pairs."""
    experiment_pairs: PairCache
    experiment_thresholds: ThresholdCache
    films: Films
    seeds: SeedSource
    metrics: Metrics
    figures: Figures
    drawing: ReadThreads
    """Threads for rendering: a video takes seconds, and nothing else should wait for it."""
    fits: ReadThreads
    """Threads for fitting monitors."""
    scores: ReadThreads
    """Threads for the scores, pairs and thresholds of campaigns, of which an experiment has hundreds."""
    decoding: ThreadPoolExecutor
    """A thread for large messages: decoding one takes too long for the event loop, and several take much memory."""


async def context_of(request: Request) -> Context:  # async: a thread switch would cost more than the lookup
    """Return the services of the app that handles a request."""
    return cast(Context, request.app.state.context)


Services = Annotated[Context, Depends(context_of)]


@asynccontextmanager
async def client_gone(request: Request) -> AsyncIterator[asyncio.Event]:
    """Provide an event that is set as soon as the client disconnects."""
    gone = asyncio.Event()

    async def watch() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass
        gone.set()

    watching = asyncio.create_task(watch())
    try:
        yield gone
    finally:
        watching.cancel()


def caller_of(request: Request) -> Caller | None:
    """Return the authenticated caller of a request, or None on a coordinator without tokens."""
    return cast(Caller | None, request.scope.get(CALLER))
