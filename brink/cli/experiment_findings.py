"""What an experiment found, pairs or thresholds: fetched, and followed up in all of its campaigns."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

import typer
from rich.console import Console
from rich.text import Text

from brink.api.client import Api, CoordinatorError
from brink.api.follow_ups import OPEN, continue_follow_up, follow_up_options, follow_up_requests
from brink.api.live import FollowUpsDisplay, Steps
from brink.cli.follow_ups import THRESHOLDS_AGAIN
from brink.cli.local import CommandSession, run_locally, stopping
from brink.cli.options import console, plain_table, print_json, settings_with, with_api
from brink.report import experiment_found
from brink.report.experiment_found import FoundWords, left_out_sentences
from brink.search.analysis.count_comparison import FoundRepeat, by_problem
from brink.server.api.schemas import ExperimentView
from brink.server.campaigns.follow_ups.question import questions
from brink.server.campaigns.plan import make_plan
from brink.server.findings.experiments import ExperimentPairs, ExperimentThresholds
from brink.server.findings.follow_ups import FollowUpView
from brink.server.problems.catalogue import check_extra
from brink.server.states import CampaignStatus, FollowUpKind

V = TypeVar("V", ExperimentPairs, ExperimentThresholds)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKind(Generic[V]):
    """What the campaigns of an experiment found, of one kind.

    Attributes:
        words: How it is reported; its name is the section of the experiment, and the end of its paths.
        view: What a coordinator answers.
        computing: What a coordinator does meanwhile.
        settings: Returns what counts, as a follow-up of a campaign is asked for.
        simulates: What each follow-up simulates, in a few words.
    """

    words: FoundWords
    view: type[V]
    computing: str
    settings: Callable[[V], Mapping[str, float]]
    simulates: Mapping[FollowUpKind, str]


async def fetch_found(api: Api, kind: FoundKind[V], experiment: str, screen: Console, **settings: float) -> V:
    """Return what an experiment found, once that of all its finished campaigns has been computed.

    Args:
        api: Its coordinator.
        kind: What is asked for.
        experiment: Its id.
        screen: Shows what is still being computed.
        settings: What counts, where that is not the experiment's own, and ``alpha``.

    Raises:
        CoordinatorError: The experiment does not exist.
    """
    with Steps(screen, kind.computing) as steps:
        path = f"/experiments/{experiment}/{kind.words.name}"
        return await api.read_computed(kind.view, path, settings, steps.show)


async def ask_follow_ups(
    api: Api,
    kind: FoundKind[V],
    found: V,
    screen: Console,
    *,
    confirm: int,
    component: bool,
    stop: asyncio.Event | None = None,
) -> tuple[list[FollowUpView], bool]:
    """Start or resume the follow-ups of every campaign of an experiment that lacks them.

    Args:
        api: The coordinator.
        kind: What is followed up.
        found: What the experiment found of it.
        screen: Told why a follow-up is refused.
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.
        stop: Ends this early.

    Returns:
        The follow-ups, and whether none was refused and this was not ended early.
    """
    settings = kind.settings(found)
    asked: list[FollowUpView] = []
    refused: dict[tuple[str, str], str] = {}
    with Steps(screen, "asking for follow-ups") as steps:
        for done, one in enumerate(found.repeats):
            steps.show("asking for follow-ups", done, len(found.repeats))
            for request in follow_up_requests(settings, confirm, component=component):
                if stop is not None and stop.is_set():
                    return asked, False
                reason = one.problem, request["kind"]
                if _is_known(one, request) or reason in refused:
                    continue
                try:
                    follow_up = await api.send(
                        FollowUpView, f"/campaigns/{one.campaign}/{kind.words.name}/follow-ups", request
                    )
                except CoordinatorError as error:
                    refused[reason] = f"campaign {one.campaign}: {error}"
                    continue
                await continue_follow_up(api, follow_up)
                asked.append(follow_up)
    for message in refused.values():
        screen.print(message, soft_wrap=True, style="yellow")
    return asked, not refused


async def run_follow_ups(
    session: CommandSession, kind: FoundKind[V], found: V, *, confirm: int, component: bool
) -> bool:
    """Run the follow-ups of all campaigns of an experiment to their end, with workers that are already running.

    Args:
        session: The coordinator and its workers.
        kind: What is followed up.
        found: What the experiment found of it.
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.

    Returns:
        Whether all of them finished. If they were stopped, those that were running are paused.
    """
    api, screen = session.api, session.screen
    asked, complete = await ask_follow_ups(
        api, kind, found, screen, confirm=confirm, component=component, stop=session.stop
    )
    if any(one.status in OPEN for one in asked):
        kinds = {one.kind for one in asked}
        simulated = " and ".join(kind.simulates[each] for each in FollowUpKind if each in kinds)
        total = sum(one.budget for one in asked)
        screen.print(f"simulating {simulated}: {total:,} simulations", soft_wrap=True)
        paths = [f"/campaigns/{one.campaign}" for one in asked]
        with FollowUpsDisplay(screen) as display:
            progress = await session.follow(found.id, display, paths)
        for reason in progress.paused if not session.stop.is_set() else ():
            screen.print(f"  campaign {reason}")
        complete = complete and progress.status is CampaignStatus.FINISHED
    return complete and not session.stop.is_set()


def show_found(
    kind: FoundKind[V],
    experiment: str,
    settings: Mapping[str, float],
    *,
    alpha: float,
    confirm: int,
    component: bool,
    workers: int,
    server: str | None,
    database: str | None,
    as_json: bool,
) -> None:
    """Print what an experiment found, having followed it up as asked: without a server, here and to the end.

    Args:
        kind: What is shown.
        experiment: Its id.
        settings: What counts, where that is not the experiment's own.
        alpha: Corrected p-value up to which a difference is significant, in (0, 1).
        confirm: Most simulations of each side with other seeds; 0 for none.
        component: Whether to ask if the component is to blame.
        workers: Number of worker processes.
        server: URL of a coordinator; None runs one here.
        database: URL of the database.
        as_json: Whether to print JSON.

    Raises:
        Exit: At the end; with status 1 if a follow-up was refused or stopped.
    """
    screen, complete = console(stderr=as_json), True

    async def run(session: CommandSession) -> bool:
        async with stopping(session.stop):
            found = await fetch_found(session.api, kind, experiment, screen, **settings)
            await _check_extras(session.api, experiment)
            session.processes.start(workers)
            complete = await run_follow_ups(session, kind, found, confirm=confirm, component=component)
            if session.stop.is_set():
                requests = follow_up_requests(settings, confirm, component=component)
                session.hint(
                    "stopped; nothing is lost. Continue with",
                    f"experiment {kind.words.name} {experiment} {follow_up_options(requests)}",
                )
            return complete

    async def ask(api: Api) -> bool:
        found = await fetch_found(api, kind, experiment, screen, **settings)
        asked, complete = await ask_follow_ups(api, kind, found, screen, confirm=confirm, component=component)
        if running := [one for one in asked if one.status in OPEN]:
            most = sum(one.budget for one in running)
            screen.print(
                f"{len(running)} campaigns simulate them, at most {most:,} simulations; the same command shows what "
                "is known so far",
                soft_wrap=True,
            )
        return complete

    if confirm or component:
        if server is not None:
            complete = with_api(server, database, ask)
        else:
            complete = run_locally(settings_with(database=database, port=0), screen, run)
    found = with_api(
        server, database, lambda api: fetch_found(api, kind, experiment, screen, alpha=alpha, **settings)
    )
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        print_found(screen, kind.words, found)
    raise typer.Exit(int(not complete))


async def _check_extras(api: Api, experiment: str) -> None:
    """Check that the extras for an experiment's problems are installed on this machine."""
    body = (await api.read(ExperimentView, f"/experiments/{experiment}")).body
    for cell in body.cells()[: len(body.problems) * len(body.algorithms)]:
        check_extra(make_plan(cell.body).problem)


def _is_known(one: FoundRepeat, request: Mapping[str, Any]) -> bool:
    """Return whether a follow-up with this request would tell nothing new about a campaign."""
    if one.computed or not one.total:
        return True
    if request["kind"] == FollowUpKind.COMPONENT:
        return one.component + one.scenario == one.total
    if (one.confirmed or 0) + one.refuted == one.confirmable:
        return True
    return one.tried == one.confirmable and one.drives >= int(request["repeats"])


def print_found(screen: Console, words: FoundWords, found: ExperimentPairs | ExperimentThresholds) -> None:
    """Print what each method found, and how methods compare."""

    def say(sentences: Iterable[str]) -> None:
        for sentence in sentences:
            screen.print(sentence.replace("**", "").rstrip(), soft_wrap=True)

    say(left_out_sentences(found.left_out, words.name))
    if not found.repeats and not found.left_out:
        screen.print("no campaign has finished yet")
    for problem in by_problem(found.repeats):
        title = f"{problem}: {words.title[0].lower()}{words.title[1:]}, {found.counted} campaigns"
        table = plain_table("", *words.headings, right=words.headings, title=title)
        for method, cells in words.cells(found, problem):
            table.add_row(Text(method), *map(Text, cells))
        screen.print(table, "")
        screen.print(words.settings(found), soft_wrap=True, style="dim")
        say(words.sentences(found, problem))
        screen.print()


PAIRS: Final = FoundKind(
    words=experiment_found.PAIRS,
    view=ExperimentPairs,
    computing="searching for pairs",
    settings=lambda found: {"eps": found.eps, "d_th": found.d_th},
    simulates={each.kind: each.simulates for each in questions()},
)
THRESHOLDS: Final = FoundKind(
    words=experiment_found.THRESHOLDS,
    view=ExperimentThresholds,
    computing="estimating thresholds",
    settings=lambda found: {},
    simulates=THRESHOLDS_AGAIN,
)
