"""Deletes campaigns: at once for everybody who looks, and piece by piece in the database.

A campaign may have gigabytes of rows, and deleting them in one transaction would keep all other requests waiting. So
the first transaction only marks it, together with its follow-ups: from then on nobody finds it. An `Eraser` then
deletes the rows in small transactions. Whatever interrupts it, the mark stays, and the next coordinator that runs on
the database goes on.
"""

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from sqlalchemy import Connection, delete, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import InstrumentedAttribute

from brink.server.db.engine import Engines, read
from brink.server.db.models import (
    NEXT_SEQUENCE,
    CampaignRow,
    DistanceBlockRow,
    ExperimentCampaignRow,
    GenerationRow,
    KnownSolutionRow,
    LlmCallRow,
    RepeatsRow,
    SolutionRow,
    ViolationNameRow,
)
from brink.server.db.sql import database_now, in_list, lock_rows
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.queue import job_store

PIECE_ROWS: Final = 200
PIECE_BYTES: Final = 8 * 1024 * 1024
"""Most rows, and most bytes of distances, that one transaction deletes; a single block may be larger."""
_DISTANCE_BYTES: Final = 4
_KEYS: Final[Sequence[InstrumentedAttribute[int]]] = (
    SolutionRow.number, KnownSolutionRow.place, GenerationRow.number, LlmCallRow.request, ViolationNameRow.number,
)  # fmt: skip
"""Column that orders the rows of a campaign, for each of the tables with many of them; further rows are deleted with
the row of the campaign."""

log = logging.getLogger(__name__)


def mark_deleted(connection: Connection, campaigns: Sequence[str]) -> None:
    """Mark campaigns and their follow-ups as deleted: nobody finds them any more.

    Args:
        connection: In a write transaction.
        campaigns: Campaigns that have ended, as have all their follow-ups.
    """
    gone, waiting = list(campaigns), list(campaigns)
    while waiting:
        follow_ups = select(RepeatsRow.campaign_id).where(RepeatsRow.of_id == waiting.pop())
        found = list(connection.execute(follow_ups).scalars())
        gone += found
        waiting += found
    # The key is free for another submission.
    values = {"deleted_at": database_now(connection), "idempotency_key": None, "sequence": NEXT_SEQUENCE}
    ids = {"ids": gone}
    connection.execute(update(CampaignRow).where(in_list(CampaignRow.id, "ids")).values(values), ids)
    connection.execute(delete(RepeatsRow).where(in_list(RepeatsRow.campaign_id, "ids")), ids)
    connection.execute(
        delete(ExperimentCampaignRow).where(in_list(ExperimentCampaignRow.campaign_id, "ids")), ids
    )


def marked_campaigns(connection: Connection) -> list[str]:
    """Return the campaigns that are marked as deleted and not yet erased, the first marked first."""
    marked = CampaignRow.deleted_at
    return list(
        connection.execute(select(CampaignRow.id).where(marked.is_not(None)).order_by(marked)).scalars()
    )


def erase_piece(connection: Connection, campaign_id: str) -> bool:
    """Delete some rows of a campaign that is marked as deleted; return whether nothing is left to do.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign. If another coordinator is erasing it, nothing is done.
    """
    marked = select(CampaignRow.id).where(CampaignRow.id == campaign_id, CampaignRow.deleted_at.is_not(None))
    if connection.execute(lock_rows(marked, connection, CampaignRow, skip_locked=True)).one_or_none() is None:
        return True
    left = PIECE_ROWS
    left -= job_store.delete_some(connection, campaign_id, left)
    if left > 0:
        left -= _erase_distances(connection, campaign_id, left)
    for key in _KEYS:
        if left > 0:
            left -= _erase_rows(connection, campaign_id, key, left)
    if left <= 0:
        return False
    connection.execute(delete(CampaignRow).where(CampaignRow.id == campaign_id))
    return True


def _erase_rows(connection: Connection, campaign_id: str, key: InstrumentedAttribute[int], limit: int) -> int:
    """Delete some rows of a campaign from the table of `key`; return how many."""
    table: Any = key.class_
    own = table.campaign_id == campaign_id
    keys = list(connection.execute(select(key).where(own).order_by(key).limit(limit)).scalars())
    if keys:
        connection.execute(delete(table).where(own, in_list(key, "keys")), {"keys": keys})
    return len(keys)


def _erase_distances(connection: Connection, campaign_id: str, limit: int) -> int:
    """Delete some distances of a campaign; return how many blocks, or the limit if there are more large ones."""
    block, size = DistanceBlockRow, 0
    own = block.campaign_id == campaign_id
    query = select(block.generation, block.rows * block.columns).where(own).order_by(block.generation)
    generations: list[int] = []
    for generation, count in connection.execute(query.limit(limit)).all():
        size += count * _DISTANCE_BYTES
        if generations and size > PIECE_BYTES:
            break
        generations.append(generation)
    if generations:
        some = delete(block).where(own, in_list(block.generation, "generations"))
        connection.execute(some, {"generations": generations})
    return limit if size > PIECE_BYTES else len(generations)


@dataclass(slots=True)
class Eraser:
    """Erases deleted campaigns in the background, one piece after another.

    Attributes:
        engines: The database.
        writer: Where the pieces wait in line with all other requests that write.
    """

    engines: Engines
    writer: Writer
    _is_wanted: bool = False
    _is_stopping: bool = False
    _task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to erase the campaigns that are marked as deleted, unless that is going on."""
        self._is_wanted = True
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def finish(self) -> None:
        """Wait until everything that was to be erased is gone."""
        if self._task is not None:
            await self._task

    async def stop(self) -> None:
        """Stop after the current piece; the next coordinator goes on."""
        self._is_stopping = True
        await self.finish()

    async def _run(self) -> None:
        while self._is_wanted and not self._is_stopping:
            self._is_wanted = False
            try:
                for campaign_id in await read(self.engines, marked_campaigns):
                    await self._erase(campaign_id)
            except (Unavailable, SQLAlchemyError) as error:
                log.warning("deleted campaigns: %s; going on later", error)
                return

    async def _erase(self, campaign_id: str) -> None:
        piece = partial(erase_piece, campaign_id=campaign_id)
        while not self._is_stopping and not await self.writer.write(piece):
            pass


def erase_all(engines: Engines) -> None:
    """Erase all campaigns that are marked as deleted, for commands without a coordinator."""
    with engines.reader.connect() as connection:
        campaigns = marked_campaigns(connection)
    for campaign_id in campaigns:
        is_done = False
        while not is_done:
            with engines.writer.begin() as connection:
                is_done = erase_piece(connection, campaign_id)
