"""Running a campaign or an experiment to its end on this machine, with an embedded coordinator and workers.

`run_locally` starts the coordinator, gives a command its `Session` and stops everything afterwards; `run_to_end`
submits a `Workload` or resumes it, watches it, and pauses it on Ctrl-C.
"""

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Protocol, TypeVar

import httpx
from rich.console import Console

from brink.api.client import TIMEOUT, Api, CoordinatorError
from brink.api.live import CampaignDisplay, earlier_words
from brink.cli.options import database_option, database_place, naming_ids, program, settings_with
from brink.server.api.schemas import ExperimentProgress, Progress
from brink.server.errors import Conflict, Unavailable
from brink.server.llm.access import with_endpoints
from brink.server.llm.settings import LlmSettings
from brink.server.runtime.coordinator import WorkerProcesses, local_coordinator
from brink.server.settings import LOOPBACK, Settings
from brink.server.states import CampaignStatus

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
POLL_S = 0.3
MAX_TROUBLE_S = 5.0
"""How long the database may reject writes before a run gives up."""

T = TypeVar("T")
ProgressT = TypeVar("ProgressT", Progress, ExperimentProgress)


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """An embedded coordinator and its workers, as a command uses them.

    Attributes:
        api: Its API.
        url: Its address.
        needs_token: Whether it rejects requests without a token.
        database: The option that names its database in hints; empty for the default one.
        processes: Its workers; none is started yet.
        stop: Set on Ctrl-C or SIGTERM.
        screen: Console for progress and hints.
        place: Where its database is, in words.
        serve: The command that serves its dashboard later, and the address it then has.
    """

    api: Api
    url: str
    needs_token: bool
    database: str
    processes: WorkerProcesses
    stop: asyncio.Event
    screen: Console
    place: str = ""
    serve: tuple[str, str] = ("serve", "http://127.0.0.1:8700")

    def hint(self, text: str, command: str) -> None:
        """Print a hint with a command that can be pasted."""
        self.screen.print(f"{text}: {program()} {command}{self.database}", soft_wrap=True)

    async def watch(self, poll: Callable[[], Awaitable[ProgressT]]) -> ProgressT:
        """Poll until the work ends or is stopped, replacing workers that died.

        Args:
            poll: Fetches and shows the progress.

        Returns:
            The last progress.

        Raises:
            Unavailable: The database has rejected writes for too long.
        """
        while True:
            progress = await poll()
            if progress.status is not CampaignStatus.RUNNING or self.stop.is_set():
                return progress
            if progress.trouble_s > MAX_TROUBLE_S:
                raise Unavailable(
                    f"{progress.trouble}; acknowledged results are stored; continue later with --resume"
                )
            self.processes.replace_dead()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.stop.wait(), POLL_S)

    async def watch_campaign(self, campaign: str) -> Progress:
        """Show the progress of a campaign until it ends or is stopped; return the last progress."""
        with CampaignDisplay(self.screen) as display:

            async def poll() -> Progress:
                since = {"since": display.generations}
                progress = await self.api.read(Progress, f"/campaigns/{campaign}/progress", since)
                display.show(progress)
                return progress

            return await self.watch(poll)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Options of the commands that run a campaign or an experiment.

    Attributes:
        file: The campaign or experiment file, for hints.
        workers: Number of worker processes.
        out: Folder for results.
        resume: Whether to resume the latest run of the file.
        new: Whether to start a new run even if an earlier one is unfinished.
        json: Whether to print the results as JSON.
        database: Database URL; None takes the default one.
        port: Port of the coordinator; 0 picks a free port, None the usual one unless it is in use.
        sizes: Options that change what the file says.
    """

    file: Path
    workers: int
    out: Path
    resume: bool
    new: bool
    json: bool
    database: str | None = None
    port: int | None = None
    sizes: tuple[str, ...] = ()

    @property
    def resume_command(self) -> str:
        """The command that continues the run, without the command group."""
        return " ".join(["run", quote(str(self.file)), *self.sizes, "--resume"])


class Workload(Protocol[ProgressT]):
    """A campaign or an experiment to run to its end.

    Attributes:
        noun: "campaign" or "experiment"; its plural is the REST resource.
        command: Command group of its own commands, with a trailing space; empty for campaigns.
        models: The language models that it names.
    """

    noun: str
    command: str

    @property
    def models(self) -> Sequence[LlmSettings | None]: ...  # noqa: D102

    async def latest(self, api: Api, statuses: Sequence[CampaignStatus]) -> ProgressT | None:
        """Return the latest run of the file that has one of these statuses."""
        ...

    async def resume(self, api: Api, found: ProgressT) -> None:
        """Resume an unfinished run."""
        ...

    async def submit(self, api: Api) -> tuple[str, str]:
        """Submit a new run; return its id and a summary of it in words."""
        ...

    async def watch(self, session: Session, name: str) -> ProgressT:
        """Show the progress until the work ends or is stopped; return the last progress."""
        ...

    def reasons(self, progress: ProgressT) -> Sequence[str]:
        """Return the reasons why the work ended unfinished."""
        ...


def run_locally(
    settings: Settings,
    worker_log: Path,
    screen: Console,
    work: Callable[[Session], Awaitable[T]],
    *,
    any_port: bool = False,
) -> T:
    """Start a coordinator, run some work against it, and stop the coordinator and its workers.

    Args:
        settings: Settings of the coordinator. Its database is created or upgraded.
        worker_log: Log file of the workers. Its folder is created first, so an unwritable one fails early.
        screen: Console for progress and hints.
        work: Called with the session.
        any_port: Whether to listen on a free port if another program uses that of the settings.

    Raises:
        DatabaseError: The database is unusable.
        CannotListen: The coordinator failed to start.
    """
    worker_log.parent.mkdir(parents=True, exist_ok=True)

    async def run(url: str, token: str | None, processes: WorkerProcesses) -> T:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT, headers=headers) as client:
            session = Session(
                api=Api(client, url),
                url=url,
                needs_token=token is not None,
                database=database_option(settings),
                processes=processes,
                stop=asyncio.Event(),
                screen=screen,
                place=database_place(settings),
                serve=_serve_later(settings),
            )
            return await naming_ids(session.api, session.place, session.database, lambda: work(session))

    coordinator = local_coordinator(settings, worker_log, any_port=any_port)
    with _default_signals_afterwards(), coordinator as (url, token, processes):
        return asyncio.run(run(url, token, processes))


def _serve_later(settings: Settings) -> tuple[str, str]:
    """Return the command that serves the dashboard of a database, and its address."""
    usual = settings_with().port
    port = settings.port or usual
    option = "" if port == usual else f" --port {port}"
    return f"serve{option}{database_option(settings)}", f"http://{LOOPBACK[0]}:{port}"


@contextlib.contextmanager
def _default_signals_afterwards() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end this process again after the block, in which `stopping` may have ignored them."""
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def run_to_end(
    workload: Workload[ProgressT],
    options: RunOptions,
    screen: Console,
    finish: Callable[[Session, ProgressT], Awaitable[T]],
) -> T | None:
    """Run a campaign or an experiment to its end on this machine.

    Args:
        workload: The campaign or experiment.
        options: Options of the command.
        screen: Console for progress and hints.
        finish: Called when the work has finished, while coordinator and workers still run.

    Returns:
        The value of `finish`; None if the work was stopped or ended unfinished.

    Raises:
        Conflict: An earlier run is unfinished, and neither `resume` nor `new` is set.
    """
    settings = settings_with(database=options.database, port=options.port)
    # The user runs both the file and the coordinator, so the language models that the file names are allowed. Keys
    # are not, nor are the models of other campaigns in the database: the file and these may come from other people.
    allowed = with_endpoints(settings.llm_endpoints, workload.models)
    settings = settings.model_copy(update={"llm_endpoints": allowed})

    async def work(session: Session) -> T | None:
        name, ended = await _start(workload, options, session)
        page = f"/#/{workload.noun}s/{name}"
        if not ended and not session.needs_token:  # the token is secret
            screen.print(f"watch it in a browser until it ends: {session.url}{page}", soft_wrap=True)
        async with stopping(session.stop):
            session.processes.start(options.workers)
            progress = await workload.watch(session, name)
            if session.stop.is_set():
                # A paused run takes no workers until it is resumed.
                with contextlib.suppress(CoordinatorError):
                    await session.api.post(f"/{workload.noun}s/{name}/pause")
                screen.print(
                    f"stopped at {progress.simulations:,} of {progress.budget:,} simulations; nothing is lost"
                )
                session.hint("continue with", f"{workload.command}{options.resume_command}")
                return None
            if progress.status is not CampaignStatus.FINISHED:
                screen.print(f"{workload.noun} {name} is {progress.status}")
                for reason in workload.reasons(progress):
                    screen.print(f"  {reason}")
                session.hint("see details with", f"{workload.command}status {name}")
                return None
            result = await finish(session, progress)
            command, url = session.serve
            screen.print(f"\nlook at it again: {program()} {command}, then open {url}{page}", soft_wrap=True)
            return result

    any_port = options.port is None
    return run_locally(settings, options.out / "worker.log", screen, work, any_port=any_port)


async def _start(workload: Workload[ProgressT], options: RunOptions, session: Session) -> tuple[str, bool]:
    """Return the id of the run to watch, the latest one of this file or a new one, and whether it has ended."""
    statuses = [CampaignStatus.RUNNING, CampaignStatus.PAUSED]
    if options.resume:
        statuses.append(CampaignStatus.FINISHED)
    found = None if options.new else await workload.latest(session.api, statuses)
    if found is None:
        if options.resume and not options.new:
            session.screen.print(
                f"there is no earlier {workload.noun} of {options.file}, as it is now, in {session.place}: "
                "this starts one",
                soft_wrap=True,
            )
        name, summary = await workload.submit(session.api)
        session.screen.print(f"{workload.noun} {name}: {summary}")
        return name, False
    done = f"{found.simulations:,} of {found.budget:,} simulations"
    if not options.resume:
        raise Conflict(
            f"{workload.noun} {found.id} of this file is unfinished, at {done}: "
            "continue it with --resume, or start another with --new"
        )
    if found.status is CampaignStatus.FINISHED:
        words = f"{workload.noun} {found.id} of this file {earlier_words(found)}; --new starts another"
        session.screen.print(words, soft_wrap=True)
    else:
        await workload.resume(session.api, found)
        session.screen.print(f"{workload.noun} {found.id}: continuing at {done}")
    return found.id, found.status is CampaignStatus.FINISHED


@contextlib.asynccontextmanager
async def stopping(stop: asyncio.Event) -> AsyncIterator[None]:
    """Set the event on Ctrl-C or SIGTERM; afterwards ignore both, until the coordinator has stopped."""
    loop = asyncio.get_running_loop()
    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, stop.set)
    try:
        yield
    finally:
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)
            signal.signal(number, signal.SIG_IGN)
