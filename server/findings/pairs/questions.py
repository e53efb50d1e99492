"""What is asked about the pairs of a campaign: which there are, and further simulations of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

from pydantic import Field, model_validator
from sqlalchemy import Connection

from brink.search.sequential import FIRST
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.limits import DEFAULT_CONFIRMATIONS, MOST_PAIRS_FOLLOWED
from brink.server.campaigns.follow_ups.question import AskedPairs, question_of
from brink.server.campaigns.follow_ups.same_episodes import read_seeds
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.pairs import PairSettings
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.store import Campaign
from brink.server.documents import Body
from brink.server.errors import Conflict, InvalidInput
from brink.server.findings.pairs.analysis import pairs_view
from brink.server.findings.pairs.table import pairs_file
from brink.server.findings.pairs.views import PairsView
from brink.server.findings.sources import Sources
from brink.server.states import ENDED, FollowUpKind


class FollowUpBody(Body):
    """The follow-up to run on the pairs of a campaign."""

    kind: Annotated[
        FollowUpKind,
        Field(
            strict=False,
            description="confirm: simulate both sides with other seeds. component: simulate the unsafe side with "
            "ground truth in place of the component. minimise: revert differences one by one. sharpen: "
            "find where along a number they turn.",
        ),
    ]
    repeats: Annotated[
        int,
        Field(
            ge=2,
            le=10_000,
            description="Maximum number of simulations of each side, to confirm pairs. It takes fewer once a "
            "side is confirmed or "
            f"refuted; fewer than {FIRST} confirm none.",
        ),
    ] = DEFAULT_CONFIRMATIONS
    eps: Annotated[float | None, Field(ge=0, le=1, description="As for the pairs themselves.")] = None
    d_th: Annotated[float | None, Field(ge=0, le=1, description="As for the pairs themselves.")] = None
    limit: Annotated[
        int,
        Field(
            ge=1,
            le=MOST_PAIRS_FOLLOWED,
            description="Maximum number of pairs to follow up, those with the smallest numbers.",
        ),
    ] = MOST_PAIRS_FOLLOWED

    @model_validator(mode="after")
    def _check_repeats_confirm(self) -> Self:
        if question_of(self.kind).repeats is None and "repeats" in self.model_fields_set:
            raise ValueError(f"expected repeats only to confirm pairs, got kind {self.kind}")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairsQuestion:
    """Which pairs a campaign has.

    Attributes:
        campaign: The campaign.
        read: Its archive.
        stored: Its follow-ups.
        settings: Which solutions are a pair, and which pairs are distinct.
    """

    campaign: Campaign
    read: ReadArchive
    stored: Sequence[StoredFollowUp]
    settings: PairSettings

    @classmethod
    async def of(cls, sources: Sources, campaign: Campaign, eps: float | None, d_th: float | None) -> Self:
        """Return the question, whose answer takes longer.

        Args:
            sources: Where findings are read from.
            campaign: The campaign.
            eps: Largest distance between the sides of a pair; by default that of the search.
            d_th: Smallest distance between two distinct pairs; by default that of the search.
        """
        read = await sources.archives.get(campaign)
        stored = await sources.pages.read(sources.engines, lambda c: read_follow_ups(c, campaign.id))
        settings = PairSettings.of(read.plan, eps, d_th)
        return cls(campaign=campaign, read=read, stored=stored, settings=settings)

    @property
    def state(self) -> tuple[object, ...]:
        """What the answer depends on."""
        follow_ups = [(one.campaign.id, one.campaign.sequence) for one in self.stored]
        campaign = self.campaign
        return campaign.id, campaign.sequence, self.read.generation, self.settings, follow_ups

    async def answer(self, sources: Sources, limit: int, form: str) -> PairsView | bytes:
        """Return the pairs, or, for a form other than ``json``, a file of them.

        Raises:
            InvalidInput: There are too many to tell apart, or Parquet is not installed.
        """
        pairs = await sources.pairs.get(self.campaign, self.read, self.settings)

        def look(connection: Connection) -> PairsView | bytes:
            view = pairs_view(connection, self.campaign, self.read, pairs, self.stored, limit)
            return view if form == "json" else pairs_file(view, self.read.plan.problem.space, form)

        return await sources.pages.read(sources.engines, look)


async def follow_up_pairs(
    sources: Sources, campaigns: CampaignService, campaign: Campaign, body: FollowUpBody
) -> tuple[Campaign, bool]:
    """Simulate sides of the distinct pairs of a campaign again, as a new campaign; see `CampaignService.follow_up`.

    Raises:
        Conflict: The campaign has not ended, or has no pair.
        InvalidInput: There are too many pairs to tell apart, or this cannot be simulated.
    """
    if campaign.status not in ENDED:
        raise Conflict(f"campaign {campaign.id} is {campaign.status}: wait until it has ended")
    read = await sources.archives.get(campaign)
    try:
        pairs = await sources.pairs.get(campaign, read, PairSettings.of(read.plan, body.eps, body.d_th))
    except InvalidInput as error:  # it points at the parameter of the question
        [refused] = error.errors
        raise InvalidInput.at(refused.pointer.removeprefix("/query"), refused.message) from None
    chosen = pairs.found.pairs[: body.limit]
    if not chosen:
        raise Conflict(
            f"campaign {campaign.id} has no pair at eps {pairs.settings.eps:g}, d_th {pairs.settings.d_th:g}"
        )
    asked = AskedPairs(campaign=campaign, plan=read.plan, archive=read.archive, pairs=chosen)
    numbers = [pair.unsafe.number for pair in chosen]
    seeds = await sources.pages.read(sources.engines, lambda c: read_seeds(c, campaign.id, numbers))
    return await campaigns.follow_up(
        campaign, lambda: question_of(body.kind).plan(asked, seeds, body.repeats)
    )
