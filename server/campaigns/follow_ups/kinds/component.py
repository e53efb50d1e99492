"""Is the component to blame? The episodes of unsafe solutions with ground truth in place of the component.

They are the very episodes of the campaign with one thing changed. The follow-up therefore has its seed, and names for
each solution the number of the candidate whose episode seed it shares.
"""

from collections.abc import Mapping, Sequence

from brink.search.algorithms.repeats import Repeats, RepeatsConfig
from brink.server.campaigns.follow_ups.follow_up import (
    FollowUp,
    PlannedFollowUp,
    StoredFollowUp,
    follow_up_body,
)
from brink.server.campaigns.follow_ups.question import AskedPairs, Offer, Question, Reducible, refusal
from brink.server.campaigns.follow_ups.same_episodes import seed_numbers, vectors_of
from brink.server.campaigns.plan import Plan, prepare_campaign, with_truth
from brink.server.states import FollowUpKind, Selection


class Component(Question):
    """Unsafe sides, simulated with ground truth."""

    kind = FollowUpKind.COMPONENT
    title = "Is the component to blame?"
    label = "Simulate with ground truth"
    option = "--component"
    words = "Simulates each unsafe side once more, with ground truth in place of the component."
    simulates = "each unsafe side with ground truth in place of the component"
    purpose = "Brink simulated unsafe {many} of {of} again, with ground truth in place of the component."
    showed = "with ground truth in place of the component, {counts} were unsafe all the same"
    is_exact = True
    is_asked_by_experiments = True

    def fits(self, plan: Plan, asks: FollowUp) -> bool:
        """Return whether a campaign simulates as many solutions with ground truth."""
        config = plan.config
        return (
            isinstance(config, RepeatsConfig)
            and plan.body.ground_truth
            and asks.selection is Selection.PAIRS
            and len(config.solutions) == len(config.seed_numbers) == len(asks.numbers)
        )

    def plan(self, asked: AskedPairs, seeds: Mapping[int, int], repeats: int) -> PlannedFollowUp:
        """Plan the episodes of the unsafe sides of pairs with ground truth in place of the component.

        Raises:
            InvalidInput: The problem has no component that can be replaced.
            Conflict: An episode seed is not one of the campaign.
        """
        with_truth(asked.plan.problem)
        campaign = asked.campaign
        numbers = sorted({pair.unsafe.number for pair in asked.pairs})
        params = {
            "solutions": vectors_of(asked.archive, numbers).tolist(),
            "seed_numbers": seed_numbers(campaign, numbers, seeds),
        }
        what = f"{len(numbers)} unsafe drive{'s' if len(numbers) > 1 else ''} with ground truth"
        body = follow_up_body(campaign.body, asked.plan, what, Repeats.id, len(numbers), params)
        asks = FollowUp(of_id=campaign.id, kind=self.kind, selection=Selection.PAIRS, numbers=tuple(numbers))
        return PlannedFollowUp(
            asks=asks, campaign=prepare_campaign(body.model_copy(update={"ground_truth": True}))
        )

    def offer(self, asked: AskedPairs, reducible: Reducible, finished: Sequence[StoredFollowUp]) -> Offer:
        """Return the cost of the follow-up for some pairs."""
        unsafe = {pair.unsafe.number for pair in asked.pairs}
        reason = refusal(lambda: with_truth(asked.plan.problem))
        if not reason and unsafe <= {number for one in finished for number in one.numbers}:
            reason = "all unsafe sides have been simulated with ground truth"
        return Offer(simulations=len(unsafe), reason=reason)

    def brief(self, evaluated: int, unsafe: int) -> str:
        """Return how many of the unsafe sides were safe."""
        return f"{evaluated - unsafe:,} of {evaluated:,} safe with ground truth"


QUESTION = Component()


def blames_scenario(stored: Sequence[StoredFollowUp]) -> Mapping[int, bool]:
    """Return, by number, whether each solution that was simulated with ground truth is then unsafe, too.

    Args:
        stored: The follow-ups of a campaign, oldest first; those of other kinds are ignored.
    """
    blamed: dict[int, bool] = {}
    for one in stored:
        if one.kind is FollowUpKind.COMPONENT:
            for place, unsafe in zip(one.evaluated, one.unsafe, strict=True):
                blamed.setdefault(one.numbers[place], unsafe)
    return blamed
