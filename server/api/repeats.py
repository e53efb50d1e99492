"""Routes of repeats: simulations of boundary solutions with other seeds, to check whether the boundary holds up."""

from collections import Counter
from typing import Annotated, Self

from fastapi import APIRouter, Response
from pydantic import Field, model_validator

from brink.search.algorithms.repeats import Conclusion, simulations_to_clear
from brink.search.fitness import wilson_interval
from brink.server.api.context import Context, Services
from brink.server.api.responses import set_created
from brink.server.api.schemas import MAX_NUMBER, View, listed_words
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.pairs import searches_for_pairs
from brink.server.campaigns.plan import looks_for_boundary
from brink.server.campaigns.repeats import MOST, StoredRepeats, read_repeats
from brink.server.campaigns.store import Campaign
from brink.server.documents import Body
from brink.server.states import CampaignStatus

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["repeats"])

DEFAULT_REPEATS = 50


class RepeatsBody(Body):
    """Which solutions to simulate again, and how often."""

    repeats: Annotated[int, Field(ge=2, le=10_000, description="Number of simulations of each solution.")] = (
        DEFAULT_REPEATS
    )
    t_b: Annotated[float, Field(ge=0, le=1, description="Maximum fitness of a boundary solution.")] = (
        DEFAULT_T_B
    )
    d_th: Annotated[
        float, Field(ge=0, le=1, description="Minimum distance between two boundary solutions.")
    ] = DEFAULT_D_TH
    numbers: Annotated[
        list[Annotated[int, Field(ge=0, le=MAX_NUMBER)]] | None,
        Field(
            min_length=1,
            max_length=MOST,
            description="Evaluated solutions to repeat instead of the distinct boundary at t_b and d_th.",
        ),
    ] = None

    @model_validator(mode="after")
    def _check_boundary_or_numbers(self) -> Self:
        if self.numbers is None:
            return self
        if given := sorted({"t_b", "d_th"} & self.model_fields_set):
            raise ValueError(
                f"expected either numbers or {given[0]}, not both: t_b and d_th select the boundary"
            )
        twice = [number for number, times in Counter(self.numbers).items() if times > 1]
        if twice:
            raise ValueError(f"numbers: expected each once, got {twice[0]} more than once")
        return self


class RepeatedSolution(View):
    """Estimated probability that a repeated solution is unsafe."""

    number: int
    evaluated: Annotated[
        int, Field(description="Number of simulations with other seeds that returned a verdict.")
    ]
    unsafe: int
    probability: Annotated[float | None, Field(description="Unsafe share of these simulations.")]
    low: Annotated[float, Field(description="Lower limit of its exact interval (Clopper-Pearson).")]
    high: float
    holds: Annotated[
        bool | None,
        Field(description="Whether the interval contains p_th; with few simulations, every interval does."),
    ]
    conclusion: Annotated[
        Conclusion | None,
        Field(
            description="What its simulations show: below or above p_th, near it (both verdicts, and an interval "
            "with a fitness of at most t_b), or inconclusive; null without a verdict."
        ),
    ]
    around: Annotated[
        float | None, Field(description="Unsafe share of its neighbourhood in the archive, including itself.")
    ]
    around_low: Annotated[float | None, Field(description="Lower limit of the neighbourhood's interval.")]
    around_high: float | None


class RepeatsView(View):
    """Results of simulating solutions of a campaign again with other seeds."""

    campaign: Annotated[str, Field(description="Campaign that runs the repeats.")]
    of: Annotated[str, Field(description="Campaign whose solutions are repeated.")]
    name: Annotated[str, Field(description="Name of the repeated campaign.")]
    status: CampaignStatus
    status_reason: str
    repeats: int
    boundary: Annotated[
        bool,
        Field(
            description="Whether these are the distinct boundary at t_b and d_th. If not, they were named by number, "
            "and t_b is 1 and d_th 0, which excludes nothing."
        ),
    ]
    t_b: float
    d_th: float
    p_th: float
    distinct: Annotated[
        int | None,
        Field(
            description="Number of distinct boundary solutions at t_b and d_th, of which the best 1,000 at most are "
            "repeated; null if the solutions were named by number."
        ),
    ] = None
    simulations: int
    budget: int
    holding: Annotated[int, Field(description="Number of solutions whose interval contains p_th.")]
    below: Annotated[
        int, Field(description="Number of solutions whose interval lies below p_th: safer than reported.")
    ]
    above: Annotated[int, Field(description="Number of solutions whose interval lies above p_th.")]
    near: Annotated[int, Field(description="Number of solutions that are near p_th themselves.")]
    inconclusive: Annotated[
        int,
        Field(description="Number of solutions whose simulations are too few, or too one-sided, to tell."),
    ]
    evaluated: Annotated[int, Field(description="Number of verdicts so far, over all solutions.")]
    unsafe: int
    pooled: Annotated[
        tuple[float, float] | None,
        Field(description="Wilson interval of the unsafe share over all solutions; null without a verdict."),
    ]
    words: Annotated[str, Field(description="What the repeats show, in sentences.")]
    solutions: Annotated[list[RepeatedSolution], Field(description="Best fitness first.")]


@router.post(
    "/repeats",
    status_code=201,
    responses={200: {"model": RepeatsView, "description": "These repeats had already been requested."}},
)
async def repeat_boundary(
    campaign_id: str, body: RepeatsBody, services: Services, response: Response
) -> RepeatsView:
    """Simulate the distinct boundary solutions, or given ones, again with other seeds, as a new campaign.

    Of a boundary with more than 1,000 solutions, the best 1,000 are simulated, and `words` says so.
    """
    campaign = await services.campaigns.get(campaign_id)
    found = await services.archives.get(campaign)
    repeats, new = await services.campaigns.repeat(
        campaign,
        found.plan,
        found.archive,
        repeats=body.repeats,
        t_b=body.t_b,
        d_th=body.d_th,
        numbers=body.numbers,
    )
    set_created(response, f"campaigns/{repeats.id}", new=new)
    views = await _views(services, campaign_id)
    return next(view for view in views if view.campaign == repeats.id)


@router.get("/repeats")
async def get_repeats(campaign_id: str, services: Services) -> list[RepeatsView]:
    """List the results of all repeats of a campaign's solutions, one entry for each request."""
    return await _views(services, campaign_id)


async def _views(services: Services, campaign_id: str) -> list[RepeatsView]:
    campaign = await services.campaigns.get(campaign_id)
    stored = await services.pages.read(services.engines, lambda c: read_repeats(c, campaign.id))
    if not stored:
        return []
    found = await services.archives.get(campaign)
    distinct = [await count_distinct(services, campaign, one, found) for one in stored]
    return await services.pages.run(
        lambda: [repeats_view(campaign, one, found, of) for one, of in zip(stored, distinct, strict=True)]
    )


async def count_distinct(
    services: Context, campaign: Campaign, stored: StoredRepeats, found: ReadArchive
) -> int | None:
    """Return how many boundary solutions there are at the thresholds of repeats; None if these are of named ones."""
    if not stored.boundary:
        return None
    if len(stored.numbers) < MOST:
        return len(stored.numbers)
    return (await services.boundaries.get(campaign, found, stored.t_b, stored.d_th)).counts.dbs


def repeats_view(
    campaign: Campaign, stored: StoredRepeats, read_archive: ReadArchive, distinct: int | None
) -> RepeatsView:
    """Return what repeats show.

    Args:
        campaign: The campaign whose solutions are repeated.
        stored: The repeats.
        read_archive: Its archive.
        distinct: How many boundary solutions there are at their thresholds; see `count_distinct`.
    """
    near = read_archive.plan.neighbourhood
    tallies = stored.tallies(near.z)
    known, holds = tallies.evaluated > 0, tallies.contains(near.p_th)
    conclusions = tallies.conclusions(near.p_th, stored.t_b if stored.boundary else DEFAULT_T_B)
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
        boundary=stored.boundary,
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
    searched = campaign.body.algorithm.id
    rated = stored.boundary or (looks_for_boundary(searched) and not searches_for_pairs(searched))
    to_clear = simulations_to_clear(near.p_th, near.z) if rated else None
    return view.model_copy(update={"words": _in_words(view, to_clear)})


def _pooled(unsafe: int, evaluated: int, z: float) -> tuple[float, float] | None:
    if not evaluated:
        return None
    low, high = wilson_interval(unsafe, evaluated, z)
    return float(low), float(high)


def _in_words(view: RepeatsView, to_clear: int | None) -> str:
    """Return what repeats show: the share of all simulations with its interval, and what is known of each solution.

    Args:
        view: The repeats.
        to_clear: Simulations, all safe, that put the interval of a solution below p_th; None for solutions of
            a search that has nothing to do with p_th.
    """
    count, reason = len(view.solutions), f" ({view.status_reason})" if view.status_reason else ""
    selected = "boundary solution" if view.boundary else "selected solution"
    what = listed_words(count, view.distinct or count, selected)
    if view.pooled is None:
        return f"{what}, none simulated again yet: {view.status}{reason}"
    if view.boundary:
        what += f" (fitness at most {view.t_b:g}, {view.d_th:g} apart)"
    each = sorted({one.evaluated for one in view.solutions})
    drives = f"{each[0]} to {each[-1]}" if len(each) > 1 else f"{each[0]}"
    low, high = view.pooled
    share = (
        f"{view.unsafe:,} of {view.evaluated:,} simulations were unsafe, {view.unsafe / view.evaluated:.1%} "
        f"(interval {low:.1%} to {high:.1%})"
    )
    if view.status is not CampaignStatus.FINISHED:
        return f"{what}, not yet simulated again {view.repeats} times: {share} so far; {view.status}{reason}"
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
