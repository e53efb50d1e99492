"""What is asked about the ends of thresholds: do they hold with other seeds, and is the component to blame?"""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from brink.search.analysis.pairs import Pair, Side
from brink.search.archive import Archive
from brink.search.conclusions import Outcome
from brink.server.campaigns.follow_ups.limits import DEFAULT_CONFIRMATIONS, MOST_PAIRS_FOLLOWED
from brink.server.campaigns.follow_ups.question import AskedPairs, question_of
from brink.server.campaigns.follow_ups.same_episodes import read_seeds
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.threshold_ends import Ends
from brink.server.campaigns.thresholds import CampaignThresholds
from brink.server.documents import Body
from brink.server.errors import Conflict
from brink.server.findings.sources import Sources
from brink.server.states import ENDED, FollowUpKind


class ThresholdFollowUpBody(Body):
    """The follow-up to run on the ends of a campaign's thresholds."""

    kind: Annotated[
        Literal["confirm", "component"],
        Field(
            description="confirm: simulate both ends with other seeds, until each is confirmed or refuted. "
            "component: simulate the unsafe end with ground truth in place of the component."
        ),
    ]
    repeats: Annotated[
        int,
        Field(
            ge=2, le=10_000, description="Maximum number of simulations of each end, to confirm thresholds."
        ),
    ] = DEFAULT_CONFIRMATIONS
    limit: Annotated[
        int,
        Field(ge=1, le=MOST_PAIRS_FOLLOWED, description="Maximum number of thresholds, the sharpest first."),
    ] = MOST_PAIRS_FOLLOWED


def ends_of(archive: Archive, found: CampaignThresholds, limit: int = MOST_PAIRS_FOLLOWED) -> Sequence[Pair]:
    """Return the ends of the first thresholds as pairs.

    Args:
        archive: The campaign's archive.
        found: Its thresholds.
        limit: Most of them.
    """
    places = {number: place for place, number in enumerate(archive.numbers.tolist())}

    def side(number: int) -> Side:
        robustness = float(archive.robustness[places[number]])
        return Side(number=number, evaluated=1, seeds=1, seed=None, robustness=robustness)

    pairs = []
    for one in found.of(Outcome.THRESHOLD)[:limit]:
        ends = Ends.of(archive, one)
        distance = ends.width / one.range
        pair = Pair(safe=side(ends.safe), unsafe=side(ends.unsafe), distance=distance, units=(one.line.unit,))
        pairs.append(pair)
    return pairs


async def follow_up_thresholds(
    sources: Sources, campaigns: CampaignService, campaign: Campaign, body: ThresholdFollowUpBody
) -> tuple[Campaign, bool]:
    """Simulate ends of the thresholds of a campaign again, as a new campaign; see `CampaignService.follow_up`.

    Raises:
        Conflict: The campaign has not ended, or has no threshold.
        InvalidInput: This cannot be simulated.
    """
    if campaign.status not in ENDED:
        raise Conflict(f"campaign {campaign.id} is {campaign.status}: wait until it has ended")
    read = await sources.archives.get(campaign)
    found = await sources.thresholds.get(campaign, read)
    pairs = ends_of(read.archive, found, body.limit)
    if not pairs:
        raise Conflict(f"campaign {campaign.id} has no threshold")
    asked = AskedPairs(campaign=campaign, plan=read.plan, archive=read.archive, pairs=pairs)
    numbers = [pair.unsafe.number for pair in pairs]
    seeds = await sources.pages.read(sources.engines, lambda c: read_seeds(c, campaign.id, numbers))
    return await campaigns.follow_up(
        campaign, lambda: question_of(FollowUpKind(body.kind)).plan(asked, seeds, body.repeats)
    )
