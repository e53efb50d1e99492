"""The stored traces of solutions, the jobs that record them, and the pictures of their films."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

from sqlalchemy import Connection, and_, select
from sqlalchemy.orm import InstrumentedAttribute

from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines, read
from brink.server.db.models import JobRow, SolutionRow, TraceRow
from brink.server.errors import NotFound
from brink.server.queue import job_store
from brink.server.queue.job_store import EVALUATIONS
from brink.server.single_flight import SingleFlightCache
from brink.server.states import JobKind, JobStatus
from brink.sim.errors import SimulatorError
from brink.sim.trace import Trace

FILMS_KEPT: Final = 4
LARGEST_FILM_BYTES: Final = 32 * 1024**2
"""Maximum total size of the pictures of a film; this project's workers never exceed it."""
MOST_COMPARED: Final = 200
"""Maximum number of simulations that are compared with their repetition."""
JPEG_MAGIC: Final = b"\xff\xd8"

Pictures: TypeAlias = Sequence[bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceStatus:
    """The state of a solution's trace.

    Attributes:
        document: The trace, if it is kept.
        needs: Capability that a worker needs to record it; None if the solution was not simulated.
        job: Status of the job that records it; None if the trace was not requested.
        last_error: Last error of that job.
    """

    document: bytes | None
    needs: str | None
    job: JobStatus | None
    last_error: str | None


def trace_status(connection: Connection, campaign_id: str, number: int) -> TraceStatus:
    """Return the state of a solution's trace.

    Args:
        connection: To the database.
        campaign_id: The solution's campaign.
        number: The solution.
    """
    episode = job_store.find_job_of(connection, campaign_id, number, JobKind.EPISODE)
    job = job_store.find_job_of(connection, campaign_id, number, JobKind.TRACE)
    return TraceStatus(
        document=_kept(connection, TraceRow.data, campaign_id, number),
        needs=None if episode is None else episode.needs,
        job=None if job is None else job.status,
        last_error=None if job is None else job.last_error,
    )


def request_trace(connection: Connection, campaign: Campaign, number: int) -> bool:
    """Enqueue the job that records the trace of a solution, unless it exists; return whether it exists now.

    Args:
        connection: To the database.
        campaign: The solution's campaign.
        number: The solution.
    """
    job_store.enqueue_traces(connection, campaign.id, [number], campaign.job_settings)
    return job_store.find_job_of(connection, campaign.id, number, JobKind.TRACE) is not None


def driven_again(connection: Connection, campaign_id: str) -> tuple[int, int]:
    """Return how many simulations were run again to record their traces, and how many of these had another result.

    Those that ran on a processor with other arithmetic are left out: their last digits may differ.

    Args:
        connection: To the database.
        campaign_id: The campaign.
    """
    query = (
        select(EVALUATIONS.c.result, JobRow.result)
        .join(
            JobRow,
            and_(JobRow.campaign_id == EVALUATIONS.c.campaign_id, JobRow.number == EVALUATIONS.c.number),
        )
        .where(
            JobRow.campaign_id == campaign_id,
            JobRow.kind == JobKind.TRACE,
            JobRow.result.is_not(None),
            EVALUATIONS.c.result.is_not(None),
        )
        .limit(MOST_COMPARED)
    )
    pairs = [(json.loads(first), json.loads(again)) for first, again in connection.execute(query)]
    alike = [
        (first, again)
        for first, again in pairs
        if first["provenance"].get("instruction_set") == again["provenance"].get("instruction_set")
    ]
    parts = ("verdicts", "objectives", "features")
    differ = sum(
        any(
            json.dumps(first[part], sort_keys=True) != json.dumps(again[part], sort_keys=True)
            for part in parts
        )
        for first, again in alike
    )
    return len(alike), differ


def _kept(connection: Connection, column: InstrumentedAttribute[Any], campaign_id: str, number: int) -> Any:
    """Return a column of a solution's trace; None if no trace is kept."""
    query = (
        select(column)
        .join(SolutionRow, SolutionRow.spec_hash == TraceRow.spec_hash)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.number == number)
    )
    return connection.execute(query).scalar_one_or_none()


@dataclass(slots=True)
class Films:
    """Serves single pictures of films, and keeps the most recently used films unpacked.

    Attributes:
        engines: Databases with the traces.
    """

    engines: Engines
    _cache: SingleFlightCache[Pictures] = field(default_factory=lambda: SingleFlightCache(FILMS_KEPT))

    async def picture(self, campaign: Campaign, number: int, index: int) -> bytes:
        """Return a picture of a solution's film, as JPEG.

        Args:
            campaign: The solution's campaign.
            number: The solution.
            index: Index of the picture in the film.

        Raises:
            NotFound: No trace is kept, it has no film, or the film has no such picture.
        """
        # Identical simulations share one trace.
        key = await read(self.engines, lambda c: _kept(c, TraceRow.spec_hash, campaign.id, number))
        if key is None:
            raise NotFound(
                f"campaign {campaign.id}: no trace of solution {number} is kept; request its episode first"
            )
        pictures = await self._cache.get(key, 0, lambda: self._pictures(campaign.id, number))
        if index >= len(pictures):
            raise NotFound(
                f"solution {number}: its film has {len(pictures)} pictures, but no picture {index}"
            )
        picture = pictures[index]
        if not picture.startswith(JPEG_MAGIC):
            raise NotFound(f"solution {number}: picture {index} of its film is not a JPEG")
        return picture

    def _pictures(self, campaign_id: str, number: int) -> Pictures:
        """Return the pictures of a film; none if there is no film that can be shown."""
        with self.engines.reader.connect() as connection:
            document = _kept(connection, TraceRow.data, campaign_id, number)
        if document is None:
            raise NotFound(f"campaign {campaign_id}: the trace of solution {number} was just removed")
        try:
            film = Trace.from_bytes(document).film
        except (SimulatorError, LookupError, ValueError, TypeError, MemoryError):
            return ()  # a worker may send anything
        if film is None or sum(map(len, film.pictures)) > LARGEST_FILM_BYTES:
            return ()
        return film.pictures
