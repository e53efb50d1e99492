"""A cache of the boundaries of campaigns: concurrent requests for the same thresholds share one computation."""

from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np
from sqlalchemy import Connection, select

from brink.search.analysis.boundary import MOST_COST, DbsGrid, IndexArray, dbs_grid, has_evidence
from brink.search.analysis.paper import D_THS, PAPER_T_BS
from brink.search.archive import Archive
from brink.search.errors import BoundaryTooLarge
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.plan import find_boundary
from brink.server.campaigns.store import Campaign
from brink.server.db.models import GenerationRow
from brink.server.errors import InvalidInput
from brink.server.single_flight import SingleFlightCache

CACHED: Final = 64
"""Maximum number of boundaries, and of grids, in memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DbsCounts:
    """The number of distinct boundary solutions, and of the strict ones among them."""

    dbs: int
    strict: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CampaignBoundary:
    """The boundary of a campaign at two thresholds.

    Attributes:
        chosen: The distinct boundary solutions as positions in the archive, best first.
        counts: How many there are.
        within: The same without the simulations beyond the budget; None if there are none.
        with_known: The same with the known results; None if the campaign did not start from any.
    """

    chosen: IndexArray
    counts: DbsCounts
    within: DbsCounts | None
    with_known: DbsCounts | None


@dataclass(slots=True)
class Boundaries:
    """A cache of boundaries.

    Attributes:
        threads: Where boundaries are found, so that other requests do not wait.
    """

    threads: InitVar[Executor]
    _found: SingleFlightCache[CampaignBoundary | BoundaryTooLarge] = field(init=False)
    _grids: SingleFlightCache[DbsGrid] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._found = SingleFlightCache(CACHED, threads)
        self._grids = SingleFlightCache(CACHED, threads)

    async def get(self, campaign: Campaign, read: ReadArchive, t_b: float, d_th: float) -> CampaignBoundary:
        """Return the boundary of a campaign.

        Args:
            campaign: The campaign.
            read: Its archive.
            t_b: Maximum fitness of a boundary solution.
            d_th: Minimum distance between two boundary solutions.

        Raises:
            InvalidInput: There are too many solutions to compare with each other.
            Unavailable: Too many costly reads are pending, or this one took too long.
        """
        boundary = await self._found.get(
            (campaign.id, t_b, d_th), read.generation, lambda: _find(campaign, read, t_b, d_th)
        )
        if isinstance(boundary, BoundaryTooLarge):
            raise InvalidInput.at("/query/d_th", f"campaign {campaign.id}: {boundary}")
        return boundary

    async def grid(self, campaign: Campaign, read: ReadArchive) -> DbsGrid:
        """Return DBS and strict DBS at all thresholds, without distances at which they would take too long.

        Args:
            campaign: The campaign.
            read: Its archive.

        Raises:
            Unavailable: Too many costly reads are pending, or this one took too long.
        """
        return await self._grids.get(
            campaign.id,
            read.generation,
            lambda: dbs_grid(read.archive, PAPER_T_BS, D_THS, most_cost=MOST_COST),
        )


def read_last_count(connection: Connection, campaign_id: str) -> int:
    """Return the number of distinct boundary solutions at the default thresholds, as of the last generation."""
    row = GenerationRow
    query = select(row.dbs).where(row.campaign_id == campaign_id).order_by(row.number.desc()).limit(1)
    return connection.execute(query).scalar() or 0


def _find(
    campaign: Campaign, read: ReadArchive, t_b: float, d_th: float
) -> CampaignBoundary | BoundaryTooLarge:
    archive = read.archive
    count = int(np.searchsorted(archive.numbers, campaign.budget))
    try:
        chosen = find_boundary(archive, t_b, d_th)
        within = None if count == len(archive) else _counts(archive.first(count), t_b, d_th)
        with_known = _counts(read.with_known, t_b, d_th) if len(read.known) else None
    except BoundaryTooLarge as error:
        return error  # cached, unlike what is raised here
    return CampaignBoundary(
        chosen=chosen, counts=_count(archive, chosen), within=within, with_known=with_known
    )


def _counts(archive: Archive, t_b: float, d_th: float) -> DbsCounts:
    return _count(archive, find_boundary(archive, t_b, d_th))


def _count(archive: Archive, chosen: IndexArray) -> DbsCounts:
    return DbsCounts(dbs=len(chosen), strict=int(np.count_nonzero(has_evidence(archive)[chosen])))
