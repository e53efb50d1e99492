"""Repeats: how often is each solution unsafe with other seeds?

The solutions are the distinct boundary at two thresholds, named by number, or sides of pairs. Sides of pairs are
simulated only until it is confirmed or refuted that they keep their verdicts. The algorithm is
`brink.search.algorithms.repeats`.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithms.repeats import (
    GENERATION_SIZE,
    Repeats,
    RepeatsConfig,
    Tallies,
    schedule,
    tallied,
)
from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.archive import Archive
from brink.search.errors import BoundaryTooLarge
from brink.search.streams import Stream, generator
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.follow_ups.follow_up import (
    FollowUp,
    PlannedFollowUp,
    StoredFollowUp,
    follow_up_body,
)
from brink.server.campaigns.follow_ups.limits import DEFAULT_CONFIRMATIONS, MOST
from brink.server.campaigns.follow_ups.question import (
    AskedPairs,
    Offer,
    Question,
    Reducible,
    refusal,
    sides_of,
)
from brink.server.campaigns.plan import Plan, check_repeatable, find_boundary, prepare_campaign
from brink.server.campaigns.store import Campaign
from brink.server.errors import FieldError, InvalidInput
from brink.server.states import ENDED, FollowUpKind, Selection

_MOST_ERRORS = 20


class Confirm(Question):
    """Solutions, simulated with other seeds."""

    kind = FollowUpKind.CONFIRM
    title = "Do the pairs hold?"
    label = "Confirm the pairs"
    option = f"--confirm {DEFAULT_CONFIRMATIONS}"
    words = "Simulates both sides of each pair with other seeds, until its verdict is confirmed or refuted."
    simulates = "both sides of each pair with other seeds"
    purpose = (
        "Brink simulated {many} of {of} again, with other random numbers, to see how often each is unsafe."
    )
    repeats = DEFAULT_CONFIRMATIONS
    is_asked_by_experiments = True

    def fits(self, plan: Plan, asks: FollowUp) -> bool:
        """Return whether a campaign repeats as many solutions, and stops early for sides of pairs alone."""
        config = plan.config
        if not isinstance(config, RepeatsConfig) or config.seed_numbers:
            return False
        kept = len(asks.numbers) if asks.selection is Selection.PAIRS else 0
        return len(config.solutions) == len(asks.numbers) and len(config.keep) == kept

    def plan(self, asked: AskedPairs, seeds: Mapping[int, int], repeats: int) -> PlannedFollowUp:
        """Plan repeats of both sides of pairs, each until its verdict is confirmed or refuted."""
        check_repeatable(asked.plan)
        return plan_named_repeats(
            asked.campaign,
            asked.plan,
            asked.archive,
            repeats=repeats,
            numbers=sides_of(asked.pairs),
            selection=Selection.PAIRS,
        )

    def offer(self, asked: AskedPairs, reducible: Reducible, finished: Sequence[StoredFollowUp]) -> Offer:
        """Return the cost of the follow-up for some pairs."""
        reason = refusal(lambda: check_repeatable(asked.plan))
        return Offer(simulations=len(sides_of(asked.pairs)), reason=reason)


QUESTION = Confirm()


def plan_boundary_repeats(
    campaign: Campaign, plan: Plan, archive: Archive, *, repeats: int, t_b: float, d_th: float
) -> PlannedFollowUp | None:
    """Plan repeats of a campaign's distinct boundary solutions, the best `MOST` of them; return None if it has none.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        repeats: Simulations of each solution.
        t_b: Maximum fitness.
        d_th: Minimum distance between two solutions.

    Raises:
        InvalidInput: The repeats cannot run, or there are too many boundary solutions to compare with each other.
    """
    try:
        chosen = find_boundary(archive, t_b, d_th)[:MOST]
    except BoundaryTooLarge as error:
        raise InvalidInput.at("/d_th", f"campaign {campaign.id}: {error}") from None
    if not len(chosen):
        return None
    asks = FollowUp(
        of_id=campaign.id,
        kind=FollowUpKind.CONFIRM,
        selection=Selection.BOUNDARY,
        t_b=t_b,
        d_th=d_th,
        repeats=repeats,
        numbers=tuple(archive.numbers[chosen].tolist()),
    )
    body = _repeats_body(
        campaign.body, plan, archive, chosen, asks.selection, repeats, "boundary again", (repeats,)
    )
    return PlannedFollowUp(asks=asks, campaign=prepare_campaign(body))


def plan_named_repeats(
    campaign: Campaign,
    plan: Plan,
    archive: Archive,
    *,
    repeats: int,
    numbers: Sequence[int],
    selection: Selection = Selection.NUMBERS,
) -> PlannedFollowUp:
    """Plan repeats of solutions named by number.

    Args:
        campaign: The campaign.
        plan: Its plan.
        archive: Its archive.
        repeats: Simulations of each solution.
        numbers: Distinct numbers in any order, at most `MOST`.
        selection: How they were chosen; sides of pairs are simulated only until their verdicts are confirmed or
            refuted, and at most `repeats` times.

    Raises:
        InvalidInput: The repeats cannot run, or a number is not an evaluated solution of the campaign.
    """
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}
    unknown = [(index, number) for index, number in enumerate(numbers) if number not in places]
    if unknown:
        raise InvalidInput(
            FieldError(
                pointer=f"/numbers/{index}",
                message=f"campaign {campaign.id} has no evaluated solution {number}",
            )
            for index, number in unknown[:_MOST_ERRORS]
        )
    body, ordered = named_repeats_body(
        campaign.body, plan, archive, repeats=repeats, numbers=numbers, selection=selection
    )
    asks = FollowUp(
        of_id=campaign.id, kind=FollowUpKind.CONFIRM, selection=selection, repeats=repeats, numbers=ordered
    )
    return PlannedFollowUp(asks=asks, campaign=prepare_campaign(body))


def named_repeats_body(
    body: CampaignBody,
    plan: Plan,
    archive: Archive,
    *,
    repeats: int,
    numbers: Sequence[int],
    selection: Selection,
) -> tuple[CampaignBody, tuple[int, ...]]:
    """Return the campaign that repeats evaluated solutions of another one, and their numbers in its order.

    Args:
        body: The other campaign.
        plan: Its plan.
        archive: Its archive.
        repeats: Simulations of each solution.
        numbers: Distinct numbers in any order, at most `MOST`.
        selection: How they were chosen; see `plan_named_repeats`.
    """
    named = np.flatnonzero(np.isin(archive.numbers, list(numbers)))
    chosen = named[np.lexsort((archive.numbers[named], archive.fitness[named]))]
    ordered = tuple(archive.numbers[chosen].tolist())
    # With the seed of other repeats, some of these would be the same episodes.
    index = (repeats, *sorted(ordered), *([len(ordered), 1] if selection is Selection.PAIRS else []))
    again = f"solution {ordered[0]} again" if len(ordered) == 1 else f"{len(ordered)} solutions again"
    return _repeats_body(body, plan, archive, chosen, selection, repeats, again, index), ordered


def _repeats_body(
    body: CampaignBody,
    plan: Plan,
    archive: Archive,
    chosen: NDArray[np.intp],
    selection: Selection,
    repeats: int,
    again: str,
    index: tuple[int, ...],
) -> CampaignBody:
    """Return the campaign that repeats solutions, given as positions in the archive.

    Its seed is that of the stream of repeats at `index`: with the campaign's own seed, the first repeats would be the
    same episodes as the campaign's.
    """
    params = {"solutions": archive.vectors[chosen].tolist()}
    if selection is Selection.PAIRS:
        params["keep"] = archive.unsafe[chosen].tolist()
    again_body = follow_up_body(body, plan, again, Repeats.id, repeats * len(chosen), params)
    seed = int(generator(body.seed, Stream.REPEATS, *index).integers(2**53))
    return again_body.model_copy(update={"seed": seed})


def drives_of(repeats: StoredFollowUp) -> list[tuple[int, bool | None]]:
    """Return the position, among the numbers, and the verdict of each finished simulation of repeats.

    The verdict says whether it was unsafe; None if it failed.
    """
    return drives_by_solution(repeats.campaign.body, repeats.verdicts)


def drives_by_solution(body: CampaignBody, ended: Mapping[int, bool | None]) -> list[tuple[int, bool | None]]:
    """Return the position, among the given solutions, and the verdict of each finished simulation of repeats.

    Args:
        body: The campaign that repeats solutions.
        ended: Whether each of its candidates that has ended was unsafe, by number; None if it failed.
    """
    params, budget = body.algorithm.params, body.budget.simulations
    keep, size = params.get("keep"), params.get("generation_size", GENERATION_SIZE)
    if not keep:
        return [(number % len(params["solutions"]), unsafe) for number, unsafe in ended.items()]
    places = dict(enumerate(schedule(keep, ended, budget, size)))
    return [(places[number], unsafe) for number, unsafe in ended.items() if number in places]


def tallies_of(repeats: StoredFollowUp, z: float) -> Tallies:
    """Return how often each solution was unsafe, with intervals at `z` standard deviations."""
    judged = [(place, unsafe) for place, unsafe in drives_of(repeats) if unsafe is not None]
    places, verdicts = [place for place, _ in judged], [unsafe for _, unsafe in judged]
    return tallied(places, verdicts, len(repeats.numbers), z)


def shares_of(stored: Sequence[StoredFollowUp]) -> Mapping[int, Share]:
    """Return how often each solution was unsafe, over all repeats among the follow-ups of a campaign, by number."""
    evaluated: Counter[int] = Counter()
    unsafe: Counter[int] = Counter()
    failed: Counter[int] = Counter()
    for repeats in stored:
        if repeats.kind is not FollowUpKind.CONFIRM:
            continue
        for place, verdict in drives_of(repeats):
            number = repeats.numbers[place]
            failed[number] += verdict is None
            evaluated[number] += verdict is not None
            unsafe[number] += bool(verdict)
    return {number: Share.of(unsafe[number], evaluated[number], failed[number]) for number in evaluated}


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeated:
    """The results of repeats of the sides of pairs.

    Attributes:
        shares: How often each repeated solution was unsafe with other seeds, by number.
        under_way: Numbers of the solutions that are being simulated again.
    """

    shares: Mapping[int, Share]
    under_way: frozenset[int]

    @classmethod
    def of(cls, stored: Sequence[StoredFollowUp]) -> Self:
        """Return the results of a campaign's repeats, ignoring other kinds of follow-ups."""
        open_ones = [
            one for one in stored if one.kind is FollowUpKind.CONFIRM and one.campaign.status not in ENDED
        ]
        under_way = frozenset(number for one in open_ones for number in one.numbers)
        return cls(shares=shares_of(stored), under_way=under_way)

    def shares_of(self, safe: int, unsafe: int) -> tuple[Share, Share]:
        """Return how often both sides of a pair were unsafe, by their numbers."""
        none = Share.of(0, 0)
        return self.shares.get(safe, none), self.shares.get(unsafe, none)

    def state(self, safe: int, unsafe: int) -> Confirmation:
        """Return whether both sides of a pair keep their verdicts with other seeds, or may turn out to."""
        return confirmation_of(
            *self.shares_of(safe, unsafe), pending=safe in self.under_way or unsafe in self.under_way
        )
