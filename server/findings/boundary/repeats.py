"""Results of simulating boundary solutions again with other seeds."""

from collections import Counter
from typing import Final

from brink.search.algorithms.repeats import simulations_to_clear
from brink.search.conclusions import Conclusion
from brink.search.fitness import wilson_interval
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_T_B
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.kinds.confirm import tallies_of
from brink.server.campaigns.follow_ups.limits import MOST
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.store import Campaign
from brink.server.findings.boundary.repeat_views import RepeatedSolution, RepeatsView
from brink.server.findings.sources import Sources
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.words import listed_words
from brink.server.states import CampaignStatus, Selection

COLUMNS: Final = [
    Column(name="number", title="solution", format=Format.SOLUTION),
    Column(name="evaluated", title="simulated", format=Format.COUNT),
    Column(name="unsafe", title="unsafe", format=Format.COUNT),
    Column(name="probability", title="probability"),
    Column(name="interval", title="interval"),
    Column(name="around", title="neighbourhood"),
    Column(name="conclusion", title="conclusion", format=Format.STATE),
]


async def find_repeats(sources: Sources, campaign: Campaign) -> list[RepeatsView]:
    """Return the results of all repeats of a campaign's solutions, one for each request."""
    follow_ups = await sources.pages.read(sources.engines, lambda c: read_follow_ups(c, campaign.id))
    stored = [one for one in follow_ups if one.repeats is not None]
    if not stored:
        return []
    read = await sources.archives.get(campaign)
    distinct = [await count_distinct(sources, campaign, one, read) for one in stored]
    return await sources.pages.run(
        lambda: [repeats_view(campaign, one, read, of) for one, of in zip(stored, distinct, strict=True)]
    )


async def count_distinct(
    services: Sources, campaign: Campaign, stored: StoredFollowUp, found: ReadArchive
) -> int | None:
    """Return how many boundary solutions there are at the thresholds of repeats; None if these are of named ones."""
    if stored.t_b is None or stored.d_th is None:
        return None
    if len(stored.numbers) < MOST:
        return len(stored.numbers)
    return (await services.boundaries.get(campaign, found, stored.t_b, stored.d_th)).counts.dbs


def repeats_view(
    campaign: Campaign, stored: StoredFollowUp, read_archive: ReadArchive, distinct: int | None
) -> RepeatsView:
    """Return the results of repeats.

    Args:
        campaign: The campaign whose solutions are repeated.
        stored: The repeats.
        read_archive: Its archive.
        distinct: How many boundary solutions there are at their thresholds; see `count_distinct`.
    """
    assert stored.repeats is not None
    near = read_archive.plan.neighbourhood
    tallies = tallies_of(stored, near.z)
    known, holds = tallies.evaluated > 0, tallies.contains(near.p_th)
    conclusions = tallies.conclusions(near.p_th, DEFAULT_T_B if stored.t_b is None else stored.t_b)
    solutions = []
    for place, number in enumerate(stored.numbers):
        index = read_archive.places.get(number)
        around = None if index is None else _around(read_archive, index)
        solutions.append(
            RepeatedSolution(
                number=number,
                evaluated=int(tallies.evaluated[place]),
                unsafe=int(tallies.unsafe[place]),
                probability=float(tallies.probability[place]) if known[place] else None,
                low=float(tallies.low[place]),
                high=float(tallies.high[place]),
                holds=bool(holds[place]) if known[place] else None,
                conclusion=conclusions[place],
                around=around[0] if around else None,
                around_low=around[1] if around else None,
                around_high=around[2] if around else None,
            )
        )
    evaluated, unsafe = int(tallies.evaluated.sum()), int(tallies.unsafe.sum())
    counts = Counter(conclusions)
    view = RepeatsView(
        campaign=stored.campaign.id,
        of=campaign.id,
        name=campaign.body.name,
        status=stored.campaign.status,
        status_reason=stored.campaign.status_reason,
        repeats=stored.repeats,
        selection=stored.selection,
        t_b=stored.t_b,
        d_th=stored.d_th,
        distinct=distinct,
        p_th=near.p_th,
        simulations=stored.campaign.completed,
        budget=stored.campaign.body.budget.simulations,
        holding=int((holds & known).sum()),
        below=counts[Conclusion.BELOW],
        above=counts[Conclusion.ABOVE],
        near=counts[Conclusion.NEAR],
        inconclusive=counts[Conclusion.INCONCLUSIVE],
        evaluated=evaluated,
        unsafe=unsafe,
        pooled=_pooled(unsafe, evaluated, near.z),
        words="",
        solutions=solutions,
    )
    rated = stored.selection is Selection.BOUNDARY or read_archive.plan.is_for("boundary")
    to_clear = simulations_to_clear(near.p_th, near.z) if rated else None
    return view.model_copy(update={"words": _in_words(view, to_clear)})


def repeats_table(view: RepeatsView) -> Table:
    """Return the repeated solutions with a verdict as a table, the most likely to be unsafe first."""
    evaluated = [one for one in view.solutions if one.evaluated]
    return Table(
        name="repeats",
        title="How likely each solution is to be unsafe",
        columns=COLUMNS,
        rows=[
            [
                one.number,
                one.evaluated,
                one.unsafe,
                f"{one.probability or 0.0:.2f}",
                f"{one.low:.2f} to {one.high:.2f}",
                "" if one.around is None else f"{one.around_low:.2f} to {one.around_high:.2f}",
                str(one.conclusion or ""),
            ]
            for one in sorted(evaluated, key=lambda one: one.probability or 0.0, reverse=True)
        ],
    )


def _pooled(unsafe: int, evaluated: int, z: float) -> tuple[float, float] | None:
    if not evaluated:
        return None
    low, high = wilson_interval(unsafe, evaluated, z)
    return float(low), float(high)


def _in_words(view: RepeatsView, to_clear: int | None) -> str:
    """Summarise repeats: the unsafe share of all simulations with its interval, and the conclusion on each solution.

    Args:
        view: The repeats.
        to_clear: Simulations, all safe, that put the interval of a solution below p_th; None for solutions of
            a search that has nothing to do with p_th.
    """
    count, reason = len(view.solutions), f" ({view.status_reason})" if view.status_reason else ""
    selected = "boundary solution" if view.selection is Selection.BOUNDARY else "selected solution"
    what = listed_words(count, view.distinct or count, selected)
    if view.pooled is None:
        return f"{what}, none simulated again yet: {view.status}{reason}"
    if view.selection is Selection.BOUNDARY:
        what += f" (fitness at most {view.t_b:g}, {view.d_th:g} apart)"
    each = sorted({one.evaluated for one in view.solutions})
    drives = f"{each[0]} to {each[-1]}" if len(each) > 1 else f"{each[0]}"
    low, high = view.pooled
    share = (
        f"{view.unsafe:,} of {view.evaluated:,} simulations were unsafe, {view.unsafe / view.evaluated:.1%} "
        f"(interval {low:.1%} to {high:.1%})"
    )
    if view.status is not CampaignStatus.FINISHED:
        return f"{what}, fewer than {view.repeats} repeats of each so far: {share}; {view.status}{reason}"
    again = f"{what}, with other seeds, {drives} times each: {share}."
    if to_clear is None:
        return f"{again} {_by_verdict(view)}"
    known = [
        (view.near, "near p_th"),
        (view.below, "below it"),
        (view.above, "above it"),
        (view.inconclusive, f"inconclusive with {drives} simulations each"),
    ]
    told = ", ".join(f"{number} {words}" for number, words in known)
    rest = f" By solution, p_th = {view.p_th:g}: {told}."
    if each[0] < to_clear and view.inconclusive:
        rest += f" Even a solution that is never unsafe takes {to_clear} to fall below p_th."
    return again + rest


def _by_verdict(view: RepeatsView) -> str:
    """Return how many solutions were always safe, always unsafe, or both."""
    simulated = [one for one in view.solutions if one.evaluated]
    unsafe = sum(one.unsafe == one.evaluated for one in simulated)
    safe = sum(one.unsafe == 0 for one in simulated)
    both = len(simulated) - unsafe - safe
    return f"By solution: {unsafe} always unsafe, {safe} always safe, {both} with both verdicts."


def _around(read_archive: ReadArchive, index: int) -> tuple[float, float, float]:
    archive = read_archive.archive
    low, high = archive.interval[index].tolist()
    return float(archive.unsafe_neighbours[index] / archive.neighbours[index]), low, high
