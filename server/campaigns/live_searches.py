"""The searches in memory: the most recently stepped ones, within a limit on memory.

A search that is not in memory is restored from its checkpoint when its next step is due, bit for bit. That costs time
but changes nothing.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

from brink.server.campaigns.plan import LiveSearch

MIB: Final = 2**20


@dataclass(slots=True)
class LiveSearches:
    """The searches in memory; safe to use from several threads.

    Attributes:
        most_bytes: Memory above which searches are dropped, the one whose last step is longest ago first. The search
            whose step was taken last is always kept.
        on_drop: Called with the campaign of each dropped search.
    """

    most_bytes: int
    on_drop: Callable[[str], None]
    _kept: OrderedDict[str, LiveSearch] = field(default_factory=OrderedDict)
    _bytes: int = 0
    _lock: Lock = field(default_factory=Lock)

    def get(self, campaign_id: str) -> LiveSearch | None:
        """Return the search of a campaign, or None if it is not in memory."""
        return self._kept.get(campaign_id)

    def keep(self, campaign_id: str, live: LiveSearch) -> None:
        """Keep the search of a campaign, whose step was just taken."""
        with self._lock:
            self._remove(campaign_id)
            self._kept[campaign_id] = live
            self._bytes += live.size
            dropped = []
            while self._bytes > self.most_bytes and len(self._kept) > 1:
                oldest = next(iter(self._kept))
                self._remove(oldest)
                dropped.append(oldest)
        for campaign in dropped:
            self.on_drop(campaign)

    def drop(self, campaign_id: str) -> None:
        """Drop the search of a campaign, if it is in memory."""
        with self._lock:
            self._remove(campaign_id)

    @property
    def campaigns(self) -> tuple[str, ...]:
        """The campaigns whose searches are in memory."""
        with self._lock:
            return tuple(self._kept)

    @property
    def size(self) -> int:
        """Measured memory of the searches, in bytes."""
        return self._bytes

    def _remove(self, campaign_id: str) -> None:
        kept = self._kept.pop(campaign_id, None)
        if kept is not None:
            self._bytes -= kept.size
