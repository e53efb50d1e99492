"""Running a campaign or an experiment to its end on this machine, with an embedded coordinator and workers.

`run_locally` starts the coordinator, gives a command its `CommandSession` and stops everything afterwards;
`run_to_end` submits a `Workload` or resumes it, follows it, and pauses it on Ctrl-C.
"""

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Final, TypeVar

from rich.console import Console

from brink.api.client import Api, connect
from brink.api.follow_ups import OPEN, continue_follow_up
from brink.api.following import P, Session
from brink.api.live import CampaignDisplay, LiveDisplay, earlier_words
from brink.cli.options import RESULTS, database_option, database_place, naming_ids, program, settings_with
from brink.server.api.schemas import CampaignView, Progress
from brink.server.errors import Conflict
from brink.server.findings.boundary.repeat_views import RepeatsView
from brink.server.findings.follow_ups import FollowUpView
from brink.server.states import CampaignStatus

if TYPE_CHECKING:
    from brink.api.runs import Workload
    from brink.server.runtime.coordinator import WorkerProcesses
    from brink.server.settings import Settings

STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandSession(Session):
    """An embedded coordinator and its workers, as a command uses them.

    Attributes:
        settings: Those of the coordinator.
        screen: Console for progress and hints.
    """

    processes: "WorkerProcesses"
    settings: "Settings"
    screen: Console

    def hint(self, text: str, command: str) -> None:
        """Print a hint with a command that can be pasted."""
        self.screen.print(f"{text}: {program()} {command}{database_option(self.settings)}", soft_wrap=True)

    async def follow_campaign(self, campaign: str) -> Progress:
        """Show the progress of a campaign until it ends or is stopped; return the last progress."""
        with CampaignDisplay(self.screen) as display:
            return await self.follow(campaign, display, [f"/campaigns/{campaign}"])

    async def finish_follow_up(self, view: FollowUpView | RepeatsView) -> Progress:
        """Simulate a follow-up to its end or until it is stopped; one that a user paused continues."""
        await continue_follow_up(self.api, view)
        return await self.follow_campaign(view.campaign)


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
        named: How the command named the file, such as ``--example quickstart``; by default its path.
        group: Command group of the command, with a trailing space; empty for campaigns.
        verb: The command itself.
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
    named: str = ""
    group: str = ""
    verb: str = "run"

    @property
    def resume_command(self) -> str:
        """The command that continues the run."""
        named = self.named or quote(str(self.file))
        return " ".join([f"{self.group}{self.verb}", named, *self.sizes, "--resume"])


def run_locally(
    settings: "Settings",
    screen: Console,
    work: Callable[[CommandSession], Awaitable[T]],
    *,
    out: Path = RESULTS,
    any_port: bool = False,
) -> T:
    """Start a coordinator, run some work against it, and stop the coordinator and its workers.

    Args:
        settings: Settings of the coordinator. Its database is created or upgraded.
        screen: Console for progress and hints.
        work: Called with the session; no worker is started yet.
        out: Folder of the workers' log. It is created first, so an unwritable one fails early.
        any_port: Whether to listen on a free port if another program uses that of the settings.

    Raises:
        DatabaseError: The database is unusable.
        CannotListen: The coordinator failed to start.
    """
    from brink.server.runtime.coordinator import WorkerProcesses, local_coordinator

    out.mkdir(parents=True, exist_ok=True)

    async def run(processes: WorkerProcesses) -> T:
        async with connect(processes.url, processes.token) as api:
            session = CommandSession(api=api, processes=processes, settings=settings, screen=screen)
            place, option = database_place(settings), database_option(settings)
            return await naming_ids(api, place, option, lambda: work(session))

    coordinator = local_coordinator(settings, out / "worker.log", any_port=any_port)
    with _default_signals_afterwards(), coordinator as processes:
        return asyncio.run(run(processes))


def _serve_later(settings: "Settings") -> tuple[str, str]:
    """Return the command that serves the dashboard of a database, and its address."""
    from brink.server.settings import LOOPBACK

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


async def check_extra_of(api: Api, campaign: str) -> None:
    """Check that workers of this machine have what the problem of a campaign needs.

    Raises:
        InvalidInput: An extra is not installed.
    """
    from brink.server.campaigns.plan import make_plan
    from brink.server.problems.catalogue import check_extra

    check_extra(make_plan((await api.read(CampaignView, f"/campaigns/{campaign}")).body).problem)


def run_to_end(
    workload: "Workload[P]",
    options: RunOptions,
    screen: Console,
    display: LiveDisplay[P],
    finish: Callable[[CommandSession, P], Awaitable[T]],
) -> T | None:
    """Run a campaign or an experiment to its end on this machine.

    Args:
        workload: The campaign or experiment.
        options: Options of the command.
        screen: Console for progress and hints.
        display: Shows the progress.
        finish: Called when the work has finished, while coordinator and workers still run.

    Returns:
        The value of `finish`; None if the work was stopped or ended unfinished.

    Raises:
        Conflict: An earlier run is unfinished, and neither `resume` nor `new` is set.
    """
    # The user runs both the file and the coordinator, so the language models that the file names are allowed. Keys
    # are not, nor are the models of other campaigns in the database: the file and these may come from other people.
    settings = settings_with(database=options.database, port=options.port).allowing(
        model.endpoint for model in workload.models if model is not None
    )

    async def work(session: CommandSession) -> T | None:
        name, ended = await _start(workload, options, session)
        resource = f"{workload.noun}s/{name}"
        if not ended and session.processes.token is None:  # the token is secret
            screen.print(
                f"watch it in a browser until it ends: {session.processes.url}/#/{resource}", soft_wrap=True
            )
        async with stopping(session.stop):
            session.processes.start(options.workers)
            with display:
                progress = await session.follow(name, display, [f"/{resource}"])
            if session.stop.is_set():
                screen.print(
                    f"stopped at {progress.simulations:,} of {progress.budget:,} simulations; nothing is lost"
                )
                session.hint("continue with", options.resume_command)
                return None
            if progress.status is not CampaignStatus.FINISHED:
                screen.print(f"{workload.noun} {name} is {progress.status}")
                for reason in workload.reasons(progress):
                    screen.print(f"  {reason}")
                session.hint("see details with", f"{options.group}status {name}")
                return None
            result = await finish(session, progress)
            command, url = _serve_later(settings)
            screen.print(
                f"\nlook at it again: {program()} {command}, then open {url}/#/{resource}", soft_wrap=True
            )
            return result

    return run_locally(settings, screen, work, out=options.out, any_port=options.port is None)


async def _start(workload: "Workload[P]", options: RunOptions, session: CommandSession) -> tuple[str, bool]:
    """Return the id of the run to watch, the latest one of this file or a new one, and whether it has ended."""
    from brink.api.runs import resume_or_submit

    statuses = [*OPEN, *([CampaignStatus.FINISHED] if options.resume else [])]
    found = None if options.new else await workload.latest(session.api, statuses)
    done = "" if found is None else f"at {found.simulations:,} of {found.budget:,} simulations"
    if found is not None and not options.resume:
        raise Conflict(
            f"{workload.noun} {found.id} of this file is unfinished, {done}: "
            "continue it with --resume, or start another with --new"
        )
    if found is None and options.resume and not options.new:
        session.screen.print(
            f"there is no earlier {workload.noun} of {options.file}, unchanged, in "
            f"{database_place(session.settings)}: this starts one",
            soft_wrap=True,
        )
    name, words = await resume_or_submit(workload, session.api, found)
    ended = found is not None and found.status is CampaignStatus.FINISHED
    if found is None:
        session.screen.print(f"{workload.noun} {name}: {words}")
    elif ended:
        words = f"{workload.noun} {name} of this file {earlier_words(found)}; --new starts another"
        session.screen.print(words, soft_wrap=True)
    else:
        session.screen.print(f"{workload.noun} {name}: continuing {done}")
    return name, ended


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
