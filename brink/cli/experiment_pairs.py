"""The pairs across the boundary of an experiment: follow-ups of all campaigns, and their results."""

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from brink.api.client import Api, CoordinatorError
from brink.api.follow_ups import OPEN, continue_follow_up, follow_up_options, follow_up_requests
from brink.api.live import FollowUpsDisplay, Steps
from brink.cli.local import CommandSession, run_locally, stopping
from brink.cli.options import plain_table, settings_with, with_api
from brink.report.experiment_pairs import (
    COLUMNS,
    left_out_sentences,
    pair_sentences,
    settings_words,
    standing_cells,
)
from brink.search.analysis.pair_comparison import PairCounts, PairRepeat, pair_standings, problems_of
from brink.server.api.experiment_pairs import ExperimentPairs, PairRepeatView
from brink.server.api.schemas import ExperimentView
from brink.server.campaigns.follow_ups.question import questions
from brink.server.campaigns.plan import make_plan
from brink.server.findings.follow_ups import FollowUpView
from brink.server.problems.catalogue import check_extra
from brink.server.states import CampaignStatus, FollowUpKind


async def fetch_experiment_pairs(
    api: Api, experiment: str, screen: Console, **settings: float
) -> ExperimentPairs:
    """Return the pairs of an experiment, once those of all its finished campaigns have been computed.

    Args:
        api: Its coordinator.
        experiment: Its id.
        screen: Shows what is still being computed.
        settings: ``eps`` and ``d_th``, where they are not the experiment's own, and ``alpha``.

    Raises:
        CoordinatorError: The experiment does not exist.
    """
    with Steps(screen, "searching for pairs") as steps:
        path = f"/experiments/{experiment}/pairs"
        return await api.read_computed(ExperimentPairs, path, settings, steps.show)


def pair_repeats_of(pairs: ExperimentPairs) -> list[PairRepeat]:
    """Return the pairs of the finished campaigns."""
    return [
        PairRepeat(
            problem=one.problem,
            method=one.method,
            seed=one.seed,
            campaign=one.campaign,
            computed=one.computed,
            counts=PairCounts(**{name: getattr(one, name) or 0 for name in PairCounts.__slots__}),
        )
        for one in pairs.repeats
    ]


async def ask_follow_ups(
    api: Api,
    pairs: ExperimentPairs,
    screen: Console,
    *,
    confirm: int,
    component: bool,
    stop: asyncio.Event | None = None,
) -> tuple[list[FollowUpView], bool]:
    """Start or resume the follow-ups of every campaign of an experiment that lacks them.

    Args:
        api: The coordinator.
        pairs: The pairs of the experiment.
        screen: Told why a follow-up is refused.
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.
        stop: Ends this early.

    Returns:
        The follow-ups, and whether none was refused and this was not ended early.
    """
    settings = {"eps": pairs.eps, "d_th": pairs.d_th}
    asked: list[FollowUpView] = []
    refused: dict[tuple[str, str], str] = {}
    with Steps(screen, "asking for follow-ups") as steps:
        for done, one in enumerate(pairs.repeats):
            steps.show("asking for follow-ups", done, len(pairs.repeats))
            for request in follow_up_requests(settings, confirm, component=component):
                if stop is not None and stop.is_set():
                    return asked, False
                reason = one.problem, request["kind"]
                if _is_known(one, request) or reason in refused:
                    continue
                try:
                    found = await api.send(
                        FollowUpView, f"/campaigns/{one.campaign}/pairs/follow-ups", request
                    )
                except CoordinatorError as error:
                    refused[reason] = f"campaign {one.campaign}: {error}"
                    continue
                await continue_follow_up(api, found)
                asked.append(found)
    for message in refused.values():
        screen.print(message, soft_wrap=True, style="yellow")
    return asked, not refused


def _is_known(one: PairRepeatView, request: dict[str, Any]) -> bool:
    """Return whether a follow-up would show nothing new about the pairs of a campaign."""
    if not one.distinct:
        return True
    if request["kind"] == FollowUpKind.COMPONENT:
        return one.component + one.scenario == one.distinct
    if (one.confirmed or 0) + one.refuted == one.distinct:
        return True
    return one.tried == one.distinct and one.drives >= int(request["repeats"])


async def run_follow_ups(
    session: CommandSession, pairs: ExperimentPairs, *, confirm: int, component: bool
) -> bool:
    """Run the follow-ups of all campaigns of an experiment to their end, with workers that are already running.

    Args:
        session: The coordinator and its workers.
        pairs: The pairs of the experiment.
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.

    Returns:
        Whether all of them finished. If they were stopped, those that were running are paused.
    """
    api, screen = session.api, session.screen
    asked, complete = await ask_follow_ups(
        api, pairs, screen, confirm=confirm, component=component, stop=session.stop
    )
    if any(one.status in OPEN for one in asked):
        kinds = {one.kind for one in asked}
        simulated = " and ".join(each.simulates for each in questions() if each.kind in kinds)
        total = sum(one.budget for one in asked)
        screen.print(f"simulating {simulated}: {total:,} simulations", soft_wrap=True)
        paths = [f"/campaigns/{one.campaign}" for one in asked]
        with FollowUpsDisplay(screen) as display:
            progress = await session.follow(pairs.id, display, paths)
        for reason in progress.paused if not session.stop.is_set() else ():
            screen.print(f"  campaign {reason}")
        complete = complete and progress.status is CampaignStatus.FINISHED
    return complete and not session.stop.is_set()


def follow_up_here(
    experiment: str,
    settings: Mapping[str, float],
    screen: Console,
    *,
    confirm: int,
    component: bool,
    workers: int,
    server: str | None,
    database: str | None,
) -> bool:
    """Start the follow-ups of all campaigns of an experiment and, without a server, run them to their end.

    Args:
        experiment: Its id.
        settings: ``eps`` and ``d_th``, where they are not the experiment's own, and ``alpha``.
        screen: Console for progress and hints.
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.
        workers: Number of worker processes.
        server: URL of a coordinator; None runs one here.
        database: URL of the database.

    Returns:
        Whether nothing was refused or stopped.
    """

    async def run(session: CommandSession) -> bool:
        async with stopping(session.stop):
            pairs = await fetch_experiment_pairs(session.api, experiment, screen, **settings)
            await _check_extras(session.api, experiment)
            session.processes.start(workers)
            complete = await run_follow_ups(session, pairs, confirm=confirm, component=component)
            if session.stop.is_set():
                requests = follow_up_requests(settings, confirm, component=component)
                session.hint(
                    "stopped; nothing is lost. Continue with",
                    f"experiment pairs {experiment} {follow_up_options(requests)}",
                )
            return complete

    async def ask(api: Api) -> bool:
        pairs = await fetch_experiment_pairs(api, experiment, screen, **settings)
        asked, complete = await ask_follow_ups(api, pairs, screen, confirm=confirm, component=component)
        if running := [one for one in asked if one.status in OPEN]:
            most = sum(one.budget for one in running)
            screen.print(
                f"{len(running)} campaigns simulate them, at most {most:,} simulations; the same command shows what "
                "is known so far",
                soft_wrap=True,
            )
        return complete

    if server is not None:
        return with_api(server, database, ask)
    return run_locally(settings_with(database=database, port=0), screen, run)


async def _check_extras(api: Api, experiment: str) -> None:
    """Check that the extras for an experiment's problems are installed on this machine."""
    body = (await api.read(ExperimentView, f"/experiments/{experiment}")).body
    for cell in body.cells()[: len(body.problems) * len(body.algorithms)]:
        check_extra(make_plan(cell.body).problem)


def print_experiment_pairs(screen: Console, pairs: ExperimentPairs) -> None:
    """Print the pairs of each method, and how methods compare."""
    repeats = pair_repeats_of(pairs)
    for sentence in left_out_sentences(pairs.left_out):
        text = sentence.replace("**", "").rstrip()
        screen.print(text, soft_wrap=True)
    if not repeats and not pairs.left_out:
        screen.print("no campaign has finished yet")
        return
    for problem in problems_of(repeats):
        screen.print(_table(repeats, problem, pairs.counted), "")
        screen.print(settings_words(pairs.eps, pairs.d_th), soft_wrap=True, style="dim")
        for sentence in pair_sentences(repeats, problem, level=pairs.alpha):
            text = sentence.replace("**", "").rstrip()
            screen.print(text, soft_wrap=True)
        screen.print()


def _table(repeats: Sequence[PairRepeat], problem: str, campaigns: int) -> Any:
    table = plain_table(
        "", *COLUMNS, right=COLUMNS, title=f"{problem}: pairs across the boundary, {campaigns} campaigns"
    )
    ours = [one for one in repeats if one.problem == problem]
    for one in pair_standings(ours):
        table.add_row(Text(one.method), *map(Text, standing_cells(one, computed=ours[0].computed)))
    return table
