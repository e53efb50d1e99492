"""`brink repeats`: simulate the boundary of a campaign again with other seeds."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from brink.api.client import Api
from brink.api.follow_ups import OPEN
from brink.cli.findings import print_steps, print_table
from brink.cli.local import CommandSession, check_extra_of, run_locally, stopping
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Server,
    Workers,
    check_picture,
    console,
    place_option,
    print_json,
    print_sentence,
    settings_with,
    with_api,
    write_json,
)
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.follow_ups.limits import DEFAULT_REPEATS
from brink.server.findings.boundary.repeat_views import RepeatedSolution, RepeatsView
from brink.server.findings.finding import Findings
from brink.server.states import CampaignStatus

SOLUTIONS_SHOWN = 20


def repeats(
    campaign: CampaignId,
    times: Annotated[
        int, typer.Option("--repeats", min=2, max=10_000, help="Simulations of each boundary solution.")
    ] = DEFAULT_REPEATS,
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    workers: Workers = 2,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG or SVG file for a plot of the intervals.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Simulate boundary solutions again with other seeds, to estimate how likely each of them is to be unsafe.

    Without --server, the command runs a coordinator and workers until the simulations are done. Calling it again
    continues them, or shows the result.

    Example: brink repeats 3f2a --repeats 50 --picture repeats.png
    """
    check_picture(picture)
    request = {"repeats": times, "t_b": t_b, "d_th": d_th}
    screen = console(stderr=as_json)
    with_api(
        server,
        database,
        lambda api: _say_what_comes_first(api, campaign, place_option(server, database), screen),
    )
    if server:
        view = with_api(server, database, lambda api: _find_or_submit(api, campaign, request))
        if view.status in OPEN:
            screen.print(
                f"campaign {view.campaign} simulates them; the same command shows its progress",
                soft_wrap=True,
            )
    else:
        view = run_locally(
            settings_with(database=database, port=0),
            screen,
            lambda session: _run(session, campaign, request, workers),
        )
    if as_json:
        print_json(view.model_dump(mode="json"))
    else:
        _print_repeats(screen, view)
    if picture is not None and view.evaluated:
        _draw_repeats(view, picture)
        screen.print(f"picture: {picture}", soft_wrap=True)
    raise typer.Exit(int(not server and view.status is not CampaignStatus.FINISHED))


async def _say_what_comes_first(api: Api, campaign: str, place: str, screen: Console) -> None:
    """If a campaign does not search for the boundary, print its finding and the follow-ups that it offers."""
    found = await api.read(Findings, f"/campaigns/{campaign}/findings", {"rows": 0})
    if found.findings and found.findings[0].kind != "boundary":
        print_sentence(screen, found.words)
        print_steps(screen, [step for step in found.steps if step.tells_more], place)


async def _run(session: CommandSession, campaign: str, request: dict[str, Any], workers: int) -> RepeatsView:
    await check_extra_of(session.api, campaign)
    view = await _find_or_submit(session.api, campaign, request)
    if view.status is CampaignStatus.FINISHED:
        return view
    async with stopping(session.stop):
        session.processes.start(workers)
        view = await _finish(session, view)
        if session.stop.is_set() and view.status is not CampaignStatus.FINISHED:
            options = " ".join(f"--{name.replace('_', '-')} {value:g}" for name, value in request.items())
            session.hint("stopped; nothing is lost. Continue with", f"repeats {campaign} {options}")
    return view


async def _find_or_submit(api: Api, campaign: str, request: dict[str, Any]) -> RepeatsView:
    """Return the repeats of a boundary, submitting them unless they exist."""
    known = await _latest(api, campaign, request)
    if known is not None:
        return known
    return await api.send(RepeatsView, f"/campaigns/{campaign}/repeats", request)


async def _latest(api: Api, campaign: str, request: dict[str, Any]) -> RepeatsView | None:
    """Return the latest repeats of a boundary that neither failed nor were cancelled."""
    given_up = (CampaignStatus.CANCELLED, CampaignStatus.FAILED)
    for one in reversed(await api.read(list[RepeatsView], f"/campaigns/{campaign}/repeats")):
        same = all(getattr(one, name) == value for name, value in request.items())
        if same and one.status not in given_up:
            return one
    return None


async def _finish(session: CommandSession, view: RepeatsView) -> RepeatsView:
    """Simulate repeats to their end or until they are stopped; return the result."""
    await session.finish_follow_up(view)
    found = await session.api.read(list[RepeatsView], f"/campaigns/{view.of}/repeats")
    return next(one for one in found if one.campaign == view.campaign)


async def repeat_finished(session: CommandSession, campaign: str, times: int) -> RepeatsView | None:
    """Wait for the repeats that a campaign file asks for.

    Args:
        session: The coordinator and its workers.
        campaign: Id of the campaign, which has finished.
        times: Number of repeats in the campaign file.

    Returns:
        The result; None if `times` is 0 or the campaign has no boundary.
    """
    request = {"repeats": times, "t_b": DEFAULT_T_B, "d_th": DEFAULT_D_TH}
    view = await _latest(session.api, campaign, request) if times else None
    if view is None or view.status is CampaignStatus.FINISHED or session.stop.is_set():
        return view
    session.screen.print("simulating the boundary again with other seeds")
    return await _finish(session, view)


def _print_repeats(screen: Console, view: RepeatsView) -> None:
    """Print the results of the repeats, and the solutions most likely to be unsafe."""
    from brink.server.findings.boundary.repeats import repeats_table

    screen.print(view.words, soft_wrap=True)
    print_table(screen, repeats_table(view), SOLUTIONS_SHOWN, more="--json prints them all")


def _probability(one: RepeatedSolution) -> float:
    return 0.0 if one.probability is None else one.probability


def _times(view: RepeatsView) -> str:
    counts = sorted({one.evaluated for one in view.solutions})
    return f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"


def write_repeats(view: RepeatsView, folder: Path, *, picture: bool) -> list[Path]:
    """Write the result of repeats as JSON and, optionally, as a picture; return the files."""
    files = [folder / "repeats.json"]
    write_json(files[0], view.model_dump(mode="json"))
    if picture and view.evaluated:
        files.append(folder / "repeats.png")
        _draw_repeats(view, files[1])
    return files


def _draw_repeats(view: RepeatsView, file: Path) -> None:
    """Plot the interval of each solution."""
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.evidence import RepeatedPoint, figure_repeats

    points = [
        RepeatedPoint(
            number=one.number,
            probability=_probability(one),
            low=one.low,
            high=one.high,
            around=_around(one),
            conclusion=one.conclusion,
        )
        for one in view.solutions
        if one.conclusion is not None
    ]
    title = f"Does the boundary hold up? {view.name}"
    figure_repeats(points, p_th=view.p_th, times=_times(view), title=title).savefig(file)


def _around(one: RepeatedSolution) -> tuple[float, float, float] | None:
    """Return the unsafe share of a solution's neighbourhood and its interval, or None if unknown."""
    if one.around is None or one.around_low is None or one.around_high is None:
        return None
    return one.around, one.around_low, one.around_high
