"""Follow-ups that a command simulates by itself: those that it was asked for, and those of every run."""

from collections.abc import Awaitable, Callable, Sequence

from brink.api.client import CoordinatorError
from brink.api.follow_ups import OPEN
from brink.cli.local import CommandSession, check_extra_of, stopping
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.findings.finding import Findings
from brink.server.findings.follow_ups import FollowUpView
from brink.server.states import CampaignStatus


async def run_follow_ups(
    session: CommandSession,
    campaign: str,
    asks: Sequence[Callable[[], Awaitable[FollowUpView | None]]],
    workers: int,
    command: str,
) -> bool:
    """Run follow-ups to their end, one after the other; return False if they were stopped or did not finish.

    Args:
        session: The coordinator, whose workers are started if anything is to be simulated.
        campaign: Id of the campaign.
        asks: Each starts a follow-up, or returns an identical one; None if there is nothing to do.
        workers: Number of worker processes.
        command: The command that continues, without the program's name.
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
            session.screen.print(f"simulating {question_of(view.kind).simulates}", soft_wrap=True)
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
