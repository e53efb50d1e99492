"""The composition root: `create_app` assembles a coordinator."""

import asyncio
import logging
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from functools import cache

from fastapi import APIRouter, FastAPI
from starlette.routing import BaseRoute

from brink import __version__
from brink.server.access.authentication import Authenticator
from brink.server.api import (
    analysis,
    campaigns,
    combinations,
    episodes,
    experiment_findings,
    experiments,
    findings,
    jobs,
    outcomes,
    pair_pictures,
    pairs,
    repeats,
    service,
    solutions,
    suites,
    thresholds,
    tolerance,
    violations,
)
from brink.server.api.context import Context
from brink.server.api.middleware import AccessMiddleware, MetricsMiddleware
from brink.server.api.problem_details import describe, install
from brink.server.api.schemas import ProblemDetail
from brink.server.api.service import add_docs
from brink.server.api.wire_routes import WireMiddleware
from brink.server.campaigns.advance import Scheduler, Stepper
from brink.server.campaigns.archives import Archives, Monitors
from brink.server.campaigns.boundaries import Boundaries
from brink.server.campaigns.checks import SLOW_AT_ONCE
from brink.server.campaigns.deletion import Eraser
from brink.server.campaigns.others import OtherCoordinators
from brink.server.campaigns.outcomes import Outcomes
from brink.server.campaigns.pairs import Pairs
from brink.server.campaigns.reported import ReportedResults
from brink.server.campaigns.result_check import ResultChecks
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.thresholds import Thresholds
from brink.server.campaigns.tolerance import Tolerances
from brink.server.campaigns.traces import Films
from brink.server.dashboard.figures import Figures
from brink.server.dashboard.page import add_dashboard
from brink.server.db.engine import Engines, open_engines
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.experiments.body import MAX_CAMPAIGNS
from brink.server.experiments.pairs import PairCache
from brink.server.experiments.service import ExperimentService, ScoreCache
from brink.server.experiments.thresholds import ThresholdCache
from brink.server.metrics import Metrics
from brink.server.queue.service import QueueService
from brink.server.queue.wakeups import Wakeups, count_listening, listen
from brink.server.read_threads import ReadThreads
from brink.server.seeding import Access, seeder
from brink.server.settings import LOOPBACK, Settings
from brink.server.single_flight import SingleFlightCache
from brink.server.user_code import USER_CODE

log = logging.getLogger(__name__)

PREFIX = "/api/v1"
DRAWING_LIMIT_S = 60.0
FIT_LIMIT_S = 120.0
"""Time limit of a monitor's fit, which takes up to 36 s for the most solutions that one is fitted to."""
SCORES_LIMIT_S = 600.0
"""Time limit of a campaign's scores or pairs in an experiment: nobody waits for them, and they are kept."""
MOST_SCORED = 4 * MAX_CAMPAIGNS
"""Maximum number of campaigns in line for those: scores and pairs of two of the largest experiments."""
DESCRIPTION = """
Brink finds where a driving system with a machine-learned component stops being safe.

Submit a campaign, let workers run its simulations, and read the distinct solutions on the hazard boundary.
A worker needs three requests: `POST /api/v1/jobs/lease`, `/heartbeat` and `/results`.
"""


def create_app(settings: Settings, *, sweeping: bool = True) -> FastAPI:
    """Return the coordinator's app.

    Args:
        settings: Settings of the coordinator.
        sweeping: Whether it is a full coordinator, which reclaims lost leases, advances campaigns and checks tokens.
            Off for the private app of a command that has access to the database anyway.

    Raises:
        DatabaseError: The database URL cannot be used.
        InvalidInput: The setting with the language models is malformed.
    """
    access = seeder().access(settings.llm_endpoints)
    engines = open_engines(settings.database)
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()
        context = _context(settings, engines, metrics, access, loop, sweeping=sweeping)
        app.state.context = context
        serving = USER_CODE.begin(settings.plugin_timeout_s, patient=not sweeping)
        stopping = asyncio.Event()
        sweeper = asyncio.create_task(_sweep(context, stopping)) if sweeping else None
        heard = context.queue.wakeups.wake, context.scheduler.advance_own
        listens = sweeping and not engines.is_sqlite
        listener = asyncio.create_task(listen(engines.writer.url, *heard)) if listens else None
        try:
            yield
        finally:
            stopping.set()
            USER_CODE.stop(serving)
            if listener is not None:
                listener.cancel()
                await asyncio.wait([listener])
            if sweeper is not None:  # not cancelled: its thread could hold a connection of disposed engines
                await sweeper
            # Without a sweeper, nobody would go on.
            await (context.eraser.stop() if sweeping else context.eraser.finish())
            loop = asyncio.get_running_loop()
            await loop.run_in_executor(None, context.seeds.close)
            await loop.run_in_executor(None, context.campaigns.close)
            reading = (
                context.drawing,
                context.fits,
                context.scores,
                context.figures,
                context.pages,
                context.analyses,
            )
            await asyncio.gather(*(loop.run_in_executor(None, one.close) for one in reading))
            await loop.run_in_executor(None, context.decoding.shutdown)
            await loop.run_in_executor(None, context.scheduler.close)
            await loop.run_in_executor(None, context.queue.close)
            engines.dispose()
            USER_CODE.end(serving)

    app = FastAPI(
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        title="Brink",
        description=DESCRIPTION,
        version=__version__,
        lifespan=lifespan,
        redirect_slashes=False,
    )
    install(app)
    describe(app)
    app.router.routes.extend(_routes())
    add_docs(app)
    add_dashboard(app)
    token = settings.token.get_secret_value() if settings.token else None
    exposed = settings.host not in LOOPBACK
    authenticator = (
        Authenticator(engines, token=token, exposed=exposed, rate_limit=settings.rate_limit)
        if sweeping
        else None
    )
    app.add_middleware(
        WireMiddleware, routes=jobs.wire.routes, prefix=PREFIX, handlers=app.exception_handlers
    )
    app.add_middleware(
        AccessMiddleware,
        authenticator=authenticator,
        max_body_bytes=settings.max_body_bytes,
        stall_s=settings.stall_s,
    )
    app.add_middleware(MetricsMiddleware, metrics=metrics, access_log=settings.access_log)
    return app


@cache
def _routes() -> list[BaseRoute]:
    """Return the API's routes, which all apps of a process share, since building them dominates the startup time."""
    api = APIRouter()
    # Routes are tried in order, so the busiest come first.
    for router in (
        jobs.wire,
        jobs.router,
        campaigns.router,
        combinations.router,
        solutions.router,
        episodes.router,
        outcomes.router,
        findings.router,
        violations.router,
        campaigns.llm_router,
        analysis.monitors_router,
        repeats.router,
        suites.router,
        suites.runs_router,
        pairs.router,
        thresholds.router,
        pair_pictures.router,
        pair_pictures.compared_router,
        tolerance.router,
        experiments.router,
        experiment_findings.router,
        service.router,
        campaigns.overview_router,
        analysis.router,
    ):
        api.include_router(router)
    everything = APIRouter(
        responses={
            "4XX": {"model": ProblemDetail, "description": "The request is invalid; `detail` says why."},
            "5XX": {
                "model": ProblemDetail,
                "description": "The coordinator cannot serve this request now; try again later.",
            },
        }
    )
    everything.include_router(api, prefix=PREFIX)
    everything.include_router(service.root)
    return everything.routes


def _context(
    settings: Settings,
    engines: Engines,
    metrics: Metrics,
    access: Access,
    loop: asyncio.AbstractEventLoop,
    *,
    sweeping: bool,
) -> Context:
    def others_are_known() -> bool:
        if engines.is_sqlite:
            return queue.has_workers_elsewhere
        with engines.reader.connect() as connection:
            return count_listening(connection) > 1

    def on_seeds(campaign_id: str) -> None:
        with suppress(RuntimeError):  # the coordinator has stopped in the meantime
            loop.call_soon_threadsafe(scheduler.advance_soon, [campaign_id])

    writer = Writer(engines.writer, on_commit=metrics.commits.observe)
    seeds = seeder().source(engines, writer, on_seeds, access)
    stepper = Stepper(
        engines,
        writer,
        max_stored_distances=settings.max_stored_distances,
        seeds=seeds,
        metrics=metrics,
        others=OtherCoordinators(engines, writer, others_are_known) if sweeping else None,
        live_searches_mib=settings.live_searches_mib,
    )
    wakeups = Wakeups()
    scheduler = Scheduler(engines, stepper, wakeups)
    queue = QueueService(
        settings=settings,
        writer=writer,
        on_due=scheduler.advance_soon,
        metrics=metrics,
        wakeups=wakeups,
        check=ResultChecks(engines),
    )
    _watch(metrics, scheduler)
    eraser = Eraser(engines, writer)
    campaigns = CampaignService(
        engines=engines, writer=writer, eraser=eraser, scheduler=scheduler, wakeups=wakeups, access=access
    )
    pages = ReadThreads(SLOW_AT_ONCE, "brink-pages", limit_s=settings.read_limit_s)
    analyses = ReadThreads(SLOW_AT_ONCE, "brink-analyses", limit_s=settings.read_limit_s)
    archives = Archives(engines=engines, stepper=stepper, threads=pages)
    drawing = ReadThreads(
        SLOW_AT_ONCE, "brink-draw", limit_s=DRAWING_LIMIT_S, instead="request a still image (png)"
    )
    fits = ReadThreads(
        SLOW_AT_ONCE,
        "brink-fits",
        limit_s=FIT_LIMIT_S,
        instead="fit the monitor on your machine with `brink monitor fit`, and use its file",
    )
    scores = ReadThreads(
        SLOW_AT_ONCE,
        "brink-scores",
        limit_s=SCORES_LIMIT_S,
        most_pending=MOST_SCORED,
        patient=True,
        instead="query one campaign instead of an experiment, or pairs with a smaller eps",
    )
    return Context(
        settings=settings,
        engines=engines,
        queue=queue,
        scheduler=scheduler,
        campaigns=campaigns,
        eraser=eraser,
        experiments=ExperimentService(
            engines=engines, writer=writer, eraser=eraser, checks=campaigns.checks, campaigns=campaigns
        ),
        scorebook=ScoreCache(archives=archives, threads=scores),
        monitors=Monitors(archives=archives, threads=fits),
        pages=pages,
        analyses=analyses,
        archives=archives,
        boundaries=Boundaries(analyses),
        outcomes=Outcomes(engines=engines, threads=pages),
        reported=ReportedResults(),
        pair_pictures=SingleFlightCache(pair_pictures.KEPT, drawing),
        pairs=Pairs(engines=engines, threads=analyses),
        tolerances=Tolerances(engines=engines, threads=analyses),
        thresholds=Thresholds(engines=engines, threads=analyses),
        experiment_pairs=PairCache(engines=engines, archives=archives, threads=scores),
        experiment_thresholds=ThresholdCache(engines=engines, archives=archives, threads=scores),
        films=Films(engines=engines),
        seeds=seeds,
        metrics=metrics,
        figures=Figures(SLOW_AT_ONCE, archives),
        drawing=drawing,
        fits=fits,
        scores=scores,
        decoding=ThreadPoolExecutor(1, thread_name_prefix="brink-decode"),
    )


def _watch(metrics: Metrics, scheduler: Scheduler) -> None:
    """Add the metrics that are polled: what is in memory, and stalled work."""
    metrics.watch(
        "brink_plugin_calls_stalled",
        "Calls of plug-ins' code that exceeded their time limit and still run",
        lambda: len(USER_CODE.stalled()),
    )
    metrics.watch(
        "brink_step_running_seconds",
        "Time since the oldest running generation step began; 0 if none runs",
        lambda: scheduler.oldest_step_s,
    )
    metrics.watch("brink_live_searches", "Searches in memory", lambda: len(scheduler.stepper.live_campaigns))
    metrics.watch(
        "brink_live_search_bytes",
        "Memory of these searches, as estimated",
        lambda: scheduler.stepper.live_bytes,
    )


async def _sweep(context: Context, stopping: asyncio.Event) -> None:
    """Periodically repair the effects of crashes: reclaim lost leases, advance due campaigns, erase deleted ones."""
    while not stopping.is_set():
        try:
            await context.queue.sweep()
            await context.scheduler.sweep()
            context.eraser.start()
        except Unavailable as error:
            log.warning("sweeper: %s; retrying in the next round", error)
        except Exception:
            log.exception("sweeper: this round failed; retrying in the next round")
        with suppress(TimeoutError):
            await asyncio.wait_for(stopping.wait(), context.settings.sweep_s)
