"""Follow-ups that a command simulates by itself: those that it was asked for, and those of every run."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any

from rich.console import Console

from brink.api.client import Api, CoordinatorError
from brink.api.follow_ups import OPEN, follow_up_options
from brink.cli.local import CommandSession, check_extra_of, run_locally, stopping
from brink.cli.options import settings_with, with_api
from brink.server.findings.finding import Findings
from brink.server.findings.follow_ups import FollowUpView
from brink.server.states import CampaignStatus, FollowUpKind

Ask = Callable[[Api, dict[str, Any]], Awaitable[FollowUpView | None]]
THRESHOLDS_AGAIN: Mapping[FollowUpKind, str] = {
    FollowUpKind.CONFIRM: "both ends of each threshold with other seeds",
    FollowUpKind.COMPONENT: "the unsafe end of each threshold with ground truth",
}
"""What follow-ups of thresholds simulate, in a few words."""


def follow_up(
    command: str,
    campaign: str,
    requests: Sequence[dict[str, Any]],
    ask: Ask,
    screen: Console,
    *,
    workers: int,
    server: str | None,
    database: str | None,
    simulates: Mapping[FollowUpKind, str] | None = None,
) -> bool:
    """Start follow-ups of a campaign and, without a server, run them to their end.

    Args:
        command: The command that is asked, such as ``pairs``.
        campaign: Id of the campaign.
        requests: What is asked for; if nothing, nothing happens.
        ask: Starts a follow-up, or returns an identical one; None if there is nothing to do.
        screen: Console for progress and hints.
        workers: Number of worker processes.
        server: URL of a coordinator; None runs one here.
        database: URL of the database.
        simulates: What each kind simulates, in a few words, if not sides of pairs.

    Returns:
        Whether none was stopped.
    """
    if not requests:
        return True
    from brink.server.campaigns.follow_ups.question import question_of

    words = {kind: question_of(kind).simulates for kind in FollowUpKind} | dict(simulates or {})
    if server is None:
        return run_locally(
            settings_with(database=database, port=0),
            screen,
            lambda session: run_follow_ups(
                session,
                campaign,
                [partial(ask, session.api, request) for request in requests],
                workers,
                f"{command} {campaign} {follow_up_options(requests)}",
                words,
            ),
        )

    async def start(api: Api) -> None:
        for request in requests:
            view = await ask(api, request)
            if view is not None and view.status in OPEN:
                screen.print(
                    f"campaign {view.campaign} simulates them ({words[view.kind]}); the same command shows what is "
                    "known so far",
                    soft_wrap=True,
                )

    with_api(server, database, start)
    return True


async def run_follow_ups(
    session: CommandSession,
    campaign: str,
    asks: Sequence[Callable[[], Awaitable[FollowUpView | None]]],
    workers: int,
    command: str,
    simulates: Mapping[FollowUpKind, str],
) -> bool:
    """Run follow-ups to their end, one after the other; return False if they were stopped or did not finish.

    Args:
        session: The coordinator, whose workers are started if anything is to be simulated.
        campaign: Id of the campaign.
        asks: Each starts a follow-up, or returns an identical one; None if there is nothing to do.
        workers: Number of worker processes.
        command: The command that continues, without the program's name.
        simulates: What each kind simulates, in a few words.
    """
    await check_extra_of(session.api, campaign)
    complete = True
    started = False
    async with stopping(session.stop):
        for ask in asks:
            view = await ask()
            if view is None or view.status not in OPEN:
                continue
            if not started:
                session.processes.start(workers)
                started = True
            session.screen.print(f"simulating {simulates[view.kind]}", soft_wrap=True)
            progress = await session.finish_follow_up(view)
            complete = complete and progress.status is CampaignStatus.FINISHED
            if session.stop.is_set():
                session.hint("stopped; nothing is lost. Continue with", command)
                return False
            if progress.status_reason:
                session.screen.print(progress.status_reason, soft_wrap=True, style="yellow")
    return complete


async def ask_by_default(session: CommandSession, campaign: str) -> None:
    """Take the next steps of a finished campaign that every run takes, with the workers that still run.

    Args:
        session: The coordinator and its workers; if it is stopped, the steps are left for later.
        campaign: Id of the campaign.
    """
    found = await session.api.read(Findings, f"/campaigns/{campaign}/findings", {"rows": 0})
    for step in found.steps:
        if not step.by_default or step.request is None or session.stop.is_set():
            continue
        session.screen.print(f"{step.question} {step.words}", soft_wrap=True)
        try:
            view = step.follow_up
            if view is None:
                view = await session.api.send(FollowUpView, f"/{step.request.path}", step.request.body)
        except CoordinatorError as error:  # the run's own results do not depend on it
            session.screen.print(f"not simulated: {error}", soft_wrap=True, style="yellow")
            continue
        await session.finish_follow_up(view)
