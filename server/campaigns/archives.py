"""Caches of archives and of the monitors fitted to them: concurrent requests share one computation."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection

from brink.search.algorithm import Known
from brink.search.analysis.choices import Model
from brink.search.analysis.monitor import Monitor, default_model
from brink.search.archive import Archive, archive_digest
from brink.search.deadline import check_time
from brink.search.errors import MissingExtra
from brink.search.space import FloatArray, IntArray
from brink.server.campaigns import step_store, view_store
from brink.server.campaigns.advance import Stepper
from brink.server.campaigns.known import KnownRecord, known_of, read_known
from brink.server.campaigns.plan import Plan, make_plan, restored_archive
from brink.server.campaigns.step_store import StoredArchive
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.errors import Conflict
from brink.server.problems.base import Problem, activity_of
from brink.server.single_flight import SingleFlightCache

CACHED = 8
"""Maximum number of archives, and of monitors, in memory."""
MOST_FITTED = 20_000
"""Maximum number of solutions that a monitor is fitted to, the latest ones; it bounds the time for the fit."""


@dataclass(frozen=True, kw_only=True)
class ReadArchive:
    """A campaign's archive as of its last completed generation, with values derived from it."""

    plan: Plan
    archive: Archive
    generation: int
    known: Known

    @cached_property
    def with_known(self) -> Archive:
        """The archive with the known results that the campaign started from, whose numbers are negative."""
        known = self.known
        numbers = -1 - np.arange(len(known))
        return self.archive.grown(numbers, known.rows, known.unsafe, known.robustness, keep_rows=False)

    @cached_property
    def digest(self) -> str:
        """The digest of the archive."""
        return archive_digest(self.archive)

    @cached_property
    def places(self) -> Mapping[int, int]:
        """The position of each solution in the archive, by its number."""
        return {number: place for place, number in enumerate(self.archive.numbers.tolist())}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArchiveActivity:
    """Which parameters were active in the episodes of an archive's n solutions; see `Activity`.

    Attributes:
        recorded: Solutions whose activity was recorded, shape ``(n,)``.
        active: Whether each parameter was active, shape ``(n, d)``; true where it was not recorded.
        effective: The solutions as their episodes had them, shape ``(n, d)``; as stored where it was not recorded.
    """

    recorded: NDArray[np.bool_]
    active: NDArray[np.bool_]
    effective: FloatArray


def read_activity(
    connection: Connection,
    campaign_id: str,
    problem: Problem,
    archive: Archive,
    places: IntArray | None = None,
) -> ArchiveActivity:
    """Return which parameters were active in the episodes of a campaign's evaluated solutions.

    Args:
        connection: Read connection.
        campaign_id: The campaign.
        problem: Its problem.
        archive: Its archive.
        places: Positions of the n solutions that are asked about; None for all of the archive.
    """
    asked = np.arange(len(archive)) if places is None else places
    rows, numbers = archive.vectors[asked], archive.numbers[asked].tolist()
    recorded = np.zeros(len(rows), dtype=np.bool_)
    active = np.ones(rows.shape, dtype=np.bool_)
    effective = rows.copy()
    if problem.records_activity:
        results = view_store.read_results(connection, campaign_id, None if places is None else numbers)
        for position, number in enumerate(numbers):
            check_time()
            text = results.get(number)
            result = json.loads(text) if text else None
            activity = activity_of(problem, problem.space.split(rows[position]), result)
            if activity is not None:
                recorded[position] = True
                active[position], effective[position] = activity.active, activity.effective
    return ArchiveActivity(recorded=recorded, active=active, effective=effective)


@dataclass(slots=True)
class Archives:
    """The archives of campaigns: from the live search if it is in memory, otherwise restored from the database.

    Attributes:
        engines: The database.
        stepper: Has the live searches.
        threads: Where archives are read, so that short queries do not wait.
    """

    engines: Engines
    stepper: Stepper
    threads: Executor
    _cache: SingleFlightCache[ReadArchive] = field(init=False)
    _activities: SingleFlightCache[ArchiveActivity] = field(init=False)

    def __post_init__(self) -> None:
        self._cache = SingleFlightCache(CACHED, self.threads)
        self._activities = SingleFlightCache(CACHED, self.threads)

    async def get(self, campaign: Campaign) -> ReadArchive:
        """Return the archive of a campaign."""
        return await self._cache.get(campaign.id, campaign.generation, lambda: self._load(campaign))

    async def activity(self, campaign: Campaign, found: ReadArchive) -> ArchiveActivity:
        """Return which parameters were active in the episodes of a campaign's archive."""

        def look() -> ArchiveActivity:
            with self.engines.reader.connect() as connection:
                return read_activity(connection, campaign.id, found.plan.problem, found.archive)

        return await self._activities.get(campaign.id, found.generation, look)

    def stored(self, campaign: Campaign) -> tuple[Plan, StoredArchive, Archive]:
        """Return a campaign's plan, the stored rows of its archive, and the archive restored from them."""
        plan = make_plan(campaign.body)
        with self.engines.reader.connect() as connection:
            stored = step_store.read_archive(connection, campaign.id, plan.problem.space.dimension)
        return plan, stored, restored_archive(plan, stored)

    async def distances(self, campaign: Campaign, archive: Archive, rows: Sequence[int]) -> FloatArray:
        """Return the distances between some solutions, from the stored matrix or, where that lacks them, computed.

        Args:
            campaign: The campaign.
            archive: Its archive.
            rows: Positions of n solutions in the archive.

        Returns:
            Distances of shape ``(n, n)``.
        """

        def look() -> FloatArray:
            with self.engines.reader.connect() as connection:
                stored = step_store.read_distances(connection, campaign.id, rows)
            return archive.distances(rows, rows) if stored is None else stored

        return await asyncio.get_running_loop().run_in_executor(self.threads, look)

    def _load(self, campaign: Campaign) -> ReadArchive:
        live = self.stepper.archive(campaign.id, campaign.generation)
        if live is not None:
            plan, generation, archive = make_plan(campaign.body), campaign.generation, live
        else:
            plan, stored, archive = self.stored(campaign)
            generation = stored.generation
        records: Sequence[KnownRecord] = ()
        if campaign.body.start_from is not None:
            with self.engines.reader.connect() as connection:
                records = read_known(connection, campaign.id)
        known = known_of(records, plan.problem.space.dimension)
        return ReadArchive(plan=plan, archive=archive, generation=generation, known=known)


@dataclass(slots=True)
class Monitors:
    """The runtime monitors of campaigns.

    Attributes:
        archives: Where campaigns are read.
        threads: Where monitors are fitted, so that other requests do not wait.
    """

    archives: Archives
    threads: InitVar[Executor]
    _cache: SingleFlightCache[Monitor] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads)

    async def get(self, campaign: Campaign, model: Model | None = None) -> Monitor:
        """Return the monitor fitted to a campaign's solutions so far.

        Args:
            campaign: The campaign.
            model: The model to fit; None for the more accurate one that can be fitted.

        Raises:
            Conflict: The campaign has too few evaluated solutions, or scikit-learn is not installed.
        """
        key = f"{campaign.id} {model or ''}"
        return await self._cache.get(key, campaign.generation, lambda: self._fit(campaign, model))

    def _fit(self, campaign: Campaign, model: Model | None) -> Monitor:
        plan, _, archive = self.archives.stored(campaign)
        if len(archive) < 2:
            raise Conflict(
                f"campaign {campaign.id}: a monitor needs at least two evaluated solutions, got {len(archive)}"
            )
        vectors, unsafe = archive.vectors[-MOST_FITTED:], archive.unsafe[-MOST_FITTED:]
        try:
            return Monitor.fitted(
                plan.problem.space,
                vectors,
                unsafe,
                threshold=plan.neighbourhood.p_th,
                z=plan.neighbourhood.z,
                seed=campaign.body.seed,
                model=model or default_model(unsafe),
            )
        except (MissingExtra, ValueError) as error:
            raise Conflict(f"campaign {campaign.id}: {error}") from None
