"""Archives for reading: from the live state where it is in memory, else restored from the database."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from sqlalchemy import Connection

from brink.search.analysis.boundary import DbsGrid, dbs_grid
from brink.search.analysis.paper import PAPER_D_THS, PAPER_T_BS
from brink.search.archive import Archive, archive_digest
from brink.search.space import FloatArray
from brink.server.campaigns import step_store
from brink.server.campaigns.advance import Stepper
from brink.server.campaigns.plan import Plan, make_plan, restored_archive
from brink.server.campaigns.values import Campaign, StoredArchive
from brink.server.db.engine import Engines
from brink.server.single_flight import Latest

KEPT = 8


@dataclass(frozen=True, kw_only=True)
class ReadArchive:
    """A campaign's archive as of its last generation told, with what is asked of it again and again."""

    plan: Plan
    archive: Archive
    generation: int

    @cached_property
    def digest(self) -> str:
        """The digest of the archive."""
        return archive_digest(self.archive)

    @cached_property
    def places(self) -> Mapping[int, int]:
        """Where in the archive each solution is, by its number."""
        return {number: place for place, number in enumerate(self.archive.numbers.tolist())}

    @cached_property
    def grid(self) -> DbsGrid:
        """DBS and strict DBS at the paper's thresholds."""
        return dbs_grid(self.archive, PAPER_T_BS, PAPER_D_THS)


@dataclass(slots=True)
class Archives:
    """The latest archives that were asked for."""

    engines: Engines
    stepper: Stepper
    _latest: Latest[ReadArchive] = field(default_factory=lambda: Latest(KEPT))

    async def get(self, campaign: Campaign) -> ReadArchive:
        """Return the archive of a campaign."""
        return await self._latest.get(campaign.id, campaign.generation, lambda: self._load(campaign))

    def stored(self, campaign: Campaign) -> tuple[Plan, StoredArchive, Archive]:
        """Return a campaign's plan, the stored rows of its archive, and the archive that they make."""
        plan = make_plan(campaign.body)
        with self.engines.reader.connect() as connection:
            stored = step_store.read_archive(connection, campaign.id, plan.problem.space.dimension)
        return plan, stored, restored_archive(plan, stored)

    async def distances(self, campaign: Campaign, archive: Archive, rows: Sequence[int]) -> FloatArray:
        """Return the distances between solutions at some positions of an archive, shape ``(rows, rows)``.

        They come from the stored matrix as far as it goes, and are computed where it does not.
        """

        def look() -> FloatArray:
            with self.engines.reader.connect() as connection:
                stored = step_store.read_distances(connection, campaign.id, rows)
            return archive.distances(rows, rows) if stored is None else stored

        return await asyncio.get_running_loop().run_in_executor(None, look)

    def _load(self, campaign: Campaign) -> ReadArchive:
        plan = make_plan(campaign.body)
        live = self.stepper.archive(campaign.id, campaign.generation)
        if live is not None:
            return ReadArchive(plan=plan, archive=live, generation=campaign.generation)

        def read(connection: Connection) -> StoredArchive:
            return step_store.read_archive(connection, campaign.id, plan.problem.space.dimension)

        with self.engines.reader.connect() as connection:
            stored = read(connection)
        return ReadArchive(plan=plan, archive=restored_archive(plan, stored), generation=stored.generation)
