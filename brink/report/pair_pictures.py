"""A pair as a picture or a film of both drives, or as a figure if there is nothing to replay, with its words."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Final

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
from brink.search.analysis.confirmation import Confirmation
from brink.search.sequential import INTERVAL, Verdict, verdict_of
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import ComponentPart, ConfirmationView, Minimality, PairsView, PairView
from brink.server.problems.changes import as_sentence
from brink.sim.verdict import held_words

FILMS: Final = (".mp4", ".gif")
_MOST_LETTERS: Final = 230
"""A longer headline is cut to the change alone."""
_CUT: Final = " more difference"
"""In a change in words that leaves differences out."""
_GAP_HELD: Final = held_words(["front-gap"])
_REPEATED: Final = (Confirmation.CONFIRMED, Confirmation.REFUTED, Confirmation.UNDECIDED)
_ONE_SEED: Final = "the {} is to blame, judged with this one seed"
_KNOWN_PARTS: Final = (ComponentPart.COMPONENT, ComponentPart.SCENARIO)


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
        Whether it shows the drives: False if there is nothing to replay, so that it is a figure.

    Raises:
        NoTrace: A drive cannot be run again; for a picture only if that failed, not if there is nothing to replay.
    """
    try:
        drives = await _drives(api, view, pair, workers=workers, show=show)
    except NothingToReplay:
        if path.suffix in FILMS:
            raise
        fetched = await fetch_archive(api, view.campaign)
        await asyncio.to_thread(_draw_figure, fetched, view, pair, path)
        return False
    what = f"drawing {path}"
    show(what, 0, 0)
    await asyncio.to_thread(
        render_pair, drives, path, on_progress=lambda done, total: show(what, done, total)
    )
    return True


async def _drives(
    api: Api, view: PairsView, pair: PairView, *, workers: bool, show: Callable[[str, int, int], None]
) -> DrivePair:
    """Return both drives of a pair with the words of the pair."""
    if view.computed:
        raise NothingToReplay("verdicts are computed, so there is no drive to film: ask for --picture")
    sides: list[Side] = []
    again = pair.confirmation
    for side, share in ((pair.safe, again.safe), (pair.unsafe, again.unsafe)):
        show(f"simulating both drives of pair {pair.place} again", len(sides), 2)
        trace = (
            await fetch_trace(api, view.campaign, side.number, TRACE_TIMEOUT_S)
            if workers
            else await run_episode(api, view.campaign, side.number)
        )
        sides.append(Side(number=side.number, trace=trace, outcome=side.outcome, again=share_words(share)))
    return DrivePair(
        safe=sides[0],
        unsafe=sides[1],
        change=headline(pair),
        findings=tuple(findings(pair)),
        facts=tuple(facts(view, pair)),
        requirement=await fetch_requirements(api, view.campaign),
    )


def headline(pair: PairView) -> str:
    """Return the change and its consequence, or the change alone if that is long."""
    words = pair.words if len(pair.words) <= _MOST_LETTERS else pair.change
    return as_sentence(words)


def findings(pair: PairView) -> list[str]:
    """Describe in sentences what the follow-ups of a pair showed about the component and about chance."""
    found = []
    if pair.component.state in _KNOWN_PARTS:
        found.append(_component_words(pair))
    again = pair.confirmation
    if again.state is Confirmation.CONFIRMED:
        found.append(f"Confirmed with {_drives_a_side(again)} other seeds each side.")
    elif again.state is Confirmation.REFUTED:
        # First, because it limits what the rest says.
        found.insert(0, f"Refuted, so chance has a part: with other seeds, {_doubt(again)}.")
    elif again.state is Confirmation.UNDECIDED:
        found.insert(0, f"Undecided with {_drives_a_side(again)} other seeds each side: chance may decide.")
    return found


def _component_words(pair: PairView) -> str:
    """State whether the unsafe drive is safe with ground truth in place of the component, and what that means."""
    first, _, rest = pair.component.outcome.partition("; ")
    others = f" (but {rest})" if rest else ""
    if pair.component.state is ComponentPart.SCENARIO:
        what = f" ({pair.component.outcome})" if pair.component.outcome else ""
        blamed = _ONE_SEED.format("scenario")
        return f"With true perception and the same seed, this drive is unsafe too{what}: {blamed}."
    keeps = "keeps the front gap" if first == _GAP_HELD else "is safe"
    blamed = _ONE_SEED.format("component")
    return f"With true perception and the same seed, this drive {keeps}{others}: {blamed}."


def _drives_a_side(again: ConfirmationView) -> str:
    counts = sorted({again.safe.evaluated, again.unsafe.evaluated})
    return " to ".join(str(count) for count in counts)


def _doubt(again: ConfirmationView) -> str:
    """State which side does not keep its verdict with other seeds."""
    said, safe, unsafe = [], again.safe, again.unsafe
    if verdict_of(safe.unsafe, safe.evaluated, safe.failed) is Verdict.REFUTED:
        said.append(f"the safe side was unsafe in {again.safe.unsafe} of {again.safe.evaluated}")
    if verdict_of(unsafe.evaluated - unsafe.unsafe, unsafe.evaluated, unsafe.failed) is Verdict.REFUTED:
        was = "" if said else " was unsafe"
        said.append(f"the unsafe side{was} in only {again.unsafe.unsafe} of {again.unsafe.evaluated}")
    return " and ".join(said)


def facts(view: PairsView, pair: PairView) -> list[str]:
    """Return further facts about a pair, in sentences."""
    found = [f"Pair {pair.place} of {view.distinct} of {view.name}."]
    if pair.moved:
        found.append(f"{as_sentence(pair.moved)}.")
    if not view.computed and pair.confirmation.state not in _REPEATED:
        found.append(_search_words(pair))
    if _CUT in pair.change:
        found.append(f"All that differs: {', '.join(change.words for change in pair.changes)}.")
    less = pair.minimality
    if less.state is Minimality.DIFFERENT_SEEDS:
        found.append("The two had different episode seeds, so chance may be the reason for the verdicts.")
    elif less.state is Minimality.MINIMAL:
        how = " (tried by simulation)" if less.tried else ""  # a single difference needs no simulation
        found.append(f"No part of the change can be left out{how}.")
    elif less.unsafe is not None:
        enough, differing = len(less.unsafe.changes), len(pair.changes)
        found.append(f"{enough} of the {differing} differences {'is' if enough == 1 else 'are'} enough.")
    return found


def _search_words(pair: PairView) -> str:
    """Return how often the search itself simulated both sides, in a sentence."""
    if pair.checked:
        return "Checked: the search simulated each side again with another seed, and both verdicts held."
    return "The search did not simulate both sides again with another seed, so chance may decide."


def share_words(share: ShareView) -> str:
    """Return how often a side was unsafe with other seeds; empty if that was not tested."""
    if share.evaluated == 0 or share.probability is None:
        return ""
    counts = f"unsafe in {share.unsafe} of {share.evaluated} simulations with other seeds"
    interval = f"{INTERVAL:.0%} interval {100 * share.low:.0f} to {100 * share.high:.0f}%"
    return f"{counts}: {100 * share.probability:.0f}%, {interval}"


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
    told = " ".join([*findings(pair), *facts(view, pair)])
    figure = figure_pair(
        inputs,
        PairFigure(safe=pair.safe.number, unsafe=pair.unsafe.number, change=headline(pair), facts=(told,)),
    )
    figure.savefig(path)
