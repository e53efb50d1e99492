"""A pair as a picture or a film of both drives, or as a figure if there is nothing to replay, with its words."""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, cast

from brink.api.client import Api
from brink.api.results import (
    TRACE_TIMEOUT_S,
    FetchedArchive,
    NothingToReplay,
    fetch_archive,
    fetch_requirements,
    fetch_trace,
    run_episode,
)
from brink.pictures import DrivePair, Side, render_pair
from brink.report.limits import FILMS
from brink.server.api.schemas import CampaignView
from brink.server.campaigns.plan import make_plan
from brink.server.findings.pairs.views import PairsView, PairView
from brink.server.findings.words import as_sentence
from brink.server.problems.base import Problem
from brink.sim.trace import VIOLATED_AT_S

_MOST_LETTERS: Final = 230
"""A longer headline is cut to the change alone."""


async def write_pair(
    api: Api,
    view: PairsView,
    pair: PairView,
    path: Path,
    *,
    workers: bool,
    show: Callable[[str, int, int], None] = lambda _what, _done, _total: None,
) -> bool:
    """Draw a pair to a file.

    Args:
        api: Coordinator of the campaign.
        view: The pairs of the campaign.
        pair: The pair.
        path: A picture (.png) or a film (.mp4, .gif).
        workers: Whether the coordinator's workers run the drives again; otherwise this machine does.
        show: Called with what is being done, in words, how much of it is done, and how much there is; 0 if that is
            unknown.

    Returns:
        Whether it shows the drives: False if there is nothing to replay, so that it is a figure of signals or of
        parameters.

    Raises:
        NoTrace: A drive cannot be run again; for a picture only if that failed, not if there is nothing to replay.
    """
    problem = make_plan((await api.read(CampaignView, f"/campaigns/{view.campaign}")).body).problem
    try:
        _check_recorded(problem, view, path)
        drives = await _drives(api, view, pair, workers=workers, show=show)
    except NothingToReplay:
        if path.suffix.lower() in FILMS:
            raise
        fetched = await fetch_archive(api, view.campaign)
        await asyncio.to_thread(_draw_figure, fetched, view, pair, path)
        return False
    what = f"drawing {path}"
    show(what, 0, 0)
    if problem.records_signals and not problem.records_traces:
        await asyncio.to_thread(_draw_signals, drives, path)
        return False
    await asyncio.to_thread(
        render_pair, drives, path, on_progress=lambda done, total: show(what, done, total)
    )
    return True


def _check_recorded(problem: Problem, view: PairsView, path: Path) -> None:
    """Check that a problem records what is to be drawn.

    Raises:
        NothingToReplay: It does not.
    """
    if view.computed and not problem.records_signals:
        raise NothingToReplay("verdicts are computed, so there is no drive to film: ask for --picture")
    if path.suffix.lower() in FILMS and not problem.records_traces:
        raise NothingToReplay(f"{problem.id} records no drive to film: ask for --picture")


async def _drives(
    api: Api, view: PairsView, pair: PairView, *, workers: bool, show: Callable[[str, int, int], None]
) -> DrivePair:
    """Return both drives of a pair with the words of the pair."""
    sides: list[Side] = []
    for side in (pair.safe, pair.unsafe):
        show(f"simulating both drives of pair {pair.place} again", len(sides), 2)
        trace = (
            await fetch_trace(api, view.campaign, side.number, TRACE_TIMEOUT_S)
            if workers
            else await run_episode(api, view.campaign, side.number)
        )
        sides.append(Side(number=side.number, trace=trace, outcome=side.outcome, again=side.again))
    return DrivePair(
        safe=sides[0],
        unsafe=sides[1],
        change=headline(pair),
        findings=pair.shown,
        facts=tuple(facts(view, pair)),
        requirement=await fetch_requirements(api, view.campaign),
    )


def headline(pair: PairView) -> str:
    """Return the change and its consequence, or the change alone if that is long."""
    words = pair.words if len(pair.words) <= _MOST_LETTERS else pair.change
    return as_sentence(words)


def facts(view: PairsView, pair: PairView) -> list[str]:
    """Return the number of the pair and further facts about it, in sentences."""
    return [f"Pair {pair.place} of {view.distinct} of {view.name}.", *pair.facts]


def _draw_signals(drives: DrivePair, path: Path) -> None:
    """Draw the signals of both sides of a pair over time."""
    from brink.plots.signals import Recorded, figure_signals
    from brink.plots.style import SAFE, UNSAFE

    sides = [
        Recorded(
            label=f"{label}: solution {side.number}",
            colour=colour,
            time_s=side.trace.time_s,
            signals=side.trace.signals,
            margins=side.trace.robustness,
            violated_at_s=cast(Mapping[str, float], side.trace.about[VIOLATED_AT_S]),
        )
        for label, colour, side in (("safe", SAFE, drives.safe), ("unsafe", UNSAFE, drives.unsafe))
    ]
    stated = cast(Mapping[str, Any], drives.unsafe.trace.about["spec"])["options"]["requirements"]
    figure_signals(sides, stated, drives.change, " ".join([*drives.findings, *drives.facts])).savefig(path)


def _draw_figure(fetched: FetchedArchive, view: PairsView, pair: PairView, path: Path) -> None:
    """Draw the parameters in which the sides of a pair differ."""
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots import CampaignFigures, PairFigure, figure_pair

    inputs = CampaignFigures(
        archive=fetched.archive,
        active=fetched.active,
        space=fetched.plan.problem.space,
        title=fetched.body.name,
        generation_ends=fetched.generations,
        t_b=0.0,
        d_th=view.d_th,
    )
    told = " ".join([*pair.shown, *facts(view, pair)])
    figure = figure_pair(
        inputs,
        PairFigure(safe=pair.safe.number, unsafe=pair.unsafe.number, change=headline(pair), facts=(told,)),
    )
    figure.savefig(path)
