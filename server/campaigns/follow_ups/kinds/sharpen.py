"""Where exactly between the two sides of a pair does it turn? Pairs are brought to thresholds.

The follow-up is a search of its own, under fresh seeds (`brink.search.algorithms.sharpen`), and its campaign has its
findings. The numbers of the follow-up are those of the two sides of each pair, the safe one first.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from brink.search.algorithms.sharpen import Sharpen, SharpenConfig, most_simulations, moved_units
from brink.search.analysis.pairs import Pair
from brink.search.streams import Stream, generator
from brink.search.thresholds import MOST
from brink.server.campaigns.follow_ups.follow_up import (
    FollowUp,
    PlannedFollowUp,
    StoredFollowUp,
    follow_up_body,
)
from brink.server.campaigns.follow_ups.question import AskedPairs, Offer, Question, Reducible
from brink.server.campaigns.follow_ups.same_episodes import vectors_of
from brink.server.campaigns.plan import Plan, prepare_campaign
from brink.server.errors import Conflict
from brink.server.states import FollowUpKind, Selection

_A_HUNT: Final = 8
"""Simulations of a pair that may be in flight at a time."""
_NO_NUMBER: Final = "no pair differs in a number: where a category decides, there is no threshold"


class Sharpening(Question):
    """Pairs, brought to thresholds."""

    kind = FollowUpKind.SHARPEN
    title = "Where exactly does it turn?"
    label = "Find the thresholds"
    option = "--sharpen"
    words = (
        "Narrows each pair to one number, and estimates with fresh seeds where along it drives turn unsafe."
    )
    simulates = "drives between the two sides of each pair"
    purpose = "Brink searched between the sides of pairs of {of} for the values at which drives turn unsafe."
    showed = "between the sides of pairs, {counts} were unsafe"
    has_findings = True

    def fits(self, plan: Plan, asks: FollowUp) -> bool:
        """Return whether a campaign sharpens as many pairs."""
        config = plan.config
        return (
            isinstance(config, SharpenConfig)
            and asks.selection is Selection.PAIRS
            and 2 * len(config.safe) == len(asks.numbers)
        )

    def plan(self, asked: AskedPairs, seeds: Mapping[int, int], repeats: int) -> PlannedFollowUp:
        """Plan the search for thresholds between the sides of pairs.

        Raises:
            Conflict: No pair differs in a number.
        """
        campaign = asked.campaign
        pairs = _numeric(asked)
        if not pairs:
            raise Conflict(f"campaign {campaign.id}: {_NO_NUMBER}")
        numbers = tuple(number for pair in pairs for number in (pair.safe.number, pair.unsafe.number))
        trials = 0 if asked.plan.problem.ignores_seeds else MOST
        params = {
            "safe": vectors_of(asked.archive, numbers[0::2]).tolist(),
            "unsafe": vectors_of(asked.archive, numbers[1::2]).tolist(),
            "trials": trials,
            "generation_size": _A_HUNT * len(pairs),
        }
        what = f"{len(pairs)} pair{'s' if len(pairs) > 1 else ''} sharpened"
        body = follow_up_body(campaign.body, asked.plan, what, Sharpen.id, _most(asked, pairs), params)
        seed = int(generator(campaign.body.seed, Stream.REPEATS, *numbers, 0, len(numbers)).integers(2**53))
        asks = FollowUp(of_id=campaign.id, kind=self.kind, selection=Selection.PAIRS, numbers=numbers)
        return PlannedFollowUp(asks=asks, campaign=prepare_campaign(body.model_copy(update={"seed": seed})))

    def offer(self, asked: AskedPairs, reducible: Reducible, finished: Sequence[StoredFollowUp]) -> Offer:
        """Return the cost of the follow-up for some pairs."""
        pairs = _numeric(asked)
        reason = ""
        if not pairs:
            reason = _NO_NUMBER
        elif {pair.unsafe.number for pair in pairs} <= {n for one in finished for n in one.numbers[1::2]}:
            reason = f"all pairs have been sharpened: see campaign {finished[-1].campaign.id}"
        return Offer(simulations=_most(asked, pairs), reason=reason)


QUESTION = Sharpening()


def _numeric(asked: AskedPairs) -> dict[Pair, int]:
    """Return the pairs that differ in a number, with how many units of numbers differ."""
    numbers = [(pair.safe.number, pair.unsafe.number) for pair in asked.pairs]
    sides = (vectors_of(asked.archive, side) for side in zip(*numbers, strict=True))
    space = asked.plan.problem.space
    moved = {
        pair: len(moved_units(space, safe, unsafe))
        for pair, safe, unsafe in zip(asked.pairs, *sides, strict=True)
    }
    return {pair: units for pair, units in moved.items() if units}


def _most(asked: AskedPairs, pairs: Mapping[Pair, int]) -> int:
    trials = 0 if asked.plan.problem.ignores_seeds else MOST
    return most_simulations(len(pairs), sum(pairs.values()), trials)
