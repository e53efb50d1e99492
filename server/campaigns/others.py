"""Decides which of several coordinators takes a campaign's steps: the one that has its search in memory.

Any other one would first have to read the whole archive, only to find that the step has been taken meanwhile. So it
leaves a step that is due, and tells the others, if it knows of any. If nobody has taken the step after a while, it
takes it nevertheless. Two coordinators that take the same step do no harm; see `brink.server.campaigns.advance`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

from sqlalchemy import select

from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.db.models import GenerationRow
from brink.server.db.writer import Writer
from brink.server.queue.wakeups import notify_due

PATIENCE_S: Final = 3.0
"""Shortest time for which a step is left to others."""
PATIENCE_STEPS: Final = 4.0
"""The same, relative to the time that the campaign's last step took."""
LONGEST_PATIENCE_S: Final = 30.0
WORTH_LEAVING_S: Final = 1.0
"""On SQLite, where the others are not notified, a shorter step is not left to them: they only look once a second."""
FORGET_S: Final = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _LeftStep:
    """A step that is left to others.

    Attributes:
        generation: Number of completed generations before the step.
        until_s: When this coordinator takes the step itself, on the monotonic clock.
    """

    generation: int
    until_s: float


@dataclass(slots=True)
class OtherCoordinators:
    """The other coordinators on the same database that may take steps; safe to use from several threads.

    Attributes:
        engines: The database.
        writer: Its writer.
        are_known: Returns whether there are any, as far as is known.
        clock: Monotonic clock, in seconds.
    """

    engines: Engines
    writer: Writer
    are_known: Callable[[], bool]
    clock: Callable[[], float] = time.monotonic
    _left: dict[str, _LeftStep] = field(default_factory=dict)
    _taken_over: set[str] = field(default_factory=set)
    _lock: Lock = field(default_factory=Lock)

    def take_over(self, campaign_id: str) -> None:
        """Take the next step of a campaign here: no coordinator has its search in memory."""
        self._taken_over.add(campaign_id)

    def forget(self, campaign_id: str) -> None:
        """Forget a campaign that has ended or is paused."""
        self._taken_over.discard(campaign_id)
        with self._lock:
            self._left.pop(campaign_id, None)

    def leave_step(self, campaign: Campaign) -> bool:
        """Return whether a due step is left to the other coordinators, and notify them if it is.

        Args:
            campaign: The campaign, whose search this coordinator does not have in memory.
        """
        if campaign.id in self._taken_over:
            self._taken_over.discard(campaign.id)
            return False
        now = self.clock()
        left = self._left.get(campaign.id)
        if left is not None and left.generation == campaign.generation:
            return now < left.until_s
        last_step_s = self._last_step_s(campaign)
        if (self.engines.is_sqlite and last_step_s < WORTH_LEAVING_S) or not self.are_known():
            return False
        patience_s = min(LONGEST_PATIENCE_S, max(PATIENCE_S, PATIENCE_STEPS * last_step_s))
        with self._lock:
            self._left = {name: one for name, one in self._left.items() if one.until_s > now - FORGET_S}
            self._left[campaign.id] = _LeftStep(generation=campaign.generation, until_s=now + patience_s)
        if not self.engines.is_sqlite:
            self.writer.submit(lambda connection: notify_due(connection, campaign.id))
        return True

    def _last_step_s(self, campaign: Campaign) -> float:
        its_last = (GenerationRow.campaign_id == campaign.id, GenerationRow.number == campaign.generation - 1)
        with self.engines.reader.connect() as connection:
            return connection.execute(select(GenerationRow.step_s).where(*its_last)).scalar() or 0.0
