"""The composition root: `create_app` puts a coordinator together."""

import asyncio
import logging
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from functools import partial

from fastapi import APIRouter, FastAPI

from brink import __version__
from brink.server.access.gate import Gate
from brink.server.api import (
    analysis,
    campaigns,
    combinations,
    episodes,
    experiments,
    jobs,
    llm,
    monitors,
    overview,
    repeats,
    service,
    solutions,
    violations,
)
from brink.server.api.context import Context
from brink.server.api.middleware import AccessMiddleware, MetricsMiddleware
from brink.server.api.problem_details import describe, install
from brink.server.api.schemas import ProblemDetail
from brink.server.api.service import add_docs
from brink.server.campaigns.advance import Stepper
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.monitors import Monitors
from brink.server.campaigns.scheduler import Scheduler
from brink.server.campaigns.service import SLOW_AT_ONCE, CampaignService
from brink.server.campaigns.traces import Films
from brink.server.dashboard.figures import Figures
from brink.server.dashboard.page import add_dashboard
from brink.server.db.engine import Engines, open_engines
from brink.server.db.news import listen
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.experiments.scorebook import Scorebook
from brink.server.experiments.service import ExperimentService
from brink.server.llm.seeds import LlmSeeds
from brink.server.metrics import Metrics
from brink.server.queue.service import QueueService
from brink.server.queue.wakeups import Wakeups
from brink.server.settings import LOOPBACK, Settings

log = logging.getLogger(__name__)

DESCRIPTION = """
Finds where a driving system with a machine-learned component stops being safe.

Submit a campaign, let workers lease its simulations, and read the distinct solutions on the hazard boundary.
Writing a worker takes three requests: `POST /api/v1/jobs/lease`, `/heartbeat` and `/results`.
"""


def create_app(settings: Settings, *, sweeping: bool = True) -> FastAPI:
    """Return the coordinator's app.

    Args:
        settings: What the coordinator is told.
        sweeping: Whether it serves others: takes back lost leases, advances campaigns, asks for tokens; off for an
            app that a command has to itself, which could read the database just as well.

    Raises:
        DatabaseError: The database URL cannot be used.
    """
    engines = open_engines(settings.database)
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        context = _context(settings, engines, metrics, asyncio.get_running_loop())
        app.state.context = context
        stopping = asyncio.Event()
        sweeper = asyncio.create_task(_sweep(context, stopping)) if sweeping else None
        shared = sweeping and not engines.is_sqlite
        listener = (
            asyncio.create_task(listen(engines.writer.url, context.queue.wakeups.wake)) if shared else None
        )
        try:
            yield
        finally:
            stopping.set()
            if listener is not None:
                listener.cancel()
                await asyncio.wait([listener])
            if sweeper is not None:  # cancelled, its thread would hold a connection of engines that are gone
                await sweeper
            loop = asyncio.get_running_loop()
            await loop.run_in_executor(None, context.seeds.close)
            await loop.run_in_executor(None, context.campaigns.close)
            await loop.run_in_executor(None, partial(context.drawing.shutdown, cancel_futures=True))
            await loop.run_in_executor(None, context.figures.close)
            await loop.run_in_executor(None, context.scheduler.close)
            await loop.run_in_executor(None, context.queue.writer.close)
            engines.dispose()

    app = FastAPI(
        docs_url=None, redoc_url=None, title="Brink", description=DESCRIPTION,
        version=__version__, lifespan=lifespan, redirect_slashes=False,
        responses={
            "4XX": {"model": ProblemDetail, "description": "What is wrong with the request."},
            "5XX": {"model": ProblemDetail, "description": "What keeps the coordinator from answering; try again."},
        },
    )  # fmt: skip
    install(app)
    describe(app)
    api = APIRouter(prefix="/api/v1")
    # The busiest first: routes are tried in order.
    api.include_router(jobs.wire)
    for module in (
        jobs,
        campaigns,
        combinations,
        solutions,
        episodes,
        violations,
        llm,
        monitors,
        repeats,
        experiments,
        service,
        overview,
        analysis,
    ):
        api.include_router(module.router)
    app.include_router(api)
    app.include_router(service.root)
    add_docs(app)
    add_dashboard(app)
    token = settings.token.get_secret_value() if settings.token else None
    exposed = settings.host not in LOOPBACK
    gate = Gate(engines, token=token, exposed=exposed, rate_limit=settings.rate_limit) if sweeping else None
    app.add_middleware(
        AccessMiddleware, gate=gate, max_body_bytes=settings.max_body_bytes, stall_s=settings.stall_s
    )
    app.add_middleware(MetricsMiddleware, metrics=metrics, access_log=settings.access_log)
    return app


def _context(
    settings: Settings, engines: Engines, metrics: Metrics, loop: asyncio.AbstractEventLoop
) -> Context:
    def came(campaign_id: str) -> None:
        with suppress(RuntimeError):  # the coordinator has stopped meanwhile
            loop.call_soon_threadsafe(scheduler.advance_soon, [campaign_id])

    writer = Writer(engines.writer, took=metrics.commits.observe)
    seeds = LlmSeeds(engines, writer, came)
    stepper = Stepper(
        engines, writer, max_stored_distances=settings.max_stored_distances, seeds=seeds, metrics=metrics
    )
    wakeups = Wakeups()
    scheduler = Scheduler(engines, stepper, wakeups)
    queue = QueueService(
        settings=settings, writer=writer, on_idle=scheduler.advance_soon, metrics=metrics, wakeups=wakeups
    )
    campaigns = CampaignService(
        engines=engines,
        writer=writer,
        scheduler=scheduler,
        wakeups=wakeups,
        llm_endpoints=settings.llm_endpoints,
    )
    archives = Archives(engines=engines, stepper=stepper)
    drawing = ThreadPoolExecutor(SLOW_AT_ONCE, thread_name_prefix="brink-draw")
    return Context(
        settings=settings,
        engines=engines,
        queue=queue,
        scheduler=scheduler,
        campaigns=campaigns,
        experiments=ExperimentService(campaigns=campaigns),
        scorebook=Scorebook(archives=archives, threads=drawing),
        monitors=Monitors(archives=archives, threads=drawing),
        archives=archives,
        films=Films(engines=engines),
        seeds=seeds,
        metrics=metrics,
        figures=Figures(SLOW_AT_ONCE),
        drawing=drawing,
    )


async def _sweep(context: Context, stopping: asyncio.Event) -> None:
    """Mend what a crash left: lost leases, and campaigns whose next step is due."""
    while not stopping.is_set():
        try:
            await context.queue.sweep()
            await context.scheduler.sweep()
        except Unavailable as error:
            log.warning("sweeper: %s; the next round will look again", error)
        except Exception:
            log.exception("sweeper: this round failed; the next one will look again")
        with suppress(TimeoutError):
            await asyncio.wait_for(stopping.wait(), context.settings.sweep_s)
