"""What the routes need: the services of this process, handed to each route."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import Depends, Request

from brink.server.access.gate import Caller
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.monitors import Monitors
from brink.server.campaigns.scheduler import Scheduler
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.traces import Films
from brink.server.dashboard.figures import Figures
from brink.server.db.engine import Engines
from brink.server.experiments.scorebook import Scorebook
from brink.server.experiments.service import ExperimentService
from brink.server.llm.seeds import LlmSeeds
from brink.server.metrics import Metrics
from brink.server.queue.service import QueueService
from brink.server.settings import Settings

CALLER = "brink.caller"
"""Key of the caller in the scope of a request."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """The services of this process."""

    settings: Settings
    engines: Engines
    campaigns: CampaignService
    experiments: ExperimentService
    scorebook: Scorebook
    monitors: Monitors
    queue: QueueService
    scheduler: Scheduler
    archives: Archives
    films: Films
    seeds: LlmSeeds
    metrics: Metrics
    figures: Figures
    drawing: ThreadPoolExecutor
    """Threads of their own: a film takes seconds, and all else must not wait for that."""


async def context_of(request: Request) -> Context:  # async: another thread would cost more than this does
    """Return the services of the app that serves a request."""
    return cast(Context, request.app.state.context)


Services = Annotated[Context, Depends(context_of)]


@asynccontextmanager
async def client_gone(request: Request) -> AsyncIterator[asyncio.Event]:
    """Give an event that is set as soon as the client of a request has gone."""
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
    """Return whose token a request carries; None where no token is asked for."""
    return cast(Caller | None, request.scope.get(CALLER))
