"""Which differences between the two sides of a pair matter? They are reverted, one by one.

The episodes are those of the unsafe sides, as in `brink.server.campaigns.follow_ups.kinds.component`. The numbers of
the follow-up are those of the two sides of each pair, the safe one first.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from brink.search.algorithms.minimise import (
    Minimise,
    MinimiseConfig,
    Reduced,
    Reductions,
    most_trials,
    replay,
)
from brink.search.analysis.pairs import Pair
from brink.search.archive import Archive
from brink.server.campaigns.follow_ups.follow_up import (
    FollowUp,
    PlannedFollowUp,
    StoredFollowUp,
    follow_up_body,
)
from brink.server.campaigns.follow_ups.question import AskedPairs, Offer, Question, Reducible
from brink.server.campaigns.follow_ups.same_episodes import seed_numbers, vectors_of
from brink.server.campaigns.plan import Plan, prepare_campaign
from brink.server.errors import Conflict
from brink.server.states import FollowUpKind, Selection


class Minimisation(Question):
    """Pairs, reduced to the differences that matter."""

    kind = FollowUpKind.MINIMISE
    title = "Which differences matter?"
    label = "Minimise the changes"
    option = "--minimise"
    words = "Reverts the differences of each pair one by one, as long as its unsafe side stays unsafe."
    simulates = "each unsafe side without one difference at a time"
    purpose = "Brink reverted differences between {many} of {of} one by one, to find those that matter."
    showed = "with some of their differences reverted, {counts} were still unsafe"

    def fits(self, plan: Plan, asks: FollowUp) -> bool:
        """Return whether a campaign reduces as many pairs."""
        config = plan.config
        return (
            isinstance(config, MinimiseConfig)
            and asks.selection is Selection.PAIRS
            and 2 * len(config.safe) == len(asks.numbers)
        )

    def plan(self, asked: AskedPairs, seeds: Mapping[int, int], repeats: int) -> PlannedFollowUp:
        """Plan the reduction of pairs to the differences that matter, under the episode seeds of the unsafe sides.

        Pairs whose sides were simulated with different seeds are left out: if the safe side is unsafe under the seed
        of the unsafe side, chance decides, and no difference matters.

        Raises:
            Conflict: No difference can be reverted, or an episode seed is not one of the campaign.
        """
        campaign = asked.campaign
        if not any(has_one_seed(asked.plan, pair) for pair in asked.pairs):
            raise Conflict(
                f"campaign {campaign.id}: the two sides of every pair have different seeds, so chance may explain "
                "the verdicts: differences are reverted only where both sides had one seed"
            )
        open_pairs, reduced = reducible_pairs(asked.plan, asked.archive, asked.pairs)
        if not open_pairs:
            raise Conflict(
                f"campaign {campaign.id}: none of the differences of its pairs can be reverted alone: they are "
                "minimal"
            )
        numbers = tuple(number for pair in open_pairs for number in (pair.safe.number, pair.unsafe.number))
        params = {
            "safe": reduced.safe.tolist(),
            "unsafe": reduced.unsafe.tolist(),
            "seed_numbers": seed_numbers(campaign, numbers[1::2], seeds),
        }
        what = f"{len(open_pairs)} pair{'s' if len(open_pairs) > 1 else ''} minimised"
        body = follow_up_body(campaign.body, asked.plan, what, Minimise.id, most_trials(reduced), params)
        asks = FollowUp(of_id=campaign.id, kind=self.kind, selection=Selection.PAIRS, numbers=numbers)
        return PlannedFollowUp(asks=asks, campaign=prepare_campaign(body))

    def offer(self, asked: AskedPairs, reducible: Reducible, finished: Sequence[StoredFollowUp]) -> Offer:
        """Return the cost of the follow-up for some pairs."""
        same_seed = sum(has_one_seed(asked.plan, pair) for pair in asked.pairs)
        open_pairs = {(pair.safe.number, pair.unsafe.number) for pair in asked.pairs} & set(reducible.pairs)
        reason = ""
        if not same_seed:
            reason = "the two sides of every pair have different seeds, so chance may explain the verdicts"
        elif not open_pairs:
            reason = "no difference can be reverted alone: all pairs are minimal"
        elif open_pairs <= {pair for one in finished for pair in pairs_of(one)}:
            reason = "the differences of all pairs have been reverted one by one"
        return Offer(simulations=reducible.most_trials, reason=reason, left_out=len(asked.pairs) - same_seed)


QUESTION = Minimisation()


def pairs_of(minimisation: StoredFollowUp) -> list[tuple[int, int]]:
    """Return the pairs whose differences a follow-up reverts, by the numbers of their two sides."""
    return list(zip(minimisation.numbers[0::2], minimisation.numbers[1::2], strict=True))


def has_one_seed(plan: Plan, pair: Pair) -> bool:
    """Return whether only the differences between the sides of a pair can explain their verdicts, not the seeds."""
    return pair.same_seed or plan.problem.ignores_seeds


def reducible_pairs(plan: Plan, archive: Archive, pairs: Sequence[Pair]) -> tuple[list[Pair], Reductions]:
    """Return the pairs with a difference that can be reverted, and their reductions before the first trial.

    The sides of these pairs were simulated with one seed.
    """
    space, pairs = plan.problem.space, [pair for pair in pairs if has_one_seed(plan, pair)]
    safe, unsafe = (
        vectors_of(archive, numbers)
        for numbers in ([pair.safe.number for pair in pairs], [pair.unsafe.number for pair in pairs])
    )
    open_pairs = sorted({trial.pair for trial in Reductions.of(space, safe, unsafe).trials()})
    return [pairs[place] for place in open_pairs], Reductions.of(space, safe[open_pairs], unsafe[open_pairs])


def reduced_by(plan: Plan, minimisation: StoredFollowUp) -> Reduced:
    """Return the progress of a follow-up that reduces pairs, from its stored verdicts.

    Args:
        plan: Plan of the follow-up's campaign.
        minimisation: The follow-up.
    """
    config = plan.config
    assert isinstance(config, MinimiseConfig)
    given = Reductions.of(
        plan.problem.space, np.asarray(config.safe, np.float64), np.asarray(config.unsafe, np.float64)
    )
    return replay(given, minimisation.verdicts, minimisation.campaign.budget)
