"""Deletes campaigns: they disappear at once, and their rows are erased piece by piece.

A campaign goes with its follow-ups, theirs, and so on: a tree. `read_trees` says what a deletion would take along.
`mark_deleted` alone decides whether it may: every campaign of a tree must have ended. All ways to delete use it.

A campaign may have gigabytes of rows, and deleting them in one transaction would keep all other requests waiting. So
the first transaction only marks the tree: from then on nobody finds it. An `Eraser` then deletes the rows in small
transactions. Whatever interrupts it, the mark stays, and the next coordinator that runs on the database goes on.
"""

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
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
    FollowUpRow,
    GenerationRow,
    KnownSolutionRow,
    LlmCallRow,
    SolutionRow,
    ViolationNameRow,
)
from brink.server.db.sql import database_now, in_list, lock_rows
from brink.server.db.writer import Writer
from brink.server.errors import Conflict, Unavailable
from brink.server.queue import job_store
from brink.server.states import ENDED, CampaignStatus

PIECE_ROWS: Final = 200
PIECE_BYTES: Final = 8 * 1024 * 1024
"""Most rows, and most bytes of distances, that one transaction deletes; a single block may be larger."""
_DISTANCE_BYTES: Final = 4
_KEYS: Final[Sequence[InstrumentedAttribute[int]]] = (
    SolutionRow.number,
    KnownSolutionRow.place,
    GenerationRow.number,
    LlmCallRow.request,
    ViolationNameRow.number,
)
"""Column that orders the rows of a campaign, for each of the tables with many of them; further rows are deleted with
the row of the campaign."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TreeMember:
    """A campaign of a tree of follow-ups.

    Attributes:
        follow_up_of: The campaign of the same tree that it is a follow-up of; None for the root.
    """

    id: str
    name: str
    status: CampaignStatus
    finished_at: datetime | None
    follow_up_of: str | None


_MEMBERS: Final = (
    select(CampaignRow.id, CampaignRow.name, CampaignRow.status, CampaignRow.finished_at)
    .where(in_list(CampaignRow.id, "ids"), CampaignRow.deleted_at.is_(None))
    .order_by(CampaignRow.id)
)
_FOLLOW_UPS: Final = (
    select(FollowUpRow.campaign_id, FollowUpRow.of_id)
    .where(in_list(FollowUpRow.of_id, "ids"))
    .order_by(FollowUpRow.campaign_id)
)


def read_trees(connection: Connection, roots: Sequence[str], *, lock: bool = False) -> list[TreeMember]:
    """Return campaigns with all their follow-ups, tree by tree, each follow-up after its campaign.

    Args:
        connection: To read from; in a write transaction if `lock` is set.
        roots: Ids of the campaigns.
        lock: Whether to lock all rows until the transaction ends. No follow-up can then be added: storing one locks
            the campaign that it is about.
    """
    members = lock_rows(_MEMBERS, connection, CampaignRow) if lock else _MEMBERS
    found = dict[str, TreeMember]()
    level = dict[str, str | None].fromkeys(roots)
    while level:
        for row in connection.execute(members, {"ids": list(level)}):
            found[row.id] = TreeMember(
                id=row.id,
                name=row.name,
                status=CampaignStatus(row.status),
                finished_at=row.finished_at,
                follow_up_of=level[row.id],
            )
        below = connection.execute(_FOLLOW_UPS, {"ids": list(level)}).all()
        level = {row.campaign_id: row.of_id for row in below if row.campaign_id not in found}
    children = dict[str | None, list[TreeMember]]()
    for one in found.values():
        children.setdefault(one.follow_up_of, []).append(one)
    ordered, waiting = list[TreeMember](), [found[one] for one in reversed(roots) if one in found]
    while waiting:
        ordered.append(waiting.pop())
        waiting += reversed(children.get(ordered[-1].id, []))
    return ordered


def mark_deleted(connection: Connection, roots: Sequence[str]) -> list[TreeMember]:
    """Mark campaigns and all their follow-ups as deleted, which hides them; return those that were marked.

    Args:
        connection: In a write transaction.
        roots: Ids of the campaigns.

    Raises:
        Conflict: One of them, or of their follow-ups, has not ended. Nothing is marked.
    """
    doomed = read_trees(connection, roots, lock=True)
    for member in doomed:
        if member.status not in ENDED:
            which = f"campaign {member.id}" + (
                f", a follow-up of {member.follow_up_of}," if member.follow_up_of else ""
            )
            raise Conflict(f"{which} is {member.status}: cancel it before deleting it")
    gone = [member.id for member in doomed]
    # The key is free for another submission.
    values = {"deleted_at": database_now(connection), "idempotency_key": None, "sequence": NEXT_SEQUENCE}
    ids = {"ids": gone}
    connection.execute(update(CampaignRow).where(in_list(CampaignRow.id, "ids")).values(values), ids)
    connection.execute(delete(FollowUpRow).where(in_list(FollowUpRow.campaign_id, "ids")), ids)
    connection.execute(
        delete(ExperimentCampaignRow).where(in_list(ExperimentCampaignRow.campaign_id, "ids")), ids
    )
    return doomed


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
        """Start erasing the campaigns that are marked as deleted, unless that is already running."""
        self._is_wanted = True
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def finish(self) -> None:
        """Wait until everything that was to be erased is gone."""
        if self._task is not None:
            await self._task

    async def stop(self) -> None:
        """Stop after the current piece; the next coordinator continues."""
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
